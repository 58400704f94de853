//! Identity, rigid motions and similarities of the samples come back on every vertex. They are applied
//! outside: the tests rewrite the positions in `samples.ply` by themselves, as any program may.

use glam::DVec3;
use simod_tests::{MANY, Motion, Ply, Workplace, real_model};

/// Largest deviation of any vertex, as a fraction of the diagonal.
const TOLERANCE: f64 = 1e-5;

/// Samples a model, and sends it through nothing and through both kinds of motion.
fn check_all(work: &Workplace, model: &str, samples: u64) {
    work.simod(&format!("sample {model} -o model.simod --samples {samples}"));
    let before = work.ply(model);
    check_identity(work, model, &before);
    let [min, max] = before.bounds();
    let (middle, diagonal) = ((min + max) / 2.0, before.diagonal());
    check_motion(work, model, &before, &Motion::rigid(middle, diagonal));
    check_motion(work, model, &before, &Motion::similarity(min, 0.3 * diagonal, 1.7));
    check_motion(work, model, &before, &Motion::similarity(middle, 0.0, 0.2));
}

fn check_identity(work: &Workplace, model: &str, before: &Ply) {
    work.simod("reconstruct model.simod --deformed model.simod/samples.ply -o out.ply");
    assert!(work.read("out.ply") == before.bytes, "{model}: nothing was moved, but the file is another one");
}

fn check_motion(work: &Workplace, model: &str, before: &Ply, motion: &Motion) {
    work.move_samples("model.simod", |p| motion.image_of(p));
    work.simod("reconstruct model.simod --deformed deformed.ply -o out.ply");
    let (before_positions, after) = (before.positions(), work.ply("out.ply").positions());
    assert_eq!(after.len(), before_positions.len());
    let deviation = |(p, q): (&DVec3, &DVec3)| motion.image_of(*p).distance(*q);
    let deviations = before_positions.iter().zip(&after).map(deviation);
    // Not by `f64::max`, which passes over NaN.
    let worst = deviations.max_by(f64::total_cmp).expect("vertices") / before.diagonal();
    assert!(worst < TOLERANCE, "{model}: off by {worst:.1e} of the diagonal after {motion:?}");
}

#[test]
fn of_a_model_of_millions() {
    let work = Workplace::new();
    work.simod(&format!("generate -o amphora.ply --vertices {MANY}"));
    check_all(&work, "amphora.ply", MANY / 20);
}

#[test]
fn of_the_horse() {
    let Some(horse) = real_model("horse.ply") else { return };
    let work = Workplace::new();
    std::fs::copy(horse, work.path("horse.ply")).expect("a copy");
    check_all(&work, "horse.ply", 10_000);
}

/// Float and double, in all encodings, with and without normals and faces.
#[test]
fn of_all_ways_to_store_a_model() {
    let work = Workplace::new();
    for encoding in ["little-endian", "big-endian", "ascii"] {
        for scalar in ["", "--double"] {
            for parts in ["", "--no-normals", "--no-faces --no-colors", "--no-faces --no-normals"] {
                let options = format!("--vertices 12000 --encoding {encoding} {scalar} {parts}");
                work.simod(&format!("generate -o model.ply {options}"));
                check_all(&work, "model.ply", 1200);
            }
        }
    }
}

/// Georeferenced models lie far from zero, where a float has no millimetres.
#[test]
fn far_from_zero() {
    let work = Workplace::new();
    for encoding in ["little-endian", "big-endian", "ascii"] {
        for parts in ["", "--no-faces --no-normals"] {
            let options = format!("--vertices 12000 --double --encoding {encoding} {parts}");
            work.simod(&format!("generate -o model.ply {options} --offset 500000,4649776,120"));
            check_all(&work, "model.ply", 1200);
        }
    }
}

#[test]
fn of_other_shapes() {
    let work = Workplace::new();
    for shape in ["bumpy-sphere", "plane"] {
        work.simod(&format!("generate -o model.ply --vertices 30000 --shape {shape}"));
        check_all(&work, "model.ply", 1500);
    }
}

/// As many samples as vertices, and next to none (fewer than three would leave a turn open).
#[test]
fn of_few_and_of_many_samples() {
    let work = Workplace::new();
    work.simod("generate -o model.ply --vertices 5000");
    for samples in [5000, 50, 20] {
        check_all(&work, "model.ply", samples);
    }
}
