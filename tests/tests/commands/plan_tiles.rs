//! Models of several tiles by units, each of which writes some of the tiles: the same bytes as by one
//! command.

use std::collections::BTreeMap;
use std::fs;
use std::process::Stdio;
use std::time::{Duration, SystemTime};

use simod_tests::Workplace;

use crate::plan::{do_all, left, shell, stages};
use crate::tiles::{names, strips};

/// The strips are bent, and samples are added.
const STEPS: &str = r#"
[[step]]
deform = "warp"
params = { operation = "twist", axis = [1, 0, 0], angle = 20 }
[[step]]
refine = { auto = true, samples = 100 }
"#;

/// Strips as tiles of a format with their session, and what `simod run` makes of them: the folder `run`.
fn survey(extension: &str) -> Workplace {
    let work = Workplace::new();
    let format = if extension == "ply" { "laz" } else { extension };
    strips(&work, format, 4, 9_000);
    // The first one is smaller than the others.
    let small = Workplace::new();
    strips(&small, format, 1, 4_000);
    work.write(&format!("tiles/t-1.{format}"), small.read(&format!("tiles/t-1.{format}")));
    if extension == "ply" {
        for tile in names(&work, "tiles") {
            work.simod(&format!("convert tiles/{tile} tiles/{} --lossy", tile.replace("laz", "ply")));
            fs::remove_file(work.path(&format!("tiles/{tile}"))).expect("a tile");
        }
    }
    // In two folders.
    fs::create_dir(work.path("more")).expect("a folder");
    let [from, to] = ["tiles/t-4", "more/t-4"].map(|name| work.path(&format!("{name}.{extension}")));
    fs::rename(from, to).expect("a tile");
    let model = format!("tiles = [\"tiles/*.{extension}\", \"more/t-4.{extension}\"]");
    let session = format!("version = 2\n[model]\n{model}\n[sampling]\nsamples = 800\n{STEPS}");
    work.write("edit.toml", session);
    work.simod("run edit.toml -o run");
    work
}

/// The bytes of all tiles in a folder.
fn written(work: &Workplace, folder: &str) -> BTreeMap<String, Vec<u8>> {
    let mut tiles = BTreeMap::new();
    for below in names(work, folder) {
        for tile in names(work, &format!("{folder}/{below}")) {
            let name = format!("{below}/{tile}");
            tiles.insert(name.clone(), work.read(&format!("{folder}/{name}")));
        }
    }
    tiles
}

/// The units that apply the deformation, and the last one.
fn last_units(work: &Workplace) -> (Vec<usize>, usize) {
    let mut stages = stages(work);
    let finish = stages.pop().expect("stages");
    (stages.pop().expect("a stage"), finish[0])
}

/// Does all units but the last `count` stages.
fn do_all_before(work: &Workplace, count: usize) {
    let stages = stages(work);
    for unit in stages[..stages.len() - count].concat() {
        work.simod(&format!("unit plan {unit}"));
    }
}

#[test]
fn units_write_what_one_command_writes() {
    for extension in ["las", "laz", "ply"] {
        let work = survey(extension);
        let expected = written(&work, "run");
        assert_eq!(expected.len(), 4);
        for units in [1, 3, 9] {
            let planned = work.report(&format!("plan edit.toml -o plan --units {units} --to out"));
            assert_eq!(planned["writing_units"], units.min(4), "{extension}: {planned}");
            do_all(&work);
            assert!(written(&work, "out") == expected, "{extension} by {units} units differs");
            // A former folder, which is replaced, leaves its permissions.
            #[cfg(unix)]
            {
                use std::os::unix::fs::PermissionsExt;
                assert_eq!(
                    mode_of(&work, "out"),
                    if units == 1 { mode_of(&work, "run") } else { 0o710 },
                    "{units} units"
                );
                fs::set_permissions(work.path("out"), fs::Permissions::from_mode(0o710))
                    .expect("permissions");
            }
            let left = left(&work);
            let are_gone =
                ["part-", "output.", "."].iter().all(|of| !left.iter().any(|name| name.starts_with(of)));
            assert!(are_gone && left.contains(&"finished.toml".to_owned()), "{left:?}");
        }
        assert!(!work.names().iter().any(|name| name.starts_with(".simod")), "{:?}", work.names());
    }
}

/// Meshes of several kinds as tiles, and a cloud: all have a say in the samples.
#[test]
fn units_read_faces_of_tiles() {
    let work = Workplace::new();
    fs::create_dir(work.path("tiles")).expect("a folder");
    work.simod("generate -o tiles/a.ply --vertices 90000 --no-normals");
    work.simod("generate -o tiles/b.ply --vertices 30000 --shape bar --no-faces");
    work.simod("generate -o tiles/c.ply --vertices 50000 --shape bumpy-plane");
    work.write("edit.toml", format!("[model]\npath = \"tiles/*.ply\"\n[sampling]\nsamples = 3000\n{STEPS}"));
    let read = |folder: &str| -> Vec<Vec<u8>> {
        names(&work, folder).iter().map(|tile| work.read(&format!("{folder}/{tile}"))).collect()
    };
    work.simod("run edit.toml -o run");
    for units in [1, 3, 7] {
        let planned = work.report(&format!("plan edit.toml -o plan --units {units} --to out"));
        assert_eq!(planned["face_units"].as_u64() > Some(0), units > 1, "{planned}");
        do_all(&work);
        assert!(read("out") == read("run"), "by {units} units");
    }
}

/// The permissions of a folder.
#[cfg(unix)]
fn mode_of(work: &Workplace, folder: &str) -> u32 {
    use std::os::unix::fs::PermissionsExt;
    fs::metadata(work.path(folder)).expect("a folder").permissions().mode() & 0o777
}

#[test]
fn engines_do_the_units() {
    let work = survey("laz");
    work.simod("plan edit.toml -o plan --units 3 --to out --emit make,slurm,commands");
    let commands = String::from_utf8(work.read("plan/commands.txt")).expect("UTF-8");
    commands.lines().filter(|line| !line.starts_with('#')).for_each(|line| shell(&work, line));
    assert!(written(&work, "out") == written(&work, "run"));
    if std::process::Command::new("make").arg("--version").output().is_err() {
        return simod_tests::skip("make is not there");
    }
    work.simod("plan edit.toml -o plan --units 3 --to made --emit make");
    shell(&work, "make -s -C plan -j 4");
    assert!(written(&work, "made") == written(&work, "run"));
    shell(&work, "make -q -C plan");
}

/// Units that are killed at any time leave nothing that hurts, and the former output until the last one is
/// done.
#[test]
fn killed_units_are_done_again() {
    let work = survey("laz");
    let expected = written(&work, "run");
    work.simod("run edit.toml -o out --method projected-barycentric");
    let former = written(&work, "out");
    assert!(former != expected);
    work.simod("plan edit.toml -o plan --units 3 --to out");
    do_all_before(&work, 2);
    let (mut state, mut killed) = (12345u64, 0);
    let (apply, finish) = last_units(&work);
    for unit in apply.into_iter().chain([finish]) {
        for attempt in 1..12u64 {
            let mut child = work.command(&format!("unit plan {unit}"));
            let mut child =
                child.stdout(Stdio::null()).stderr(Stdio::null()).spawn().expect("the program starts");
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            // Later each time, so that it comes to an end.
            std::thread::sleep(Duration::from_micros((state >> 33) % (3000 * attempt * attempt)));
            let _ = child.kill();
            if child.wait().expect("an end").success() {
                break;
            }
            killed += 1;
            let now = written(&work, "out");
            assert!(now == former || (unit == finish && now == expected), "unit {unit}: something is mixed");
        }
        work.simod(&format!("unit plan {unit}"));
    }
    assert!(killed > 5, "{killed}");
    assert!(written(&work, "out") == expected);
    let hidden: Vec<String> = left(&work).into_iter().chain(work.names()).collect();
    assert!(!hidden.iter().any(|name| name.starts_with(".simod")), "{hidden:?}");
}

/// Killed once the output was in its place, the last unit finds that it is.
#[test]
fn what_is_in_its_place_stays_there() {
    let work = survey("las");
    work.simod("plan edit.toml -o plan --units 2 --to out");
    do_all_before(&work, 1);
    let (apply, finish) = last_units(&work);
    let parts: Vec<String> = (0..apply.len()).map(|number| format!("plan/part-{number}.bin")).collect();
    let records: Vec<Vec<u8>> = parts.iter().map(|part| work.read(part)).collect();
    work.simod(&format!("unit plan {finish}"));
    let expected = written(&work, "run");
    let undone = || {
        parts.iter().zip(&records).for_each(|(part, record)| work.write(part, record));
        fs::remove_file(work.path("plan/finished.toml")).expect("a file");
    };
    undone();
    assert_eq!(work.report(&format!("unit plan {finish}"))["was_done"], false);
    assert!(written(&work, "out") == expected);
    // Tiles of the same size that were written by somebody else are none of the parts.
    undone();
    work.simod("run edit.toml -o out --method projected-barycentric");
    work.refuses(&format!("unit plan {finish}"), &["part-0.bin", "is not there as a whole"]);
    for unit in apply {
        work.simod(&format!("unit plan {unit}"));
    }
    work.simod(&format!("unit plan {finish}"));
    assert!(written(&work, "out") == expected);
}

#[test]
fn what_is_wrong_is_told() {
    let work = survey("las");
    work.simod("plan edit.toml -o plan --units 2 --to out");
    do_all_before(&work, 2);
    let (apply, finish) = last_units(&work);
    let finishing = format!("unit plan {finish}");
    // A full disk: nothing is left of the tile that was finished before.
    let largest = written(&work, "run").values().map(Vec::len).max().expect("tiles") as u64;
    let first = format!("unit plan {}", apply[0]);
    let second = work.read("tiles/t-2.las").len() as u64;
    assert!(second > largest / 2, "the second tile of the part is the one that does not fit");
    let failed = work.run_beyond(largest / 2, &first);
    assert!(failed.stderr.contains("plan/output.tiles/tiles/t-2.las"), "{}", failed.stderr);
    assert!(written(&work, "plan/output.tiles").is_empty() && !work.path("plan/part-0.bin").exists());
    for unit in &apply {
        work.simod(&format!("unit plan {unit}"));
    }
    // A tile of the output that is lost, or cut off, is written again with its part.
    let tile = "plan/output.tiles/tiles/t-1.las";
    let good = work.read(tile);
    work.write(tile, &good[..good.len() - 1]);
    work.refuses(&finishing, &["part-0.bin", "t-1.las", "is not there as a whole"]);
    assert_eq!(work.report(&first)["was_done"], false);
    assert!(work.read(tile) == good && !work.path("out").exists());
    // Files that are not of the plan are not brought along, and those that are there are not lost.
    work.write("plan/output.tiles/notes.txt", "precious");
    work.refuses(&finishing, &["notes.txt"]);
    fs::remove_file(work.path("plan/output.tiles/notes.txt")).expect("notes");
    work.write("out/mine.txt", "precious");
    work.refuses(&finishing, &["out holds mine.txt"]);
    fs::remove_dir_all(work.path("out")).expect("a folder");
    // A tile that changed meanwhile, by its size, by when it was written, and by a byte alone.
    let model = work.path("tiles/t-2.las");
    let (bytes, time) =
        (work.read("tiles/t-2.las"), fs::metadata(&model).and_then(|is| is.modified()).expect("a time"));
    work.write("tiles/t-2.las", &bytes[..bytes.len() - 1]);
    work.refuses(&finishing, &["t-2.las"]);
    let mut other = bytes.clone();
    *other.last_mut().expect("bytes") ^= 1;
    let write = |bytes: &[u8], time: SystemTime| {
        work.write("tiles/t-2.las", bytes);
        fs::File::options()
            .write(true)
            .open(&model)
            .and_then(|file| file.set_modified(time))
            .expect("a time");
    };
    write(&other, time + Duration::from_secs(1));
    work.refuses(&finishing, &["part-0.bin", "another model"]);
    for unit in &apply {
        work.simod(&format!("unit plan {unit}"));
    }
    work.refuses(&finishing, &["changed since it was sampled"]);
    write(&bytes, time);
    for unit in &apply {
        work.simod(&format!("unit plan {unit}"));
    }
    work.simod(&finishing);
    assert!(written(&work, "out") == written(&work, "run"));
}

/// Tiles of which it is not known beforehand where their vertices are go to one unit.
#[test]
fn tiles_of_text_are_written_by_one_unit() {
    let work = survey("ply");
    work.simod("convert more/t-4.ply more/t-4.xyz --lossy");
    fs::remove_file(work.path("more/t-4.ply")).expect("a tile");
    let session = String::from_utf8(work.read("edit.toml")).expect("UTF-8");
    work.write("edit.toml", session.replace("t-4.ply", "t-4.xyz"));
    work.simod("run edit.toml -o one-machine");
    let planned = work.simod("plan edit.toml -o plan --units 3 --to out");
    assert!(planned.stderr.contains("one unit writes the model: it is 4 tiles of"), "{}", planned.stderr);
    do_all(&work);
    assert!(written(&work, "out") == written(&work, "one-machine"));
}

/// Where the plan is on another disk than the output, the tiles are copied.
#[cfg(target_os = "linux")]
#[test]
fn tiles_come_from_another_disk() {
    use std::os::unix::fs::MetadataExt;
    let work = survey("las");
    let elsewhere = tempfile::tempdir_in("/dev/shm").ok();
    let device = |path: &std::path::Path| fs::metadata(path).expect("a folder").dev();
    let Some(elsewhere) = elsewhere.filter(|folder| device(folder.path()) != device(&work.path("."))) else {
        return simod_tests::skip("there is no other disk");
    };
    let plan = elsewhere.path().join("plan");
    for turn in 0..2 {
        let line = format!("plan edit.toml -o {} --units 2 --to out", plan.display());
        let units = work.report(&line)["units"].as_u64().expect("a number");
        for unit in 0..units {
            work.simod(&format!("unit {} {unit}", plan.display()));
        }
        assert!(written(&work, "out") == written(&work, "run"), "turn {turn}");
        assert!(!plan.join("output.tiles").exists());
        assert!(!work.names().iter().any(|name| name.starts_with(".simod")), "{:?}", work.names());
    }
}
