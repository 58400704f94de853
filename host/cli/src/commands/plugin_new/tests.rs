//! The deformation called as SIMOD calls it, but without SIMOD.

use super::*;

const BOUNDS: Bounds = Bounds { min: [-1.0; 3], max: [1.0; 3] };

/// Nearer to the centre or the rim, points move by less than can be told.
const SMALL: f64 = 1e-3;

/// Points all over the box.
fn points() -> Vec<[f32; 3]> {
    let steps = || (-5..=5).map(|i| i as f32 / 5.0);
    steps().flat_map(|x| steps().flat_map(move |y| steps().map(move |z| [x, y, z]))).collect()
}

fn exactly(points: &[[f32; 3]]) -> Vec<[f64; 3]> {
    points.iter().map(|p| p.map(f64::from)).collect()
}

fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|i| (a[i] - b[i]).powi(2)).sum::<f64>().sqrt()
}

/// Where points go: by `deform`, and by `evaluate`. The radius is 0.3 of the diagonal, and the handle is
/// moved by so much.
fn images_where(points: &[[f32; 3]], strength: f64, moved: [f64; 3]) -> (Vec<[f32; 3]>, Vec<[f64; 3]>) {
    let strength = [strength];
    let params = [
        Param::numbers("center", ParamKind::POINT, &[0.0; 3]),
        Param::numbers("radius", ParamKind::FLOAT, &[0.3]),
        Param::numbers("strength", ParamKind::FLOAT, &strength),
        Param::numbers("profile", ParamKind::CURVE, PROFILE.as_flattened()),
    ];
    let (host, samples) = (Host::new(&()), Samples::new(points, &[], &[]));
    let mut motion = Affine::IDENTITY;
    motion.rows.iter_mut().zip(moved).for_each(|(row, by)| row[3] = by);
    let motions = [motion];
    let motions = HandleMotions::new(&motions);
    let parts = [Part::new(&motions)];
    let input = DeformInput::new(samples, BOUNDS, &[], &params).with_parts(&parts);
    __TYPE__::prepare(&PrepareInput::new(samples, BOUNDS, &[], &params), &host).unwrap();
    // What is not written stays visible.
    let mut deformed = vec![[f32::NAN; 3]; points.len()];
    __TYPE__::deform(&(), &input, &mut (), &mut deformed, &host).unwrap();
    let mut evaluated = exactly(points);
    __TYPE__::evaluate(&(), &input, &mut evaluated, &host).unwrap();
    (deformed, evaluated)
}

fn images(points: &[[f32; 3]], strength: f64) -> (Vec<[f32; 3]>, Vec<[f64; 3]>) {
    images_where(points, strength, [0.0; 3])
}

#[test]
fn what_swells_follows_the_handle() {
    let (points, moved) = (points(), [0.4, 0.0, -0.2]);
    let (_, images) = images_where(&points, 0.5, moved);
    for (p, q) in exactly(&points).into_iter().zip(images) {
        let from_center = distance(p, moved);
        let moves = from_center > SMALL && from_center < 0.3 * BOUNDS.diagonal() - SMALL;
        let stays = from_center < 1e-6 || from_center > 0.3 * BOUNDS.diagonal();
        assert!(!(moves && p == q) && !(stays && distance(p, q) > 1e-6), "{p:?} goes to {q:?}");
    }
}

#[test]
fn without_strength_nothing_moves() {
    let points = points();
    assert_eq!(images(&points, 0.0), (points.clone(), exactly(&points)));
}

#[test]
fn all_that_is_near_moves_and_nothing_else() {
    let points = points();
    for strength in [-1.0, 0.5, 10.0] {
        let (deformed, _) = images(&points, strength);
        for (p, q) in exactly(&points).into_iter().zip(exactly(&deformed)) {
            assert!(q.iter().all(|x| x.is_finite()), "{p:?} goes to {q:?}");
            let from_center = distance(p, [0.0; 3]);
            let moves = from_center > SMALL && from_center < 0.3 * BOUNDS.diagonal() - SMALL;
            let stays = from_center == 0.0 || from_center > 0.3 * BOUNDS.diagonal();
            assert!(!(moves && p == q) && !(stays && p != q), "{p:?} goes to {q:?}");
        }
    }
}

#[test]
fn both_ways_to_ask_give_the_same() {
    let (deformed, evaluated) = images(&points(), 0.7);
    for (p, q) in exactly(&deformed).into_iter().zip(evaluated) {
        assert!(distance(p, q) < 1e-6, "{p:?} by deform, {q:?} by evaluate");
    }
}
