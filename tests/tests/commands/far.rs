//! Models that go far from where they were keep their digits.

use glam::DVec3;
use simod_tests::{Motion, Workplace};

/// Ways that a model of two to three units goes: as from one map's coordinates to another's.
const WAYS: [DVec3; 2] = [DVec3::new(5e5, -3e5, 40.0), DVec3::new(-1e7, 4e6, 1e7)];

/// Largest error of positions, in units: numbers of the size of `WAYS` are rounded to 2e-9, motions of
/// samples relative to each other to some 1e-7.
const OFF: f64 = 1e-6;

/// A model of doubles, and its samples.
fn model_of_doubles() -> (Workplace, Vec<DVec3>) {
    let work = Workplace::new();
    work.simod("generate -o model.ply --vertices 30000 --double");
    work.simod("sample model.ply -o model.simod --samples 2000");
    let rest = work.ply("model.ply").positions();
    (work, rest)
}

/// A turn about the model's middle, and a way.
fn rigid(work: &Workplace, way: DVec3) -> impl Fn(DVec3) -> DVec3 {
    let (model, [min, max]) = (work.ply("model.ply"), work.ply("model.ply").bounds());
    let motion = Motion::rigid((min + max) / 2.0, model.diagonal());
    move |p| motion.image_of(p) + way
}

fn worst(work: &Workplace, output: &str, rest: &[DVec3], to: impl Fn(DVec3) -> DVec3) -> f64 {
    let after = work.ply(output).positions();
    assert_eq!(after.len(), rest.len());
    let off = rest.iter().zip(after).map(|(p, q)| to(*p).distance(q));
    off.max_by(f64::total_cmp).expect("vertices")
}

#[test]
fn rigid_moves_of_deformed_samples() {
    let (work, rest) = model_of_doubles();
    for way in WAYS {
        let to = rigid(&work, way);
        work.move_samples("model.simod", &to);
        for method in ["blended-jets", "projected-barycentric"] {
            let line = "reconstruct model.simod --deformed deformed.ply -o out.ply";
            work.simod(&format!("{line} --method {method} --diagnostics figures.ply"));
            let off = worst(&work, "out.ply", &rest, &to);
            assert!(off < OFF, "{way} {method}: {off:e}");
            assert!(worst(&work, "figures.ply", &rest, &to) < OFF);
        }
        // The new samples of a refinement go along.
        let line = "refine model.simod --into more.simod --sphere 0,1,0,0.5 --factor 4";
        work.simod(&format!("{line} --deformed deformed.ply -o more.ply"));
        let off = worst(&work, "more.ply", &work.ply("more.simod/samples.ply").positions(), &to);
        assert!(off < OFF, "{way}: {off:e}");
        // So do the shapes that select where the deformed model is.
        let estimated = work.report(
            "refine model.simod --into none.simod --auto --deformed deformed.ply -o none.ply --error 1e-6",
        );
        assert_eq!(estimated["added"], 0, "{estimated}");
    }
}

/// Steps that plugins evaluate in double precision, by `run`, and by `deform` and `reconstruct`.
#[test]
fn rigid_moves_of_steps() {
    let (work, rest) = model_of_doubles();
    for way in WAYS {
        let region = "[[step.region]]\nrole = \"handle\"\n\
            shapes = [{ half-space = { point = [0, -9, 0], normal = [0, 1, 0] } }]";
        let [x, y, z] = way.to_array();
        let step =
            format!("[[step]]\ndeform = \"rbf\"\n{region}\nmove = {{ translate = [{x}, {y}, {z}] }}\n");
        work.write_session("model.ply", 2000, &step);
        work.simod("run edit.toml");
        let off = worst(&work, "edited.ply", &rest, |p| p + way);
        assert!(off < OFF, "{way}: {off:e}");
        work.simod("deform model.simod --session edit.toml -o moved.ply");
        work.simod("reconstruct model.simod --deformed moved.ply -o out.ply");
        assert!(work.read("out.ply") == work.read("edited.ply"), "{way}");
    }
}
