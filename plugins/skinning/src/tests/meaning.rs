//! Tests of the meaning of skinning.

use super::scene::{Listener, Scene, at, turn};
use super::solids::{FORK, LIMB, Surface, fork, limb, together, tube};
use glam::{DAffine3, DVec3};
use proptest::prelude::*;

const METHODS: [&str; 2] = ["linear", "dual-quaternion"];
const BINDINGS: [&str; 2] = ["biharmonic", "geodesic"];

fn bent() -> [(&'static str, DAffine3); 1] {
    [("lower", turn(DVec3::Z, 80.0))]
}

/// The largest difference between two results.
fn difference(a: &[[f32; 3]], b: &[[f32; 3]]) -> f64 {
    a.iter().zip(b).map(|(a, b)| at(*a).distance(at(*b))).fold(0.0, f64::max)
}

#[test]
fn what_does_not_move_stays_to_the_last_bit() {
    for (method, binding) in METHODS.into_iter().zip(BINDINGS) {
        let scene = Scene { method, binding, ..Scene::new(limb(), &LIMB) };
        let state = scene.prepare();
        assert_eq!(scene.deform(&state, &[]), scene.points);
        // Places that only the upper bone moves stay, and those of the lower one turn.
        let moved = scene.deform(&state, &bent());
        let (mut still, mut turned) = (0, 0);
        for (p, q) in scene.points.iter().zip(&moved) {
            if p[0] < -0.5 {
                assert_eq!(p, q);
                still += 1;
            } else if p[0] > 0.5 {
                assert!(turn(DVec3::Z, 80.0).transform_point3(at(*p)).distance(at(*q)) < 1e-6);
                turned += 1;
            }
        }
        assert!(still > 500 && turned > 500, "{still} {turned}");
    }
}

/// Distances in a straight limb are known, and so are weights.
#[test]
fn weights_are_those_of_exact_distances() {
    let scene = Scene { binding: "geodesic", ..Scene::new(limb(), &LIMB) };
    let state = scene.prepare();
    let share = |x: f64| {
        let (own, other) = (0.15_f64, 0.15_f64.hypot(x));
        let other = (own / other).powi(4);
        let fade = |s: f64| {
            let t = ((s - 0.01) / 0.04).clamp(0.0, 1.0);
            s * t * t * (3.0 - 2.0 * t)
        };
        let [own, other] = [1.0, other].map(|w| fade(w / (1.0 + other)));
        if x < 0.0 { other / (own + other) } else { own / (own + other) }
    };
    let (mut worst, mut sum, mut count) = (0.0_f64, 0.0, 0);
    for (i, p) in scene.points.iter().enumerate().filter(|(_, p)| p[0].abs() < 0.7) {
        let found: f64 = state.table.of_sample(i).filter(|(j, _)| *j == 1).map(|(_, w)| w).sum();
        let miss = found - share(f64::from(p[0]));
        worst = worst.max(miss.abs());
        sum += miss * miss;
        count += 1;
    }
    let rms = (sum / f64::from(count)).sqrt();
    println!("weights differ by {worst:.4} at most, {rms:.4} rms");
    assert!(worst < 0.03 && rms < 0.01, "{worst} {rms}");
}

#[test]
fn weights_sum_to_one_and_are_as_few_as_wanted() {
    for (limit, binding) in [1, 2, 4, 8].into_iter().zip(BINDINGS.into_iter().cycle()) {
        let scene = Scene { influences: f64::from(limit), binding, ..Scene::new(fork(), &FORK) };
        let state = scene.prepare();
        for i in 0..scene.points.len() {
            let weights: Vec<(usize, f64)> = state.table.of_sample(i).collect();
            let sum: f64 = weights.iter().map(|w| w.1).sum();
            assert!((sum - 1.0).abs() < 1e-6 && (1..=limit as usize).contains(&weights.len()), "{weights:?}");
            assert!(weights.iter().all(|(j, w)| *w > 0.0 && !FORK[*j].0.ends_with("tip")));
        }
    }
}

/// The gap between both limbs is as wide as two thirds of a radius.
#[test]
fn limbs_beside_each_other_do_not_take_each_other_along() {
    let is_b = |p: &[f32; 3]| p[1] > 0.12 && p[0] > 0.3;
    let [mesh, cloud] = [Scene::new(fork(), &FORK), Scene::new(fork(), &FORK).into_cloud()];
    let geodesic = Scene { binding: "geodesic", ..mesh.clone() };
    for scene in [mesh, cloud, geodesic] {
        let state = scene.prepare();
        let moved = scene.deform(&state, &[("a-middle", turn(DVec3::Z, -60.0))]);
        let b: Vec<usize> = (0..moved.len()).filter(|i| is_b(&scene.points[*i])).collect();
        assert!(b.len() > 500 && b.iter().all(|i| moved[*i] == scene.points[*i]));
        let a = scene.points.iter().zip(&moved).filter(|(p, _)| p[0] > 0.9 && p[1] < 0.08);
        assert!(a.clone().count() > 100 && a.clone().all(|(p, q)| at(*p).distance(at(*q)) > 0.2));
    }
}

/// Surface without every fifth triangle, the others turned about and each with corners of its own.
fn soup((points, triangles): &Surface) -> Surface {
    let kept = triangles.iter().enumerate().filter(|(i, _)| i % 5 != 0);
    let kept: Vec<[u32; 3]> =
        kept.map(|(i, [a, b, c])| if i % 2 == 0 { [*a, *c, *b] } else { [*a, *b, *c] }).collect();
    let corners = kept.iter().flatten().map(|v| points[*v as usize]).collect();
    (corners, (0..kept.len() as u32).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect())
}

#[test]
fn soups_and_clouds_bend_as_closed_surfaces_do() {
    let closed = Scene::new(limb(), &LIMB);
    let wanted = closed.deform(&closed.prepare(), &bent());
    let cloud = closed.clone().into_cloud();
    let off = difference(&cloud.deform(&cloud.prepare(), &bent()), &wanted);
    println!("as a cloud: {off:.1e}");
    assert!(off < 0.01, "{off}");
    let torn = Scene::new(soup(&limb()), &LIMB);
    let state = torn.prepare();
    let off = difference(&torn.deform(&state, &bent()), &soup(&(wanted.clone(), limb().1)).0);
    println!("as a soup: {off:.1e}");
    assert!(off < 0.01, "{off}");
    // A limb with one end open is solid all the same.
    let (points, triangles) = limb();
    let open = triangles.into_iter().filter(|t| t.iter().any(|v| points[*v as usize][0] < 0.999)).collect();
    let open = Scene::new((points, open), &LIMB);
    let off = difference(&open.deform(&open.prepare(), &bent()), &wanted);
    println!("with an open end: {off:.1e}");
    assert!(off < 0.01, "{off}");
}

/// One side of the limb: it encloses nothing, and its bones lie off its surface.
#[test]
fn open_surfaces_bend_along_themselves() {
    let (points, triangles) = limb();
    let front = triangles.into_iter().filter(|t| t.iter().all(|v| points[*v as usize][2] > 0.0)).collect();
    let mut scene = Scene::new((points, front), &LIMB);
    // Without the samples that are in no triangle.
    let keep: Vec<usize> = (0..scene.points.len()).filter(|i| scene.points[*i][2] > 0.0).collect();
    for v in scene.triangles.iter_mut().flatten() {
        *v = keep.binary_search(&(*v as usize)).unwrap() as u32;
    }
    scene.points = keep.iter().map(|i| scene.points[*i]).collect();
    let host = Listener::default();
    let state = scene.try_prepare(&host).unwrap();
    let told = host.lines.into_inner().unwrap();
    assert!(told.len() == 1 && told[0].contains("encloses nothing"), "{told:?}");
    for (p, q) in scene.points.iter().zip(scene.deform(&state, &bent())) {
        match p[0] {
            x if x < -0.6 => assert_eq!(*p, q),
            x if x > 0.6 => {
                assert!(turn(DVec3::Z, 80.0).transform_point3(at(*p)).distance(at(q)) < 1e-6, "{p:?}");
            }
            _ => {}
        }
    }
}

#[test]
fn the_order_of_samples_does_not_matter() {
    let scene = Scene::new(fork(), &FORK);
    let moved = [("a-middle", turn(DVec3::Y, 40.0)), ("b", turn(DVec3::X, 30.0))];
    let wanted = scene.deform(&scene.prepare(), &moved);
    let count = scene.points.len();
    let place = |i: usize| (i * 7919) % count;
    assert!(!count.is_multiple_of(7919));
    let mut other = scene.clone();
    (0..count).for_each(|i| other.points[place(i)] = scene.points[i]);
    other.triangles.iter_mut().flatten().for_each(|v| *v = place(*v as usize) as u32);
    other.triangles.reverse();
    let found = other.deform(&other.prepare(), &moved);
    assert!((0..count).all(|i| found[place(i)] == wanted[i]));
}

#[test]
fn what_is_symmetric_bends_symmetrically() {
    // Blocks of voxels that smooth weights begin with need not be symmetric.
    for (binding, most) in BINDINGS.into_iter().zip([6e-3, 1e-4]) {
        let scene = Scene { binding, ..Scene::new(limb(), &LIMB) };
        let state = scene.prepare();
        let points: Vec<DVec3> = scene.points.iter().map(|p| at(*p)).collect();
        let mirror = DVec3::new(1.0, 1.0, -1.0);
        let mirrored: Vec<DVec3> = points.iter().map(|p| *p * mirror).collect();
        let (a, b) = (scene.evaluate(&state, &bent(), &points), scene.evaluate(&state, &bent(), &mirrored));
        let off = a.iter().zip(&b).map(|(a, b)| (*a * mirror).distance(*b)).fold(0.0, f64::max);
        println!("{binding}: off by {off:.1e}");
        assert!(off < most, "{binding}: {off}");
    }
}

/// A limb about its own bone follows it alone, and weights fall from there on.
#[test]
fn smooth_weights_are_whole_about_their_bones() {
    let scene = Scene::new(fork(), &FORK);
    let state = scene.prepare();
    let of = |i: usize, id: &str| {
        let joint = FORK.iter().position(|j| j.0 == id).unwrap();
        state.table.of_sample(i).filter(|(j, _)| *j == joint).map(|(_, w)| w).sum::<f64>()
    };
    let tip = (0..scene.points.len()).filter(|i| scene.points[*i][0] > 1.0 && scene.points[*i][1] < 0.08);
    let weights: Vec<f64> = tip.map(|i| of(i, "a-middle")).collect();
    let mean = weights.iter().sum::<f64>() / weights.len() as f64;
    println!("{} samples at the tip: {mean:.4}", weights.len());
    assert!(weights.len() > 50 && mean > 0.99, "{mean}");
    // And nothing of the limb beside it.
    assert!((0..scene.points.len()).all(|i| of(i, "a-middle") * of(i, "b-middle") < 1e-4));
}

/// The map is continuous, and does not jump from voxel to voxel.
#[test]
fn neighbours_stay_neighbours() {
    let scene = Scene::new(limb(), &LIMB);
    let state = scene.prepare();
    let points: Vec<DVec3> = (0..4000).map(|i| DVec3::new(-0.4 + 2e-4 * f64::from(i), 0.15, 0.0)).collect();
    let images = scene.evaluate(&state, &bent(), &points);
    let steps: Vec<f64> = images.windows(2).map(|p| p[0].distance(p[1]) / 2e-4).collect();
    let (least, most) = steps.iter().fold((f64::MAX, 0.0_f64), |(a, b), s| (a.min(*s), b.max(*s)));
    println!("lengths change by factors from {least:.2} to {most:.2}");
    // On the inner side of a bend of 80° there is less room.
    assert!(least > 0.0 && most < 2.0, "{least} {most}");
}

/// A button over the lower bone, and a bone that misses the model.
#[test]
fn what_nothing_reaches_follows_what_is_near() {
    let button = tube(DVec3::new(0.6, 0.3, 0.0), DVec3::new(0.7, 0.3, 0.0), 0.04, 16);
    let scene = Scene::new(together(&[limb(), button]), &LIMB);
    let moved = scene.deform(&scene.prepare(), &bent());
    let on: Vec<_> = scene.points.iter().zip(&moved).filter(|(p, _)| p[1] > 0.2).collect();
    assert!(on.len() > 100);
    for (p, q) in on {
        assert!(turn(DVec3::Z, 80.0).transform_point3(at(*p)).distance(at(*q)) < 1e-6);
    }

    let mut scene = Scene::new(limb(), &LIMB);
    scene.joints.push(("stray", [0.2, 0.4, 0.0], 1));
    scene.joints.push(("stray-tip", [0.5, 0.4, 0.0], 3));
    let host = Listener::default();
    let state = scene.try_prepare(&host).unwrap();
    let told = host.lines.into_inner().unwrap().concat();
    assert!(told.contains("from `stray` to `stray-tip`") && !told.contains("upper"), "{told}");
    let moved = scene.deform(&state, &[("stray", DAffine3::from_translation(DVec3::Y))]);
    let most = scene.points.iter().zip(&moved).map(|(p, q)| at(*p).distance(at(*q))).fold(0.0, f64::max);
    assert!(most > 0.01, "{most}");
}

/// Bones in the skeleton's order: `root` to `a`, and its limb, and then the same of `b`.
#[test]
fn a_pose_moves_bones_that_share_a_joint_apart() {
    let still = "1 0 0 0 0 1 0 0 0 0 1 0\n";
    let up = "1 0 0 0 0 1 0 0 0 0 1 0.5\n";
    let mut file = tempfile::NamedTempFile::new().unwrap();
    let frames = [still.repeat(6), up.repeat(3) + &still.repeat(3)].concat();
    std::io::Write::write_all(&mut file, frames.as_bytes()).unwrap();
    let mut scene = Scene { pose: file.path().to_str().unwrap().to_owned(), ..Scene::new(fork(), &FORK) };
    assert!(scene.try_handles().unwrap().is_empty(), "the file moves them");
    let state = scene.prepare();
    assert_eq!(scene.try_deform(&state, &[]).unwrap(), scene.points);
    scene.frame = 1;
    for method in METHODS {
        scene.method = method;
        let moved = scene.try_deform(&state, &[]).unwrap();
        let (mut went, mut stayed) = (0, 0);
        for (p, q) in scene.points.iter().zip(&moved) {
            // The limbs, and what is about the bones from `root` to these.
            if p[0] > 0.2 {
                let by = if p[1] < 0.1 { 0.5 } else { 0.0 };
                assert!(at(*q).distance(at(*p) + DVec3::Z * by) < 1e-6, "{p:?} {q:?}");
                if by > 0.0 { went += 1 } else { stayed += 1 }
            }
        }
        assert!(went > 500 && stayed > 500);
        let part = |y: f32| {
            let of = |p: &[f32; 3]| (p[1] - y).abs() < 0.015 && p[0] < -0.03;
            let all =
                scene.points.iter().zip(&moved).filter(|(p, _)| of(p)).map(|(p, q)| f64::from(q[2] - p[2]));
            let (sum, count) = all.fold((0.0, 0), |(sum, count), z| (sum + z, count + 1));
            sum / f64::from(count)
        };
        let [a, b] = [part(0.03), part(0.17)];
        println!("{a} {b}");
        assert!(a > 0.4 && b < 0.1, "{a} {b}");
    }
    scene.frame = 2;
    assert!(scene.try_deform(&state, &[]).unwrap_err().message.contains("2 frames"));
}

#[test]
fn a_file_keeps_all_that_it_has_and_what_is_left_out_is_told() {
    let joints: Vec<(&'static str, [f64; 3], u32)> = ["a", "b", "c", "d", "e", "f", "g", "h", "i", "j"]
        .into_iter()
        .enumerate()
        .map(|(i, id)| (id, [0.1 * i as f64, 0.0, 0.0], u32::MAX))
        .collect();
    let mut file = tempfile::NamedTempFile::new().unwrap();
    let text = "x y z a b c d e f g h i j\n0 0 0 .1 .1 .1 .1 .1 .1 .1 .1 .1 .1\n";
    std::io::Write::write_all(&mut file, text.as_bytes()).unwrap();
    let mut scene = Scene::new((vec![[0.0; 3]; 3], Vec::new()), &joints);
    scene.weights = file.path().to_str().unwrap().to_owned();
    let prepare = |scene: &Scene| {
        let host = Listener::default();
        let state = scene.try_prepare(&host).unwrap();
        (state.table.of_sample(0).count(), host.lines.into_inner().unwrap().concat())
    };
    scene.influences = 0.0;
    assert_eq!(prepare(&scene), (10, String::new()));
    scene.influences = 4.0;
    let (count, told) = prepare(&scene);
    assert!(count == 4 && told.contains("3 of 3 samples lose more than 1 %"), "{count} {told}");
}

/// A single joint takes all along.
#[test]
fn a_lone_joint_moves_the_model() {
    let scene = Scene::new(limb(), &[("all", [0.3, 0.0, 0.0], u32::MAX)]);
    let motion = DAffine3::from_translation(DVec3::Y) * turn(DVec3::X, 30.0);
    let about =
        DAffine3::from_translation(DVec3::X * 0.3) * motion * DAffine3::from_translation(DVec3::X * -0.3);
    for (p, q) in scene.points.iter().zip(scene.deform(&scene.prepare(), &[("all", motion)])) {
        assert!(about.transform_point3(at(*p)).distance(at(q)) < 1e-6);
    }
}

#[test]
fn an_end_is_dragged_and_reaches() {
    let mut scene = Scene::new(limb(), &LIMB);
    let ids: Vec<String> = scene.try_handles().unwrap().iter().map(|h| h.id.to_string()).collect();
    assert_eq!(ids, ["upper", "lower", "tip", "tip/reach"]);
    let state = scene.prepare();
    let (tip, by) = (DVec3::X * 0.95, DVec3::new(-0.4, 0.5, 0.2));
    let shift = DAffine3::from_translation(by);
    for handle in ["tip", "tip/reach"] {
        let q = scene.evaluate(&state, &[(handle, shift)], &[tip, DVec3::X * -0.95])[0];
        assert!(q.distance(tip + by) < 1e-9, "{handle}: {q}");
    }
    // Dragged along with the posed skeleton, or to a place of space.
    let up = DAffine3::from_translation(DVec3::Z * 0.1);
    let q = scene.evaluate(&state, &[("upper", up), ("tip", shift)], &[tip])[0];
    assert!(q.distance(tip + by + DVec3::Z * 0.1) < 1e-9, "{q}");
    let q = scene.evaluate(&state, &[("upper", up), ("tip/reach", shift)], &[tip])[0];
    assert!(q.distance(tip + by) < 1e-9, "{q}");
    // One bone alone: the upper one stays.
    scene.reach_length = 1.0;
    let [upper, q] = scene.evaluate(&state, &[("tip/reach", shift)], &[DVec3::X * -0.5, tip])[..] else {
        return;
    };
    assert!(upper == DVec3::X * -0.5, "{upper}");
    assert!(q.distance(0.95 * (tip + by).normalize_or_zero()) < 1e-9, "{q}");
    scene.reach = "all";
    let ids: Vec<String> = scene.try_handles().unwrap().iter().map(|h| h.id.to_string()).collect();
    assert_eq!(ids[3..], ["lower/reach", "tip/reach"]);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(8))]

    #[test]
    fn what_moves_as_a_whole_moves_rigidly(
        axis in prop::array::uniform3(0.1..1.0_f64), degrees in -180.0..180.0_f64,
        by in prop::array::uniform3(-1.0..1.0_f64),
    ) {
        let motion = DAffine3::from_translation(by.into())
            * turn(DVec3::from(axis).normalize_or(DVec3::X), degrees);
        for method in METHODS {
            let scene = Scene { method, resolution: 48.0, ..Scene::new(fork(), &FORK) };
            let handles = scene.try_handles().unwrap().len();
            let moved = scene.try_deform(&scene.prepare(), &vec![super::scene::rows(motion); handles]).unwrap();
            for (p, q) in scene.points.iter().zip(moved) {
                prop_assert!(motion.transform_point3(at(*p)).distance(at(q)) < 1e-6);
            }
        }
    }

    /// Wherever the ends are dragged to, those that can be reached are, and bones keep their lengths.
    #[test]
    fn several_ends_reach(a in prop::array::uniform3(-0.3..0.3_f64), b in prop::array::uniform3(-0.3..0.3_f64)) {
        let scene = Scene { resolution: 48.0, ..Scene::new(fork(), &FORK) };
        let state = scene.prepare();
        // The chains begin below the joint that branches.
        let at = |id: &str| DVec3::from(FORK.iter().find(|j| j.0 == id).unwrap().1);
        let moved = [("a-tip/reach", a), ("b-tip/reach", b)]
            .map(|(id, by)| (id, DAffine3::from_translation(DVec3::from(by))));
        let tips = [at("a-tip"), at("b-tip")];
        let images = scene.evaluate(&state, &moved, &tips);
        for ((tip, by), (image, base)) in
            tips.into_iter().zip([a, b]).zip(images.into_iter().zip([at("a"), at("b")]))
        {
            let target = tip + DVec3::from(by);
            let far = target.distance(base);
            let wanted = if far <= 1.1 { target } else { base + (target - base) * (1.1 / far) };
            prop_assert!(image.distance(wanted) < 1e-6, "{} instead of {}", image, wanted);
        }
    }
}
