//! Clouds in LAS and LAZ through the program: written and read by another library.

use std::io::Cursor;
use std::process::Stdio;
use std::time::Duration;

use glam::DVec3;
use las::point::Format;
use las::{Builder, Color, Point, Reader, Transform, Vector, Vlr, Writer};
use simod_tests::Workplace;

const SCALE: f64 = 0.001;

/// The cloud's first corner, in UTM coordinates.
const CORNER: DVec3 = DVec3::new(412_345.678, 5_318_765.432, 512.3);

/// A file of hills, 100 m wide, of a version and a point format; `name` says whether it is compressed.
fn write(work: &Workplace, name: &str, format: (u8, u8), count: u64) {
    write_in_steps(SCALE, work, name, format, count);
}

/// The same, with positions in steps of so many metres.
fn write_in_steps(scale: f64, work: &Workplace, name: &str, (minor, format): (u8, u8), count: u64) {
    let mut builder = Builder::from((1, minor));
    builder.point_format = Format::new(format).expect("a format");
    builder.point_format.is_compressed = name.ends_with(".laz");
    let offsets = DVec3::new(412_000.0, 5_318_000.0, 0.0);
    let [x, y, z] = offsets.to_array().map(|offset| Transform { scale, offset });
    builder.transforms = Vector { x, y, z };
    builder.vlrs.push(Vlr {
        user_id: "LASF_Projection".to_owned(),
        record_id: 2112,
        description: String::new(),
        data: b"PROJCS[\"ETRS89 / UTM zone 32N\"]\0".to_vec(),
    });
    let header = builder.into_header().expect("a header");
    let file = std::fs::File::create(work.path(name)).expect("a file");
    let mut writer = Writer::new(std::io::BufWriter::new(file), header).expect("a writer");
    let side = count.isqrt();
    for i in 0..count {
        let (u, v) = ((i % side) as f64 / side as f64, (i / side) as f64 / side as f64);
        let noise = (i.wrapping_mul(2_654_435_761) % 1000) as f64 / 1000.0;
        let p =
            CORNER + DVec3::new(100.0 * u, 100.0 * v, 5.0 * (9.0 * u).sin() * (7.0 * v).cos() + 0.01 * noise);
        let point = Point {
            x: p.x,
            y: p.y,
            z: p.z,
            intensity: (i % 4000) as u16,
            gps_time: Some(3e8 + i as f64 * 1e-5),
            color: Some(Color::new(i as u16, (i / 3) as u16, 7)).filter(|_| matches!(format, 3 | 7)),
            point_source_id: (i / 1000) as u16,
            ..Point::default()
        };
        writer.write_point(point).expect("a point");
    }
    writer.close().expect("a file");
}

/// A file's points, and their box as its header has it.
fn read(bytes: Vec<u8>) -> (Vec<Point>, [DVec3; 2]) {
    let mut reader = Reader::new(Cursor::new(bytes)).expect("a reader");
    let bounds = reader.header().bounds();
    let vector = |v: Vector<f64>| DVec3::new(v.x, v.y, v.z);
    let all = reader.read_all().expect("points");
    let points = all.points().map(|point| point.expect("a point")).collect();
    (points, [vector(bounds.min), vector(bounds.max)])
}

/// Bends what is beyond the middle, and leaves the rest.
fn bent(p: DVec3) -> DVec3 {
    let u = (p.x - CORNER.x - 50.0).max(0.0);
    p + DVec3::new(0.0, 0.05 * u, 0.002 * u * u)
}

/// A cloud with its samples, and bent ones.
fn sampled(name: &str, format: (u8, u8), count: u64) -> Workplace {
    let work = Workplace::new();
    write(&work, name, format, count);
    work.simod(&format!("sample {name} -o model.simod --samples {}", count / 30));
    work.move_samples("model.simod", bent);
    work
}

#[test]
fn clouds_bend_and_keep_all_else() {
    for (name, format) in [("a.las", (2, 3)), ("a.laz", (2, 1)), ("a.las", (4, 7)), ("a.laz", (4, 6))] {
        let work = sampled(name, format, 60_000);
        let line = format!("reconstruct model.simod --deformed deformed.ply -o out-{name}");
        work.simod(&line);
        let (before, after) = (read(work.read(name)), read(work.read(&format!("out-{name}"))));
        assert_eq!(before.0.len(), after.0.len());
        let mut bounds = [DVec3::INFINITY, DVec3::NEG_INFINITY];
        for (old, new) in before.0.into_iter().zip(after.0) {
            let [was, is] = [&old, &new].map(|p| DVec3::new(p.x, p.y, p.z));
            // The map of the samples is not exact where the bend begins.
            let off = is.distance(bent(was));
            assert!(off < 0.05, "{name} {format:?}: {was} goes to {is}");
            if was.x < CORNER.x + 40.0 {
                assert_eq!(was, is);
            }
            bounds = [bounds[0].min(is), bounds[1].max(is)];
            assert_eq!(Point { x: old.x, y: old.y, z: old.z, ..new }, old);
        }
        // Where nothing changed, the other library has left itself a step of room.
        assert!(bounds[0].distance(after.1[0]) < 3.0 * SCALE && bounds[1].distance(after.1[1]) < 3.0 * SCALE);
        let once = work.read(&format!("out-{name}"));
        for threads in [1, 8] {
            work.simod(&format!("{line} --threads {threads}"));
            assert!(work.read(&format!("out-{name}")) == once, "{name}, {threads} threads");
        }
        work.simod("bind model.simod");
        work.simod(&line);
        assert!(work.read(&format!("out-{name}")) == once, "{name}, bound");
        let rest = "model.simod/samples.ply";
        work.simod(&format!("reconstruct model.simod --deformed {rest} deformed.ply -o {{}}.{name}"));
        assert!(work.read(&format!("samples.{name}")) == work.read(name), "an identity is another file");
        assert!(work.read(&format!("deformed.{name}")) == once);
    }
}

/// Errors that come of writing coarse steps are told, and no more samples are advised: these would not help.
#[test]
fn coarse_steps_do_not_ask_for_samples() {
    let work = Workplace::new();
    write_in_steps(0.1, &work, "a.las", (4, 6), 40_000);
    work.simod("sample a.las -o model.simod --samples 4000");
    work.move_samples("model.simod", |p| p + DVec3::new(0.0, 0.0, 1e-4 * (p.x - CORNER.x).powi(2)));
    let line = "reconstruct model.simod --deformed deformed.ply -o out.las";
    let report = work.report(line);
    let expected = report["expected_error"]["worst"].as_f64().expect("a number");
    assert!((1e-4..1e-3).contains(&expected), "{expected:e}");
    let said = work.simod(line).stderr;
    assert!(!said.contains("warning"), "{said}");
}

#[test]
fn a_session_runs_with_and_without_samples() {
    let work = Workplace::new();
    write(&work, "a.laz", (4, 7), 40_000);
    let twist = "[[step]]\ndeform = \"warp\"\n";
    work.write_session("a.laz", 3000, twist);
    work.simod("run edit.toml -o out.laz");
    work.simod("run edit.toml -o exact.laz --exact");
    let [out, exact] = ["out.laz", "exact.laz"].map(|name| read(work.read(name)));
    for (out, exact) in out.0.iter().zip(&exact.0) {
        let [out, exact] = [out, exact].map(|p| DVec3::new(p.x, p.y, p.z));
        assert!(out.distance(exact) < 0.05);
    }
    let report = work.report("run edit.toml -o out.laz --measure");
    assert_eq!(report["vertices"], 40_000);
    // Samples are added where they are needed, which is read again.
    let more = format!("{twist}[[step]]\nrefine = {{ auto = true, error = 1e-5 }}\n");
    work.write_session("a.laz", 1000, &more);
    work.simod("run edit.toml -o out.laz");
}

#[test]
fn info_tells_where_a_cloud_is() {
    let work = Workplace::new();
    for (name, told) in [("a.las", "LAS 1.4, point format 7"), ("a.laz", "LAS 1.4, point format 7, LAZ")] {
        write(&work, name, (4, 7), 1000);
        let report = work.report(&format!("info {name}"));
        assert_eq!(report["format"], told);
        assert_eq!(report["vertices"], 1000);
        assert_eq!(report["crs"], "ETRS89 / UTM zone 32N");
        assert_eq!(report["scale"][0], SCALE);
        assert_eq!(report["offset"][1], 5_318_000.0);
        let text = work.simod(&format!("info {name}")).stdout;
        assert!(text.contains("ETRS89 / UTM zone 32N") && text.contains("ushort intensity"), "{text}");
    }
}

#[test]
fn what_leaves_the_integers_is_known_before_anything_is_written() {
    let work = sampled("a.laz", (2, 3), 20_000);
    let far = DVec3::new(3e6, 0.0, -2.5e6);
    work.move_samples("model.simod", |p| p + far);
    let line = "reconstruct model.simod --deformed deformed.ply -o out.laz";
    let outcome = work.run(line);
    outcome.refused(line, &["sample ", "2559483.647"]);
    assert!(outcome.hint().contains("--offset auto"));
    assert!(!work.path("out.laz").exists());
    let outcome = work.simod(&format!("{line} --offset auto"));
    assert!(outcome.stderr.contains("the offset of the positions becomes"), "{}", outcome.stderr);
    let (before, after) = (read(work.read("a.laz")), read(work.read("out.laz")));
    for (old, new) in before.0.iter().zip(&after.0) {
        let [was, is] = [old, new].map(|p| DVec3::new(p.x, p.y, p.z));
        assert!(is.distance(was + far) < 3.0 * SCALE);
    }
    assert!((after.1[0] - before.1[0]).distance(far) < 5.0 * SCALE);
    // Where it has room, the offset stays, and an identity the file.
    work.simod("reconstruct model.simod --deformed model.simod/samples.ply -o same.laz --offset auto");
    assert!(work.read("same.laz") == work.read("a.laz"));
    work.simod("generate -o model.ply --vertices 1000");
    work.simod("sample model.ply -o ply.simod --samples 100");
    let line = "reconstruct ply.simod --deformed ply.simod/samples.ply -o out.ply --offset auto";
    work.run(line).refused(line, &["has no offset"]);
}

#[test]
fn killed_and_gone_on_with() {
    for name in ["a.las", "a.laz"] {
        let work = sampled(name, (4, 6), 400_000);
        let line = format!("reconstruct model.simod --deformed deformed.ply -o out-{name} --part-size 100K");
        work.simod(&line);
        let expected = work.read(&format!("out-{name}"));
        let mut gone_on = 0;
        for parts in [1, 3, 5] {
            std::fs::remove_file(work.path(&format!("out-{name}"))).expect("an output");
            kill_after(&work, &line, &format!(".simod-out-{name}.journal"), parts);
            let report = work.report(&format!("{line} --resume"));
            gone_on += u32::from(report["resumed_bytes"].as_u64().is_some_and(|bytes| bytes > 0));
            assert!(work.read(&format!("out-{name}")) == expected, "{name}, killed after {parts} parts");
        }
        assert!(gone_on > 0, "it was never killed in the midst of it");
    }
}

/// Starts a reconstruction and kills it once its journal lists so many parts.
pub fn kill_after(work: &Workplace, line: &str, journal: &str, parts: usize) {
    let mut command = work.command(line);
    let mut child = command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().expect("a start");
    let listed = || {
        let journal = std::fs::read_to_string(work.path(journal)).unwrap_or_default();
        journal.lines().filter(|line| line.starts_with("part ")).count()
    };
    while listed() < parts && child.try_wait().expect("a child").is_none() {
        std::thread::sleep(Duration::from_micros(200));
    }
    child.kill().expect("a child");
    child.wait().expect("an end");
}

#[test]
fn cut_off_or_spoilt_files_leave_nothing() {
    let work = Workplace::new();
    write(&work, "a.laz", (4, 7), 2000);
    let bytes = work.read("a.laz");
    for end in [3, 100, 374, 500, bytes.len() / 2, bytes.len() - 1] {
        work.write("cut.laz", &bytes[..end]);
        let line = "sample cut.laz -o cut.simod";
        work.run(line).refused(line, &["cut.laz"]);
    }
    assert!(!work.path("cut.simod").exists());
}
