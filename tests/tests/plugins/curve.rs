//! A wire through a model, from a session to its vertices.

use glam::{DQuat, DVec3};
use simod_tests::Workplace;

fn cylinder(step: &str) -> Workplace {
    let work = Workplace::new();
    work.simod("generate --shape cylinder -o cylinder.ply --vertices 40000");
    work.write_session("cylinder.ply", 6000, step);
    work
}

/// Points along a line, a line of text for each.
fn text(points: &[DVec3]) -> String {
    points.iter().map(|p| format!("{}, {}, {}\n", p.x, p.y, p.z)).collect()
}

#[test]
fn a_wire_in_a_file_bends_the_model_as_an_arc_does() {
    let step = "[[step]]\ndeform = \"curve\"\nparams = { wire = \"wire.csv\", moved = \"moved.csv\" }\n";
    let work = cylinder(step);
    let before = work.ply("cylinder.ply").positions();
    let [low, high] = before.iter().fold([DVec3::MAX, DVec3::MIN], |[a, b], p| [a.min(*p), b.max(*p)]);
    let axis = (high - low).max_position();
    let middle = low.midpoint(high);
    let along = |t: f64| {
        let mut p = middle;
        p[axis] = low[axis] + t * (high[axis] - low[axis]);
        p
    };
    let wire: Vec<DVec3> = (0..=40).map(|i| along(f64::from(i) / 40.0)).collect();
    // An arc of two thirds of a turn, as long as the wire.
    let (length, angle) = (high[axis] - low[axis], 240f64.to_radians());
    let (tangent, across) = (DVec3::AXES[axis], DVec3::AXES[(axis + 1) % 3]);
    let radius = length / angle;
    let pivot = wire[0] + radius * across;
    let bent = |p: DVec3| {
        let at = (p - wire[0]).dot(tangent) / length;
        let turn = DQuat::from_axis_angle(tangent.cross(across), angle * at);
        pivot + turn * (p - (p - wire[0]).dot(tangent) * tangent - pivot)
    };
    work.write("wire.csv", text(&wire));
    work.write("moved.csv", text(&wire.iter().map(|p| bent(*p)).collect::<Vec<_>>()));
    let report = work.report("run edit.toml --measure");
    assert!(report["transfer_error"]["rms"].as_f64().expect("a figure") < 1e-4, "{report}");
    let after = work.ply("edited.ply").positions();
    let inner = |p: &DVec3| (0.1..0.9).contains(&((p - wire[0]).dot(tangent) / length));
    let all = before.iter().zip(&after).filter(|(p, _)| inner(p));
    let worst = all.map(|(p, q)| bent(*p).distance(*q)).fold(0.0, f64::max);
    assert!(worst < 1e-3 * (high - low).length(), "{worst}");
}

#[test]
fn handles_of_a_made_wire_move_what_is_about_them() {
    let step = "[[step]]\ndeform = \"curve\"\nparams = { points = 7 }\n[[step.handle]]\nid = \"6\"\nmove = { translate = \
                [0.0, 0.1, 0.2] }\n";
    let work = cylinder(step);
    work.simod("run edit.toml --exact");
    let (before, after) = (work.ply("cylinder.ply").positions(), work.ply("edited.ply").positions());
    let moved = |p: &(&DVec3, &DVec3)| p.0.distance(*p.1) > 0.05;
    let all = before.iter().zip(&after);
    let (moved, still) = (all.clone().filter(moved).count(), all.filter(|(p, q)| p == q).count());
    assert!(moved > 3000 && still > 20_000, "{moved} moved, {still} are where they were");
}

#[test]
fn files_that_do_not_fit_are_told() {
    let step = "[[step]]\ndeform = \"curve\"\nparams = { wire = \"wire.csv\", moved = \"moved.csv\" }\n";
    let work = cylinder(step);
    work.write("wire.csv", "0 0 0\n1 0 0\n");
    work.write("moved.csv", "0 0 0\n1 0 0\n2 0 0\n");
    work.refuses("run edit.toml", &["the moved wire has 3 points", "2"]);
    work.write("moved.csv", "0 0 0\n1 0 1e999\n");
    work.refuses("run edit.toml", &["moved.csv, line 2", "not finite"]);
}
