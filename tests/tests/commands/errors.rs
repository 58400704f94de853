//! Errors about files: each time one line says what and where, one what to do, and nothing is left behind.

use glam::DVec3;
use simod_tests::{Ply, Workplace, skip};

/// A PLY file in text with these vertices.
fn text_model(vertices: &[&str]) -> String {
    let properties = "property float x\nproperty float y\nproperty float z";
    let header =
        format!("ply\nformat ascii 1.0\nelement vertex {}\n{properties}\nend_header\n", vertices.len());
    header + &vertices.iter().map(|v| format!("{v}\n")).collect::<String>()
}

/// A generated model and its samples: `model.ply`, `model.simod`.
fn sampled() -> Workplace {
    let work = Workplace::new();
    work.simod("generate -o model.ply --vertices 20000");
    work.simod("sample model.ply -o model.simod --samples 1000");
    work
}

const RECONSTRUCT: &str = "reconstruct model.simod --deformed deformed.ply -o out.ply";

#[test]
fn a_model_that_is_none() {
    let work = Workplace::new();
    work.simod("generate -o whole.ply --vertices 5000");
    let whole = work.read("whole.ply");
    work.write("empty.ply", "");
    work.write("half.ply", &whole[..whole.len() / 2]);
    work.write("header.ply", &whole[..60]);
    work.write("byte-short.ply", &whole[..whole.len() - 1]);
    work.write("text.ply", "this is a letter and no model\n");
    work.write("folder.ply/file", "");
    for model in ["missing", "empty", "half", "header", "byte-short", "text", "folder"] {
        let name = format!("{model}.ply");
        work.refuses(&format!("sample {name} -o out.simod"), &[&name]);
        if model != "folder" {
            work.refuses(&format!("info {name}"), &[&name]);
        }
        work.refuses(&format!("render {name} -o out.png"), &[&name]);
        work.write_session(&name, 100, "");
        work.refuses("run edit.toml", &[&name]);
    }
}

/// The program as it is built for these tests talks to no store, and says which one does; what is secret in a
/// URL, it does not.
#[test]
fn objects_without_object_storage() {
    let work = sampled();
    work.write("none.toml", "");
    work.simod("deform model.simod --session none.toml -o deformed.ply");
    for name in ["s3://bucket/a.ply", "https://me:5ecret@host.example/a.ply?sig=5ecret", "gs://bucket/a.ply"]
    {
        let shown = &name.replace("me:5ecret@", "").replace("?sig=5ecret", "");
        work.write_session(name, 100, "");
        for line in [
            &format!("sample {name} -o out.simod"),
            &format!("info {name}"),
            "run edit.toml",
            &format!("{RECONSTRUCT} --model={name}"),
            &format!("reconstruct model.simod --deformed deformed.ply -o {name}"),
            &format!("convert model.ply {name}"),
        ] {
            let outcome = work.refuses(line, &[shown, "this build"]);
            assert!(outcome.hint().contains("--features object-storage"), "{}", outcome.stderr);
            assert!(!outcome.stderr.contains("5ecret"), "{}", outcome.stderr);
        }
        // Pictures and other files that are no models stay in files.
        work.refuses(&format!("render model.ply -o {name}"), &[shown, "here a file is needed"]);
    }
}

/// Text cannot be measured beforehand: what is missing is noticed wherever it is.
#[test]
fn a_text_that_ends_early() {
    let work = Workplace::new();
    work.simod("generate -o whole.ply --vertices 2000 --encoding ascii");
    let whole = work.read("whole.ply");
    for tenth in [1, 5, 9] {
        work.write("cut.ply", &whole[..whole.len() * tenth / 10]);
        work.refuses("sample cut.ply -o out.simod", &["cut.ply"]);
    }
    work.write("words.ply", text_model(&["0 0 0", "0 x 0"]));
    work.refuses("sample words.ply -o out.simod", &["words.ply"]);
}

#[test]
fn a_header_that_lies() {
    let work = Workplace::new();
    let tail = "property float x\nproperty float y\nproperty float z\nend_header\n0 0 0\n1 1 1\n";
    let face = "element face 9223372036854775807\nproperty list uchar int vertex_indices\nend_header";
    for format in ["ascii", "binary_little_endian", "binary_big_endian"] {
        for count in [1000, 1 << 62, u64::MAX] {
            work.write("lie.ply", format!("ply\nformat {format} 1.0\nelement vertex {count}\n{tail}"));
            work.refuses("sample lie.ply -o out.simod", &["lie.ply"]);
        }
        let beyond = format!("ply\nformat {format} 1.0\nelement vertex 99999999999999999999999\n{tail}");
        work.write("lie.ply", beyond);
        work.refuses("sample lie.ply -o out.simod", &["lie.ply", "line 3"]);
        let faces =
            format!("ply\nformat {format} 1.0\nelement vertex 1\n{}", tail.replace("end_header", face));
        work.write("lie.ply", faces);
        work.refuses("sample lie.ply -o out.simod", &["lie.ply", "face"]);
    }
}

/// Positions that are not finite are counted and told of, and keep their bytes; all others move.
#[test]
fn positions_that_are_not_finite() {
    let work = Workplace::new();
    work.simod("generate -o model.ply --vertices 20000");
    let mut before = work.ply("model.ply");
    let odd = [(1234, f64::NAN), (7777, f64::INFINITY), (15_000, f64::NEG_INFINITY)];
    for (vertex, x) in odd {
        let p = before.positions()[vertex];
        before.set_position(vertex, DVec3 { y: x, ..p });
    }
    work.write("model.ply", &before.bytes);

    let check_told = |line: &str| {
        let outcome = work.simod(&format!("{line} --json"));
        let [warning] = outcome.lines("warning: ")[..] else { panic!("{}", outcome.stderr) };
        assert!(warning.starts_with('3') && warning.contains("vertex 1234"), "{warning}");
        let report = outcome.json();
        assert_eq!(report["non_finite"], 3);
        assert_eq!(report["warnings"].as_array().map(Vec::len), Some(1), "{report}");
    };
    check_told("sample model.ply -o model.simod --samples 1000");
    work.move_samples("model.simod", |p| p + DVec3::ONE);
    check_told(RECONSTRUCT);

    let after = work.ply("out.ply");
    assert!(after.other_bytes() == before.other_bytes());
    for (vertex, _) in odd {
        let bytes = before.position_bytes(vertex);
        assert_eq!(after.bytes[bytes.clone()], before.bytes[bytes], "vertex {vertex}");
    }
    let finite = before.positions().into_iter().zip(after.positions()).filter(|(p, _)| p.is_finite());
    assert_eq!(finite.clone().count(), 20_000 - 3);
    assert!(finite.clone().all(|(p, q)| (q - p - DVec3::ONE).length() < 1e-5), "a finite vertex went astray");

    work.write("none.ply", text_model(&["nan 0 0", "0 inf 0", "0 0 -inf"]));
    work.refuses("sample none.ply -o none.simod", &["none.ply", "3"]);
}

#[test]
fn no_point_is_an_error_and_few_are_fine() {
    let work = Workplace::new();
    work.write("none.ply", text_model(&[]));
    work.refuses("sample none.ply -o none.simod", &["none.ply"]);

    let same = ["0.5 -2 7"; 50];
    let line: Vec<String> = (0..50).map(|i| format!("{i} {} 1", 2 * i)).collect();
    let line: Vec<&str> = line.iter().map(String::as_str).collect();
    let models: [&[&str]; 5] = [&same[..1], &["0 0 0", "1 2 3"], &["0 0 0", "1 0 0", "0 1 0"], &same, &line];
    for vertices in models {
        work.write("few.ply", text_model(vertices));
        let report = work.report("sample few.ply -o few.simod --samples 10");
        assert_eq!(report["vertices"], vertices.len());
        work.simod("reconstruct few.simod --deformed few.simod/samples.ply -o out.ply");
        assert_eq!(work.read("out.ply"), work.read("few.ply"));
        // A shift is told by a single sample.
        work.move_samples("few.simod", |p| p + DVec3::new(1.0, 2.0, -3.0));
        work.simod("reconstruct few.simod --deformed deformed.ply -o out.ply");
        for (p, q) in work.ply("few.ply").positions().into_iter().zip(work.ply("out.ply").positions()) {
            assert!((q - p - DVec3::new(1.0, 2.0, -3.0)).length() < 1e-4, "{p} went to {q}");
        }
    }
}

#[test]
fn deformed_samples_that_do_not_fit() {
    let work = sampled();
    let samples = work.ply("model.simod/samples.ply");
    let count = samples.len().to_string();
    work.write("deformed.ply", text_model(&["0 0 0"; 5]));
    work.refuses(RECONSTRUCT, &["deformed.ply", "5", &count]);

    let mut broken = Ply::parse(samples.bytes.clone());
    for vertex in [17, 500] {
        broken.set_position(vertex, DVec3::new(0.0, f64::NAN, 0.0));
    }
    work.write("deformed.ply", &broken.bytes);
    work.refuses(RECONSTRUCT, &["deformed.ply", "2", "17"]);
    (100..350).for_each(|vertex| broken.set_position(vertex, DVec3::new(f64::INFINITY, 0.0, f64::NAN)));
    work.write("deformed.ply", &broken.bytes);
    for method in ["blended-jets", "projected-barycentric"] {
        work.refuses(&format!("{RECONSTRUCT} --method {method}"), &["deformed.ply", "252", "17"]);
    }

    work.write("deformed.ply", &samples.bytes[..samples.bytes.len() - 10]);
    work.refuses(RECONSTRUCT, &["deformed.ply"]);
    work.refuses(&RECONSTRUCT.replace("deformed.ply", "missing.ply"), &["missing.ply"]);
}

#[test]
fn a_source_that_changed_since() {
    let work = sampled();
    work.move_samples("model.simod", |p| p + DVec3::X);
    let model = work.ply("model.ply");

    let mut changed = model.bytes.clone();
    changed[model.position_bytes(model.len() / 2).start] ^= 1;
    work.write("model.ply", &changed);
    let outcome = work.refuses(RECONSTRUCT, &["model.ply", "changed"]);
    assert!(outcome.hint().contains("sample it again"), "{}", outcome.hint());

    work.write("model.ply", &model.bytes[..model.bytes.len() - 13]);
    work.refuses(RECONSTRUCT, &["model.ply"]);
    work.simod("generate -o model.ply --vertices 20100");
    work.refuses(RECONSTRUCT, &["model.ply", "changed"]);

    std::fs::rename(work.path("model.ply"), work.path("other.ply")).expect("a file to move");
    work.refuses(RECONSTRUCT, &["model.ply", "gone"]);
    // Back again under another name.
    work.write("moved.ply", &model.bytes);
    work.refuses(&format!("{RECONSTRUCT} --model other.ply"), &["other.ply", "changed"]);
    work.simod(&format!("{RECONSTRUCT} --model moved.ply"));
}

#[test]
fn a_folder_that_is_no_sampled_model() {
    let work = sampled();
    work.write_session("model.ply", 100, "");
    work.refuses("deform model.ply --session edit.toml -o out.ply", &["model.ply"]);
    work.refuses("info missing.simod", &["missing.simod"]);
    // Nothing but a sampled model is replaced by one.
    work.write("precious/letter.txt", "dear");
    work.refuses("sample model.ply -o precious", &["precious"]);
    work.simod("sample model.ply -o model.simod --samples 500");
    work.write("model.simod/letter.txt", "dear");
    work.refuses("sample model.ply -o model.simod", &["model.simod", "letter.txt"]);
    std::fs::remove_file(work.path("model.simod/letter.txt")).expect("a letter");

    let description = String::from_utf8(work.read("model.simod/simod.toml")).expect("text");
    work.write("model.simod/simod.toml", &description[..description.len() / 2]);
    work.refuses("info model.simod", &["simod.toml"]);
    work.write("model.simod/simod.toml", description.replace("sampled-model/1", "sampled-model/9"));
    work.refuses("info model.simod", &["simod.toml", "sampled-model/9"]);
    work.write("model.simod/simod.toml", description);
    let samples = work.read("model.simod/samples.ply");
    work.write("model.simod/samples.ply", &samples[..samples.len() / 2]);
    work.refuses("info model.simod", &["samples.ply"]);
    // Deformed in place: the samples at rest are lost, and nothing may be reconstructed from that.
    work.write("model.simod/samples.ply", &samples);
    work.move_samples("model.simod", |p| 2.0 * p);
    std::fs::rename(work.path("deformed.ply"), work.path("model.simod/samples.ply")).expect("a move");
    let line = "reconstruct model.simod --deformed model.simod/samples.ply -o out.ply";
    work.refuses(line, &["samples.ply", "not what was sampled"]);
    // The model itself is no place for its deformation.
    work.write("model.simod/samples.ply", &samples);
    work.move_samples("model.simod", |p| 2.0 * p);
    let line = "reconstruct model.simod --deformed deformed.ply -o model.ply";
    work.refuses(line, &["model.ply", "the model itself"]);
}

#[test]
fn a_session_that_makes_no_sense() {
    let work = sampled();
    let deform = "deform model.simod --session edit.toml -o out.ply";
    let refuses = |steps: &str, named: &[&str]| {
        work.write_session("model.ply", 100, steps);
        work.refuses(deform, named);
        work.refuses("run edit.toml", named)
    };
    // The steps begin at line 5.
    let outcome = refuses("[[step]]\ndeform = \"wrap\"", &["edit.toml, line 5", "`wrap`"]);
    assert!(outcome.hint().contains("`warp`"), "{}", outcome.hint());
    let outcome =
        refuses("[[step]]\ndeform = \"warp\"\nparams = { angel = 3 }", &["edit.toml, line 7", "angel"]);
    assert!(outcome.hint().contains("angle"), "{}", outcome.hint());
    let outcome = refuses(
        "[[step]]\ndeform = \"rbf\"\nparams = { tolerance = 5 }",
        &["edit.toml, line 7", "tolerance"],
    );
    assert!(outcome.hint().contains('1'), "{}", outcome.hint());
    refuses("[[step]]\ndeform = \"warp\"\nparams = { angle = \"much\" }", &["edit.toml, line 7", "angle"]);
    // Each parameter on a line of its own; also where the plugin itself refuses it.
    let table = |params: &str| {
        format!("[[step]]\ndeform = \"warp\"\n\n[step.params]\noperation = \"bend\"\n\n{params}\n")
    };
    refuses(&table("angle = true"), &["edit.toml, line 11", "`angle`"]);
    refuses(&table("axis = [0, 0, 0]"), &["edit.toml, line 11", "`axis`"]);
    refuses("[[step]]\ndeform = \"warp\"\nparams = { from = 0.5, to = -0.5 }", &["warp", "from"]);
    refuses("[[step]]\ndeform = \"rbf\"", &["edit.toml, line 5", "rbf"]);
    refuses("[[step]]\ndeform = ", &["edit.toml, line 6"]);
    refuses("[[step]]\n\n[[setp]]", &["edit.toml, line 7", "setp"]);
    refuses("[[step]]\ndeform = \"warp\"\nparms = {}", &["edit.toml, line 7", "parms"]);

    work.refuses("run missing.toml", &["missing.toml"]);
    work.refuses("run model.ply", &["model.ply"]);
    work.write("edit.toml", "[sampling]\nsamples = 5\n[output]\npath = \"out.ply\"\n");
    work.refuses("run edit.toml", &["model"]);
    work.write("edit.toml", "[model]\npath = \"model.ply\"\n");
    work.refuses("run edit.toml", &["edit.toml"]);
}

#[test]
fn numbers_out_of_range() {
    let work = sampled();
    work.refuses("sample model.ply -o out.simod --samples 0", &["0 samples"]);
    work.refuses("sample model.ply -o out.simod --error 0", &["0"]);
    work.refuses("sample model.ply -o out.simod --error nan", &["NaN"]);
    work.refuses("sample model.ply -o out.simod --grid 1", &["1"]);
    work.refuses("generate -o out.ply --vertices 3", &["3"]);
}

/// The command line itself is at fault: exit code 2.
#[test]
fn usage_errors_are_told_apart() {
    let work = Workplace::new();
    let lines = [
        "",
        "smaple",
        "sample",
        "sample a.ply",
        "sample a.ply -o b --samples many",
        "run",
        "run a b",
        "reconstruct a",
        "plugin",
        "sample a.ply -o b --samples 5 --error 1",
        "generate -o a.ply --offset 1,2",
    ];
    for line in lines {
        let outcome = work.run(line);
        assert_eq!(outcome.code, Some(2), "simod {line}: {}", outcome.stderr);
        assert_eq!(outcome.stdout, "", "simod {line}");
        assert!(outcome.stderr.contains("--help"), "simod {line}: {}", outcome.stderr);
    }
    assert!(work.names().is_empty());
    assert_eq!(work.run("--help").code, Some(0));
}

#[test]
fn a_target_that_cannot_be_written() {
    let work = sampled();
    work.write("deformed.ply", work.read("model.simod/samples.ply"));
    work.write("file", "");
    work.write("folder/file", "");
    for target in ["missing/out.ply", "file/out.ply", "folder"] {
        work.refuses(&format!("reconstruct model.simod --deformed deformed.ply -o {target}"), &[target]);
        work.refuses(&format!("generate -o {target} --vertices 2000"), &[target]);
        work.write_session("model.ply", 100, "");
        work.refuses(&format!("run edit.toml -o {target}"), &[target]);
        work.refuses(&format!("deform model.simod --session edit.toml -o {target}"), &[target]);
        work.refuses(&format!("render model.ply --size 64x64 -o {target}"), &[target]);
        work.refuses(&format!("render model.ply --size 64x64 --turntable 2 -o {target}"), &[target]);
        work.refuses(&format!("sample model.ply -o {target}"), &[target]);
    }
    // A file that is there already stays as it is, whatever fails.
    work.write("out.ply", "precious");
    work.write("deformed.ply", text_model(&["0 0 0"]));
    work.refuses(RECONSTRUCT, &["deformed.ply"]);
    assert_eq!(work.read("out.ply"), b"precious");
}

#[cfg(unix)]
#[test]
fn a_folder_without_permission() {
    use std::os::unix::fs::PermissionsExt;
    let work = sampled();
    work.write("deformed.ply", work.read("model.simod/samples.ply"));
    work.write("locked/file", "");
    let lock = |mode| {
        let permissions = std::fs::Permissions::from_mode(mode);
        std::fs::set_permissions(work.path("locked"), permissions).expect("our own folder");
    };
    lock(0o555);
    if std::fs::File::create(work.path("locked/probe")).is_ok() {
        skip("permissions do not bind the superuser");
    } else {
        work.refuses(
            "reconstruct model.simod --deformed deformed.ply -o locked/out.ply",
            &["locked/out.ply"],
        );
        work.refuses("sample model.ply -o locked/out.simod", &["locked/out.simod"]);
    }
    lock(0o755);
}

/// The disk fills up at any point of the work.
#[cfg(unix)]
#[test]
fn a_target_that_is_full() {
    let work = sampled();
    work.write("deformed.ply", work.read("model.simod/samples.ply"));
    let warp = "[[step]]\ndeform = \"warp\"\n";
    work.write_session("model.ply", 1000, warp);
    work.refuses_beyond(0, "run edit.toml", &["a temporary file"]);
    // Without temporary files, it is the output that has no room.
    work.write_session("model.ply", 1000, &format!("sheets = false\n{warp}"));
    let whole = work.read("model.ply").len() as u64;
    for limit in [0, 4096, whole / 2, whole - 512] {
        work.refuses_beyond(limit, RECONSTRUCT, &["out.ply"]);
        work.refuses_beyond(limit, "run edit.toml", &["edited.ply"]);
        let refused = work.refuses_beyond(limit, "generate -o new.ply --vertices 20000", &["new.ply"]);
        assert!(refused.hint().contains("raise the limit"), "{}", refused.hint());
    }
    for limit in [0, 4096] {
        work.refuses_beyond(
            limit,
            "sample model.ply -o new.simod --samples 1000 --skip triangles,sheets,colors --place vertices",
            &["new.simod"],
        );
        work.refuses_beyond(
            limit,
            "sample model.ply -o model.simod --samples 1000 --skip triangles,sheets,colors --place vertices",
            &["model.simod"],
        );
        work.refuses_beyond(limit, "deform model.simod --session edit.toml -o new.ply", &["new.ply"]);
        work.refuses_beyond(limit, "render model.ply -o new.png", &["new.png"]);
    }
}
