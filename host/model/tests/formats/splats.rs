//! `.splat` and compressed PLY.

use std::io::Read;
use std::sync::atomic::{AtomicU64, Ordering};

use glam::{DMat3, DQuat, DVec3, Mat3};
use proptest::prelude::*;
use simod_model::{ErrorKind, Model, Progress, Rewriting};

use super::*;

/// Splats along a line of hills, as `.splat`.
fn records(count: usize) -> Vec<u8> {
    let mut bytes = Vec::new();
    for i in 0..count {
        let t = i as f32 / 100.0;
        let scales = [0.01, 0.02 + 0.001 * (i % 7) as f32, 0.001];
        [t, (3.0 * t).sin(), 0.1 * t].iter().chain(&scales).for_each(|x: &f32| bytes.extend(x.to_le_bytes()));
        bytes.extend([i as u8, 100, 255 - i as u8, (37 * i) as u8]);
        bytes.extend([200 + (i % 40) as u8, 128, 90, 150]);
    }
    bytes
}

/// The same number as compressed PLY; with colours' bounds and harmonics, or without.
fn chunks(count: usize, whole: bool) -> Vec<u8> {
    let mut header = format!(
        "ply\nformat binary_little_endian 1.0\ncomment of a test\nelement chunk {}\n",
        count.div_ceil(256)
    );
    let mut groups = vec!["", "scale_"];
    groups.extend(whole.then_some("rgb"));
    for group in &groups {
        let names = if *group == "rgb" { ["r", "g", "b"] } else { ["x", "y", "z"] };
        for side in ["min", "max"] {
            let group = if *group == "rgb" { "" } else { group };
            names.iter().for_each(|name| header += &format!("property float {side}_{group}{name}\n"));
        }
    }
    header += &format!("element vertex {count}\n");
    ["position", "rotation", "scale", "color"]
        .iter()
        .for_each(|name| header += &format!("property uint packed_{name}\n"));
    if whole {
        header += &format!("element sh {count}\n");
        (0..9).for_each(|i| header += &format!("property uchar f_rest_{i}\n"));
    }
    let mut bytes = (header + "end_header\n").into_bytes();
    for chunk in 0..count.div_ceil(256) {
        let x = chunk as f32;
        let bounds = [x, -1.0, 0.0, x + 1.0, 1.0, 0.5, -6.0, -6.0, -8.0, -3.0, -4.0, -7.0];
        let colours = [-0.1, 0.0, 0.1, 1.1, 1.0, 0.9];
        bounds
            .iter()
            .chain(&colours[..if whole { 6 } else { 0 }])
            .for_each(|b| bytes.extend(b.to_le_bytes()));
    }
    for i in 0..count as u32 {
        // Any bits are a splat.
        (0..4).for_each(|k| bytes.extend((i + 1).wrapping_mul(2_654_435_761 + 40_503 * k).to_le_bytes()));
    }
    if whole {
        bytes.extend((0..9 * count).map(|i| (i * 31) as u8));
    }
    bytes
}

/// The same number as SPZ of a version and with harmonics of a degree, not compressed yet.
fn unpacked(count: usize, version: u32, degree: u8) -> Vec<u8> {
    let mut bytes = b"NGSP".to_vec();
    bytes.extend(version.to_le_bytes());
    bytes.extend((count as u32).to_le_bytes());
    bytes.extend([degree, 12, 0, 0]);
    let harmonics = 3 * ((usize::from(degree) + 1).pow(2) - 1);
    for i in 0..count as i32 {
        [41 * i, -9000 + 30 * i, 7].iter().for_each(|p: &i32| bytes.extend(&p.to_le_bytes()[..3]));
    }
    let rest = count * (1 + 3 + 3 + if version == 2 { 3 } else { 4 } + harmonics);
    bytes.extend((0..rest as u32).map(|i| {
        let noise = i.wrapping_add(1).wrapping_mul(2_654_435_761);
        // Far from the ends of what bytes hold.
        80 + ((noise >> 8) % 96) as u8
    }));
    bytes
}

/// Compressed by gzip.
fn spz(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
    encoder.write_all(bytes).unwrap();
    encoder.finish().unwrap()
}

fn of_spz(bytes: &[u8]) -> Vec<u8> {
    let mut found = Vec::new();
    flate2::read::GzDecoder::new(bytes).read_to_end(&mut found).unwrap();
    found
}

/// The numbers of a model by the names that they have.
fn numbers(model: &dyn Model) -> Vec<Vec<f64>> {
    let mut reader = model.vertices(0..u64::MAX).unwrap();
    let (mut chunk, mut all) = (VertexChunk::default(), vec![Vec::new(); model.info().attributes.len()]);
    let mut some = all.clone();
    while reader.read(&mut chunk).unwrap() {
        model.attributes(&chunk, &mut some).unwrap();
        all.iter_mut().zip(&some).for_each(|(all, some)| all.extend(some));
    }
    all
}

/// The covariance and the opacity of each splat.
fn shapes(model: &dyn Model) -> Vec<(DMat3, f64)> {
    let numbers = numbers(model);
    let place = |name: &str| model.info().attributes.iter().position(|a| a.name == name).unwrap();
    let (scale, rotation, opacity) = (place("scale_0"), place("rot_0"), place("opacity"));
    let shape = |i: usize| {
        let [w, x, y, z] = [0, 1, 2, 3].map(|k| numbers[rotation + k][i]);
        let scales = DVec3::from_array([0, 1, 2].map(|k| numbers[scale + k][i].exp()));
        let half = DMat3::from_quat({
            let q = DQuat::from_xyzw(x, y, z, w);
            q * (1.0 / q.length())
        }) * DMat3::from_diagonal(scales);
        (half * half.transpose(), numbers[opacity][i])
    };
    (0..numbers[0].len()).map(shape).collect()
}

fn map() -> DMat3 {
    DMat3::from_axis_angle(DVec3::new(1.0, 2.0, -0.5).normalize_or(DVec3::X), 0.8)
        * DMat3::from_diagonal(DVec3::new(1.3, 0.9, 1.0))
}

/// Bytes of the model after a linear map of all.
fn deformed(model: &dyn Model) -> Vec<u8> {
    rewrite(model, |edited: &mut Edited| {
        edited.positions.iter_mut().for_each(|p| *p = map() * *p);
        assert_eq!(edited.gradients.len(), edited.positions.len());
        edited.gradients.fill(map().as_mat3());
    })
    .unwrap()
}

#[test]
fn what_is_packed_comes_back_as_it_was() {
    for count in [1, 255, 256, 257, 700] {
        let model = check_whole(&records(count), ".splat");
        assert_eq!(model.info().vertices, count as u64);
        for whole in [false, true] {
            let model = check_whole(&chunks(count, whole), ".ply");
            assert_eq!((model.info().vertices, model.info().faces), (count as u64, 0));
            assert_eq!(model.info().attributes.len(), if whole { 20 } else { 11 });
            assert!((model.info().step.x - 1.0 / 1023.0).abs() < 2e-3);
        }
    }
}

#[test]
fn numbers_are_those_of_the_description() {
    let model = open(&records(3), ".splat").unwrap();
    let all = numbers(model.as_ref());
    let of =
        |name: &str, i: usize| all[model.info().attributes.iter().position(|a| a.name == name).unwrap()][i];
    assert!((0.5 + 0.282_094_79 * of("f_dc_1", 1) - 100.0 / 255.0).abs() < 1e-6);
    assert!((1.0 / (1.0 + (-of("opacity", 1)).exp()) - 37.0 / 255.0).abs() < 1e-9);
    assert!((of("scale_1", 1).exp() - 0.021).abs() < 1e-8);
    assert_eq!((of("rot_0", 1), of("rot_2", 1)), (73.0 / 128.0, -38.0 / 128.0));

    let bytes = chunks(300, true);
    let model = open(&bytes, ".ply").unwrap();
    let at = bytes.len() - 300 * 9 - 300 * 16 + 299 * 16;
    let word = |k: usize| u32::from_le_bytes(bytes[at + 4 * k..at + 4 * k + 4].try_into().unwrap());
    let (positions, _) = read(model.as_ref()).unwrap();
    assert!((positions[299].x - (1.0 + f64::from(word(0) >> 21) / 2047.0)).abs() < 1e-12);
    assert!((positions[299].y - (f64::from(word(0) >> 11 & 1023) / 1023.0 * 2.0 - 1.0)).abs() < 1e-12);
    let all = numbers(model.as_ref());
    let of = |name: &str| all[model.info().attributes.iter().position(|a| a.name == name).unwrap()][299];
    assert!((of("scale_2") - (-8.0 + f64::from(word(2) & 2047) / 2047.0)).abs() < 1e-12);
    assert!(
        (0.5 + 0.282_094_79 * of("f_dc_0") - (-0.1 + 1.2 * f64::from(word(3) >> 24) / 255.0)).abs() < 1e-6
    );
    let q = ["rot_0", "rot_1", "rot_2", "rot_3"].map(of);
    assert!((q.iter().map(|x| x * x).sum::<f64>() - 1.0).abs() < 1e-12);
    let byte = bytes[bytes.len() - 9];
    let expected = if byte == 0 { -4.0 } else { ((f64::from(byte) + 0.5) / 256.0 - 0.5) * 8.0 };
    assert!((of("f_rest_0") - expected).abs() < 1e-12 || byte == 255);
}

#[test]
fn splats_turn_as_far_as_their_bits_tell() {
    for (bytes, extension, bound) in [
        (records(700), ".splat", 0.05),
        (chunks(700, false), ".ply", 0.01),
        (chunks(700, true), ".ply", 0.01),
    ] {
        let model = open(&bytes, extension).unwrap();
        let out = deformed(model.as_ref());
        assert_eq!(out.len(), bytes.len());
        let found = open(&out, extension).unwrap();
        let (rest, now) = (read(model.as_ref()).unwrap().0, read(found.as_ref()).unwrap().0);
        let step = found.info().step.max_element().max(1e-6);
        for (p, q) in rest.iter().zip(&now) {
            assert!(q.distance(map() * *p) < step, "{q} is not {}", map() * *p);
        }
        for ((s, opacity), (t, other)) in shapes(model.as_ref()).iter().zip(shapes(found.as_ref())) {
            // Most splats are near: where axes are much longer than others, the rotation by a step of the
            // quaternion is seen.
            let expected = map() * *s * map().transpose();
            let size = |m: DMat3| m.to_cols_array().iter().map(|x| x * x).sum::<f64>().sqrt();
            assert!(size(t - expected) < bound * size(expected), "{t} is not {expected}");
            assert_eq!(*opacity, other);
        }
        check_whole(&out, extension);
    }
}

#[test]
fn what_does_not_move_keeps_its_bytes() {
    let bytes = records(700);
    let model = open(&bytes, ".splat").unwrap();
    let move_some = |edited: &mut Edited| {
        let far = edited.positions.iter().map(|p| p.x > 5.0).collect::<Vec<_>>();
        for (i, _) in far.iter().enumerate().filter(|(_, is)| **is) {
            edited.positions[i].y += 1.0;
            edited.gradients[i] = Mat3::from_rotation_y(0.5);
        }
    };
    let out = rewrite(model.as_ref(), move_some).unwrap();
    for (i, (a, b)) in bytes.chunks(32).zip(out.chunks(32)).enumerate() {
        assert_eq!(a == b, i <= 500, "{i}");
        // Colours and scales are those of before.
        assert!(a[12..28] == b[12..28]);
    }

    let bytes = chunks(2560, true);
    let model = open(&bytes, ".ply").unwrap();
    let out = rewrite(model.as_ref(), move_some).unwrap();
    let start = bytes.windows(11).position(|w| w == b"end_header\n").unwrap() + 11;
    let parts = |bytes: &[u8], chunk: usize| {
        let splats = start + 10 * 72 + 256 * 16 * chunk;
        let harmonics = start + 10 * 72 + 2560 * 16 + 256 * 9 * chunk;
        let bounds = &bytes[start + 72 * chunk..][..72];
        [bounds, &bytes[splats..][..256 * 16], &bytes[harmonics..][..256 * 9]].map(<[u8]>::to_vec)
    };
    for chunk in 0..10 {
        let (before, after) = (parts(&bytes, chunk), parts(&out, chunk));
        assert_eq!(before == after, chunk < 5, "{chunk}");
        assert!(before[0][24..] == after[0][24..], "bounds of scales and colours");
        assert_eq!(before[2] == after[2], chunk < 5);
    }
}

/// Adds up what is done.
#[derive(Default)]
struct Done(AtomicU64);

impl Progress for Done {
    fn begin(&self, _stage: &'static str, _total_bytes: u64) {}
    fn advance(&self, bytes: u64) {
        self.0.fetch_add(bytes, Ordering::Relaxed);
    }
    fn is_cancelled(&self) -> bool {
        false
    }
}

#[test]
fn progress_ends_with_all_bytes() {
    for (bytes, extension) in [
        (records(700), ".splat"),
        (chunks(700, false), ".ply"),
        (chunks(700, true), ".ply"),
        (spz(&unpacked(700, 2, 0)), ".spz"),
        (spz(&unpacked(700, 3, 2)), ".spz"),
    ] {
        let model = open(&bytes, extension).unwrap();
        let (done, mut out) = (Done::default(), Written::default());
        let keep = |_: &VertexChunk, _: &mut [Edited]| Ok(());
        model.rewrite(&mut [&mut out], Rewriting::default(), &keep, &done).unwrap();
        assert_eq!(done.0.into_inner(), model.bytes_to_rewrite(), "{extension}");
    }
}

#[test]
fn spz_turns_as_far_as_its_bits_tell() {
    for (version, degree) in [(2, 0), (2, 2), (3, 1), (3, 3)] {
        let bytes = unpacked(700, version, degree);
        let packed = spz(&bytes);
        let model = check_whole_but(&packed);
        let harmonics = 3 * ((usize::from(degree) + 1).pow(2) - 1);
        assert_eq!((model.info().vertices, model.info().attributes.len()), (700, 11 + harmonics));
        let (rest, _) = read(model.as_ref()).unwrap();
        assert_eq!(rest[100], DVec3::new(4100.0, -6000.0, 7.0) / 4096.0);

        let all = numbers(model.as_ref());
        let of = |name: &str| all[model.info().attributes.iter().position(|a| a.name == name).unwrap()][3];
        // Positions, opacities, colours, then scales.
        let scales = 16 + 700 * 13;
        assert_eq!(of("scale_1"), f64::from(bytes[scales + 3 * 3 + 1]) / 16.0 - 10.0);
        if degree > 0 {
            // Red, green and blue of each coefficient stand together.
            let start = bytes.len() - (700 - 3) * harmonics;
            let name = format!("f_rest_{}", harmonics / 3);
            assert_eq!(of(&name), (f64::from(bytes[start + 1]) - 128.0) / 128.0);
        }

        let out = deformed(model.as_ref());
        let found = open(&out, ".spz").unwrap();
        let now = read(found.as_ref()).unwrap().0;
        for (p, q) in rest.iter().zip(&now) {
            assert!(q.distance(map() * *p) < 1.0 / 4096.0, "{q} is not {}", map() * *p);
        }
        for ((s, opacity), (t, other)) in shapes(model.as_ref()).iter().zip(shapes(found.as_ref())) {
            let expected = map() * *s * map().transpose();
            let size = |m: DMat3| m.to_cols_array().iter().map(|x| x * x).sum::<f64>().sqrt();
            // Scales are in steps of 6 %.
            assert!(size(t - expected) < 0.13 * size(expected), "{t} is not {expected}");
            assert_eq!(*opacity, other);
        }
        // Colours and opacities are kept.
        assert!(of_spz(&out)[16 + 700 * 9..16 + 700 * 13] == bytes[16 + 700 * 9..16 + 700 * 13]);
    }
}

/// Checks of every good file, but that gzip may pack the same bytes in another way.
fn check_whole_but(bytes: &[u8]) -> Box<dyn Model> {
    let model = open(bytes, ".spz").unwrap();
    let all = read(model.as_ref()).unwrap();
    for chunk in [1, 3, 1000] {
        assert!(read_by(model.as_ref(), 0..u64::MAX, chunk).unwrap() == all);
        assert!(vertex_bytes(model.as_ref(), chunk) == vertex_bytes(model.as_ref(), 1 << 16));
    }
    let out = rewrite(model.as_ref(), |_: &mut Edited| {}).unwrap();
    assert!(of_spz(&out) == of_spz(bytes));
    model
}

#[test]
fn spz_that_lies_is_refused() {
    let good = unpacked(3, 3, 1);
    let refused = |bytes: &[u8], named: &str| {
        let found = message(open(bytes, ".spz"));
        assert!(found.contains(named), "{found}");
    };
    let with = |at: usize, byte: u8| {
        let mut bytes = good.clone();
        bytes[at] = byte;
        spz(&bytes)
    };
    refused(&with(0, b'X'), "its content is no SPZ");
    refused(&with(4, 4), "version 4");
    refused(&with(12, 4), "degree 4");
    refused(&with(8, 4), "another number of bytes");
    refused(&with(8, 2), "another number of bytes");
    refused(&with(11, 200), "bytes in all");
    let packed = spz(&good);
    for end in 1..packed.len() {
        assert!(open(&packed[..end], ".spz").is_err() || end + 9 > packed.len());
    }
    for at in 0..packed.len() {
        for other in [0, 1, 0x7f, 0xff] {
            let mut bad = packed.clone();
            bad[at] = other;
            if let Ok(model) = open(&bad, ".spz") {
                read(model.as_ref()).unwrap();
            }
        }
    }
    // Far positions have no room.
    let model = open(&packed, ".spz").unwrap();
    assert!(!model.has_room_for(DVec3::splat(3000.0)) && model.has_room_for(DVec3::splat(2000.0)));
    let far = rewrite(model.as_ref(), |edited: &mut Edited| edited.positions[1].y = 3000.0);
    assert!(message(far).contains("too far for its 24 bits"));
}

#[test]
fn what_lies_is_refused() {
    check_bad(&records(3), ".splat");
    check_bad(&chunks(3, true), ".ply");
    assert!(message(open(&records(3)[..90], ".splat")).contains("26 bytes are left"));
    let bytes = chunks(300, true);
    let text = |from: &str, to: &str| {
        let at = bytes.windows(from.len()).position(|w| w == from.as_bytes()).unwrap();
        [&bytes[..at], to.as_bytes(), &bytes[at + from.len()..]].concat()
    };
    for (from, to, named) in [
        ("element chunk 2", "element chunk 3", "3 chunks are not of 300 splats"),
        ("float max_scale_y", "float max_scale_q", "bounds of their chunks"),
        ("uint packed_scale", "uint packed_scald", "other properties"),
        ("uchar f_rest_8", "uchar f_rest_9", "harmonics are not bytes"),
        ("binary_little_endian", "binary_big_endian", "binary_little_endian"),
        ("element sh 300", "element sh 299", "harmonics are not bytes"),
    ] {
        let found = open(&text(from, to), ".ply");
        assert!(matches!(&found, Err(e) if e.kind() == ErrorKind::Format), "{to}");
        assert!(message(found).contains(named), "{to}");
    }
    assert!(message(open(&bytes[..bytes.len() - 1], ".ply")).contains("ends within its 300 packed splats"));
    // Bytes behind the splats are kept.
    check_whole(&[&bytes[..], b"more"].concat(), ".ply");
}

proptest! {
    #[test]
    fn any_bytes_are_splats(bytes in prop::collection::vec(any::<u8>(), 32..600)) {
        let bytes = &bytes[..bytes.len() / 32 * 32];
        go_over(bytes, ".splat").unwrap();
        deformed_or_refused(bytes, ".splat");
        let mut packed = chunks(8, true);
        let end = packed.len();
        let start = end - (72 + 8 * 25);
        packed[start..start + bytes.len().min(end - start)].copy_from_slice(&bytes[..bytes.len().min(end - start)]);
        go_over(&packed, ".ply").unwrap();
        deformed_or_refused(&packed, ".ply");
    }
}

/// Positions of any size may leave the numbers of the file, and nothing else may go wrong.
fn deformed_or_refused(bytes: &[u8], extension: &str) {
    let model = open(bytes, extension).unwrap();
    let done = rewrite(model.as_ref(), |edited: &mut Edited| {
        edited.positions.iter_mut().for_each(|p| *p = map() * *p);
        edited.gradients.fill(map().as_mat3());
    });
    match done {
        Ok(out) => assert_eq!(out.len(), bytes.len()),
        Err(e) => assert_eq!(e.kind(), ErrorKind::Degenerate),
    }
}
