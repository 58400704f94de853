//! A model that is made of several files, through the program: sampled as one, and written tile by tile.

use std::fs;
use std::path::Path;

use glam::DVec3;
use las::point::Format;
use las::{Builder, Point, Transform, Vector, Vlr, Writer};
use simod_tests::Workplace;

/// The cloud's first corner, in UTM coordinates.
const CORNER: DVec3 = DVec3::new(412_345.678, 5_318_765.432, 512.3);

/// Width of a strip of the hills, in metres.
const WIDTH: f64 = 50.0;

/// Reference system that the tiles name.
const SYSTEM: &str = "ETRS89 / UTM zone 32N";

/// The points of one of the strips of hills, which lie side by side.
fn strip(number: usize, count: usize) -> impl Iterator<Item = Point> {
    let side = count.isqrt().max(1);
    (0..count).map(move |i| {
        let (u, v) = ((i % side) as f64 / side as f64, (i / side) as f64 / side as f64);
        let x = WIDTH * (number as f64 + v);
        let z = 5.0 * (0.09 * x).sin() * (7.0 * u).cos();
        let p = CORNER + DVec3::new(x, 100.0 * u, z + 0.01 * ((i * 7919) % 1000) as f64 / 1000.0);
        Point {
            x: p.x,
            y: p.y,
            z: p.z,
            intensity: (i % 4000) as u16,
            gps_time: Some(i as f64),
            ..Point::default()
        }
    })
}

/// Writes points as LAS or LAZ, as the name says, with an offset of the tile's own.
fn write(work: &Workplace, name: &str, (offset, system): (f64, &str), points: impl Iterator<Item = Point>) {
    let mut builder = Builder::from((1, 4));
    builder.point_format = Format::new(6).expect("a format");
    builder.point_format.is_compressed = name.ends_with(".laz");
    let offsets = [412_000.0 + offset, 5_318_000.0, 0.0];
    let [x, y, z] = offsets.map(|offset| Transform { scale: 0.001, offset });
    builder.transforms = Vector { x, y, z };
    if !system.is_empty() {
        builder.vlrs.push(Vlr {
            user_id: "LASF_Projection".to_owned(),
            record_id: 2112,
            description: String::new(),
            data: format!("PROJCS[\"{system}\"]\0").into_bytes(),
        });
    }
    let header = builder.into_header().expect("a header");
    work.write(name, b"");
    let file = std::fs::File::create(work.path(name)).expect("a file");
    let mut writer = Writer::new(std::io::BufWriter::new(file), header).expect("a writer");
    points.for_each(|point| writer.write_point(point).expect("a point"));
    writer.close().expect("a file");
}

/// Strips side by side, `tiles/t-1` and so on, of so many points each, and all their points as one file.
pub(crate) fn strips(work: &Workplace, extension: &str, count: usize, points: usize) {
    for number in 0..count {
        let offset = 10.0 * number as f64;
        write(work, &format!("tiles/t-{}.{extension}", number + 1), (offset, SYSTEM), strip(number, points));
    }
    let all = (0..count).flat_map(|number| strip(number, points));
    write(work, &format!("whole.{extension}"), (0.0, SYSTEM), all);
}

/// Bends what is beyond the first strip.
fn bent(p: DVec3) -> DVec3 {
    let u = (p.x - CORNER.x - WIDTH).max(0.0);
    p + DVec3::new(0.0, 0.05 * u, 0.002 * u * u)
}

/// The file that a single tile becomes by the samples in `model.simod` and `deformed.ply`, as if these were
/// its own.
fn alone(work: &Workplace, tile: &str) -> Vec<u8> {
    work.simod(&format!("sample {tile} -o alone.simod --samples 50"));
    let table = |text: Vec<u8>| -> toml::Table {
        String::from_utf8(text).expect("text").parse().expect("a description")
    };
    let own = table(work.read("alone.simod/simod.toml"));
    let mut description = table(work.read("model.simod/simod.toml"));
    description.insert("model".to_owned(), own["model"].clone());
    work.write("alone.simod/simod.toml", description.to_string());
    for file in ["samples.ply", "sheets.bin"] {
        let from = work.path(&format!("model.simod/{file}"));
        if from.exists() {
            std::fs::copy(from, work.path(&format!("alone.simod/{file}"))).expect("a copy");
        } else {
            let _ = std::fs::remove_file(work.path(&format!("alone.simod/{file}")));
        }
    }
    let _ = std::fs::remove_file(work.path("alone.simod/cells.bin"));
    let extension = Path::new(tile).extension().and_then(|e| e.to_str()).expect("an extension");
    work.simod(&format!("reconstruct alone.simod --deformed deformed.ply -o alone.{extension}"));
    work.read(&format!("alone.{extension}"))
}

pub(crate) fn names(work: &Workplace, folder: &str) -> Vec<String> {
    let entries = std::fs::read_dir(work.path(folder)).expect("a folder");
    let mut names: Vec<String> =
        entries.map(|e| e.expect("an entry").file_name().into_string().expect("a name")).collect();
    names.sort();
    names
}

/// Samples of tiles are those of the same points in one file, and each tile becomes what it would alone.
#[test]
fn tiles_are_one_model_and_become_what_each_would_alone() {
    for extension in ["las", "laz"] {
        let work = Workplace::new();
        strips(&work, extension, 3, 21_000);
        let report = work.report(&format!("info tiles/*.{extension}"));
        assert_eq!((report["vertices"].as_u64(), report["tiles"].as_u64()), (Some(63_000), Some(3)));
        assert_eq!(report["crs"], SYSTEM);
        work.simod(&format!("sample tiles/t-*.{extension} -o model.simod --samples 2000"));
        work.simod(&format!("sample whole.{extension} -o whole.simod --samples 2000"));
        assert!(work.read("model.simod/samples.ply") == work.read("whole.simod/samples.ply"), "{extension}");
        work.move_samples("model.simod", bent);
        let line = "reconstruct model.simod --deformed deformed.ply -o out";
        work.simod(line);
        let tiles = [1, 2, 3].map(|number| format!("t-{number}.{extension}"));
        assert_eq!(names(&work, "out"), tiles);
        let written = |folder: &str| tiles.each_ref().map(|tile| work.read(&format!("{folder}/{tile}")));
        let once = written("out");
        for (tile, bytes) in tiles.iter().zip(&once) {
            assert!(*bytes == alone(&work, &format!("tiles/{tile}")), "{tile} is not what it would be alone");
        }
        // Bound, again over what is there, and by any number of threads.
        work.simod("bind model.simod");
        for threads in [1, 5] {
            work.simod(&format!("{line} --threads {threads}"));
            assert!(written("out") == once, "{threads} threads");
        }
        if extension == "las" {
            // Other bytes of the same size.
            let tile = work.read("tiles/t-2.las");
            let mut other = tile.clone();
            if let Some(last) = other.last_mut() {
                *last ^= 1;
            }
            work.write("tiles/t-2.las", &other);
            work.refuses(line, &["changed since", "probably", "t-2.las"]);
            work.write("tiles/t-2.las", &tile);
        }
        // Samples and tiles moved together; and tiles moved alone, to a folder that --model names.
        for name in ["tiles", "model.simod", "deformed.ply"] {
            std::fs::create_dir_all(work.path("moved")).expect("a folder");
            std::fs::rename(work.path(name), work.path(&format!("moved/{name}"))).expect("moved");
        }
        work.simod("reconstruct moved/model.simod --deformed moved/deformed.ply -o again");
        assert!(written("again") == once);
        std::fs::rename(work.path("moved/tiles"), work.path("elsewhere")).expect("moved");
        let moved = "reconstruct moved/model.simod --deformed moved/deformed.ply -o again";
        work.refuses(moved, &[&format!("t-1.{extension}"), "is gone"]);
        for model in ["elsewhere".to_owned(), format!("elsewhere/*.{extension}")] {
            work.simod(&format!("{moved} --model {model}"));
            assert!(written("again") == once);
        }
        // In place of the tiles, or over one of them, nothing is written.
        let over = format!("{moved} --model elsewhere");
        work.refuses(&over.replace("-o again", "-o elsewhere"), &["elsewhere", "tiles"]);
    }
}

/// Formats are mixed; a session runs, with steps that refine.
#[test]
fn formats_are_mixed_in_a_session() {
    let work = Workplace::new();
    strips(&work, "laz", 2, 10_000);
    work.simod("convert tiles/t-2.laz tiles/u.ply --lossy");
    // Without its reference system, which is in comments.
    let mut bytes = work.read("tiles/u.ply");
    let told = b"comment crs";
    while let Some(at) = bytes.windows(told.len()).position(|some| some == told) {
        bytes[at..at + told.len()].copy_from_slice(b"comment was");
    }
    work.write("tiles/u.ply", bytes);
    std::fs::remove_file(work.path("tiles/t-2.laz")).expect("a file");
    write(&work, "more/v.las", (7.0, SYSTEM), strip(2, 10_000));
    let steps = r#"
        [[step]]
        deform = "warp"
        params = { operation = "twist", angle = 20 }
        [[step]]
        refine = { auto = true, samples = 200 }
    "#;
    let session = |version: u32, tiles: &str| {
        let model = format!("[model]\ntiles = {tiles}\n[sampling]\nsamples = 1000\n");
        work.write("edit.toml", format!("version = {version}\n{model}{steps}\n[output]\npath = \"out\"\n"));
    };
    session(1, r#"["tiles/*", "more/v.las"]"#);
    work.refuses("run edit.toml", &["edit.toml, line 3", "`tiles` are of sessions of version 2"]);
    session(2, "[]");
    work.refuses("run edit.toml", &["edit.toml, line 3", "no `tiles`"]);
    session(2, r#""nothing/*.laz""#);
    work.refuses("run edit.toml", &["nothing/*.laz matches no file"]);
    session(2, r#"["tiles/*", "more/v.las"]"#);
    let outcome = work.simod("run edit.toml");
    let notes = outcome.lines("note: ");
    assert!(notes.iter().any(|note| note.contains("none is said (tiles/u.ply)")), "{}", outcome.stderr);
    assert_eq!(names(&work, "out"), ["more", "tiles"]);
    assert_eq!(names(&work, "out/tiles"), ["t-1.laz", "u.ply"]);
    for name in ["tiles/t-1.laz", "tiles/u.ply", "more/v.las"] {
        assert!(work.read(&format!("out/{name}")) != work.read(name), "{name} did not move");
    }
    // The same by units, which sample ranges, and of which one writes.
    for units in [1, 3] {
        work.simod(&format!("plan edit.toml --units {units} -o plan --to planned"));
        let text = work.read("plan/plan.toml");
        let plan: toml::Table = toml::from_str(std::str::from_utf8(&text).expect("text")).expect("TOML");
        let stages = plan["unit"].as_array().expect("units").iter();
        let stages: Vec<&str> = stages.map(|unit| unit["stage"].as_str().expect("a stage")).collect();
        assert_eq!(
            stages.iter().filter(|stage| **stage == "cluster").count(),
            if units == 1 { 0 } else { 3 }
        );
        for unit in 0..stages.len() {
            work.simod(&format!("unit plan {unit}"));
        }
        for name in ["tiles/t-1.laz", "tiles/u.ply", "more/v.las"] {
            assert!(
                work.read(&format!("planned/{name}")) == work.read(&format!("out/{name}")),
                "{name} by {units}"
            );
        }
        std::fs::remove_dir_all(work.path("planned")).expect("a folder");
    }
    // Commands that cannot take tiles say so.
    work.refuses("convert tiles/* joined.ply", &["several tiles, which are not joined"]);
}

/// Another offset is chosen for those tiles alone whose integers do not reach: of others, however far away,
/// nothing changes.
#[test]
fn offsets_are_chosen_tile_by_tile() {
    const FAR: f64 = 9e6;
    let work = Workplace::new();
    write(&work, "tiles/near.las", (0.0, SYSTEM), strip(0, 5_000));
    let far = strip(1, 5_000).map(|point| Point { x: point.x + FAR, ..point });
    write(&work, "tiles/far.laz", (FAR, SYSTEM), far);
    work.simod("sample tiles/* -o model.simod --samples 500");
    let is_far = |p: DVec3| p.x > CORNER.x + FAR / 2.0;
    let away = move |p: DVec3| if is_far(p) { p + DVec3::new(3e6, 0.0, 0.0) } else { p };
    let line = "reconstruct model.simod --deformed deformed.ply --offset auto -o";
    work.move_samples("model.simod", |p| p);
    work.simod(&format!("{line} same"));
    work.move_samples("model.simod", away);
    work.refuses("reconstruct model.simod --deformed deformed.ply -o out", &["has no room in its integers"]);
    let outcome = work.simod(&format!("{line} out"));
    assert!(outcome.stderr.contains("the offset of the positions becomes"), "{}", outcome.stderr);
    for name in ["near.las", "far.laz"] {
        assert!(work.read(&format!("same/{name}")) == work.read(&format!("tiles/{name}")), "{name}");
    }
    assert!(work.read("out/near.las") == work.read("tiles/near.las"), "what is near stays");
    let points = |name: &str| -> Vec<Point> {
        let mut reader = las::Reader::from_path(work.path(name)).expect("a reader");
        let all = reader.read_all().expect("points");
        all.points().map(|point| point.expect("a point")).collect()
    };
    for (was, is) in points("tiles/far.laz").iter().zip(points("out/far.laz")) {
        assert!((is.x - was.x - 3e6).abs() < 0.002, "{} goes to {}", was.x, is.x);
        assert!((is.y, is.z) == (was.y, was.z));
    }
}

/// Meshes side by side: the faces of each are of its own vertices.
#[test]
fn faces_of_meshes_stay_with_their_vertices() {
    let work = Workplace::new();
    std::fs::create_dir(work.path("tiles")).expect("a folder");
    work.simod("generate -o tiles/a.ply --vertices 20000");
    work.simod("generate -o b.ply --vertices 5000");
    let mut b = work.ply("b.ply");
    b.move_vertices(|p| p + DVec3::new(30.0, 0.0, 0.0));
    work.write("tiles/b.ply", &b.bytes);
    let [whole, a, b] =
        ["tiles/*.ply", "tiles/a.ply", "tiles/b.ply"].map(|model| work.report(&format!("info {model}")));
    let faces = |report: &serde_json::Value| report["faces"].as_u64().expect("a number");
    assert_eq!(faces(&whole), faces(&a) + faces(&b));
    let outcome = work.simod("sample tiles/*.ply -o model.simod --samples 1000");
    assert!(!outcome.stderr.contains("refer to vertices"), "{}", outcome.stderr);
    assert!(work.report("info model.simod")["triangles"].as_u64().is_some_and(|count| count > 1000));
    work.move_samples("model.simod", |p| p + DVec3::new(0.0, 0.02 * p.x * p.x, 0.0));
    work.simod("reconstruct model.simod --deformed deformed.ply -o out");
    for tile in ["a.ply", "b.ply"] {
        assert!(work.read(&format!("out/{tile}")) == alone(&work, &format!("tiles/{tile}")), "{tile}");
    }
    // Their faces are read all at once to refine them.
    work.simod("refine model.simod --factor 2 --sphere 30,0,0,3");
}

#[test]
fn bad_tiles_are_named_and_nothing_is_written() {
    let work = Workplace::new();
    strips(&work, "laz", 3, 5_000);
    let sample = "sample tiles/*.laz -o model.simod --samples 300";
    let refused = |what: &[&str]| {
        work.refuses(sample, what);
        assert!(!work.path("model.simod").exists());
    };
    let whole = work.read("tiles/t-2.laz");
    for (bytes, what) in
        [(&whole[..whole.len() / 2], "t-2.laz"), (b"", "t-2.laz is empty"), (b"hello", "t-2.laz")]
    {
        work.write("tiles/t-2.laz", bytes);
        refused(&[what]);
    }
    work.write("tiles/t-2.laz", &whole);
    work.refuses("sample tiles/t-1.laz tiles/t-9.laz -o model.simod", &["t-9.laz"]);
    work.refuses("sample tiles/t-1.laz tiles/*.laz -o model.simod", &["t-1.laz is named twice"]);
    std::fs::hard_link(work.path("tiles/t-1.laz"), work.path("tiles/t-4.laz")).expect("a link");
    refused(&["t-1.laz", "t-4.laz", "are the same file"]);
    std::fs::remove_file(work.path("tiles/t-4.laz")).expect("a file");
    // Other systems are named, and taken as if they were one.
    write(&work, "tiles/t-4.laz", (0.0, "ETRS89 / UTM zone 33N"), strip(3, 5_000));
    let outcome = work.simod(sample);
    let [note] = outcome.lines("note: ")[..] else { panic!("{}", outcome.stderr) };
    for named in ["zone 32N (t-1.laz, t-2.laz, t-3.laz)", "zone 33N (t-4.laz)"] {
        assert!(note.contains(named), "{note}");
    }
    work.move_samples("model.simod", bent);
    let line = "reconstruct model.simod --deformed deformed.ply -o out";
    // Files in the folder stay, unless they are former tiles.
    work.write("out/mine.txt", "precious");
    work.refuses(line, &["out holds mine.txt"]);
    work.write("file", "precious");
    work.refuses(&line.replace("-o out", "-o file"), &["file is a file"]);
    std::fs::remove_file(work.path("out/mine.txt")).expect("a file");
    work.write("out/t-1.laz", "dear");
    work.refuses(line, &["t-1.laz", "is no model"]);
    std::fs::hard_link(work.path("tiles/t-3.laz"), work.path("out/t-3.laz")).expect("a link");
    work.refuses(&format!("{line} --force"), &["out/t-3.laz", "tiles"]);
    std::fs::remove_file(work.path("out/t-3.laz")).expect("a file");
    work.simod(&format!("{line} --force"));
    // A tile changed since: by its size, and by its content alone.
    let done = work.read("out/t-2.laz");
    write(&work, "tiles/t-2.laz", (0.0, SYSTEM), strip(1, 4_000));
    work.refuses(line, &["t-2.laz changed since"]);
    let mut other = whole.clone();
    let middle = other.len() / 2;
    other[middle] ^= 1;
    work.write("tiles/t-2.laz", &other);
    work.refuses(line, &["t-2.laz"]);
    std::fs::remove_file(work.path("tiles/t-2.laz")).expect("a file");
    work.refuses(line, &["t-2.laz is gone"]);
    assert!(work.read("out/t-2.laz") == done);
    assert_eq!(names(&work, "out"), ["t-1.laz", "t-2.laz", "t-3.laz", "t-4.laz"]);
    assert!(!work.names().iter().any(|name| name.starts_with(".simod")), "{:?}", work.names());
}

/// Far more tiles than the program may have open at a time.
#[cfg(unix)]
#[test]
fn thousands_of_tiles_with_few_files_open() {
    let work = Workplace::new();
    let point = |at: DVec3| format!("{} {} {}\n", at.x, at.y, at.z);
    let header = "ply\nformat ascii 1.0\nelement vertex 4\nproperty double x\nproperty double y\nproperty double z\nend_header\n";
    let write = |folder: &str, count: usize| {
        for tile in 0..count {
            let corner = DVec3::new((tile % 50) as f64, (tile / 50) as f64, 0.0);
            let step = |i: i32| DVec3::new(f64::from(i % 2), f64::from(i / 2), 0.1 * f64::from(i)) / 2.0;
            let body: String = (0..4).map(|i| point(corner + step(i))).collect();
            work.write(&format!("{folder}/{tile}.ply"), format!("{header}{body}"));
        }
    };
    let limited = |line: &str| {
        let program = work.command(line);
        let mut shell = std::process::Command::new("sh");
        shell.args(["-c", "ulimit -n 60; exec \"$@\"", "sh"]);
        shell.arg(program.get_program()).args(program.get_args());
        let output = work.prepared(shell).output().expect("a shell");
        assert!(output.status.success(), "{line}: {}", String::from_utf8_lossy(&output.stderr));
    };
    write("many", 2000);
    limited("sample many/*.ply -o many.simod --samples 500");
    assert_eq!(work.report("info many.simod")["tiles"], 2000);
    // Fewer, as each file that is written has to come to the disk.
    write("tiles", 100);
    limited("sample tiles/*.ply -o model.simod --samples 100");
    work.move_samples("model.simod", |p| p + DVec3::new(0.0, 0.0, 0.01 * p.x * p.x));
    limited("reconstruct model.simod --deformed deformed.ply -o out");
    assert_eq!(names(&work, "out").len(), 100);
    assert!(work.read("out/99.ply") == alone(&work, "tiles/99.ply"));
}

/// Tiles become another format one by one, in a folder that appears whole or not at all.
#[test]
fn tiles_are_converted_each_by_itself() {
    let work = Workplace::new();
    strips(&work, "laz", 3, 4_000);
    fs::create_dir_all(work.path("more")).expect("a folder");
    fs::rename(work.path("tiles/t-3.laz"), work.path("more/t-3.laz")).expect("a tile");
    let line = "convert */t-*.laz out --to las";
    let report = work.report(line);
    assert_eq!((report["vertices"].as_u64(), report["tiles"].as_u64()), (Some(12_000), Some(3)));
    assert_eq!(report["lost"].as_array().map(Vec::len), Some(0));
    assert_eq!((names(&work, "out/tiles").len(), names(&work, "out/more").len()), (2, 1));
    let mut bytes = 0;
    for tile in ["tiles/t-1", "tiles/t-2", "more/t-3"] {
        work.simod(&format!("convert {tile}.laz alone.las"));
        let written = work.read(&format!("out/{tile}.las"));
        assert!(written == work.read("alone.las"), "{tile} is not what it becomes alone");
        bytes += written.len() as u64;
    }
    assert_eq!(report["bytes"].as_u64(), Some(bytes));
    // A former folder is replaced, but not what else may be there.
    work.simod(line);
    work.write("out/notes.txt", "precious");
    work.refuses(line, &["out holds notes.txt"]);
    // Losses are listed once, and have to be allowed.
    work.refuses("convert tiles/*.laz lost --to csv", &["lost/t-1.csv would lose", "reference system"]);
    let report = work.report("convert tiles/*.laz lost --to csv --lossy");
    assert_eq!(report["lost"].as_array().map(Vec::len), Some(1), "{report}");
    // Wrong options are told, and nothing is left.
    work.refuses("convert tiles/*.laz folder --to ../x", &["../x is no format"]);
    work.refuses("convert tiles/t-1.laz one.las --to las", &["--to las is for tiles"]);
    work.refuses("convert tiles/*.laz joined.las", &["several tiles, which are not joined"]);
    work.refuses("convert tiles/*.laz tiles --to laz", &["tiles"]);
    fs::copy(work.path("tiles/t-1.laz"), work.path("tiles/t-1.copc")).expect("a copy");
    work.refuses("convert tiles/t-1.* twice --to las", &["two tiles would become t-1.las"]);
    let tile = work.read("tiles/t-2.laz");
    work.write("tiles/t-2.laz", &tile[..tile.len() / 2]);
    work.refuses("convert tiles/*.laz broken --to las", &["t-2.laz"]);
    assert!(!work.names().iter().any(|name| name.starts_with(".simod")), "{:?}", work.names());
}

/// Methods are compared on tiles as on the same points in one file.
#[test]
fn methods_are_compared_on_tiles() {
    let work = Workplace::new();
    strips(&work, "las", 3, 6_000);
    let methods = r#"
        [[method]]
        name = "twist"
        deform = "warp"
        params = { operation = "twist", axis = [1, 0, 0], angle = 20 }
        [[method]]
        name = "bend"
        deform = "warp"
        params = { operation = "bend", axis = [1, 0, 0], direction = [0, 0, 1], angle = 20 }
        reconstruction = "projected-barycentric"
    "#;
    let head = |model: &str| {
        format!("[model]\npath = \"{model}\"\n[sampling]\nsamples = 600\n[camera]\nsize = [64, 64]\n")
    };
    let page = |model: &str, to: &str, options: &str| -> serde_json::Value {
        work.write("compare.toml", head(model) + methods);
        work.simod(&format!("compare compare.toml -o {to} {options}"));
        serde_json::from_slice(&work.read(&format!("{to}/compare.json"))).expect("JSON")
    };
    let tiles = page("tiles/*.las", "of-tiles", "--keep-models");
    let whole = page("whole.las", "of-whole", "");
    assert_eq!(tiles["model"]["vertices"], whole["model"]["vertices"]);
    for i in [0, 1] {
        for figure in ["samples", "displacement", "to_first", "folded_samples"] {
            let [a, b] = [&tiles, &whole].map(|page| &page["methods"][i]["figures"][figure]);
            // Sums of squares are those of as many vertices as are read at once, which end with a tile.
            let [mut a, mut b] = [a.clone(), b.clone()];
            if let [Some(x), Some(y)] = [&a, &b].map(|figure| figure["rms"].as_f64()) {
                assert!((x - y).abs() <= 1e-13 * y, "{figure}: {x} and {y}");
                (a["rms"], b["rms"]) = (serde_json::Value::Null, serde_json::Value::Null);
            }
            assert_eq!(a, b, "{figure}");
            assert!(!a.is_null() || (i, figure) == (0, "to_first"), "method {i} has no {figure}");
        }
    }
    for picture in ["rest.png", "twist.png", "bend-difference.png"] {
        let [a, b] = ["of-tiles", "of-whole"].map(|page| work.read(&format!("{page}/{picture}")));
        assert!(a == b, "{picture}");
    }
    assert_eq!(names(&work, "of-tiles/bend"), ["t-1.las", "t-2.las", "t-3.las"]);
    // The result of another program is a folder of tiles, too; the page is replaced by another one.
    let made = "[[method]]\nname = \"made\"\nmodel = \"of-tiles/bend\"\n";
    work.write("made.toml", head("tiles/*.las") + made + methods);
    for _ in 0..2 {
        let report = work.report("compare made.toml -o page");
        assert_eq!((report["done"].as_u64(), report["failed"].as_u64()), (Some(3), Some(0)));
        assert!(!work.path("page/twist").exists());
    }
    work.refuses("compare made.toml -o tiles", &["tiles"]);
    let command = "[[method]]\nname = \"program\"\ncommand = \"cp {model} {output}\"\n";
    work.write("made.toml", head("tiles/*.las") + command);
    work.refuses("compare made.toml -o other --allow-commands", &["program", "several tiles"]);
}
