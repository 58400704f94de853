//! Brush strokes, smooth handles and skeletons, from a session to the model's vertices.

use simod_tests::Workplace;

/// A stroke over a generated sphere lifts what is under it, and leaves every byte elsewhere.
#[test]
fn a_stroke_lifts_what_is_under_it() {
    let work = Workplace::new();
    work.simod("generate -o sphere.ply --shape bumpy-sphere --vertices 60000");
    let stroke = |points: &str, params: &str| {
        format!("[[step.stroke]]\nradius = 0.3\nparams = {{ {params} }}\npoints = {points}\n")
    };
    let step = "[[step]]\ndeform = \"displacement-paint\"\nparams = { brush = \"draw\", depth = 0.4 }\n";
    let path = "[[0.1, -0.2, 1], [0.15, 0, 1.02], [0.1, 0.2, 1]]";
    work.write_session("sphere.ply", 10_000, &format!("{step}{}", stroke(path, "")));
    work.simod("run edit.toml");
    let (before, after) = (work.ply("sphere.ply"), work.ply("edited.ply"));
    assert!(after.other_bytes() == before.other_bytes());
    let (mut highest, mut still): (f64, usize) = (0.0, 0);
    for (p, q) in before.positions().into_iter().zip(after.positions()) {
        let moved = p.distance(q);
        highest = highest.max(moved);
        if p.z < 0.6 {
            assert_eq!(p, q);
            still += 1;
        }
    }
    assert!((highest - 0.12).abs() < 0.01, "{highest}");
    assert!(still > 40_000, "{still}");

    // Parameters of a stroke's own; a second stroke that undoes the first; and none at all.
    let back = stroke(path, "brush = \"draw\"").replace("radius = 0.3", "radius = 0.3\nstrength = -1");
    work.write_session("sphere.ply", 10_000, &format!("{step}{}{back}", stroke(path, "")));
    work.simod("run edit.toml");
    let after = work.ply("edited.ply");
    let moved = before.positions().into_iter().zip(after.positions()).map(|(p, q)| p.distance(q));
    let left = moved.fold(0.0, f64::max);
    assert!(left < 0.4 * highest, "{left} of {highest}");
    work.write_session("sphere.ply", 10_000, step);
    work.simod("run edit.toml");
    assert!(work.read("edited.ply") == work.read("sphere.ply"));
    work.write_session("sphere.ply", 10_000, &format!("{step}{}", stroke(path, "brush = \"chisel\"")));
    work.refuses("run edit.toml", &["brush", "chisel"]);
}

/// A handle turns a part of the model exactly, and what lies between it and what is fixed by parts of the
/// angle.
#[test]
fn a_smooth_handle_turns_by_parts() {
    let work = Workplace::new();
    work.simod("generate -o amphora.ply --vertices 100000");
    let steps = "[[step]]\ndeform = \"smooth-handle\"\n\
        [[step.region]]\nrole = \"fixed\"\n\
        shapes = [{ half-space = { point = [0, 0.5, 0], normal = [0, -1, 0] } }]\n\
        [[step.region]]\nrole = \"handle\"\n\
        shapes = [{ half-space = { point = [0, 1.5, 0], normal = [0, 1, 0] } }]\n\
        move = { axis = [0, 1, 0], degrees = 90 }\n";
    work.write_session("amphora.ply", 20_000, steps);
    work.simod("run edit.toml");
    let (before, after) = (work.ply("amphora.ply"), work.ply("edited.ply"));
    assert!(after.other_bytes() == before.other_bytes());
    let mut between = 0;
    for (p, q) in before.positions().into_iter().zip(after.positions()) {
        // The reconstruction reaches a few spacings of the samples over the borders.
        if p.y < 0.35 {
            assert_eq!(p, q);
        } else if p.y > 1.6 {
            assert!(q.distance(glam::DVec3::new(p.z, p.y, -p.x)) < 1e-5, "{p} went to {q}");
        } else {
            let radius = |v: glam::DVec3| v.x.hypot(v.z);
            assert!((radius(p) - radius(q)).abs() < 5e-3 && (p.y - q.y).abs() < 5e-3, "{p} went to {q}");
            between += 1;
        }
    }
    assert!(between > 10_000, "{between}");
}

/// A compact kernel deforms a part of the model; what is beyond its support, and what is fixed, keeps every
/// byte.
#[test]
fn a_compact_handle_moves_what_is_near_alone() {
    let work = Workplace::new();
    work.simod("generate -o sphere.ply --shape bumpy-sphere --vertices 60000");
    // The diagonal is about 3.5, the support 0.7; the handle ends at y = 0.8.
    let step = "[[step]]\ndeform = \"rbf\"\nparams = { kernel = \"compact-c2\", support = 0.2 }\n\
        [[step.region]]\nrole = \"handle\"\n\
        shapes = [{ half-space = { point = [0, 0.8, 0], normal = [0, 1, 0] } }]\n\
        move = { translate = [0, 0.2, 0], axis = [0, 1, 0], degrees = 40 }\n";
    work.write_session("sphere.ply", 10_000, step);
    work.simod("run edit.toml");
    let (before, after) = (work.ply("sphere.ply"), work.ply("edited.ply"));
    assert!(after.other_bytes() == before.other_bytes());
    let (sin, cos) = 40_f64.to_radians().sin_cos();
    let (mut still, mut between) = (0, 0);
    for (p, q) in before.positions().into_iter().zip(after.positions()) {
        // The reconstruction reaches a few spacings of the samples over the borders.
        if p.y < -0.1 {
            assert_eq!(p, q);
            still += 1;
        } else if p.y > 0.9 {
            let told = glam::DVec3::new(cos * p.x + sin * p.z, p.y + 0.2, cos * p.z - sin * p.x);
            assert!(q.distance(told) < 1e-5, "{p} went to {q}");
        } else if p != q {
            between += 1;
        }
    }
    assert!(still > 20_000 && between > 5_000, "{still}, {between}");
}

/// A skeleton in the amphora: its upper half bows, its foot stays to the last byte, and its mouth reaches.
#[test]
fn a_skeleton_bends_the_amphora() {
    let work = Workplace::new();
    work.simod("generate -o amphora.ply --vertices 100000");
    let joint = |id: &str, y: f64, parent: &str| {
        let parent = if parent.is_empty() { String::new() } else { format!("parent = \"{parent}\"\n") };
        format!("[[step.joint]]\nid = \"{id}\"\nat = [0, {y}, 0]\n{parent}")
    };
    // Children may come first.
    let joints = joint("mouth", 1.95, "neck")
        + &joint("foot", 0.1, "")
        + &joint("belly", 0.8, "foot")
        + &joint("neck", 1.5, "belly");
    let step = |params: &str, moved: &str| {
        format!(
            "[[step]]\ndeform = \"skinning\"\nparams = {{ {params} }}\n{joints}[[step.handle]]\n{moved}\n"
        )
    };
    let run = |steps: &str| -> Vec<(glam::DVec3, glam::DVec3)> {
        work.write_session("amphora.ply", 20_000, steps);
        let report = work.report("run edit.toml --measure");
        let rms = report["transfer_error"]["rms"].as_f64().expect("a figure");
        assert!(rms < 1e-4, "{rms}");
        let (before, after) = (work.ply("amphora.ply"), work.ply("edited.ply"));
        assert!(after.other_bytes() == before.other_bytes());
        before.positions().into_iter().zip(after.positions()).collect()
    };
    let bow = "id = \"neck\"\nmove = { axis = [0, 0, 1], degrees = -40 }";
    for method in ["linear", "dual-quaternion"] {
        let (mut still, mut bowed) = (0, 0);
        let turn = glam::DAffine3::from_translation(glam::DVec3::Y * 1.5)
            * glam::DAffine3::from_rotation_z(-40_f64.to_radians())
            * glam::DAffine3::from_translation(glam::DVec3::Y * -1.5);
        for (p, q) in run(&step(&format!("method = \"{method}\""), bow)) {
            if p.y < 0.3 {
                assert_eq!(p, q);
                still += 1;
            } else if p.y > 1.95 {
                // The mouth is wide, and the belly still has a bit of it.
                assert!(turn.transform_point3(p).distance(q) < 0.06, "{p} went to {q}");
                bowed += 1;
            }
        }
        assert!(still > 5000 && bowed > 500, "{still} {bowed}");
    }
    let reach = "id = \"mouth/reach\"\nmove = { translate = [0.4, -0.3, 0] }";
    let rim: Vec<_> = run(&step("", reach)).into_iter().filter(|(p, _)| (p.y - 1.95).abs() < 0.02).collect();
    let middle = rim.iter().map(|(_, q)| *q).sum::<glam::DVec3>() / rim.len() as f64;
    assert!(middle.distance(glam::DVec3::new(0.4, 1.65, 0.0)) < 0.06, "{middle}");

    work.write_session("amphora.ply", 20_000, &step("", &bow.replace("neck", "nek")));
    work.refuses("run edit.toml", &["no handle `nek`"]);
    let flat = joints.replace("at = [0, 0.8, 0]", "at = [0, 0.1, 0]");
    work.write_session("amphora.ply", 20_000, &step("", bow).replace(&joints, &flat));
    work.refuses("run edit.toml", &["`foot` and `belly` are in one place"]);
    work.write_session("amphora.ply", 20_000, &step("", bow).replace(&joints, ""));
    work.refuses("run edit.toml", &["no joints"]);
}
