//! Plugins whose handles are their own: the control points of a lattice, the vertices of a cage.

use glam::DVec3;
use simod_tests::Workplace;

/// The amphora, which stands from y = 0 to y = 2, and a session of these steps.
fn amphora(steps: &str) -> Workplace {
    let work = Workplace::new();
    work.simod("generate -o amphora.ply --vertices 60000");
    work.write_session("amphora.ply", 6000, steps);
    work
}

/// Moves a handle.
fn handle(id: &str, motion: &str) -> String {
    format!("[[step.handle]]\nid = \"{id}\"\nmove = {{ {motion} }}\n")
}

/// Positions before and after.
fn edit(work: &Workplace) -> Vec<(DVec3, DVec3)> {
    let (before, after) = (work.ply("amphora.ply").positions(), work.ply("edited.ply").positions());
    before.into_iter().zip(after).collect()
}

/// Root mean square of the transfer's distance from the exact map, as a fraction of the diagonal.
fn run(work: &Workplace) -> f64 {
    let report = work.report("run edit.toml --measure");
    report["transfer_error"]["rms"].as_f64().expect("a figure")
}

#[test]
fn a_lattice_s_top_takes_the_mouth_aside() {
    let mut steps = "[[step]]\ndeform = \"lattice\"\nparams = { resolution-y = 9 }\n".to_owned();
    for (i, k) in (0..16).map(|n| (n / 4, n % 4)) {
        steps += &handle(&format!("{i},8,{k}"), "translate = [0.4, 0, 0]");
        steps += &handle(&format!("{i},7,{k}"), "translate = [0.4, 0, 0]");
    }
    let work = amphora(&steps);
    assert!(run(&work) < 1e-4);
    let edit = edit(&work);
    let mouth: Vec<f64> = edit.iter().filter(|(p, _)| p.y > 1.95).map(|(p, q)| q.x - p.x).collect();
    assert!(mouth.len() > 500 && mouth.iter().all(|x| (0.3..=0.41).contains(x)), "{mouth:?}");
    // The splines of both layers begin at the fourth of six spans.
    let still = edit.iter().filter(|(p, _)| p.y < 0.9);
    assert!(still.clone().count() > 5000 && still.clone().all(|(p, q)| p == q));
}

#[test]
fn a_lattice_that_covers_a_part_leaves_the_rest_alone() {
    let mut steps =
        "[[step]]\ndeform = \"lattice\"\nparams = { resolution-x = 5, resolution-y = 5, resolution-z = 5, \
        center = [0, 1, 0.55], size-x = 0.2, size-y = 0.2, size-z = 0.2, axis = [0, 0, 1], angle = 45 }\n"
            .to_owned();
    steps += &handle("2,2,2", "translate = [0, 0, 0.1]");
    let work = amphora(&steps);
    assert!(run(&work) < 1e-4);
    let (moved, still): (Vec<_>, Vec<_>) = edit(&work).into_iter().partition(|(p, q)| p != q);
    assert!(moved.len() > 300 && still.len() > 50_000, "{}", moved.len());
    assert!(moved.iter().all(|(p, _)| p.distance(DVec3::new(0.0, 1.0, 0.55)) < 0.7));
    assert!(moved.iter().any(|(p, q)| q.z - p.z > 0.01));
}

/// A motion of the whole cage moves the model alike, as the file's coordinates are the model's.
#[test]
fn a_cage_from_a_file_carries_the_model() {
    let cage = [[-1.0, -0.2, -1.0], [1.0, -0.2, -1.0], [0.0, -0.2, 1.7], [0.0, 6.0, 0.0]];
    let obj = |c: &[[f64; 3]]| {
        let vertices: String = c.iter().map(|[x, y, z]| format!("v {x} {y} {z}\n")).collect();
        vertices + "f 1 2 3\nf 1 4 2\nf 2 4 3\nf 3 4 1\n"
    };
    let params = "file = \"cage.obj\"";
    let mut steps = format!("[[step]]\ndeform = \"cage\"\nparams = {{ {params} }}\n");
    // Each vertex a turn about y, about the origin, and a bit up.
    for i in 0..4 {
        steps += &handle(
            &i.to_string(),
            "axis = [0, 1, 0], degrees = 90, pivot = [0, 0, 0], translate = [0, 0.5, 0]",
        );
    }
    let work = amphora(&steps);
    work.write("cage.obj", obj(&cage));
    assert!(run(&work) < 1e-6);
    for (p, q) in edit(&work) {
        assert!(q.distance(DVec3::new(p.z, p.y + 0.5, -p.x)) < 1e-5, "{p} went to {q}");
    }
    // The tip alone: a point's weight is its barycentric coordinate in a tetrahedron.
    let steps = format!(
        "[[step]]\ndeform = \"cage\"\nparams = {{ {params} }}\n{}",
        handle("3", "translate = [0.62, 0, 0]")
    );
    work.write_session("amphora.ply", 6000, &steps);
    run(&work);
    for (p, q) in edit(&work) {
        assert!((q - p).distance(DVec3::X * 0.1 * (p.y + 0.2)) < 1e-4, "{p} went to {q}");
    }
    work.write("cage.obj", obj(&cage).replace("f 3 4 1\n", ""));
    work.refuses("run edit.toml", &["a hole", "`file`"]);
    work.write("cage.obj", obj(&cage));
    work.write_session("amphora.ply", 6000, &steps.replace("id = \"3\"", "id = \"4\""));
    work.refuses("run edit.toml", &["no handle `4`"]);
}

#[test]
fn a_cage_about_the_model_moves_what_is_near_its_vertices() {
    for cage in ["hull", "box"] {
        let work = amphora(&format!(
            "[[step]]\ndeform = \"cage\"\nparams = {{ cage = \"{cage}\", detail = 60 }}\n{}",
            handle("0", "translate = [0, 0, 0.2]")
        ));
        assert!(run(&work) < 1e-4);
        let lengths: Vec<f64> = edit(&work).iter().map(|(p, q)| p.distance(*q)).collect();
        let [most, mean] = [lengths.iter().copied().fold(0.0, f64::max), lengths.iter().sum::<f64>() / 6e4];
        assert!((0.002..0.2).contains(&most) && mean < 0.3 * most, "{cage}: {most} {mean}");
    }
}

/// Without a motion, or with none to speak of, the result is the model.
#[test]
fn handles_at_rest_change_no_byte() {
    let nothing = "translate = [0, 0, 0]";
    let steps = format!(
        "[[step]]\ndeform = \"lattice\"\n{}[[step]]\ndeform = \"cage\"\n{}",
        handle("3,3,3", nothing),
        handle("5", nothing)
    );
    let work = amphora(&steps);
    work.simod("run edit.toml");
    assert!(work.read("amphora.ply") == work.read("edited.ply"));
}
