//! Statements on the transfer's error hold: estimates beside the truth, the exact map at every vertex, and
//! tolerances.

use std::f64::consts::PI;

use glam::{DQuat, DVec3};
use serde_json::Value;
use simod_tests::{Outcome, Workplace};

/// Half a turn about y, over the height of the amphora.
fn twist(p: DVec3) -> DVec3 {
    DQuat::from_rotation_y(1.5 * p.y) * p
}

/// A local bump, where the surface is.
fn bump(p: DVec3) -> DVec3 {
    let at = DVec3::new(0.0, 1.0, 0.4);
    p + DVec3::new(0.06, 0.08, 0.1) * (-p.distance_squared(at) / 0.04).exp()
}

/// Expected error of each vertex in a diagnostics file: in the model's unit, and as a fraction.
fn expected(work: &Workplace, name: &str) -> Vec<[f64; 2]> {
    let bytes = work.read(name);
    let end = bytes.windows(11).position(|w| w == b"end_header\n").expect("a header") + 11;
    let number = |at: &[u8]| f64::from(f32::from_le_bytes(at.try_into().expect("four bytes")));
    bytes[end..].chunks(33).map(|v| [number(&v[25..29]), number(&v[29..33])]).collect()
}

fn figure(report: &Value, name: &str) -> f64 {
    report[name].as_f64().unwrap_or_else(|| panic!("no {name} in {report}"))
}

#[test]
fn what_is_expected_is_of_the_size_of_the_truth() {
    for shape in ["amphora", "bumpy-sphere"] {
        let work = Workplace::new();
        work.simod(&format!("generate -o model.ply --vertices 60000 --shape {shape}"));
        work.simod("sample model.ply -o model.simod --samples 4000");
        let model = work.ply("model.ply");
        let (rest, diagonal) = (model.positions(), model.diagonal());
        for map in [twist, bump] {
            work.move_samples("model.simod", map);
            let line = "reconstruct model.simod --deformed deformed.ply -o out.ply";
            let plain = work.report(line);
            let report = work.report(&format!("{line} --diagnostics figures.ply"));
            let truth: Vec<f64> = rest
                .iter()
                .zip(work.ply("out.ply").positions())
                .map(|(p, q)| q.distance(map(*p)) / diagonal)
                .collect();
            let rms = |all: &[f64]| (all.iter().map(|e| e * e).sum::<f64>() / all.len() as f64).sqrt();
            let told = expected(&work, "figures.ply");
            let fractions: Vec<f64> = told.iter().map(|[_, fraction]| *fraction).collect();
            for [length, fraction] in &told {
                assert!((length - fraction * diagonal).abs() <= 1e-5 * length, "{length} {fraction}");
            }
            let ratio = rms(&fractions) / rms(&truth);
            assert!((1.0 / 3.0..3.0).contains(&ratio), "{shape}: {ratio}");
            let of_vertices = &report["expected_error"];
            assert_eq!(of_vertices["of_vertices"], true);
            assert!((figure(of_vertices, "rms") / rms(&fractions) - 1.0).abs() < 1e-3);
            // By the samples alone, more roughly.
            let of_samples = &plain["expected_error"];
            let ratio = figure(of_samples, "rms") / rms(&truth);
            assert_eq!(of_samples["of_vertices"], false);
            assert!((0.2..5.0).contains(&ratio), "{shape}: {ratio} by the samples");
            assert!(figure(of_samples, "worst") > truth.iter().copied().fold(0.0, f64::max) / 3.0, "{shape}");
            for t in [1e-6, 1e-5, 1e-4] {
                let beyond: Vec<usize> = (0..truth.len()).filter(|i| truth[*i] > 3.0 * t).collect();
                // Few of them tell no share.
                if beyond.len() < 200 {
                    continue;
                }
                let warned = beyond.iter().filter(|i| fractions[**i] > t).count();
                assert!(
                    warned * 100 >= beyond.len() * 90,
                    "{shape}: {warned} of {} beyond {t}",
                    beyond.len()
                );
            }
        }
    }
}

#[test]
fn what_is_exact_is_expected_to_be() {
    let work = Workplace::new();
    work.simod("generate -o model.ply --vertices 30000");
    work.simod("sample model.ply -o model.simod --samples 2000");
    let maps: [(&dyn Fn(DVec3) -> DVec3, f64); 3] = [
        (&|p| p, 0.0),
        (&|p| DQuat::from_rotation_x(1.0) * p + DVec3::ONE, 3e-7),
        (&|p| p * DVec3::new(1.5, 0.7, 1.0), 3e-7),
    ];
    for (map, most) in maps {
        work.move_samples("model.simod", map);
        let report =
            work.report("reconstruct model.simod --deformed deformed.ply -o out.ply --diagnostics f.ply");
        assert!(figure(&report["expected_error"], "rms") <= most, "{report}");
        assert!(report["warnings"].is_null(), "{report}");
        assert!(expected(&work, "f.ply").iter().flatten().all(|e| *e >= 0.0));
    }
}

#[test]
fn a_step_is_warned_of() {
    let work = Workplace::new();
    work.simod("generate -o model.ply --vertices 30000");
    work.simod("sample model.ply -o model.simod --samples 2000");
    work.move_samples("model.simod", |p| if p.y > 1.0 { p + 0.2 * DVec3::Y } else { p });
    let report = work.report("reconstruct model.simod --deformed deformed.ply -o out.ply");
    let warnings = report["warnings"].as_array().expect("warnings");
    let warning = warnings.iter().filter_map(Value::as_str).find(|w| w.contains("expected to be off"));
    let warning = warning.unwrap_or_else(|| panic!("{report}"));
    assert!(
        warning.contains("simod refine model.simod --auto --error 1e-4 --deformed deformed.ply "),
        "{warning}"
    );
}

const TWIST: &str =
    "[[step]]\ndeform = \"warp\"\nparams = { operation = \"twist\", axis = [0, 1, 0], angle = 90 }\n";
const SMOOTH: &str = "[[step]]\ndeform = \"laplacian\"\n\
    [[step.region]]\nrole = \"fixed\"\nshapes = [{ half-space = { point = [0, 0.5, 0], normal = [0, -1, 0] } }]\n\
    [[step.region]]\nrole = \"handle\"\nshapes = [{ half-space = { point = [0, 1.5, 0], normal = [0, 1, 0] } }]\n\
    move = { translate = [0, 0.1, 0] }\n";
const SMOOTH_PLANE: &str = "[[step]]\ndeform = \"laplacian\"\n\
    [[step.region]]\nrole = \"fixed\"\nshapes = [{ half-space = { point = [-0.5, 0, 0], normal = [-1, 0, 0] } }]\n\
    [[step.region]]\nrole = \"handle\"\nshapes = [{ half-space = { point = [0.5, 0, 0], normal = [1, 0, 0] } }]\n\
    move = { translate = [0, 0.1, 0] }\n";
const MASK: &str = "[[step.region]]\nrole = \"mask\"\nshapes = [{ half-space = { point = [0, 1, 0], normal = [0, 1, 0] } }]\n";

#[test]
fn every_vertex_is_evaluated() {
    let work = Workplace::new();
    work.simod("generate -o model.ply --vertices 40000");
    let before = work.ply("model.ply");
    work.write_session("model.ply", 4000, TWIST);
    work.simod("run edit.toml -o transferred.ply");
    let transferred = work.ply("transferred.ply");
    let report = work.report("run edit.toml --exact --measure --diagnostics figures.ply");
    assert!(figure(&report["transfer_error"], "max") < 1.5e-7, "{report}");
    assert!(figure(&report["exact"], "expected_seconds") > 0.0);
    assert_eq!(report["exact"]["evaluations"], 7 * 40_000u64.max(before.len() as u64));
    let exact = work.ply("edited.ply");
    assert!(exact.other_bytes() == before.other_bytes(), "what is no vertex has changed");
    let turned = |(a, b): (&DVec3, &DVec3)| a.angle_between(*b).to_degrees();
    let mut angles: Vec<f64> = exact.normals().iter().zip(&transferred.normals()).map(turned).collect();
    angles.sort_by(f64::total_cmp);
    assert!(angles[angles.len() / 2] < 0.1, "{} degrees in the median", angles[angles.len() / 2]);
    assert!(expected(&work, "figures.ply").iter().all(|[_, e]| *e < 2e-7));
    // Where a mask keeps the step away, and where nothing is deformed, not a bit changes.
    work.write_session("model.ply", 4000, &format!("{TWIST}{MASK}"));
    work.simod("run edit.toml --exact");
    let masked = work.ply("edited.ply");
    let (positions, normals, normals_before) = (masked.positions(), masked.normals(), before.normals());
    let mut kept = 0;
    for (i, p) in before.positions().iter().enumerate().filter(|(_, p)| p.y < 0.99) {
        kept += 1;
        assert_eq!(positions[i], *p);
        assert_eq!(normals[i], normals_before[i]);
    }
    assert!(kept > 5000);
}

#[test]
fn a_step_that_knows_samples_only_is_named() {
    let work = Workplace::new();
    work.simod("generate -o model.ply --vertices 20000");
    work.write_session("model.ply", 1000, &format!("{TWIST}{SMOOTH}"));
    for option in ["--exact", "--measure", "--exact --measure"] {
        work.refuses(&format!("run edit.toml {option}"), &["laplacian", "samples only", "edit.toml"]);
    }
    // A step of which nothing is done is the identity, whatever it knows.
    let off = SMOOTH.replacen("\"laplacian\"\n", "\"laplacian\"\namount = 0\n", 1);
    work.write_session("model.ply", 1000, &format!("{TWIST}{off}"));
    work.simod("run edit.toml --exact");
    // Nothing is transferred by any method then.
    assert_eq!(work.run("run edit.toml --exact --method projected-barycentric").code, Some(2));
    work.write_session("model.ply", 1000, &format!("{TWIST}{SMOOTH}"));
    // Before the model is read, even.
    std::fs::remove_file(work.path("model.ply")).expect("a file");
    work.refuses("run edit.toml --exact", &["laplacian", "samples only"]);
}

#[test]
fn a_run_is_refined_until_its_tolerance_is_met() {
    let work = Workplace::new();
    work.simod("generate -o model.ply --vertices 60000");
    let diagonal = work.ply("model.ply").diagonal();
    work.write_session("model.ply", 2000, TWIST);
    let report = work.report("run edit.toml --tolerance 2e-5 --measure");
    let certificate = &report["certificate"];
    assert!(figure(certificate, "added_samples") > 0.0, "{report}");
    assert!(figure(certificate, "expected") <= 2e-5, "{report}");
    assert!(figure(&certificate["true_error"], "max") <= 2e-5, "{report}");
    assert_eq!(certificate["true_error"]["vertices"], report["vertices"]);
    // All vertices were measured, so that it is the worst.
    assert!(figure(&report["transfer_error"], "max") <= 2e-5, "{report}");
    // The same in the model's unit.
    let bytes = work.read("edited.ply");
    work.simod(&format!("run edit.toml --tolerance {}u", 2e-5 * diagonal));
    let again = work.ply("edited.ply").positions();
    let differs =
        simod_tests::Ply::parse(bytes).positions().iter().zip(&again).any(|(a, b)| a.distance(*b) > 1e-5);
    assert!(!differs);
    // A tolerance that is finer than floats.
    std::fs::remove_file(work.path("edited.ply")).expect("a file");
    work.refuses("run edit.toml --tolerance 1e-9", &["1.0e-9", "cannot be met", "float"]);
    for bad in ["0", "-1e-5", "nan", "1e-5m"] {
        assert_eq!(work.run(&format!("run edit.toml --tolerance {bad}")).code, Some(2), "{bad}");
    }
}

/// An eighth of a turn between a lower and an upper part that stay as they are, along an axis.
fn rbf_twist(axis: [i32; 3], low: f64, high: f64) -> String {
    let [x, y, z] = axis;
    let at = |t: f64| format!("[{}, {}, {}]", t * f64::from(x), t * f64::from(y), t * f64::from(z));
    format!(
        "[[step]]\ndeform = \"rbf\"\n[[step.region]]\nrole = \"fixed\"\n\
         shapes = [{{ half-space = {{ point = {}, normal = [{}, {}, {}] }} }}]\n\
         [[step.region]]\nrole = \"handle\"\nshapes = [{{ half-space = {{ point = {}, normal = {axis:?} }} }}]\n\
         move = {{ axis = {axis:?}, degrees = 45, pivot = {} }}\n",
        at(low),
        -x,
        -y,
        -z,
        at(high),
        at(0.5 * (low + high)),
    )
}

#[test]
fn tolerances_are_met_from_any_sampling() {
    let (upright, across) = (rbf_twist([0, 1, 0], 0.5, 1.5), rbf_twist([1, 0, 0], -0.5, 0.5));
    let cases = [
        ("amphora", TWIST, "2e-5", [700, 1000, 1400, 5000]),
        ("amphora", &upright, "1e-4", [1000, 2000, 10_000, 20_000]),
        ("bumpy-plane", TWIST, "1e-5", [1000, 1400, 2000, 5000]),
        ("bumpy-plane", &across, "1e-4", [1000, 2000, 5000, 20_000]),
        ("cylinder", TWIST, "2e-5", [10, 30, 100, 200]),
        ("cylinder", &upright, "1e-4", [10, 30, 100, 200]),
    ];
    for (shape, steps, tolerance, samples) in cases {
        let work = Workplace::new();
        work.simod(&format!("generate -o model.ply --vertices 60000 --shape {shape}"));
        let most: f64 = tolerance.parse().expect("a number");
        for samples in samples {
            work.write_session("model.ply", samples, steps);
            let report = work.report(&format!("run edit.toml --tolerance {tolerance} --measure"));
            assert!(figure(&report["certificate"], "expected") <= most, "{shape} {samples}: {report}");
            assert!(figure(&report["transfer_error"], "max") <= most, "{shape} {samples}: {report}");
        }
    }
}

/// Spheres one in the other, two thousandths of their radius apart, with faces.
fn nested_spheres(rings: usize) -> Vec<u8> {
    let around = 2 * rings;
    let (mut vertices, mut faces) = (Vec::new(), Vec::new());
    for sphere in 0..5u32 {
        for i in 0..around * rings {
            let up = PI * (i % rings + 1) as f64 / (rings + 1) as f64;
            let turn = PI * (i / rings) as f64 / rings as f64;
            let unit = DVec3::new(turn.cos() * up.sin(), turn.sin() * up.sin(), up.cos());
            let p = (1.0 - 0.002 * f64::from(sphere)) * unit;
            let numbers = p.to_array().into_iter().chain(unit.to_array());
            vertices.extend(numbers.flat_map(|x| (x as f32).to_le_bytes()));
        }
        let at = |u: usize, v: usize| ((sphere as usize * around + u % around) * rings + v) as u32;
        for (u, v) in (0..around).flat_map(|u| (1..rings).map(move |v| (u, v))) {
            let [a, b, c, d] = [at(u, v - 1), at(u + 1, v - 1), at(u + 1, v), at(u, v)];
            faces.extend([[a, b, c], [a, c, d]]);
        }
    }
    let properties: String =
        ["x", "y", "z", "nx", "ny", "nz"].map(|name| format!("property float {name}\n")).concat();
    let header = format!(
        "ply\nformat binary_little_endian 1.0\nelement vertex {}\n{properties}element face {}\n\
         property list uchar int vertex_indices\nend_header\n",
        vertices.len() / 24,
        faces.len()
    );
    let corners = faces.into_iter().flat_map(|face| {
        [3u8].into_iter().chain(face.into_iter().flat_map(u32::to_le_bytes)).collect::<Vec<u8>>()
    });
    header.into_bytes().into_iter().chain(vertices).chain(corners).collect()
}

#[test]
fn a_tolerance_is_met_where_few_samples_do_not_tell_sheets_apart() {
    let work = Workplace::new();
    work.write("model.ply", nested_spheres(60));
    let twist = TWIST.replace("[0, 1, 0]", "[0, 0, 1]");
    // Each sheet has samples enough for the first tolerance, from however few in all; for the second one the
    // first samples are too few to add others by.
    for (samples, tolerance, anew) in [(2000, 1e-3, false), (50, 1e-3, false), (50, 1e-4, true)] {
        work.write_session("model.ply", samples, &twist);
        let report = work.report(&format!("run edit.toml --tolerance {tolerance} --measure"));
        let certificate = &report["certificate"];
        assert!(figure(certificate, "expected") <= tolerance, "{samples}: {report}");
        assert_eq!(certificate["sampled_anew"].is_u64(), anew, "{samples}: {report}");
        assert!(figure(&report["transfer_error"], "max") <= tolerance, "{samples}: {report}");
    }
}

#[test]
fn why_a_tolerance_is_not_met_is_told() {
    let work = Workplace::new();
    work.simod("generate -o model.ply --vertices 60000");
    let far = "[[step]]\ndeform = \"rbf\"\n[[step.region]]\nrole = \"handle\"\n\
        shapes = [{ half-space = { point = [0, -1, 0], normal = [0, 1, 0] } }]\nmove = { translate = [10000, 0, 0] }\n";
    let cases = [
        (format!("{TWIST}{MASK}"), 5000, "1e-4", "a step there"),
        (far.to_owned(), 2000, "1e-4", "rounding to floats"),
        (rbf_twist([0, 1, 0], 0.5, 1.5), 20_000, "5e-6", "no vertices left there"),
    ];
    for (steps, samples, tolerance, why) in cases {
        work.write_session("model.ply", samples, &steps);
        let refused = work.run(&format!("run edit.toml --tolerance {tolerance}"));
        let errors = refused.lines("error: ");
        assert_eq!((refused.code, errors.len()), (Some(1), 1), "{}", refused.stderr);
        assert!(
            errors[0].contains("is not met")
                && errors[0].contains(why)
                && errors[0].contains("in the model's unit"),
            "{}",
            refused.stderr
        );
        assert!(!work.names().contains(&"edited.ply".to_owned()));
    }
}

/// The words of the command that a text advises.
fn advised(text: &str) -> Vec<String> {
    let line =
        text.split('`').find(|part| part.starts_with("simod refine ")).unwrap_or_else(|| panic!("{text}"));
    shlex::split(line).expect("words of a shell").split_off(1)
}

#[test]
fn what_is_advised_meets_the_tolerance() {
    let work = Workplace::new();
    work.simod("generate -o model.ply --vertices 30000");
    work.simod("sample model.ply -o model.simod --samples 3000");
    // Names that a shell, or the program, takes for something else unless they are written as paths.
    std::fs::rename(work.path("model.ply"), work.path("-my model.ply")).expect("a name");
    std::fs::rename(work.path("model.simod"), work.path("-my model.simod")).expect("a name");
    work.move_samples("-my model.simod", twist);
    let reconstruct = |tolerance: &str| {
        let line = format!("reconstruct --deformed deformed.ply -o out.ply --tolerance {tolerance}");
        let mut command = work.command(&line);
        command.args(["--model=-my model.ply", "--json", "--", "-my model.simod"]);
        Outcome::from(command.output().expect("the program starts"))
    };
    let report = reconstruct("0.1").json();
    // A little less than what is expected, which is no number of few digits.
    let tolerance = format!("{}u", 0.9995 * figure(&report["tolerance"]["lengths"], "expected"));
    for _ in 0..6 {
        let outcome = reconstruct(&tolerance);
        if outcome.code == Some(0) {
            return;
        }
        let words = advised(&outcome.stderr);
        let mut command = work.command("");
        let refined = Outcome::from(command.args(words).output().expect("the program starts"));
        assert_eq!(refined.code, Some(0), "{}", refined.stderr);
        assert!(!refined.stdout.contains("Nothing is changed"), "{}", refined.stdout);
        work.move_samples("-my model.simod", twist);
    }
    panic!("the tolerance of {tolerance} is not met");
}

/// The samples of a plane of gentle relief, twisted about its normal, agree on a gradient across it that is
/// wrong: what single vertices are expected to be off by is more than the samples tell.
#[test]
fn a_tolerance_holds_for_vertices() {
    let work = Workplace::new();
    work.simod("generate -o model.ply --vertices 30000 --shape bumpy-plane");
    work.simod("sample model.ply -o model.simod --samples 1000");
    let (model, tolerance) = (work.ply("model.ply"), 1.5e-4);
    let (rest, diagonal) = (model.positions(), model.diagonal());
    let line = format!("reconstruct model.simod --deformed deformed.ply -o out.ply --tolerance {tolerance}");
    work.move_samples("model.simod", twist);
    for judged in ["--diagnostics figures.ply", "--resume"] {
        let before = work.names();
        let refused =
            work.refuses(&format!("{line} {judged}"), &["out.ply", "1.5e-4", "nothing was written"]);
        assert!(advised(&refused.stderr).contains(&"--by-vertices".to_owned()), "{}", refused.stderr);
        assert_eq!(work.names(), before);
    }
    // Nor is any of more versions than share a reading, of which only the last one is off.
    let still = work.read("model.simod/samples.ply");
    (0..4).for_each(|i| work.write(&format!("still-{i}.ply"), &still));
    let all = "still-0.ply still-1.ply still-2.ply still-3.ply deformed.ply -o out-{}.ply";
    work.refuses(&line.replace("deformed.ply -o out.ply", all), &["out-deformed.ply", "nothing was written"]);
    for turn in 0..4 {
        let outcome = work.run(&line);
        if outcome.code == Some(0) {
            assert!(turn > 0);
            let off = |(p, q): (&DVec3, DVec3)| q.distance(twist(*p)) / diagonal;
            let worst = rest.iter().zip(work.ply("out.ply").positions()).map(off).fold(0.0, f64::max);
            assert!(worst <= tolerance, "{worst}");
            return;
        }
        let refined = work.command("").args(advised(&outcome.stderr)).output().expect("the program starts");
        assert!(refined.status.success());
        work.move_samples("model.simod", twist);
    }
    panic!("the tolerance is not met");
}

#[test]
fn a_run_judges_its_vertices() {
    let work = Workplace::new();
    work.simod("generate -o model.ply --vertices 30000 --shape bumpy-plane");
    // No step that knows its map, so that estimates alone decide.
    work.write_session("model.ply", 3000, SMOOTH_PLANE);
    let report = work.report("run edit.toml --tolerance 2e-3 --diagnostics figures.ply");
    let certificate = &report["certificate"];
    assert!(certificate["true_error"].is_null(), "{report}");
    assert_eq!(certificate["vertices"]["of_vertices"], true);
    let worst = expected(&work, "figures.ply").iter().map(|[_, e]| *e).fold(0.0, f64::max);
    assert!(worst <= 2e-3, "{worst}");
    assert!((figure(&certificate["vertices"], "worst") / worst - 1.0).abs() < 1e-3, "{worst} {report}");
}

#[test]
fn a_bend_at_the_rim_of_a_region_is_named() {
    let work = Workplace::new();
    work.simod("generate -o model.ply --vertices 30000");
    work.write_session("model.ply", 2000, SMOOTH);
    work.refuses("run edit.toml --tolerance 2e-4", &["at the rim of a region of the step laplacian"]);
}

#[test]
fn reconstruct_checks_a_tolerance() {
    let work = Workplace::new();
    work.simod("generate -o model.ply --vertices 30000");
    work.simod("sample model.ply -o model.simod --samples 2000");
    work.move_samples("model.simod", twist);
    let line = "reconstruct model.simod --deformed deformed.ply -o out.ply";
    let refused = work.refuses(&format!("{line} --tolerance 1e-5"), &["out.ply", "1.0e-5"]);
    // Finer than the tolerance, as density changes around what is refined.
    let more = 3 * work.ply("deformed.ply").len();
    let command = format!(
        "`simod refine model.simod --auto --error 5e-6 --samples {more} --deformed deformed.ply -o more.ply`"
    );
    let command = command.as_str();
    for named in [command, "program that deformed"] {
        assert!(refused.stderr.contains(named), "{}", refused.stderr);
    }
    work.refuses(&format!("{line} --tolerance 1e-9"), &["cannot be met"]);
    let report = work.report(&format!("{line} --tolerance 0.1"));
    assert!(figure(&report["tolerance"], "expected") < 0.1);
    let checked = work.read("out.ply");
    work.simod(line);
    assert!(work.read("out.ply") == checked);
}
