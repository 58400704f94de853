//! Mistakes that the derives refuse: with texts that help, at the places that they speak of.

/// The compiler's messages, beside each program. `TRYBUILD=overwrite` writes them anew.
#[test]
fn mistakes_are_told_where_they_are() {
    trybuild::TestCases::new().compile_fail("tests/mistakes/*.rs");
}
