//! `simod refine`: more samples where they are asked for, before and after a deformation, and in sessions.

use std::fs;
use std::process::{Command, Stdio};
use std::time::Duration;

use glam::DVec3;
use simod_tests::{Outcome, Ply, Workplace, skip};

/// Place that the tests refine, on the amphora's belly.
const PLACE: DVec3 = DVec3::new(0.41, 1.0, 0.41);
const SPHERE: &str = "--sphere 0.41,1,0.41,0.25";

/// A twist that grows upwards, and a bend.
fn twisted(p: DVec3) -> DVec3 {
    let (sin, cos) = (1.2 * p.y).sin_cos();
    DVec3::new(cos * p.x - sin * p.z + 0.2 * p.y * p.y, p.y, sin * p.x + cos * p.z)
}

/// The rms distance of the deformed model's vertices to where they belong, as a fraction of the diagonal: of
/// those well inside the sphere, and of those far from it.
fn errors(work: &Workplace, model: &str, out: &str) -> [f64; 2] {
    let (model, out) = (work.ply(model), work.ply(out));
    let (diagonal, mut sums) = (model.diagonal(), [(0.0, 0.0); 2]);
    for (p, q) in model.positions().into_iter().zip(out.positions()) {
        let d = p.distance(PLACE);
        let part = if d < 0.2 {
            0
        } else if d > 0.8 {
            1
        } else {
            continue;
        };
        sums[part].0 += (q.distance(twisted(p)) / diagonal).powi(2);
        sums[part].1 += 1.0;
    }
    assert!(sums.iter().all(|(_, n)| *n > 100.0));
    sums.map(|(sum, n)| (sum / n).sqrt())
}

fn bytes_of(work: &Workplace, ply: &str, count: usize) -> Vec<Vec<u8>> {
    let ply = work.ply(ply);
    (0..count).map(|i| ply.bytes[ply.position_bytes(i)].to_vec()).collect()
}

fn deformed(work: &Workplace, sampled: &str, out: &str) {
    work.move_samples(sampled, twisted);
    work.simod(&format!("reconstruct {sampled} --deformed deformed.ply -o {out}"));
}

#[test]
fn the_error_falls_inside_and_stays_outside() {
    let work = Workplace::new();
    work.simod("generate -o model.ply --vertices 150000");
    work.simod("sample model.ply -o model.simod --samples 3000");
    deformed(&work, "model.simod", "out.ply");
    let [mut inside, outside] = errors(&work, "model.ply", "out.ply");
    let mut samples = work.ply("model.simod/samples.ply").len();
    for step in 0..3 {
        let before = bytes_of(&work, "model.simod/samples.ply", samples);
        let report = work.report(&format!("refine model.simod {SPHERE} --factor 3"));
        let now = work.ply("model.simod/samples.ply").len();
        assert_eq!(report["added"], now - samples);
        assert_eq!(report["samples"], now);
        assert!(bytes_of(&work, "model.simod/samples.ply", samples) == before, "old samples have moved");
        samples = now;
        deformed(&work, "model.simod", "out.ply");
        let [inside_now, outside_now] = errors(&work, "model.ply", "out.ply");
        assert!(inside_now < 0.75 * inside, "step {step}: {inside:.1e} before, {inside_now:.1e} after");
        assert!((outside_now / outside - 1.0).abs() < 0.1, "outside {outside:.1e}, now {outside_now:.1e}");
        inside = inside_now;
    }
    // Down to the vertices, where nothing is left to transfer but rounding and the blend's own width.
    work.simod(&format!("refine model.simod {SPHERE} --error 0"));
    deformed(&work, "model.simod", "out.ply");
    let [full, _] = errors(&work, "model.ply", "out.ply");
    assert!(full < 1e-6, "{full:.1e} with all vertices");
    let info = work.report("info model.simod");
    let refinements = info["refinements"].as_array().expect("a list");
    assert_eq!(refinements.len(), 4);
    assert_eq!(refinements[3]["error"], 0.0);
    assert_eq!(refinements[0]["shapes"][0]["sphere"]["radius"], 0.25);
    assert_eq!(info["cells_kept"], true);
}

#[test]
fn before_or_after_the_deformation_is_the_same() {
    let work = Workplace::new();
    work.simod("generate -o model.ply --vertices 150000");
    for sampled in ["before.simod", "after.simod"] {
        work.simod(&format!("sample model.ply -o {sampled} --samples 5000"));
    }
    work.simod(&format!("refine before.simod {SPHERE} --error 5e-4"));
    deformed(&work, "before.simod", "before.ply");

    work.move_samples("after.simod", twisted);
    let old = work.ply("deformed.ply");
    let bits = bytes_of(&work, "deformed.ply", old.len());
    let report =
        work.report(&format!("refine after.simod {SPHERE} --error 5e-4 --deformed deformed.ply -o more.ply"));
    let more = work.ply("more.ply");
    assert_eq!(more.len(), old.len() + report["added"].as_u64().expect("a number") as usize);
    assert_eq!(more.len(), work.ply("after.simod/samples.ply").len());
    assert!(bytes_of(&work, "more.ply", old.len()) == bits, "deformed samples have moved");
    assert!(work.read("before.simod/samples.ply") == work.read("after.simod/samples.ply"));
    // The new ones are where the coarse reconstruction takes them: off by its error.
    let rest = work.ply("after.simod/samples.ply").positions();
    let diagonal = more.diagonal();
    let places = more.positions().into_iter().zip(rest).skip(old.len());
    let worst = places.map(|(q, p)| q.distance(twisted(p)) / diagonal).fold(0.0, f64::max);
    assert!(worst < 1e-3, "a new sample is off by {worst:.1e}");
    work.simod("reconstruct after.simod --deformed more.ply -o after.ply");
    let [before, _] = errors(&work, "model.ply", "before.ply");
    let [after, _] = errors(&work, "model.ply", "after.ply");
    assert!(before < 1e-4 && after < 1e-4, "{before:.1e} before, {after:.1e} after");
}

#[test]
fn only_what_is_needed_is_read() {
    let work = Workplace::new();
    work.simod("generate -o model.ply --vertices 400000 --no-faces");
    work.simod("sample model.ply -o model.simod --samples 20000");
    let report = work.report("refine model.simod --sphere 0.41,1,0.41,0.1 --factor 10");
    let [read, all] =
        [&report["bytes_read"]["vertices"], &report["model_bytes"]].map(|n| n.as_u64().expect("a number"));
    assert!(read * 5 < all, "{read} of {all} bytes");
    // In no order, and too large for the places of all vertices to be kept, nearly all has to be read, and is
    // told.
    work.simod("generate -o large.ply --vertices 2500000 --no-faces --no-normals --no-colors");
    let all = work.ply("large.ply").positions();
    let mixed: Vec<DVec3> = (0..all.len()).map(|i| all[i * 7_919_477 % all.len()]).collect();
    work.write("mixed.ply", Ply::from_points(&mixed, &[]).bytes);
    work.simod("sample mixed.ply -o mixed.simod --samples 20000");
    let outcome = work.simod("refine mixed.simod --sphere 0.41,1,0.41,0.1 --factor 10");
    assert!(outcome.lines("note: ")[0].contains("% of its vertices are read"), "{}", outcome.stderr);
    assert!(work.ply("mixed.simod/samples.ply").len() > 20_100);
}

#[test]
fn clouds_and_soups_are_refined() {
    let work = Workplace::new();
    work.simod("generate -o cloud.ply --vertices 60000 --no-faces --no-normals");
    work.simod("sample cloud.ply -o cloud.simod --samples 3000");
    let before = work.ply("cloud.simod/samples.ply");
    work.simod(&format!("refine cloud.simod {SPHERE} --factor 5"));
    let after = work.ply("cloud.simod/samples.ply");
    assert!(after.len() > before.len() + 200);
    assert_eq!(after.normals()[..before.len()], before.normals());
    assert!(after.normals().iter().all(|n| (n.length() - 1.0).abs() < 1e-3));
    deformed(&work, "cloud.simod", "out.ply");
    assert!(errors(&work, "cloud.ply", "out.ply")[0] < 1e-3);

    // Triangles with corners of their own, as some scanners write them.
    work.simod("generate -o mesh.ply --vertices 30000");
    let mesh = work.ply("mesh.ply");
    let vertices = mesh.positions();
    let corners: Vec<DVec3> = vertices.windows(3).take(20_000).flatten().copied().collect();
    work.write("soup.ply", Ply::from_points(&corners, &[]).bytes);
    work.simod("sample soup.ply -o soup.simod --samples 1500");
    let report = work.report("refine soup.simod --half-space 0,0.3,0,0,-1,0 --error 0");
    // Corners that lie in one place share a sample.
    let samples = work.ply("soup.simod/samples.ply").len();
    assert!(report["added"].as_u64().expect("a number") > 0 && samples < 21_000, "{samples}");
}

#[test]
fn a_session_refines_between_its_steps() {
    let work = Workplace::new().with_plugins("plugins");
    work.simod("generate -o model.ply --vertices 120000");
    let twist = "[[step]]\ndeform = \"warp\"\n";
    let refine = "[[step]]\nrefine = { shapes = [{ sphere = { center = [0.41, 1, 0.41], radius = 0.25 } }], error = 6e-4 }\n";
    let mut last: Option<f64> = None;
    // Refined before the deformation, or not at all: the exact map tells the difference.
    for steps in [twist.to_owned(), format!("{refine}{twist}")] {
        work.write_session("model.ply", 4000, &steps);
        let report = work.report("run edit.toml --measure");
        let rms = report["transfer_error"]["rms"].as_f64().expect("a number");
        assert!(last.is_none_or(|before| rms < before), "{rms:.1e}, {last:?} without");
        last = Some(rms);
    }
    // Between two, and of the model as it is then.
    work.write_session("model.ply", 4000, &format!("{twist}{refine}{twist}"));
    let run = work.report("run edit.toml -o run.ply");
    work.simod("sample model.ply -o model.simod --samples 4000");
    let before = work.read("model.simod/samples.ply");
    work.refuses("deform model.simod --session edit.toml -o moved.ply", &["edit.toml, line", "refines"]);
    work.simod("deform model.simod --session edit.toml -o moved.ply --refined refined.simod");
    assert!(work.read("model.simod/samples.ply") == before);
    let samples = work.ply("refined.simod/samples.ply").len();
    assert_eq!(run["samples"], samples);
    assert!(samples > 4200);
    work.simod("reconstruct refined.simod --deformed moved.ply -o steps.ply");
    assert!(work.read("run.ply") == work.read("steps.ply"));
    // A selection that meets nothing is an error with its place.
    work.write_session(
        "model.ply",
        4000,
        &format!("{twist}{}", refine.replace("[0.41, 1, 0.41]", "[30, 1, 0]")),
    );
    work.refuses("run edit.toml", &["edit.toml, line", "does not meet the model"]);
}

#[test]
fn what_makes_no_sense_is_refused_and_changes_nothing() {
    let work = Workplace::new();
    work.simod("generate -o model.ply --vertices 40000");
    work.simod("sample model.ply -o model.simod --samples 2000");
    work.simod("generate -o other.ply --vertices 30000");
    let refuses = |arguments: &str, named: &[&str]| work.refuses(&format!("refine {arguments}"), named);
    refuses("model.ply --sphere 0,1,0,1 --error 1e-4", &["model.ply", "no sampled model"]);
    refuses("missing.simod --sphere 0,1,0,1 --error 1e-4", &["missing.simod"]);
    refuses("model.simod --sphere 0,1,0,0 --error 1e-4", &["radius"]);
    refuses("model.simod --sphere 0,1,nan,1 --error 1e-4", &["no finite number"]);
    refuses("model.simod --box 1,1,1,0,0,0 --error 1e-4", &["min of a box"]);
    refuses("model.simod --half-space 0,1,0,0,0,0 --error 1e-4", &["normal of a half-space"]);
    refuses("model.simod --sphere 50,1,0,1 --error 1e-4", &["does not meet the model"]);
    refuses("model.simod --sphere 0,1,0,1 --error -1", &["error bound -1"]);
    refuses("model.simod --sphere 0,1,0,1 --error nan", &["error bound NaN"]);
    refuses("model.simod --sphere 0,1,0,1 --factor 1", &["factor 1"]);
    refuses("model.simod --sphere 0,1,0,1 --samples 0", &["0 samples"]);
    refuses("model.simod --sphere 0,1,0,1 --error 1e-4 --model other.ply", &["other.ply changed"]);
    refuses("model.simod --sphere 0,1,0,1 --error 1e-4 --deformed model.ply -o d.ply", &["40000 vertices"]);
    work.move_samples("model.simod", twisted);
    refuses(
        "model.simod --sphere 0,1,0,1 --error 1e-4 --deformed deformed.ply -o deformed.ply",
        &["overwritten"],
    );
    for usage in [
        "model.simod --error 1e-4",
        "model.simod --sphere 0,1,0,1",
        "model.simod --sphere 0,1,0 --error 1e-4",
        "model.simod --sphere 0,1,0,1 --error 1e-4 --factor 2",
        "model.simod --sphere 0,1,0,1 --error 1e-4 -o d.ply",
    ] {
        assert_eq!(work.run(&format!("refine {usage}")).code, Some(2), "{usage}");
    }
    // Nothing to do is no failure.
    let before = work.snapshot();
    let report = work.report("refine model.simod --sphere 0,1,0,1 --error 0.5");
    assert_eq!(report["added"], 0);
    assert_eq!(work.snapshot(), before);

    // A vertex that moved, in what is read.
    let model = work.ply("model.ply");
    let near = model.positions().iter().position(|p| p.distance(PLACE) < 0.1).expect("a vertex");
    let mut moved = Ply::parse(model.bytes);
    let p = moved.positions()[near];
    moved.set_position(near, p * 1.001);
    work.write("moved.ply", moved.bytes);
    refuses(
        &format!("model.simod {SPHERE} --error 1e-4 --model moved.ply"),
        &["moved.ply changed since it was sampled"],
    );

    // Once refined, the cells cannot be made again.
    work.write("model.simod/keep.txt", "mine");
    refuses(&format!("model.simod {SPHERE} --error 1e-3"), &["holds keep.txt"]);
    fs::remove_file(work.path("model.simod/keep.txt")).expect("a file");
    work.simod("bind model.simod");
    let outcome = work.simod(&format!("refine model.simod {SPHERE} --error 1e-3"));
    assert!(outcome.lines("warning: ")[0].contains("binding.bin"), "{}", outcome.stderr);
    work.simod("refine model.simod --box -0.4,0.9,-0.4,-0.2,1.1,-0.2 --error 1e-3 --into other.simod");
    assert!(!work.path("model.simod/binding.bin").exists());
    let mut cells = work.read("model.simod/cells.bin");
    let middle = cells.len() / 2;
    cells[middle] ^= 1;
    work.write("model.simod/cells.bin", cells);
    refuses(&format!("model.simod {SPHERE} --error 1e-4"), &["cells.bin", "refined"]);
}

/// Whatever the moment at which it ends, the folder is the one before or the one after.
#[test]
#[cfg(unix)]
fn a_killed_refinement_leaves_the_old_model_or_the_new_one() {
    let work = Workplace::new();
    work.simod("generate -o model.ply --vertices 400000");
    work.simod("sample model.ply -o model.simod --samples 20000");
    let old = work.read("model.simod/samples.ply");
    work.simod(&format!("refine model.simod {SPHERE} --error 0 --into new.simod"));
    let new = work.read("new.simod/samples.ply");
    let mut interrupted = 0;
    for (i, wait) in [5u64, 20, 40, 60, 80, 100, 120, 150, 200, 300, 400].iter().enumerate() {
        let mut command = work.command(&format!("refine model.simod {SPHERE} --error 0"));
        let child =
            command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("the program starts");
        std::thread::sleep(Duration::from_millis(*wait));
        let signal = if i % 2 == 0 { "-KILL" } else { "-INT" };
        let sent = Command::new("kill").args([signal, &child.id().to_string()]).status().expect("kill runs");
        let outcome = Outcome::from(child.wait_with_output().expect("an end"));
        interrupted += usize::from(sent.success() && outcome.code != Some(0));
        let now = work.read("model.simod/samples.ply");
        assert!(now == old || now == new, "after {wait} ms");
        work.simod("info model.simod");
        if now == new {
            fs::remove_dir_all(work.path("model.simod")).expect("a folder");
            work.simod("sample model.ply -o model.simod --samples 20000");
        }
    }
    if interrupted == 0 {
        skip("every refinement was done before it could be interrupted");
    }
}

/// A bump on the amphora's belly.
fn bumped(p: DVec3) -> DVec3 {
    p + DVec3::new(0.1, 0.0, 0.1) * (-p.distance_squared(PLACE) / 0.01).exp()
}

#[test]
fn auto_refines_where_the_deformation_needs_it() {
    let work = Workplace::new();
    work.simod("generate -o model.ply --vertices 150000");
    work.simod("sample model.ply -o model.simod --samples 4000");
    work.move_samples("model.simod", bumped);
    let old = work.ply("deformed.ply").len();
    let bits = bytes_of(&work, "deformed.ply", old);
    let auto = "refine model.simod --auto --deformed deformed.ply -o more.ply";
    let report = work.report(&format!("{auto} --samples 500"));
    let added = report["added"].as_u64().expect("a number") as usize;
    assert!((100..=500).contains(&added), "{added}");
    assert!(report["needy_samples"].as_u64().expect("a number") > 10);
    let samples = work.ply("model.simod/samples.ply");
    assert!(samples.positions()[old..].iter().all(|p| p.distance(PLACE) < 0.6));
    assert_eq!(work.ply("more.ply").len(), old + added);
    assert!(bytes_of(&work, "more.ply", old) == bits, "deformed samples have moved");
    let info = work.report("info model.simod");
    let number = |value: &serde_json::Value| value.as_f64().expect("a number");
    let refinement = &info["refinements"][0];
    assert!(number(&refinement["transfer_error"]) >= 1e-5);
    let diagonal = number(&info["diagonal"]);
    assert_eq!(number(&refinement["lengths"]["error"]), number(&refinement["error"]) * diagonal);
    let expected = number(&report["expected_transfer_error"]) * number(&report["diagonal"]);
    assert_eq!(number(&report["expected_transfer_error_length"]), expected);
    assert_eq!(number(&report["lengths"]["expected_transfer_error"]), expected);
    assert_eq!(report["lengths"]["error"], report["error_length"]);
    let outcome = work.simod("info model.simod");
    assert!(outcome.stdout.contains("wherever it was needed"), "{}", outcome.stdout);

    // A rigid motion, or none, needs no more samples.
    for map in [|p: DVec3| p, |p: DVec3| DVec3::new(-p.z, p.y + 1.0, p.x)] {
        work.move_samples("model.simod", map);
        let before = work.read("model.simod/samples.ply");
        let outcome = work.simod(auto);
        assert!(outcome.stdout.contains("needs no more samples"), "{}", outcome.stdout);
        assert!(work.read("model.simod/samples.ply") == before);
        assert_eq!(work.ply("more.ply").len(), old + added);
    }
    work.move_samples("model.simod", |p| if p.distance(PLACE) < 0.05 { DVec3::NAN } else { p });
    work.refuses(auto, &["deformed.ply"]);
    work.move_samples("model.simod", bumped);
    work.refuses(&format!("{auto} --error 0"), &["transfer error 0"]);
    work.refuses(&format!("{auto} --samples 0"), &["0 samples"]);
    let refused = work.refuses(&format!("{auto} --samples 5000000000"), &["number of 5000000000 samples"]);
    assert!(refused.stderr.contains("from 1 to 4294967295 samples"), "{}", refused.stderr);
    for usage in
        ["--auto", "--auto --deformed deformed.ply -o d.ply --factor 2", "--deformed deformed.ply -o d.ply"]
    {
        assert_eq!(work.run(&format!("refine model.simod {usage}")).code, Some(2), "{usage}");
    }
}

#[test]
fn where_no_vertices_are_left_more_is_expected() {
    let work = Workplace::new().with_plugins("plugins");
    work.simod("generate -o model.ply --vertices 3000");
    work.simod("sample model.ply -o model.simod --samples 1000");
    work.simod("refine model.simod --half-space 0,-9,0,0,1,0 --error 0");
    work.move_samples("model.simod", |p| if p.y > 1.0 { p + 0.1 * DVec3::Y } else { p });
    let outcome = work.simod("refine model.simod --auto --deformed deformed.ply -o more.ply");
    for told in ["which is more than 1.0e-5", "no vertices left there", "Nothing is changed"] {
        assert!(outcome.stdout.contains(told), "{}", outcome.stdout);
    }
    let steps = "[[step]]\nrefine = { shapes = [{ half-space = { point = [0, -9, 0], normal = [0, 1, 0] } }], error = 0 }\n\
        [[step]]\ndeform = \"warp\"\n\
        [[step.region]]\nrole = \"mask\"\nshapes = [{ half-space = { point = [0, 1, 0], normal = [0, 1, 0] } }]\n\
        [[step]]\nrefine = { auto = true }\n";
    work.write_session("model.ply", 1000, steps);
    let outcome = work.simod("run edit.toml");
    assert!(outcome.stderr.contains("no vertices left there"), "{}", outcome.stderr);
}

#[test]
fn a_step_that_refines_nothing_says_so() {
    let work = Workplace::new().with_plugins("plugins");
    work.simod("generate -o model.ply --vertices 5000 --shape bar");
    // So few that the bound rises to where no cluster is divided.
    let steps = "[[step]]\ndeform = \"warp\"\n[[step]]\nrefine = { auto = true, samples = 1 }\n";
    work.write_session("model.ply", 500, steps);
    let outcome = work.simod("run edit.toml");
    assert!(outcome.stderr.contains("divides no cluster any further"), "{}", outcome.stderr);
}

#[test]
fn a_session_refines_where_its_steps_need_it() {
    let work = Workplace::new().with_plugins("plugins");
    work.simod("generate -o model.ply --vertices 120000");
    let twist = "[[step]]\ndeform = \"warp\"\n";
    let auto = "[[step]]\nrefine = { auto = true, error = 1e-6, samples = 1500 }\n";
    // The refinement that the first twist needs serves the second one.
    let run = |steps: &str| {
        work.write_session("model.ply", 4000, steps);
        let report = work.report("run edit.toml --measure");
        let number = |value: &serde_json::Value| value.as_f64().expect("a number");
        (number(&report["transfer_error"]["rms"]), number(&report["samples"]))
    };
    let (coarse, few) = run(&[twist, twist].concat());
    let (fine, more) = run(&[twist, auto, twist].concat());
    assert!(more > few + 100.0 && more <= few + 1500.0, "{few}, {more}");
    assert!(fine < coarse, "{coarse:.1e}, {fine:.1e}");
    // First of all, nothing has moved.
    let (_, same) = run(&[auto, twist].concat());
    assert_eq!(same, few);
    work.write_session("model.ply", 4000, &auto.replace("1e-6", "0"));
    work.refuses("run edit.toml", &["edit.toml, line", "no fineness"]);
}
