//! Tests: the geometry of samples at rest is kept as it was found, and nothing else is taken for it.

use std::sync::Arc;

use glam::Vec3;
use proptest::prelude::*;

use super::RestGeometry;
use super::kept_geometry::{self, unpack};
use crate::sampling::SampleSet;

/// Letters, version and checksum of a file.
const AROUND: (usize, usize) = (12, 16);

fn set(points: &[Vec3], normals: &[Vec3]) -> SampleSet {
    SampleSet::new(points.to_vec(), normals.to_vec()).expect("samples")
}

/// The bytes of a file.
fn pack(around: &RestGeometry<'_>) -> Vec<u8> {
    let mut bytes = Vec::new();
    kept_geometry::pack(around, &mut bytes).expect("a file");
    bytes
}

/// All of the geometry that is kept of samples, as bits.
fn known(around: &RestGeometry<'_>) -> Vec<Vec<u32>> {
    let samples = around.samples;
    let mut all: Vec<Vec<u32>> = (0..samples.len())
        .flat_map(|i| {
            let reaching = around.supports.of_home(i).iter();
            let own = [around.supports.radius[i].to_bits(), around.supports.ranging[i].to_bits()];
            let crowded = u32::from(around.sheets.is_crowded(i));
            [
                around.sheets.graph().nearest_to(i).to_vec(),
                around.sheets.of_sample(i).to_vec(),
                around.sheets.strangers(i).to_vec(),
                reaching.flat_map(|r| [r.from.to_bits(), r.sample]).chain(own).chain([crowded]).collect(),
                samples.normals()[i].to_array().map(f32::to_bits).to_vec(),
                vec![samples.spacing()[i].to_bits()],
            ]
        })
        .collect();
    all.push(around.cells().parted().as_flattened().to_vec());
    all
}

/// Points of a wavy plane, in a poor order, with normals where they are wanted; the second of two plates
/// close to each other faces away.
fn plates(side: u32, plates: u32) -> (Vec<Vec3>, Vec<Vec3>) {
    let number = side * side;
    let place = |i: u32| {
        let (plate, at) = (i % plates, i / plates * 7919 % number);
        let (x, z) = ((at % side) as f32 / side as f32, (at / side) as f32 / side as f32);
        let up = if plate == 0 { Vec3::Y } else { Vec3::NEG_Y };
        (Vec3::new(x, 0.1 * (6.0 * x).sin() - 0.3 * plate as f32 / side as f32, z), up)
    };
    (0..plates * number).map(place).unzip()
}

/// Dense on one side and sparse on the other: some are neighbours of others, but not the other way round.
fn uneven(count: u32) -> Vec<Vec3> {
    let place = |i: u32| {
        let (x, z) = ((i as f32 * 0.754_877_7).fract(), (i as f32 * 0.569_840_3).fract());
        Vec3::new(x * x * x * x, 0.05 * (9.0 * z).cos(), z * z)
    };
    (0..count).map(place).collect()
}

#[test]
fn what_was_kept_is_what_was_found() {
    let (plane, up) = plates(70, 1);
    let (two, facing) = plates(20, 2);
    let mut cases = vec![
        (plane.clone(), up),
        (plane, Vec::new()),
        (two.clone(), facing),
        (two, Vec::new()),
        (uneven(3000), Vec::new()),
        // Samples all at one place, and in heaps.
        (vec![Vec3::ONE; 40], Vec::new()),
        ((0..900).map(|i| Vec3::new((i / 15) as f32, 0.0, (i / 150) as f32)).collect(), Vec::new()),
    ];
    cases.extend([1, 2, 3, 5, 32, 33, 34, 100].map(|count| (uneven(count), Vec::new())));
    for (points, normals) in cases {
        let samples = set(&points, &normals);
        let found = RestGeometry::new(&samples);
        let bytes = pack(&found);
        let again = set(&points, &normals);
        let kept = unpack(&again, &bytes).expect("what was kept");
        assert!(known(&kept) == known(&found), "{} samples", points.len());
        // Geometry is not taken for other samples, or for the same ones with other normals.
        let mut others = points.clone();
        others[0].x += 1e-3;
        assert!(unpack(&set(&others, &normals), &bytes).is_none());
        assert!(unpack(&set(&points, &vec![Vec3::X; points.len()]), &bytes).is_none());
        let twice = [&points[..], &points[..]].concat();
        assert!(unpack(&set(&twice, &[]), &bytes).is_none());
    }
}

#[test]
fn what_is_found_is_found_once() {
    let mut samples = set(&plates(20, 2).0, &[]);
    let supports = |samples: &SampleSet| RestGeometry::new(samples).supports.clone();
    let first = supports(&samples);
    assert!(Arc::ptr_eq(&first, &supports(&samples)));
    // Contacts that are set anew change the sheets of samples.
    samples.set_contacts(None);
    assert!(!Arc::ptr_eq(&first, &supports(&samples)));
}

/// Seals bytes again.
fn fit(bytes: &mut [u8]) {
    let end = bytes.len() - AROUND.1;
    let checksum = xxhash_rust::xxh3::xxh3_128(&bytes[..end]).to_le_bytes();
    bytes[end..].copy_from_slice(&checksum);
}

#[test]
fn damage_is_noticed_wherever_it_is() {
    let (points, normals) = plates(6, 2);
    let samples = set(&points, &normals);
    let good = pack(&RestGeometry::new(&samples));
    for at in 0..good.len() {
        let mut bytes = good.clone();
        bytes[at] ^= 0x41;
        assert!(unpack(&samples, &bytes).is_none(), "byte {at}");
        assert!(unpack(&samples, &good[..at]).is_none(), "{at} bytes");
    }
    // Of an older version, whole as it is.
    let mut older = good.clone();
    older[8] -= 1;
    fit(&mut older);
    assert!(unpack(&samples, &older).is_none());
    assert!(unpack(&samples, &good).is_some());
}

proptest! {
    /// Files that lie, with checksums that fit, are refused or can be used.
    #[test]
    fn what_lies_does_no_harm(
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..4),
        cut in prop::option::of((any::<prop::sample::Index>(), any::<prop::sample::Index>())),
    ) {
        let (points, normals) = plates(9, 2);
        let mut bytes = pack(&RestGeometry::new(&set(&points, &normals)));
        if let Some((a, b)) = cut {
            let (a, b) = (a.index(bytes.len()), b.index(bytes.len()));
            bytes.drain(a.min(b)..a.max(b));
        }
        prop_assume!(bytes.len() > AROUND.0 + AROUND.1);
        for (at, to) in changes {
            let end = bytes.len() - AROUND.1;
            bytes[AROUND.0 + at.index(end - AROUND.0)] = to;
        }
        fit(&mut bytes);
        let samples = set(&points, &normals);
        if let Some(around) = unpack(&samples, &bytes) {
            let deformed: Vec<Vec3> = points.iter().map(|p| *p + Vec3::X * p.z).collect();
            let field = super::DeformationField::new(&around, &deformed, super::Method::BlendedJets);
            let between: Vec<Vec3> = points.windows(2).map(|p| 0.5 * (p[0] + p[1])).collect();
            let _ = super::tests::carried(&field, &between);
        }
    }
}
