//! `simod render`: what pictures are coloured by.

use serde_json::{Value, json};
use simod_tests::Workplace;
use std::fmt::Write as _;
use std::fs::File;
use std::io::BufReader;

/// A flat sheet: its left half is red, its right half is blue; intensity rises upwards, and classes are 2
/// and 6.
fn sheet(work: &Workplace) {
    const SIDE: u32 = 120;
    let mut text = format!("ply\nformat ascii 1.0\nelement vertex {}\n", SIDE * SIDE);
    for (kind, names) in [
        ("float", "x y z nx ny nz"),
        ("uchar", "red green blue"),
        ("ushort", "intensity"),
        ("uchar", "classification"),
    ] {
        for name in names.split(' ') {
            writeln!(text, "property {kind} {name}").expect("a line");
        }
    }
    text.push_str("end_header\n");
    for i in 0..SIDE * SIDE {
        let (x, y) = (i % SIDE, i / SIDE);
        let left = x < SIDE / 2;
        let color = if left { "230 20 20" } else { "20 20 230" };
        let class = if left { 2 } else { 6 };
        writeln!(text, "{x} {y} 0 0 0 1 {color} {} {class}", 100 * y).expect("a line");
    }
    work.write("sheet.ply", text);
}

/// The mean colour of the picture's left or right part, and its upper or lower one, around the middle of
/// each.
fn mean(work: &Workplace, name: &str, [x, y]: [f64; 2]) -> [f64; 3] {
    let decoder = png::Decoder::new(BufReader::new(File::open(work.path(name)).expect("a picture")));
    let mut reader = decoder.read_info().expect("a PNG file");
    let mut pixels = vec![0; reader.output_buffer_size().expect("a size")];
    let info = reader.next_frame(&mut pixels).expect("pixels");
    // A legend is below the picture.
    let side = info.width as usize;
    let at = |share: f64| (share * side as f64) as usize;
    let mut sum = [0.0; 3];
    for (row, column) in (0..9).map(|i| (at(y) + i / 3, at(x) + i % 3)) {
        let place = 3 * (row * side + column);
        sum.iter_mut().zip(&pixels[place..place + 3]).for_each(|(sum, c)| *sum += f64::from(*c) / 9.0);
    }
    sum
}

const LEFT: [f64; 2] = [0.35, 0.5];
const RIGHT: [f64; 2] = [0.65, 0.5];

#[test]
fn own_colours_attributes_and_clay() {
    let work = Workplace::new();
    sheet(&work);
    work.simod("sample sheet.ply -o sheet.simod --samples 1500");
    let how = "--size 200x200 --yaw 0 --pitch 0";
    for of in ["sheet.ply", "sheet.simod"] {
        for option in ["", "--color own"] {
            work.simod(&format!("render {of} -o own.png {how} {option}"));
            let [red, _, little] = mean(&work, "own.png", LEFT);
            assert!(red > 3.0 * little, "{of} {option}: the left half is red, not {red} and {little}");
            let [little, _, blue] = mean(&work, "own.png", RIGHT);
            assert!(blue > 3.0 * little, "{of} {option}: the right half is blue, not {blue} and {little}");
        }
        work.simod(&format!("render {of} -o clay.png {how} --color clay"));
        let [a, b] = [LEFT, RIGHT].map(|at| mean(&work, "clay.png", at));
        assert!(a.iter().zip(b).all(|(a, b)| (a - b).abs() < 12.0), "{of}: clay is alike, {a:?} and {b:?}");

        work.simod(&format!("render {of} -o intensity.png {how} --color intensity"));
        let light = |at| mean(&work, "intensity.png", at).iter().sum::<f64>();
        let (low, high) = (light([0.5, 0.7]), light([0.5, 0.3]));
        assert!(low > 1.5 * high, "{of}: the scale gets darker upwards, {low} to {high}");

        work.simod(&format!("render {of} -o classes.png {how} --color classification"));
        // Ground is brown, buildings are red.
        let [[r, g, _], [s, h, _]] = [LEFT, RIGHT].map(|at| mean(&work, "classes.png", at));
        assert!(g / r > 0.6 && h / s < 0.6, "{of}: {r} {g}, {s} {h}");
        work.refuses(&format!("render {of} -o no.png --color temperature"), &["temperature"]);
        // The meaning of colours is also in the report.
        let told = |option: &str| {
            let report = work.report(&format!("render {of} -o told.png --size 20x20 {option}"));
            (report["color"].clone(), report["color_range"].clone())
        };
        assert_eq!(told(""), ("own".into(), Value::Null));
        assert_eq!(told("--color clay"), ("clay".into(), Value::Null));
        assert_eq!(told("--color classification"), ("classification".into(), json!([2.0, 6.0])));
        let (name, range) = told("--color intensity");
        assert!(name == "intensity" && range[0].as_f64() < range[1].as_f64(), "{range}");
    }
}

/// Around a point of the left half there is no blue, however the whole lies; and a diagnosis is a colour,
/// too.
#[test]
fn a_crop_shows_a_part_larger() {
    let work = Workplace::new();
    sheet(&work);
    let how = "--size 200x200 --yaw 0 --pitch 0 --color own";
    work.simod(&format!("render sheet.ply -o crop.png {how} --target 30,60,0 --crop 0.2"));
    work.simod(&format!("render sheet.ply -o whole.png {how} --target 59.5,59.5,0 --crop 1"));
    work.simod(&format!("render sheet.ply -o plain.png {how}"));
    for at in [[0.05, 0.05], [0.95, 0.95], [0.05, 0.95], [0.95, 0.05]] {
        let [r, _, b] = mean(&work, "crop.png", at);
        assert!(r > b + 60.0, "{at:?}: {r}, {b}");
    }
    assert!(work.read("whole.png") == work.read("plain.png"));
    let [left, right] = [LEFT, RIGHT].map(|at| mean(&work, "whole.png", at));
    assert!(left[0] > left[2] && right[2] > right[0]);
    for bad in ["--target 1,2", "--target 1,2,nan", "--crop 0", "--crop 2"] {
        assert_eq!(work.run(&format!("render sheet.ply -o no.png {bad}")).code, Some(2), "{bad}");
    }
    let step = "[[step]]\ndeform = \"warp\"\nparams = { operation = \"shear\", axis = [1, 0, 0], direction = [0, 0, 1] }\n";
    work.write_session("sheet.ply", 1500, step);
    work.simod("run edit.toml --diagnostics diagnosis.ply");
    work.simod("render diagnosis.ply -o d.png --size 200x200 --yaw 0 --pitch 0 --color-by displacement");
    assert_ne!(mean(&work, "d.png", LEFT), mean(&work, "d.png", [0.5, 0.5]));
}

/// A plane of two large triangles is drawn whole, as its corners alone cannot be; its own colours are mixed
/// in between, and samples have triangles, too.
#[test]
fn faces_are_drawn_where_there_are_any() {
    let work = Workplace::new();
    let head = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n\
                property uchar red\nproperty uchar green\nproperty uchar blue\nelement face 2\n\
                property list uchar int vertex_indices\nend_header\n";
    let vertices = "0 0 0 220 20 20\n2 0 0 20 20 220\n2 2 0 20 20 220\n0 2 0 220 20 20\n";
    work.write("quad.ply", format!("{head}{vertices}3 0 1 2\n3 0 2 3\n"));
    let how = "--size 200x200 --yaw 0 --pitch 0";
    work.simod(&format!("render quad.ply -o quad.png {how}"));
    let [[r, _, b], [s, _, c]] = [LEFT, RIGHT].map(|at| mean(&work, "quad.png", at));
    assert!(r > b + 40.0 && c > s + 40.0, "{r} {b}, {s} {c}");
    work.simod(&format!("render quad.ply -o dots.png {how} --points"));
    assert!(work.read("quad.png") != work.read("dots.png"));
    work.simod(&format!("render quad.ply -o turn --turntable 1 {how}"));
    assert!(work.read("quad.png") == work.read("turn/frame-0001.png"));

    work.simod("generate --shape cylinder --vertices 40000 -o c.ply");
    work.simod("sample c.ply -o c.simod --samples 1000");
    work.simod("render c.simod -o faces.png --size 200x200");
    work.simod("render c.simod -o discs.png --size 200x200 --points");
    work.simod("render c.simod -o turned --turntable 1 --size 200x200 --points");
    assert!(work.read("faces.png") != work.read("discs.png"));
    assert!(work.read("discs.png") == work.read("turned/frame-0001.png"));
}
