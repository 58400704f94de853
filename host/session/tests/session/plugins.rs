//! Loading real libraries: plugins, and files that are none.
#![allow(clippy::unwrap_used, clippy::disallowed_methods, reason = "a test that cannot go on shall stop")]

use crate::common;

use common::{copy, load};
use simod_model::ErrorKind;
use simod_tests::library;

#[test]
fn plugins_stand_side_by_side() {
    let registry = common::registry();
    assert!(registry.rejected().is_empty(), "{:?}", registry.rejected());
    let ids: Vec<&str> = registry.plugins().iter().map(|p| p.id()).collect();
    assert_eq!(ids, ["misbehaving", "rbf", "warp"]);
    assert!(registry.plugins().iter().all(|p| p.capabilities().evaluate));
    let warp = registry.get("warp").unwrap();
    assert_eq!(warp.name(), "Warp");
    assert!(warp.params().iter().any(|p| p.id == "angle"));
}

#[test]
fn an_unknown_plugin_is_guessed_at() {
    let error = common::registry().get("wrap").unwrap_err();
    assert_eq!(
        (error.to_string().as_str(), error.hint()),
        ("there is no plugin `wrap`", "did you mean `warp`?")
    );
    let error = common::registry().get("cloth-simulation").unwrap_err();
    assert_eq!(error.hint(), "there are misbehaving, rbf, warp");
}

/// Each bad library alone gets a reason, on one line; none keeps the good one from working.
#[test]
fn bad_libraries_do_not_hide_good_ones() {
    let folder = tempfile::tempdir().unwrap();
    let suffix = std::env::consts::DLL_SUFFIX;
    let write = |name: &str, bytes: &[u8]| {
        std::fs::write(folder.path().join(format!("{name}{suffix}")), bytes).unwrap()
    };
    let whole = std::fs::read(library("simod_warp")).unwrap();
    write("a-empty", b"");
    write("b-text", "this is no library, but a text of some length\n".repeat(20).as_bytes());
    write("c-half", &whole[..whole.len() / 2]);
    write("d-header", &whole[..64]);
    write("e-nearly", &whole[..whole.len() - whole.len() / 20]);
    std::fs::create_dir(folder.path().join(format!("f-folder{suffix}"))).unwrap();
    std::fs::write(folder.path().join("g-other.txt"), "left alone").unwrap();
    copy("simod_warp", folder.path(), "z-good");

    let registry = load(folder.path());
    assert_eq!(registry.plugins().len(), 1);
    assert_eq!(registry.rejected().len(), 5, "{:?}", registry.rejected());
    for rejected in registry.rejected() {
        let text = rejected.error.to_string();
        assert_eq!(rejected.error.kind(), ErrorKind::Plugin);
        assert!(text.contains(rejected.path.to_str().unwrap()), "{text}");
        assert!(!text.contains('\n') && text.len() < 300, "{text}");
        assert!(!rejected.error.hint().is_empty());
    }
}

/// Any library that is not ours will do.
#[test]
#[cfg(all(target_os = "linux", target_pointer_width = "64"))]
fn a_library_that_is_no_plugin_is_named() {
    let maps = std::fs::read_to_string("/proc/self/maps").unwrap();
    let libc = maps.split_whitespace().find(|w| w.contains("/libc.so") || w.contains("/libc-2")).unwrap();
    let folder = tempfile::tempdir().unwrap();
    std::os::unix::fs::symlink(libc, folder.path().join("libc.so")).unwrap();
    let registry = load(folder.path());
    let text = registry.rejected()[0].error.to_string();
    assert!(text.ends_with("is no SIMOD plugin"), "{text}");
}

#[test]
fn of_two_plugins_of_one_id_one_is_used() {
    let folder = tempfile::tempdir().unwrap();
    let first = copy("simod_warp", folder.path(), "a");
    let second = copy("simod_warp", folder.path(), "b");
    let registry = load(folder.path());
    assert_eq!(registry.plugins().len(), 1);
    let [duplicate] = registry.duplicates() else { panic!("{:?}", registry.duplicates()) };
    assert_eq!((&duplicate.used, &duplicate.unused), (&first, &second));
    assert_eq!(duplicate.id, "warp");
}

#[test]
fn a_folder_that_is_not_there_is_fine() {
    let registry = load(std::path::Path::new("/nonexistent/plugins"));
    assert!(registry.plugins().is_empty() && registry.rejected().is_empty());
}

/// A library that is written anew while the program runs is another plugin, beside which the old one goes on.
#[test]
fn a_changed_library_is_loaded_anew() {
    let folder = tempfile::tempdir().unwrap();
    let file = copy("simod_warp", folder.path(), "tool");
    copy("misbehaving", folder.path(), "other");
    let mut registry = load(folder.path());
    let (old, other) = (registry.get("warp").unwrap().clone(), registry.get("misbehaving").unwrap().clone());
    registry.refresh(&common::options(folder.path()));
    assert!(std::sync::Arc::ptr_eq(registry.get("warp").unwrap(), &old), "nothing changed");
    // The library is replaced as by a compiler: by another file of the same name.
    std::fs::remove_file(&file).unwrap();
    copy("simod_rbf", folder.path(), "tool");
    registry.refresh(&common::options(folder.path()));
    let ids: Vec<&str> = registry.plugins().iter().map(|p| p.id()).collect();
    assert_eq!(ids, ["misbehaving", "rbf"]);
    assert!(std::sync::Arc::ptr_eq(registry.get("misbehaving").unwrap(), &other));
    assert_eq!(registry.get("rbf").unwrap().path(), file);
    assert_eq!(old.id(), "warp");
    assert!(registry.rejected().is_empty(), "{:?}", registry.rejected());
}
