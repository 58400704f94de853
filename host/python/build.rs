//! Puts the program and its plugins into the package, where the module finds them: `simod/bin`.

use std::path::{Path, PathBuf};
use std::{env, fs, io};

fn main() {
    if let Err(error) = stage() {
        println!("cargo:warning=the wheel is without the program: {error}: `cargo build --release` makes it");
    }
}

fn stage() -> io::Result<()> {
    let here = PathBuf::from(env::var_os("CARGO_MANIFEST_DIR").unwrap_or_default());
    let out = PathBuf::from(env::var_os("OUT_DIR").unwrap_or_default());
    // …/release/build/simod-python-…/out
    let built = out.ancestors().nth(3).ok_or(io::ErrorKind::NotFound)?;
    let package = here.join("simod").join("bin");
    fs::create_dir_all(&package)?;
    let mut files = vec![format!("simod{}", env::consts::EXE_SUFFIX)];
    for plugin in fs::read_dir(here.join("../../plugins"))? {
        let name = plugin?.file_name().to_string_lossy().replace('-', "_");
        files.push(format!("{}simod_{name}{}", env::consts::DLL_PREFIX, env::consts::DLL_SUFFIX));
    }
    for old in fs::read_dir(&package)? {
        fs::remove_file(old?.path())?;
    }
    files.iter().try_for_each(|file| copy(&built.join(file), &package.join(file)))
}

fn copy(from: &Path, to: &Path) -> io::Result<()> {
    println!("cargo:rerun-if-changed={}", from.display());
    fs::copy(from, to).map(drop).map_err(|e| io::Error::new(e.kind(), format!("{}: {e}", from.display())))
}
