//! Damaged files of comparisons: an error of one line, never a panic.

#![allow(clippy::unwrap_used, reason = "a panic is how a test fails")]

use std::path::Path;

use proptest::prelude::*;
use simod_compare::CompareFile;
use simod_tests::damage::{damage, damaged, runner};

const COMPARE: &str = include_str!("compare.toml");

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
