//! Damaged files of comparisons: an error of one line, never a panic.

#![allow(clippy::unwrap_used, reason = "a panic is how a test fails")]

use std::path::Path;

use proptest::prelude::*;
use simod_compare::CompareFile;
use simod_tests::damage::{damage, damaged, runner};

const COMPARE: &str = r#"[model]
path = "cactus.ply"
[sampling]
samples = 20000
[[region]]
role = "handle"
shapes = [{ sphere = { center = [0, 2, 0], radius = 0.3 } }]
move = { translate = [1, 0, 0] }
[camera]
yaw = 10
size = [400, 300]
[[method]]
name = "as rigid as possible"
deform = "laplacian"
params = { mode = "arap" }
[[method]]
name = "rbf, coarse"
deform = "rbf"
sampling = { samples = 5000 }
reconstruction = "projected-barycentric"
[[method]]
name = "a whole session"
session = "bend.toml"
"#;

#[test]
fn damaged_comparisons_do_no_harm() {
    let path = Path::new("compare.toml");
    assert_eq!(CompareFile::parse(COMPARE, path).unwrap().methods.len(), 3);
    let tested = runner(400).run(&prop::collection::vec(damage(), 1..4), |all| {
        let bytes = damaged(COMPARE.as_bytes(), COMPARE.len(), &all);
        if let Err(e) = CompareFile::parse(&String::from_utf8_lossy(&bytes), path) {
            assert!(!e.to_string().contains('\n') && !e.hint().is_empty(), "{e}");
        }
        Ok(())
    });
    tested.unwrap();
}
