//! Landmarks in a file, from a session to the model's vertices, and what is told of them.

use glam::DVec3;
use simod_tests::Workplace;

/// The amphora, and a session that takes its landmarks to where they belong.
fn amphora(params: &str) -> Workplace {
    let work = Workplace::new();
    work.simod("generate -o amphora.ply --vertices 60000");
    with(&work, params);
    work
}

fn with(work: &Workplace, params: &str) {
    let step = format!(
        "[[step]]\ndeform = \"control-points\"\nparams = {{ landmarks = \"landmarks.csv\", {params} }}\n"
    );
    work.write_session("amphora.ply", 6000, &step);
}

/// Landmarks of some of the model's vertices.
fn csv(work: &Workplace, by: impl Fn(DVec3) -> DVec3) -> String {
    let places = work.ply("amphora.ply").positions();
    let mut text = "name,x,y,z,to x,to y,to z\n".to_owned();
    for (i, p) in places.iter().step_by(places.len() / 24).enumerate() {
        let q = by(*p);
        text += &format!("p{i},{},{},{},{},{},{}\n", p.x, p.y, p.z, q.x, q.y, q.z);
    }
    text
}

fn turned(p: DVec3) -> DVec3 {
    1.5 * (glam::DQuat::from_rotation_y(0.7) * p) + DVec3::new(3.0, 0.0, -1.0)
}

#[test]
fn a_similarity_is_found_and_done_to_all_vertices() {
    let work = amphora("method = \"similarity\", report = \"json\"");
    work.write("landmarks.csv", csv(&work, turned));
    let report = work.report("run edit.toml --measure");
    assert!(report["transfer_error"]["rms"].as_f64().expect("a figure") < 1e-6, "{report}");
    let (before, after) = (work.ply("amphora.ply").positions(), work.ply("edited.ply").positions());
    for (p, q) in before.iter().zip(after) {
        assert!(q.distance(turned(*p)) < 1e-5, "{p} went to {q}");
    }
    let notes = report["notes"].as_array().expect("what is told");
    let told = notes[0].as_str().expect("a text").strip_prefix("control-points: ").expect("whose it is");
    let told: serde_json::Value = serde_json::from_str(told).expect("JSON");
    assert!(told["method"] == "similarity" && told["rms"].as_f64().expect("a figure") < 1e-5, "{told}");
    assert_eq!(notes.len(), 1 + told["landmarks"].as_u64().expect("a number") as usize);
}

#[test]
fn a_spline_meets_its_landmarks_and_tells_which_is_wrong() {
    let work = amphora("report = \"landmarks\"");
    let bend = |p: DVec3| p + DVec3::new(0.05 * p.y * p.y, 0.0, 0.02 * p.y);
    let text = csv(&work, bend);
    work.write("landmarks.csv", text.clone());
    let outcome = work.simod("run edit.toml --exact");
    assert!(outcome.stdout.contains("control-points: p3: residual "), "{}", outcome.stdout);
    let places = work.ply("amphora.ply").positions();
    let after = work.ply("edited.ply").positions();
    for i in (0..places.len()).step_by(places.len() / 24) {
        assert!(after[i].distance(bend(places[i])) < 1e-5);
    }
    // By affine maps, one that is wrong does not pass for a bend.
    with(&work, "method = \"affine\"");
    let wrong =
        csv(&work, |p| if (p - places[0]).length() == 0.0 { bend(p) + 2.0 * DVec3::X } else { bend(p) });
    work.write("landmarks.csv", wrong);
    let report = work.report("run edit.toml");
    let warnings = report["warnings"].to_string();
    assert!(warnings.contains("stand out") && warnings.contains("`p0`"), "{report}");
}

#[test]
fn what_landmarks_leave_open_is_said_with_what_they_determine() {
    let work = amphora("method = \"affine\"");
    let refused = |text: &str, parts: &[&str], offered: &str| {
        work.write("landmarks.csv", text);
        work.refuses("run edit.toml", parts);
        let outcome = work.run("run edit.toml");
        assert!(outcome.hint().contains(offered), "{}", outcome.stderr);
    };
    refused(
        "a,0,0,0,1,0,0\nb,0,1,0,1,1,0\nc,0,2,0,1,2,0\n",
        &["landmarks.csv", "one line"],
        "method = \"translation\"",
    );
    refused("a,0,0,0,1,0,0\nb,0,1,0,1,1,0\nc,1,0,0,2,0,0\n", &["one plane"], "method = \"similarity\"");
    refused("a,0,0,0,1,0,0\nb,0,1,0,1,1\n", &["landmarks.csv, line 2", "6 fields"], "a name");
    refused("a,0,0,0,1,0,0\na,0,1,0,1,1,0\n", &["line 2", "as line 1 does"], "");
    refused("a,0,0,0,1,0,nan\n", &["line 1", "not finite"], "");
    refused("a,9e5,0,0,1,0,0\n", &["landmarks.csv", "far from the model"], "same origin");
    refused("a,0,0,0,1,0,0\n", &["there is one landmark"], "method = \"translation\"");
    with(&work, "method = \"thin-plate\"");
    refused(
        "a,0,0,0,1,0,0\nb,0,1,0,1,1,0\nc,0.3,0,0,1.3,0,0\nd,0,0,0.3,1,0,0.3\ne,0,1,0,2,2,2\n",
        &["`b` and `e` coincide, in lines 2 and 5"],
        "method = \"affine\"",
    );
    with(&work, "method = \"translation\"");
    work.write("landmarks.csv", "a,0,0,0,1,0,0\nb,0,1,0,1,1,0\nc,0,2,0,1,2,0\n");
    work.simod("run edit.toml");
}
