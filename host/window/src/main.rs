//! `simod-viewer`: the window to edit a model in.

use std::process::ExitCode;

fn main() -> ExitCode {
    simod_window::main()
}
