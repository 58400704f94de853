//! No code: with this crate below the others, features that the libraries of the window, of what talks to
//! stores, of the tests or of the benches turn on in libraries that the program needs too are on in every
//! build, and those of the program in that of the library for Python. What would else be built once for each
//! of them, this workspace's own crates included, is built once. `tests/tests/architecture.rs` holds that.
