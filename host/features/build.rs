//! Nothing to do: without a build script, features of libraries that macros use are not turned on.

fn main() {}
