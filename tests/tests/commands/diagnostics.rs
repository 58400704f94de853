//! Diagnostics of `reconstruct`: figures of the surface at each vertex, and a warning where it folds.

use glam::{DQuat, DVec3};
use serde_json::Value;
use simod_tests::Workplace;

const VERTICES: u64 = 20_000;

/// A vertex of a diagnostics file.
struct Figures {
    displacement: f64,
    largest: f64,
    smallest: f64,
    folded: u8,
}

/// A model of which this many samples were taken.
fn sampled(options: &str) -> Workplace {
    let work = Workplace::new();
    work.simod(&format!("generate -o model.ply --vertices {VERTICES} {options}"));
    work.simod("sample model.ply -o model.simod --samples 1000");
    work
}

/// Deforms the samples, and reconstructs with diagnostics: the report, and what they say.
fn diagnosed(work: &Workplace, options: &str, to: impl FnMut(DVec3) -> DVec3) -> (Value, Vec<Figures>) {
    work.move_samples("model.simod", to);
    let line = format!("reconstruct model.simod --deformed deformed.ply -o out.ply {options}");
    let plain = work.report(&line);
    let expected = work.read("out.ply");
    let report = work.report(&format!("{line} --diagnostics figures.ply"));
    assert!(work.read("out.ply") == expected, "diagnostics change the result");
    assert_eq!(report["folded_samples"], plain["folded_samples"]);
    assert_eq!(report["warnings"], plain["warnings"]);
    assert!(plain["folded_vertices"].is_null());
    (report, figures(work, "figures.ply"))
}

fn figures(work: &Workplace, name: &str) -> Vec<Figures> {
    let bytes = work.read(name);
    let end = bytes.windows(11).position(|w| w == b"end_header\n").expect("a header") + 11;
    let header = std::str::from_utf8(&bytes[..end]).expect("text");
    let is_double = header.contains("property double x\nproperty double y\nproperty double z\n");
    let expected = "property float displacement\nproperty float stretch_max\nproperty float stretch_min\n\
                    property uchar folded\n\
                    property float expected_error\nproperty float expected_error_fraction\nend_header\n";
    assert!(header.ends_with(expected), "{header}");
    let position = if is_double { 24 } else { 12 };
    let figures = bytes[end..].chunks(position + 21).map(|vertex| {
        let number = |i: usize| {
            let at = position + 4 * i;
            f64::from(f32::from_le_bytes(vertex[at..at + 4].try_into().expect("four bytes")))
        };
        Figures {
            displacement: number(0),
            largest: number(1),
            smallest: number(2),
            folded: vertex[position + 12],
        }
    });
    figures.collect()
}

/// Warnings of folds.
fn warnings(report: &Value) -> Vec<&str> {
    let all = report["warnings"].as_array().into_iter().flatten();
    all.filter_map(Value::as_str).filter(|w| w.contains("folds the surface at")).collect()
}

fn middle(work: &Workplace) -> DVec3 {
    let [min, max] = work.ply("model.ply").bounds();
    (min + max) / 2.0
}

#[test]
fn displacements_are_between_both_files() {
    let formats =
        ["", "--encoding big-endian --double --offset 500000,4649776,120", "--encoding ascii --no-normals"];
    for format in formats {
        let work = sampled(format);
        let (middle, diagonal) = (middle(&work), work.ply("model.ply").diagonal());
        let height = diagonal / 2.0;
        let twist =
            |p: DVec3| middle + DQuat::from_rotation_y(p.y / height - middle.y / height) * (p - middle);
        for method in ["blended-jets", "projected-barycentric"] {
            let (report, figures) = diagnosed(&work, &format!("--method {method}"), twist);
            assert!(warnings(&report).is_empty(), "{report}");
            assert_eq!((&report["folded_samples"], &report["folded_vertices"]), (&0.into(), &0.into()));
            let (before, after) = (work.ply("model.ply").positions(), work.ply("out.ply").positions());
            assert_eq!(work.ply("figures.ply").positions(), after, "{format}, {method}");
            assert_eq!(figures.len(), before.len());
            for ((f, p), q) in figures.iter().zip(before).zip(after) {
                assert!((f.displacement - p.distance(q)).abs() < 1e-6 * diagonal, "{p}: {}", f.displacement);
                assert!((0.0..=f.largest).contains(&f.smallest) && f.largest.is_finite(), "{p}");
                assert_eq!(f.folded, 0, "{p}");
            }
        }
    }
}

#[test]
fn stretches_of_an_affine_map() {
    let work = sampled("--shape bumpy-sphere");
    let (_, figures) = diagnosed(&work, "", |p| p * DVec3::new(2.0, 1.0, 1.0));
    let normals = work.ply("model.ply").normals();
    let mut along = 0;
    for (f, n) in figures.iter().zip(normals) {
        assert!(f.smallest > 0.99 && f.smallest < 1.01 && f.largest < 2.01, "{} {}", f.smallest, f.largest);
        // The direction x lies in the surface.
        if n.x.abs() < 0.05 {
            along += 1;
            assert!(f.largest > 1.9, "{n}: {}", f.largest);
        }
        // Where x is the normal, nothing is stretched; the normals of samples differ from those of vertices.
        if n.x.abs() > 0.99 {
            assert!(f.largest < 1.3, "{n}: {}", f.largest);
        }
    }
    assert!(along > 100);
    let (_, figures) = diagnosed(&work, "", |p| p);
    assert!(figures.iter().all(|f| f.displacement == 0.0 && f.folded == 0));
    assert!(figures.iter().all(|f| (f.largest - 1.0).abs() < 1e-5 && (f.smallest - 1.0).abs() < 1e-5));
}

#[test]
fn what_is_turned_inside_out_is_marked() {
    let work = sampled("--shape bumpy-sphere");
    let height = middle(&work).y + 0.1 * work.ply("model.ply").diagonal();
    let inwards = |p: DVec3| if p.y > height { DVec3::new(p.x, 2.0 * height - p.y, p.z) } else { p };
    let mirrored = |p: DVec3| p * DVec3::new(-1.0, 1.0, 1.0);
    let spacing = 0.05 * work.ply("model.ply").diagonal();
    // Of a mirrored model the part is turned inside out that is not mirrored.
    let maps: [&dyn Fn(DVec3) -> DVec3; 2] = [&inwards, &|p| mirrored(inwards(p))];
    for map in maps {
        let (report, figures) = diagnosed(&work, "", map);
        let samples = report["folded_samples"].as_u64().expect("a count");
        assert!((50..500).contains(&samples), "{samples}");
        let folded = figures.iter().filter(|f| f.folded == 1).count();
        assert_eq!(report["folded_vertices"], folded);
        let found = warnings(&report);
        assert!(
            found.len() == 1 && found[0].contains(&format!("at {samples} samples, first near (")),
            "{report}"
        );
        let near = found[0].split_once("near (").and_then(|(_, rest)| rest.split_once(')')).expect("a place");
        let place: Vec<f64> = near.0.split(", ").map(|x| x.parse().expect("a number")).collect();
        assert!(place[1] > height - spacing, "{}", found[0]);
        let mut wrong = 0;
        for (f, p) in figures.iter().zip(work.ply("model.ply").positions()) {
            if (p.y - height).abs() > spacing && (f.folded == 1) != (p.y > height) {
                wrong += 1;
            }
        }
        assert!(wrong * 100 < folded, "{wrong} of {folded}");
    }
    for shape in ["bumpy-sphere", "amphora", "plane"] {
        let work = sampled(&format!("--shape {shape}"));
        let (report, figures) = diagnosed(&work, "", mirrored);
        assert!(warnings(&report).is_empty() && report["folded_samples"] == 0, "{report}");
        assert!(figures.iter().all(|f| f.folded == 0));
    }
}

#[test]
fn several_versions() {
    let work = sampled("--shape bumpy-sphere");
    let height = middle(&work).y;
    work.move_samples("model.simod", |p| DVec3::new(p.x, (p.y - height).abs(), p.z));
    std::fs::rename(work.path("deformed.ply"), work.path("in-2.ply")).expect("a file");
    work.move_samples("model.simod", |p| 1.5 * p);
    std::fs::rename(work.path("deformed.ply"), work.path("in-1.ply")).expect("a file");
    let line = "reconstruct model.simod --deformed";
    let report =
        work.report(&format!("{line} in-1.ply in-2.ply -o out-{{}}.ply --diagnostics figures-{{}}.ply"));
    let found = warnings(&report);
    assert!(found.len() == 1 && found[0].starts_with("out-in-2.ply: "), "{report}");
    for version in ["in-1", "in-2"] {
        let (several, after) =
            (work.read(&format!("figures-{version}.ply")), work.ply(&format!("out-{version}.ply")));
        assert_eq!(work.ply(&format!("figures-{version}.ply")).positions(), after.positions());
        work.simod(&format!("{line} {version}.ply -o one.ply --diagnostics figures.ply"));
        assert!(work.read("figures.ply") == several, "{version}");
    }
    let folded =
        |version: &str| figures(&work, &format!("figures-{version}.ply")).iter().any(|f| f.folded == 1);
    assert_eq!((folded("in-1"), folded("in-2")), (false, true));
}

#[test]
fn vertices_that_are_nowhere_have_no_figures() {
    let work = Workplace::new();
    work.simod("generate -o model.ply --vertices 20000");
    let mut model = work.ply("model.ply");
    model.set_position(7, DVec3::new(f64::NAN, 1.0, 2.0));
    work.write("model.ply", &model.bytes);
    work.simod("sample model.ply -o model.simod --samples 500");
    let (report, figures) = diagnosed(&work, "", |p| 2.0 * p);
    assert_eq!(report["non_finite"], 1);
    for (i, f) in figures.iter().enumerate() {
        assert_eq!([f.displacement, f.largest, f.smallest].map(f64::is_nan), [i == 7; 3]);
        assert_eq!(f.folded, 0);
    }
    let p = work.ply("figures.ply").positions()[7];
    assert!(p.x.is_nan() && (p.y, p.z) == (model.positions()[7].y, model.positions()[7].z));
}

#[test]
fn whole_or_not_at_all() {
    let work = sampled("");
    work.move_samples("model.simod", |p| 2.0 * p);
    let line = "reconstruct model.simod --deformed deformed.ply -o out.ply --diagnostics";
    work.refuses(&format!("{line} figures.ply --resume"), &["diagnostics"]);
    work.refuses(&format!("{line} out.ply"), &["two files", "out.ply"]);
    work.refuses(&format!("{line} model.ply"), &["model.ply", "the model itself"]);
    work.refuses(&format!("{line} deformed.ply"), &["deformed.ply", "one of the deformed"]);
    work.refuses(&format!("{line} missing/figures.ply"), &["missing/figures.ply"]);
    work.write("figures.ply", "precious");
    #[cfg(unix)]
    work.refuses_beyond(100_000, &format!("{line} figures.ply"), &[]);
    std::fs::copy(work.path("deformed.ply"), work.path("in-1.ply")).expect("a copy");
    std::fs::copy(work.path("deformed.ply"), work.path("in-2.ply")).expect("a copy");
    let several = "reconstruct model.simod --deformed in-1.ply in-2.ply -o {}-out.ply --diagnostics";
    work.refuses(&format!("{several} figures.ply"), &["2 versions", "figures.ply"]);
    // Beyond what the type float can hold.
    work.move_samples("model.simod", |p| 1e38 * p);
    let names = work.names();
    let outcome = work.run(&format!("{line} other.ply"));
    if outcome.code != Some(0) {
        assert_eq!(work.names(), names);
    }
    // A model that is not what was sampled, which shows at the end of the reading.
    let mut model = work.ply("model.ply");
    model.set_position(11, DVec3::ONE);
    work.write("model.ply", &model.bytes);
    work.move_samples("model.simod", |p| 2.0 * p);
    work.refuses(&format!("{line} another.ply"), &["changed since it was sampled"]);
}
