//! Readers of damaged files: sessions with the strokes and selections beside them, and what is remembered
//! of plugins. Any bytes are an error or fit, and nothing panics. Hashes are made to fit what is
//! damaged, so that what is behind them is reached. `PROPTEST_CASES` says how many.
#![allow(clippy::unwrap_used, reason = "a panic is how a test fails")]

use std::path::Path;

use proptest::prelude::*;
use simod_model::output;
use simod_session::plugins::PluginFolder;
use simod_session::session_file::{SessionFile, inputs};
use simod_session::step::Action;
use simod_session::{PluginOptions, PluginRegistry, Stack};
use simod_tests::damage::{damage, damaged, runner};
use xxhash_rust::xxh3::xxh3_128;

const SESSION: &str = r#"version = 1
[model]
path = "model.ply"
fingerprint = "xxh3-128:0123"
[sampling]
samples = 50000
grid = 64
[time]
frame = 12
rate = 24
[[step]]
deform = "warp"
plugin = { version = "1.2.0", author = "somebody", url = "there" }
state-version = 2
params = { operation = "bend", angle = 90, axis = [0, 1, 0], center = [0.5, 1e3, -2] }
[[step.region]]
role = "mask"
shapes = [{ sphere = { center = [0, 300, 0], radius = 40 } }, { box = { min = [0, 0, 0], max = [1, 1, 1] } }]
falloff = 2
[[step]]
deform = "skinning"
enabled = false
params = { weights = "weights.csv", falloff = [[0, 1], [0.5, 0.2], [1, 0]] }
[[step.joint]]
id = "arm"
at = [0, 1, 0]
[[step.joint]]
id = "hand"
at = [1, 1, 0]
parent = "arm"
[[step.handle]]
id = "hand"
move = { translate = [10, 0, 0], axis = [0, 1, 0], degrees = 30, pivot = [0, 300, 0], scale = 1 }
[[step.region]]
role = "handle"
shapes = [{ half-space = { point = [0, 0, 0], normal = [0, -1, 0] } }, { selection = { inside = [[0, 0, 0]], outside = [[1, 1, 1]] } }]
move = { scale = 2 }
[[step.stroke]]
radius = 5
strength = 0.5
points = [[0, 310, 20], [2, 312, 20]]
pressures = [0.5, 1]
params = { brush = "smooth" }
[[step]]
refine = { shapes = [{ sphere = { center = [0, 0, 0], radius = 1 } }], error = 1e-4 }
[[step]]
refine = { auto = true, samples = 1000 }
[output]
path = "out.ply"
"#;

fn put(path: &Path, bytes: &[u8]) {
    output::write_file(path, bytes).unwrap();
}

fn all() -> impl Strategy<Value = Vec<simod_tests::damage::Damage>> {
    prop::collection::vec(damage(), 1..4)
}

/// Does with a session what commands do. Errors are fine, and of one line each.
fn use_session(path: &Path) {
    let _ = inputs(path);
    match SessionFile::load(path) {
        Ok(session) => {
            let _ = Stack::build(&session.steps, &PluginRegistry::default());
            let _ = session.output_beside(path);
            // The session that was read can be written, and says the same.
            let again = path.with_file_name("again.toml");
            if session.save(&again).is_ok() {
                let reread = SessionFile::load(&again).unwrap();
                assert_eq!(reread.steps.len(), session.steps.len());
            }
        }
        Err(e) => assert!(!e.to_string().contains('\n') && !e.hint().is_empty(), "{e}"),
    }
}

#[test]
fn damaged_sessions_do_no_harm() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("edit.toml");
    put(&path, SESSION.as_bytes());
    assert_eq!(SessionFile::load(&path).unwrap().steps.len(), 4, "a session that is whole");
    let tested = runner(400).run(&all(), |all| {
        put(&path, &damaged(SESSION.as_bytes(), SESSION.len(), &all));
        use_session(&path);
        Ok(())
    });
    tested.unwrap();
}

/// Strokes and selections that are too long for the session are in files beside it, which it names with their
/// hashes.
#[test]
fn damaged_strokes_and_selections_do_no_harm() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("edit.toml");
    let points = |n: usize| (0..n).map(|i| format!("[{i}, 0.5, 1e-3]")).collect::<Vec<_>>().join(", ");
    let many = points(1200);
    let text = format!(
        "[[step]]\ndeform = \"displacement-paint\"\n[[step.region]]\nrole = \"mask\"\n\
         shapes = [{{ selection = {{ inside = [{many}], outside = [[0, 9, 9]] }} }}]\n\
         [[step.stroke]]\nradius = 5\npoints = [{many}]\nparams = {{ brush = \"smooth\" }}\n\
         [[step.stroke]]\nradius = 1\npoints = [[1, 2, 3]]\npressures = [0.5]\n"
    );
    let written = SessionFile::parse(&text, &path).unwrap().save(&path).unwrap();
    assert_eq!(written.len(), 2, "{written:?}");
    let session = std::fs::read_to_string(&path).unwrap();
    let kept: Vec<Vec<u8>> = written.iter().map(|file| std::fs::read(file).unwrap()).collect();
    let hash = |bytes: &[u8]| format!("xxh3-128:{:032x}", xxh3_128(bytes));
    for bytes in &kept {
        assert!(session.contains(&hash(bytes)), "the session has the hash of its files");
    }
    let how = (all(), 0..written.len(), 0..3usize);
    let tested = runner(400).run(&how, |(all, which, place)| {
        // Mostly near the beginning, where the structure is.
        let within = [60, 300, kept[which].len()][place];
        let spoilt = damaged(&kept[which], within, &all);
        put(&written[which], &spoilt);
        put(&path, session.replace(&hash(&kept[which]), &hash(&spoilt)).as_bytes());
        use_session(&path);
        put(&written[which], &kept[which]);
        Ok(())
    });
    tested.unwrap();
    put(&path, session.as_bytes());
    let again = SessionFile::load(&path).unwrap();
    let Action::Deform(step) = &again.steps[0].action else { panic!("a deformation") };
    assert_eq!((step.strokes.len(), step.strokes[0].points.len()), (2, 1200));
}

/// The file of what is remembered of plugins may have any content: the libraries are asked again, or the
/// content is refused.
#[test]
fn a_damaged_memory_of_plugins_does_no_harm() {
    let folder = tempfile::tempdir().unwrap();
    let cache = folder.path().join("plugins.json");
    // Few libraries, as each may be read again for each damage.
    let libraries = folder.path().join("libraries");
    std::fs::create_dir(&libraries).unwrap();
    for name in ["simod_warp", "simod_lattice", "simod_curve"] {
        let library = simod_tests::library(name);
        std::fs::copy(&library, libraries.join(library.file_name().unwrap())).unwrap();
    }
    let shipped = PluginFolder { path: libraries, by_name: true, shipped: true };
    let options = PluginOptions { cache: Some(cache.clone()), ..PluginOptions::in_process(vec![shipped]) };
    let known = PluginRegistry::discover(&options);
    assert_eq!(known.plugins().len(), 3, "{:?}", known.rejected());
    let good = std::fs::read(&cache).unwrap();
    // Commas and colons part words, too.
    let spaced = String::from_utf8(good).unwrap().replace(',', " ,\n").replace(':', ": ");
    let tested = runner(150).run(&all(), |all| {
        put(&cache, &damaged(spaced.as_bytes(), spaced.len(), &all));
        let found = PluginRegistry::discover(&options);
        // Each library is used or refused, and what is used can be shown.
        for plugin in found.plugins() {
            assert!(!plugin.id().is_empty());
            simod_session::describe_params(plugin.params());
            plugin.params().iter().for_each(|d| drop(simod_session::param_data(d)));
        }
        Ok(())
    });
    tested.unwrap();
}
