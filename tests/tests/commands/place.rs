//! A vertex goes where its place goes: whatever file it stands in, and where, and beside whom. And what a
//! poor order of the vertices will cost is told beforehand.

use glam::DVec3;
use simod_tests::{Ply, Workplace};

fn hash(i: u64) -> u64 {
    let x = (i ^ i >> 31).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    (x ^ x >> 29).wrapping_mul(0xbf58_476d_1ce4_e5b9)
}

fn moved(p: DVec3) -> DVec3 {
    p + DVec3::new(0.1 * p.y * p.y, 0.3 * p.x, 1.0)
}

/// Text and binary come in other blocks.
#[test]
fn text_and_binary_give_the_same_positions() {
    let work = Workplace::new();
    for encoding in ["ascii", "little-endian"] {
        work.simod(&format!("generate -o {encoding}.ply --vertices 60000 --encoding {encoding}"));
        work.simod(&format!("sample {encoding}.ply -o {encoding}.simod --samples 3000"));
    }
    assert!(work.read("ascii.simod/samples.ply") == work.read("little-endian.simod/samples.ply"));
    work.move_samples("ascii.simod", moved);
    for method in ["blended-jets", "projected-barycentric"] {
        for encoding in ["ascii", "little-endian"] {
            work.simod(&format!(
                "reconstruct {encoding}.simod --deformed deformed.ply -o {encoding}-out.ply --method {method}"
            ));
        }
        let (text, binary) = (work.ply("ascii-out.ply"), work.ply("little-endian-out.ply"));
        assert!(text.positions() == binary.positions(), "{method}");
    }
}

/// A soup of triangles that share no vertices, and have normals of their own.
#[test]
fn a_soup_stays_together() {
    let work = Workplace::new();
    let n = 150;
    let at = |i: u64, j: u64| {
        let (u, v) = (i as f64 / n as f64, j as f64 / n as f64);
        DVec3::new(u, 0.1 * (9.0 * u).sin() * (7.0 * v).cos(), v).as_vec3().as_dvec3()
    };
    let triangle = |k: u64| {
        let (i, j) = (k / 2 % n, k / 2 / n);
        if k.is_multiple_of(2) {
            [at(i, j), at(i + 1, j), at(i, j + 1)]
        } else {
            [at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)]
        }
    };
    // The triangles in no order.
    let mut order: Vec<u64> = (0..2 * n * n).collect();
    order.sort_by_key(|k| hash(*k));
    let positions: Vec<DVec3> = order.iter().flat_map(|k| triangle(*k)).collect();
    let normal = |k: u64| (DVec3::new(hash(k) as f64, 2e19, hash(k + 1) as f64) - 1e19).normalize_or_zero();
    let normals: Vec<DVec3> = order.iter().flat_map(|k| [normal(*k); 3]).collect();
    work.write("soup.ply", Ply::from_points(&positions, &normals).bytes);
    work.simod("sample soup.ply -o soup.simod --samples 2000");
    work.move_samples("soup.simod", moved);
    let bits = |p: DVec3| p.to_array().map(f64::to_bits);
    for method in ["blended-jets", "projected-barycentric"] {
        work.simod(&format!("reconstruct soup.simod --deformed deformed.ply -o out.ply --method {method}"));
        let out = work.ply("out.ply").positions();
        let mut places: Vec<_> = positions.iter().zip(&out).map(|(p, q)| (bits(*p), bits(*q))).collect();
        places.sort_unstable();
        places.dedup();
        let images = places.len();
        places.dedup_by_key(|(place, _)| *place);
        assert_eq!([places.len(), images], [((n + 1) * (n + 1)) as usize; 2], "{method}");
    }
}

#[test]
fn what_a_poor_order_costs_is_told_beforehand() {
    let work = Workplace::new();
    let n = 520_000u64;
    let place = |i: u64| {
        let (u, v) = (0.01 * (i as f64 / 720.0).floor(), 0.01 * (i % 720) as f64);
        DVec3::new(u, 0.3 * u.sin() * v.cos(), v)
    };
    let in_order: Vec<DVec3> = (0..n).map(place).collect();
    let mut order: Vec<u64> = (0..n).collect();
    order.sort_by_key(|i| hash(*i));
    let in_none: Vec<DVec3> = order.iter().map(|i| place(*i)).collect();
    let told = "come in no order in space";
    for (positions, poor) in [(in_order, false), (in_none, true)] {
        work.write("model.ply", Ply::from_points(&positions, &[]).bytes);
        let sampled = work.simod("sample model.ply -o model.simod --samples 500 --skip cells");
        work.move_samples("model.simod", moved);
        let reconstructed = work.simod("reconstruct model.simod --deformed deformed.ply -o out.ply");
        let info = work.simod("info model.simod");
        for text in [&sampled.stderr, &reconstructed.stderr, &info.stdout] {
            assert_eq!(text.contains(told), poor, "{text}");
        }
        let jumps = work.report("info model.simod")["jumps"].as_u64().expect("a number");
        assert_eq!(jumps > n / 2, poor, "{jumps}");
        // A folder of a former version knows nothing of it.
        let text = String::from_utf8(work.read("model.simod/simod.toml")).expect("text");
        let former: Vec<&str> = text.lines().filter(|line| !line.starts_with("jumps")).collect();
        assert!(former.len() < text.lines().count());
        work.write("model.simod/simod.toml", former.join("\n"));
        let reconstructed = work.simod("reconstruct model.simod --deformed deformed.ply -o out.ply");
        assert!(!reconstructed.stderr.contains(told));
    }
}
