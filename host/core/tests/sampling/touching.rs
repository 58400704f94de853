//! Parts of a model that touch: their faces tell them apart.

use std::f64::consts::{PI, TAU};
use std::fs;
use std::path::Path;

use glam::{DQuat, DVec3, Vec3};
use simod_core::reconstruction::{DeformationField, Method, Moved, RestGeometry, carry};
use simod_core::refinement::{Finer, Refining, SpaceSelection, refine};
use simod_core::sampled_model::SampledModel;
use simod_core::sampling::{Placement, Sampling, Skip, Target};
use simod_model::output::write_file;
use simod_model::progress::Silent;

use crate::body::{Body, sample_file};
use crate::cells::Saved;

/// A tube of rings of vertices around points with two directions each; closed, if its last ring is followed
/// by the first one.
fn tube(rings: &[(DVec3, DVec3, DVec3)], around: u32, radius: f64, closed: bool) -> Body {
    let mut body = Body::default();
    for (center, a, b) in rings {
        let at = |j: u32| TAU * f64::from(j) / f64::from(around);
        body.positions.extend((0..around).map(|j| *center + radius * (*a * at(j).cos() + *b * at(j).sin())));
    }
    let count = rings.len() as u32;
    for i in 0..if closed { count } else { count - 1 } {
        for j in 0..around {
            let at = |i: u32, j: u32| i % count * around + j % around;
            body.faces.push([at(i, j), at(i + 1, j), at(i + 1, j + 1)]);
            body.faces.push([at(i, j), at(i + 1, j + 1), at(i, j + 1)]);
        }
    }
    body
}

const RADIUS: f64 = 0.2;

/// Two interlocked rings that touch inside, but for a gap; and for each vertex whether it is of the second.
fn rings(gap: f64) -> (Body, Vec<f64>) {
    finer_rings(gap, 1)
}

/// The same of so many times as many vertices along each edge.
fn finer_rings(gap: f64, finer: u32) -> (Body, Vec<f64>) {
    let ring = |center: DVec3, x: DVec3, y: DVec3| {
        let at = |i: u32| {
            let t = TAU * f64::from(i) / f64::from(300 * finer);
            let out = x * t.cos() + y * t.sin();
            (center + out, out, x.cross(y))
        };
        tube(&(0..300 * finer).map(at).collect::<Vec<_>>(), 60 * finer, RADIUS, true)
    };
    let mut body = ring(DVec3::ZERO, DVec3::X, DVec3::Y);
    let second = ring(DVec3::X * (2.0 - 2.0 * RADIUS - gap), DVec3::X, DVec3::Z);
    let first = body.positions.len() as u32;
    body.positions.extend(second.positions);
    body.faces.extend(second.faces.into_iter().map(|face| face.map(|v| v + first)));
    let part = (0..body.positions.len()).map(|v| f64::from(u32::from(v as u32 >= first))).collect();
    (body, part)
}

/// A stem whose end is bent over and lies on it, but for a gap; and for each vertex the part of the way that
/// it goes with that arm.
fn cactus(gap: f64) -> (Body, Vec<f64>) {
    let bend = RADIUS + 0.5 * gap;
    let (up, over, down) = (1.5, PI * bend, 1.2);
    let count = 500;
    let ring = |i: u32| {
        let s = f64::from(i) / f64::from(count - 1) * (up + over + down);
        let angle = ((s - up) / bend).clamp(0.0, PI);
        let height = s.min(up) + bend * angle.sin() - (s - up - over).max(0.0);
        let center = DVec3::new(bend * (1.0 - angle.cos()), 0.0, height);
        let along = DVec3::new(angle.sin(), 0.0, angle.cos());
        ((center, DVec3::Y.cross(along), DVec3::Y), angle / PI)
    };
    let rings: Vec<_> = (0..count).map(ring).collect();
    let body = tube(&rings.iter().map(|(ring, _)| *ring).collect::<Vec<_>>(), 80, RADIUS, false);
    let way = |w: f64| w * w * (3.0 - 2.0 * w);
    (body, rings.iter().flat_map(|(_, w)| vec![way(*w); 80]).collect())
}

/// Model with vertices of its own for each face, as in an STL file.
fn soup((body, part): (Body, Vec<f64>)) -> (Body, Vec<f64>) {
    let corners: Vec<usize> = body.faces.iter().flatten().map(|v| *v as usize).collect();
    let faces = (0..body.faces.len() as u32).map(|f| [3 * f, 3 * f + 1, 3 * f + 2]).collect();
    let positions = corners.iter().map(|v| body.positions[*v]).collect();
    (Body { positions, normals: Vec::new(), faces }, corners.iter().map(|v| part[*v]).collect())
}

/// The same faces in no order: vertices at one place are far from each other then.
fn shuffled((mut body, part): (Body, Vec<f64>)) -> (Body, Vec<f64>) {
    let count = body.faces.len();
    // A prime, which leaves out no face.
    body.faces = (0..count).map(|f| body.faces[f * 48_271 % count]).collect();
    (body, part)
}

/// Distance of two sheets of a stack.
const APART: f64 = 0.003;

/// Flat sheets one above the other, which nothing joins; and for each vertex whether it is of the middle one.
fn stack(sheets: u32) -> (Body, Vec<f64>) {
    let (mut body, edge) = (Body::default(), 80);
    for (sheet, i) in (0..sheets).flat_map(|sheet| (0..edge).map(move |i| (sheet, i))) {
        let at = |j: u32| DVec3::new(f64::from(i), f64::from(j), 0.0) / f64::from(edge - 1);
        body.positions.extend((0..edge).map(|j| at(j) + DVec3::Z * APART * f64::from(sheet)));
        for j in (0..edge - 1).filter(|_| i + 1 < edge) {
            let a = (sheet * edge + i) * edge + j;
            body.faces.extend([[a, a + edge, a + edge + 1], [a, a + edge + 1, a + 1]]);
        }
    }
    let of = of_stack(sheets);
    let part = body.positions.iter().map(|p| of(*p)).collect();
    (body, part)
}

fn of_stack(sheets: u32) -> impl Fn(DVec3) -> f64 {
    move |p| f64::from(u32::from((p.z / APART).round() == f64::from(sheets / 2)))
}

/// A foil of twelve turns, a hundredth apart.
fn foil() -> Body {
    let (mut body, along, across) = (Body::default(), 1600, 120);
    for i in 0..along {
        let turns = 1.0 + 12.0 * f64::from(i) / f64::from(along - 1);
        let (sin, cos) = (TAU * turns).sin_cos();
        let place =
            |j: u32| DVec3::new(cos, sin, 0.0) * (0.1 + 0.01 * turns) + DVec3::Z * f64::from(j) / 119.0;
        body.positions.extend((0..across).map(place));
        for j in (0..across - 1).filter(|_| i + 1 < along) {
            let a = i * across + j;
            body.faces.extend([[a, a + across, a + across + 1], [a, a + across + 1, a + 1]]);
        }
    }
    body
}

/// Two spheres with holes at their poles, by their centers and radii, with their normals; and for each vertex
/// whether it is of the second.
fn two_spheres(of: [(DVec3, f64); 2]) -> (Body, Vec<f64>) {
    let (around, along) = (300, 150);
    let mut body = Body::default();
    for ((center, radius), first) in of.into_iter().zip([0, around * along]) {
        let ring = |i: u32| PI * (f64::from(i) + 0.5) / f64::from(along);
        let out = |i: u32, j: u32| {
            let (turn, rise) = (TAU * (f64::from(j) + 0.5) / f64::from(around), ring(i));
            DVec3::new(turn.cos() * rise.sin(), turn.sin() * rise.sin(), -rise.cos())
        };
        let outs = (0..along).flat_map(|i| (0..around).map(move |j| (i, j))).map(|(i, j)| out(i, j));
        for out in outs {
            body.positions.push(center + radius * out);
            body.normals.push(out.as_vec3());
        }
        for i in 0..along - 1 {
            for j in 0..around {
                let at = |i: u32, j: u32| first + i * around + j % around;
                body.faces.push([at(i, j), at(i, j + 1), at(i + 1, j + 1)]);
                body.faces.push([at(i, j), at(i + 1, j + 1), at(i + 1, j)]);
            }
        }
    }
    let half = body.positions.len() / 2;
    let part = (0..2 * half).map(|v| f64::from(u32::from(v >= half))).collect();
    (body, part)
}

/// The corners of two boxes that stand face to face, but for a gap.
fn corners(gap: f64) -> [(DVec3, DVec3); 2] {
    let (low, high) = (DVec3::new(1.0 + gap, 0.1003, 0.1007), DVec3::new(1.8 + gap, 0.9031, 0.9011));
    [(DVec3::ZERO, DVec3::ONE), (low, high)]
}

/// Two boxes of six sides each that share places alone; and for each vertex whether it is of the second.
fn boxes(gap: f64) -> (Body, Vec<f64>) {
    let (mut body, mut first) = (Body::default(), 0);
    for ((low, high), edge) in corners(gap).into_iter().zip([0.006, 0.0071]) {
        for (axis, side) in [0, 1, 2].into_iter().flat_map(|axis| [(axis, low), (axis, high)]) {
            let [a, b] = [(axis + 1) % 3, (axis + 2) % 3];
            let [m, n] = [a, b].map(|axis| ((high - low)[axis] / edge) as u32);
            let from = body.positions.len() as u32;
            for (i, j) in (0..=m).flat_map(|i| (0..=n).map(move |j| (i, j))) {
                let mut p = side;
                p[a] = low[a] + (high - low)[a] * f64::from(i) / f64::from(m);
                p[b] = low[b] + (high - low)[b] * f64::from(j) / f64::from(n);
                body.positions.push(p);
            }
            for (i, j) in (0..m).flat_map(|i| (0..n).map(move |j| (i, j))) {
                let at = |i: u32, j: u32| from + i * (n + 1) + j;
                body.faces.push([at(i, j), at(i + 1, j), at(i + 1, j + 1)]);
                body.faces.push([at(i, j), at(i + 1, j + 1), at(i, j + 1)]);
            }
        }
        first = if first == 0 { body.positions.len() } else { first };
    }
    let part = (0..body.positions.len()).map(|v| f64::from(u32::from(v >= first))).collect();
    (body, part)
}

/// Box to which a sample belongs: 1 on the surface of the second, 0 on that of the first.
fn of_boxes(gap: f64) -> impl Fn(DVec3) -> f64 {
    let off = |(low, high): (DVec3, DVec3), p: DVec3| {
        let inside = (low - p).max(p - high).max_element().min(0.0);
        p.distance(p.clamp(low, high)) - inside
    };
    move |p| {
        let [first, second] = corners(gap).map(|of| off(of, p));
        f64::from(u32::from(second < first))
    }
}

/// Two spheres, one beside the other in a direction, that touch, but for a gap. There is no vertex where they
/// do.
fn spheres(beside: DVec3, gap: f64) -> (Body, Vec<f64>) {
    two_spheres([-1.0, 1.0].map(|side| (side * (1.0 + 0.5 * gap) * beside, 1.0)))
}

/// Part to which a sample belongs, of two parts that no triangle of samples joins: 1 for that of the sample
/// farthest along x, 0 for the other one.
fn of_triangles(sampled: &SampledModel) -> impl Fn(DVec3) -> f64 + use<> {
    let places: Vec<DVec3> = sampled.samples.positions.iter().map(|p| sampled.frame.to_model(*p)).collect();
    let mut is_second = vec![false; places.len()];
    let last = (0..places.len()).max_by(|a, b| places[*a].x.total_cmp(&places[*b].x)).unwrap();
    (is_second[last], is_second[0]) = (true, last == 0);
    let mut grows = true;
    while grows {
        grows = false;
        for corners in &sampled.triangles {
            let corners = corners.map(|i| i as usize);
            if corners.iter().any(|i| is_second[*i]) && !corners.iter().all(|i| is_second[*i]) {
                corners.iter().for_each(|i| is_second[*i] = true);
                grows = true;
            }
        }
    }
    move |p| {
        let at = places.iter().position(|place| *place == p).unwrap();
        f64::from(u32::from(is_second[at]))
    }
}

/// Part with which a sample goes: 1 for the second of two tubes on whose surface it may lie, 0 for the first.
fn of_rings(gap: f64) -> impl Fn(DVec3) -> f64 {
    move |p| {
        let off = |center: DVec3, axis: DVec3| {
            let d = p - center;
            let flat = d - axis * d.dot(axis);
            ((flat.length() - 1.0).hypot(d.dot(axis)) - RADIUS).abs()
        };
        let second = off(DVec3::X * (2.0 - 2.0 * RADIUS - gap), DVec3::X.cross(DVec3::Z));
        f64::from(u32::from(second < off(DVec3::ZERO, DVec3::Z)))
    }
}

fn of_cactus(gap: f64) -> impl Fn(DVec3) -> f64 {
    let bend = RADIUS + 0.5 * gap;
    move |p| {
        if p.z > 1.5 {
            let w = (p.z - 1.5).atan2(bend - p.x) / PI;
            return w * w * (3.0 - 2.0 * w);
        }
        let off = |x: f64| ((p.x - x).hypot(p.y) - RADIUS).abs();
        f64::from(u32::from(off(2.0 * bend) < off(0.0)))
    }
}

const AWAY: DVec3 = DVec3::new(0.6, 0.64, 0.48);

/// Moves the samples of the second part away; returns the error of each vertex, as a fraction of the way.
pub fn pulled(sampled: &SampledModel, body: &Body, part: &[f64], of: &dyn Fn(DVec3) -> f64) -> Vec<f64> {
    off_by(sampled, body, part, of, &|p, part| p + AWAY * part)
}

/// Error of each vertex, where a map takes places of parts.
fn off_by(
    sampled: &SampledModel,
    body: &Body,
    part: &[f64],
    of: &dyn Fn(DVec3) -> f64,
    map: &dyn Fn(DVec3, f64) -> DVec3,
) -> Vec<f64> {
    let place = |p: &Vec3| {
        let p = sampled.frame.to_model(*p);
        sampled.frame.to_local(map(p, of(p)))
    };
    let deformed: Vec<Vec3> = sampled.samples.positions.iter().map(place).collect();
    let around = RestGeometry::new(&sampled.samples);
    let field = DeformationField::new(&around, &deformed, Method::BlendedJets);
    let mut moved = body.positions.clone();
    carry(&[field], &sampled.frame, &body.positions, None, &mut [Moved::places(&mut moved)]);
    let off = |((p, q), part): ((&DVec3, &DVec3), &f64)| q.distance(map(*p, *part));
    body.positions.iter().zip(&moved).zip(part).map(off).collect()
}

/// Whether parts have to be told apart at a place: not where the arm leaves the stem, as there the
/// displacement changes within a spacing.
fn is_plain(p: &DVec3, name: &str) -> bool {
    name != "an arm on its stem" || p.z < 1.3
}

fn share(off: &[f64], beyond: f64) -> f64 {
    off.iter().filter(|off| **off > beyond).count() as f64 / off.len() as f64
}

fn sampling(sheets: bool) -> Sampling {
    let skip = Skip { sheets: !sheets, ..Skip::default() };
    Sampling { target: Target::Samples(4000), skip, ..Sampling::default() }
}

#[test]
fn nobody_stays_and_nobody_follows() {
    type Case = (&'static str, (Body, Vec<f64>), Box<dyn Fn(DVec3) -> f64>);
    let cases: [Case; 4] = [
        ("rings that touch", rings(1e-3), Box::new(of_rings(1e-3))),
        ("rings that cross", rings(-5e-3), Box::new(of_rings(-5e-3))),
        ("an arm on its stem", cactus(1e-3), Box::new(of_cactus(1e-3))),
        ("rings of single faces", soup(rings(1e-3)), Box::new(of_rings(1e-3))),
    ];
    for (name, (body, part), of) in cases {
        let [with, without] = [true, false].map(|sheets| {
            let sampled = body.sampled(sampling(sheets));
            assert_eq!(sampled.samples.contacts().is_some(), sheets, "{name}");
            assert!((3800..=4000).contains(&sampled.samples.len()), "{name}: {}", sampled.samples.len());
            let off = pulled(&sampled, &body, &part, &of).into_iter().zip(&body.positions);
            off.filter(|(_, p)| is_plain(p, name)).map(|(off, _)| off).collect::<Vec<_>>()
        });
        println!(
            "{name}: {:.5} of the vertices are off by half of the way, {:.5} by a tenth; without, {:.5} and {:.5}",
            share(&with, 0.5),
            share(&with, 0.1),
            share(&without, 0.5),
            share(&without, 0.1)
        );
        // Samples beside a curve in which surfaces cross may be taken for the other part's by where they are.
        let (least, times) = if name == "rings that cross" { (1e-3, 2.0) } else { (1e-4, 10.0) };
        assert!(share(&with, 0.5) < least && share(&with, 0.5) * times < share(&without, 0.5), "{name}");
        assert!(share(&with, 0.1) * times.min(5.0) < share(&without, 0.1), "{name}");
    }
}

/// Clusters are parted by their normals, or by a border of cells, before they hold vertices of both.
#[test]
fn parts_that_no_cluster_holds_two_of_come_apart() {
    let sampling = |sheets| Sampling { target: Target::Samples(3000), ..sampling(sheets) };
    let mut stay_without = 0;
    for gap in [0.0, 1e-3, -0.02] {
        let plain = |(body, part): (Body, Vec<f64>)| (body.without_normals(), part);
        let cases = [
            ("with normals", spheres(DVec3::X, gap)),
            ("without", plain(spheres(DVec3::X, gap))),
            ("single faces", soup(spheres(DVec3::X, gap))),
        ];
        for (name, (body, part)) in cases {
            let off = [true, false].map(|sheets| {
                let sampled = body.sampled(sampling(sheets));
                pulled(&sampled, &body, &part, &of_triangles(&sampled))
            });
            let [worst, without] = off.map(|off| off.into_iter().fold(0.0, f64::max));
            println!("spheres {gap} apart, {name}: off by {worst:.1e} of the way, and {without:.1e} without");
            assert!(worst < 1e-4, "{gap}, {name}: {worst}");
            stay_without += usize::from(without > 0.3);
        }
    }
    assert!(stay_without >= 6, "{stay_without} cases need to be told");
}

/// Clusters of a wall between two boxes that hold both sheets are more than get further samples: so some
/// sheets have few of them, far beyond those of the other one, and a coarser cut may put clusters of both
/// together.
#[test]
fn boxes_face_to_face_come_apart() {
    let gap = 5e-4;
    let (body, part) = boxes(gap);
    let of = of_boxes(gap);
    // Among the fewest samples, a few vertices are beyond all whose planes are looked at.
    for (samples, most) in [(1000, 4), (15_000, 0), (30_000, 0)] {
        let sampled = body.sampled(Sampling { target: Target::Samples(samples), ..sampling(true) });
        let off = pulled(&sampled, &body, &part, &of);
        let (follow, joins) = (off.iter().filter(|off| **off > 0.25).count(), joining(&sampled, &of));
        println!("{samples} samples: {follow} vertices off by a quarter, {joins} triangles join");
        let count = sampled.samples.len() as u64;
        assert!((samples * 19 / 20..=samples).contains(&count), "{count}");
        assert!(follow <= most && joins == 0, "{samples}: {follow} vertices, {joins} triangles");
    }
}

/// Clusters of a stack hold all of its sheets, more than samples can be given to each.
#[test]
fn sheets_of_a_stack_come_apart() {
    let sheets = 10;
    let (body, part) = stack(sheets);
    for samples in [1000, 3000, 10_000] {
        let sampled = body.sampled(Sampling { target: Target::Samples(samples), ..sampling(true) });
        let count = sampled.samples.len() as u64;
        let off = pulled(&sampled, &body, &part, &of_stack(sheets));
        let follow = off.iter().filter(|off| **off > 0.25).count();
        println!("{count} samples: {follow} vertices off by a quarter");
        assert!((samples * 17 / 20..=samples).contains(&count), "{count}");
        assert!(follow == 0, "{samples}: {follow} vertices");
    }
}

/// Among the samples nearest to one in space hardly any are on its own turn.
#[test]
fn samples_of_a_foil_know_others_of_their_turn() {
    for samples in [1000, 3000] {
        let sampled = foil().sampled(Sampling { target: Target::Samples(samples), ..sampling(true) });
        let contacts = sampled.samples.contacts().unwrap();
        let known = contacts.told().iter().filter_map(|i| contacts.same_sheet(*i as usize));
        let least = known.map(<[u32]>::len).min().unwrap();
        println!("{samples} samples: {least} neighbours at least");
        assert!(contacts.told().len() > samples as usize * 4 / 5 && least >= 12, "{samples}: {least}");
    }
}

/// Of vertices at one place that are far from each other in the file, not all are found in passing.
#[test]
fn faces_in_no_order_are_no_tangle() {
    let (body, part) = soup(shuffled(finer_rings(1e-3, 2)));
    let sampled = body.sampled(Sampling { target: Target::Samples(1000), ..sampling(true) });
    let off = pulled(&sampled, &body, &part, &of_rings(1e-3));
    println!("{:.5} of the vertices are off by a quarter", share(&off, 0.25));
    assert!(sampled.samples.contacts().is_some() && share(&off, 0.25) < 1e-4);
}

/// Parts that go one way lend each other samples, and those that a hinge joins where they touch do not.
#[test]
fn parts_lend_samples_where_they_go_one_way() {
    let (body, part) = rings(1e-3);
    let of = of_rings(1e-3);
    let touch = DVec3::X * (1.0 - RADIUS);
    let near = |off: Vec<f64>| -> Vec<f64> {
        let all = off.into_iter().zip(&body.positions);
        all.filter(|(_, p)| p.distance(touch) < 0.15).map(|(off, _)| off).collect()
    };
    let rms = |off: &[f64]| (off.iter().map(|e| e * e).sum::<f64>() / off.len() as f64).sqrt();
    let twist = |p: DVec3, _: f64| DQuat::from_rotation_x(2.0 * (p.x - touch.x)) * p;
    let [with, without] = [true, false].map(|sheets| body.sampled(sampling(sheets)));
    let [twisted, as_one] =
        [&with, &without].map(|sampled| rms(&near(off_by(sampled, &body, &part, &of, &twist))));
    println!("near the contact a twist is off by {twisted:.2e}, and as of one surface by {as_one:.2e}");
    assert!(twisted < 1.1 * as_one);
    for axis in [DVec3::X, DVec3::Y, DVec3::Z] {
        let hinge = |p: DVec3, part: f64| touch + DQuat::from_axis_angle(axis, 0.1 * part) * (p - touch);
        let off = near(off_by(&with, &body, &part, &of, &hinge));
        let worst = off.iter().copied().fold(0.0, f64::max);
        println!("a hinge about {axis}: {worst:.2e} at worst");
        assert!(worst < 1e-6, "a hinge about {axis}: {worst}");
    }
}

/// Faces of parted clusters are found by their places in the file, or all are read: the samples that they
/// place are the same.
#[test]
fn faces_place_the_samples_of_parts_wherever_they_are_read() {
    for (body, _) in [rings(1e-3), soup(rings(1e-3))] {
        let body = Body { normals: Vec::new(), ..body };
        for target in [Target::Samples(4000), Target::Error(2e-3)] {
            let [some, all] = [false, true].map(|cells| {
                body.sampled(Sampling {
                    target,
                    skip: Skip { cells, ..sampling(true).skip },
                    ..sampling(true)
                })
            });
            assert!(some.samples.contacts().is_some());
            assert_eq!(some.samples.positions, all.samples.positions);
            assert_eq!(some.triangles, all.triangles);
        }
    }
}

/// Number of triangles with samples of both parts.
fn joining(sampled: &SampledModel, of: &dyn Fn(DVec3) -> f64) -> usize {
    let is_second = |i: &u32| of(sampled.frame.to_model(sampled.samples.positions[*i as usize])) > 0.5;
    sampled.triangles.iter().filter(|t| t.iter().any(|i| is_second(i) != is_second(&t[0]))).count()
}

/// Refined around a place.
fn refined(sampled: &SampledModel, path: &Path, place: DVec3, radius: f64, finer: Finer) -> SampledModel {
    let model = simod_model::open(path).unwrap();
    let distance = |p: DVec3| p.distance(place) - radius;
    let selection = SpaceSelection { distance: &distance, so_far: None, at_rest: true };
    let how = Refining { finer, memory_limit: None, shapes: Vec::new() };
    let folder = path.parent().unwrap();
    refine(sampled, model.as_ref(), selection, &how, folder, &Silent).unwrap().sampled.unwrap()
}

/// Clusters of a thin wall all hold both sides, and normals do not tell.
#[test]
fn the_sides_of_a_thin_wall_come_apart() {
    for thickness in [0.004, 0.02] {
        let (body, part) = two_spheres([(DVec3::ZERO, 1.0), (DVec3::ZERO, 1.0 - thickness)]);
        let body = body.without_normals();
        let of = |p: DVec3| f64::from(u32::from(p.length() < 1.0 - 0.5 * thickness));
        let off = |sheets| {
            let target = Target::Samples(10_000);
            let sampled =
                body.sampled(Sampling { target, placement: Placement::Vertices, ..sampling(sheets) });
            let samples = sampled.samples.len();
            assert!((9_500..=10_000).contains(&samples), "{samples}");
            pulled(&sampled, &body, &part, &of).into_iter().fold(0.0, f64::max)
        };
        let [worst, without] = [true, false].map(off);
        println!("a wall of {thickness}: off by {worst:.1e} of the way, and {without:.1e} without sheets");
        assert!(worst < 1e-4 && without > 0.3, "{thickness}: {worst}, {without}");
    }
}

/// In the end each vertex has a sample, and those of the other part are as near as the next one of its own.
#[test]
fn refinements_down_to_every_vertex_keep_parts_apart() {
    let of = |p: DVec3| f64::from(u32::from(p.z > 0.0));
    let (body, part) = spheres(DVec3::Z, 0.0);
    for (name, body) in [("with normals", body.clone()), ("without", body.without_normals())] {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("model.ply");
        body.write(&path);
        let mut sampled = sample_file(&path, Sampling { target: Target::Samples(3000), ..sampling(true) });
        for (radius, error) in [(0.4, 5e-4), (0.15, 2e-4), (0.1, 0.0)] {
            sampled = refined(&sampled, &path, DVec3::ZERO, radius, Finer::Error(error));
            let worst = pulled(&sampled, &body, &part, &of).into_iter().fold(0.0, f64::max);
            println!("spheres {name}, {} samples: off by {worst:.1e} of the way", sampled.samples.len());
            assert!(worst < 1e-3, "{name}, {radius}: {worst}");
        }
    }
}

#[test]
fn a_refinement_keeps_parts_apart() {
    let cactus_of = of_cactus(1e-3);
    let rings_of = of_rings(1e-3);
    type Case<'a> = (&'static str, (Body, Vec<f64>), &'a dyn Fn(DVec3) -> f64, DVec3, bool);
    let cases: [Case<'_>; 4] = [
        ("rings that touch", rings(1e-3), &rings_of, DVec3::X * 0.8, true),
        ("without triangles", rings(1e-3), &rings_of, DVec3::X * 0.8, false),
        ("rings of single faces", soup(rings(1e-3)), &rings_of, DVec3::X * 0.8, true),
        ("an arm on its stem", cactus(1e-3), &cactus_of, DVec3::new(RADIUS, 0.0, 0.8), true),
    ];
    for (name, (body, part), of, place, triangles) in cases {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("model.ply");
        body.write(&path);
        let skip = Skip { triangles: !triangles, ..sampling(true).skip };
        let target = Target::Samples(1000);
        let mut sampled = sample_file(&path, Sampling { skip, target, ..sampling(true) });
        let shares = |sampled: &SampledModel| {
            let off = pulled(sampled, &body, &part, of).into_iter().zip(&body.positions);
            let off: Vec<f64> = off.filter(|(_, p)| is_plain(p, name)).map(|(off, _)| off).collect();
            [share(&off, 0.5), share(&off, 0.1)]
        };
        let near = |sampled: &SampledModel| {
            let near = |p: &&Vec3| sampled.frame.to_model(**p).distance(place) < 0.04;
            sampled.samples.positions.iter().filter(near).count()
        };
        let (mut off, mut there, before) = (shares(&sampled), near(&sampled), joining(&sampled, of));
        println!("{name}: {off:?}, {there} samples near, {before} triangles join");
        let steps = [(0.3, Finer::Factor(2.0)), (0.15, Finer::Factor(2.0)), (0.06, Finer::Error(0.0))];
        for (radius, finer) in steps {
            let next = refined(&sampled, &path, place, radius, finer);
            assert!(next.samples.len() > sampled.samples.len() + 20);
            let (now, more, joins) = (shares(&next), near(&next), joining(&next, of));
            println!("{name}: {now:?}, {more} samples near, {joins} triangles join");
            // The samples where they touch are split as all others are.
            assert!(more > there, "{name}: {more} samples of {there}");
            // Around the bend of the arm the way changes within a spacing.
            assert!(now[0] <= off[0] + 1e-4 && now[1] <= off[1] + 5e-4, "{name}");
            assert!(joins <= before, "{name}: triangles join the parts");
            // A refined model that is saved and loaded goes on as before.
            let saved = folder.path().join("model.simod");
            next.save(&saved).unwrap();
            let mut loaded = SampledModel::load(&saved).unwrap();
            loaded.hold_cells(SampledModel::kept_cells(&saved).unwrap());
            assert_eq!(shares(&loaded), now);
            (sampled, off, there) = (loaded, now, more);
        }
    }
}

#[test]
fn what_is_kept_comes_back_and_only_where_parts_touch() {
    let (body, part) = rings(1e-3);
    let saved = Saved::new(&body, sampling(true));
    assert!(saved.names().contains(&"sheets.bin".to_owned()));
    let (loaded, fresh) = (saved.load(), body.sampled(sampling(true)));
    let of = of_rings(1e-3);
    let off = |sampled: &SampledModel| pulled(sampled, &body, &part, &of);
    assert_eq!(off(&loaded), off(&fresh));
    assert_eq!(loaded.samples.contacts().unwrap().digest(), fresh.samples.contacts().unwrap().digest());
    // Without triangles the samples are the same.
    let plain =
        body.sampled(Sampling { skip: Skip { triangles: true, ..sampling(true).skip }, ..sampling(true) });
    assert_eq!(plain.samples.positions, fresh.samples.positions);
    assert_eq!(plain.samples.contacts().unwrap().digest(), fresh.samples.contacts().unwrap().digest());
    // Cells that were lost are found again.
    let cells = saved.bytes();
    fs::remove_file(saved.folder().join("cells.bin")).unwrap();
    saved.cells();
    assert!(saved.bytes() == cells);

    // Damage is noticed.
    let path = saved.folder().join("sheets.bin");
    let bytes = fs::read(&path).unwrap();
    for i in (0..bytes.len()).step_by(bytes.len() / 40) {
        let mut changed = bytes.clone();
        changed[i] ^= 4;
        write_file(&path, &changed).unwrap();
        assert!(SampledModel::load(&saved.folder()).is_err(), "byte {i}");
        write_file(&path, &bytes[..i]).unwrap();
        assert!(SampledModel::load(&saved.folder()).is_err(), "{i} bytes");
    }

    // Rings that are far from each other touch nowhere, and neither do faces that share no vertices.
    for (body, _) in [rings(0.3), soup(rings(0.3))] {
        let apart = Saved::new(&body, sampling(true));
        assert!(!apart.names().contains(&"sheets.bin".to_owned()));
        let without = body.sampled(sampling(false));
        assert_eq!(apart.load().samples.positions, without.samples.positions);
    }
}
