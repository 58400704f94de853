//! simod
fn main() {}
