//! The output is the input with other positions, and normals turned with the surface: every other byte is the
//! same.

use glam::DVec3;
use simod_tests::{MANY, Motion, Ply, Workplace};

/// Moves a model rigidly through its samples, and checks that only what moves has changed.
fn check_moved(work: &Workplace, model: &str, samples: u64) {
    work.simod(&format!("sample {model} -o model.simod --samples {samples}"));
    let before = work.ply(model);
    let [min, max] = before.bounds();
    let motion = Motion::rigid((min + max) / 2.0, before.diagonal());
    work.move_samples("model.simod", |p| motion.image_of(p));
    work.simod("reconstruct model.simod --deformed deformed.ply -o out.ply");
    let after = work.ply("out.ply");

    assert!(after.other_bytes() == before.other_bytes(), "{model}: more changed than positions and normals");
    let worst = worst(&before.positions(), &after.positions(), |p| motion.image_of(p)) / before.diagonal();
    assert!(worst < 1e-5, "{model}: positions are off by {worst:.1e} of the diagonal");
    let normals = before.normals();
    if !normals.is_empty() {
        // Normals keep their length, which is not 1 in all of these files. The turn is known as well as the
        // rounding of positions in floats lets it, over the spacing of samples.
        let worst = self::worst(&normals, &after.normals(), |n| motion.turn * n);
        assert!(worst < 1e-3, "{model}: normals are off by {worst:.1e}");
    }
}

/// Largest distance of what came out from where `to` sends what went in.
fn worst(before: &[DVec3], after: &[DVec3], to: impl Fn(DVec3) -> DVec3) -> f64 {
    assert_eq!(before.len(), after.len());
    let distances = before.iter().zip(after).map(|(p, q)| to(*p).distance(*q));
    // Not by `f64::max`, which passes over NaN.
    distances.max_by(f64::total_cmp).expect("vertices")
}

#[test]
fn faces_and_colours_of_a_model_of_millions() {
    let work = Workplace::new();
    work.simod(&format!("generate -o amphora.ply --vertices {MANY}"));
    check_moved(&work, "amphora.ply", MANY / 20);
}

#[test]
fn all_encodings() {
    let work = Workplace::new();
    for encoding in ["little-endian", "big-endian", "ascii"] {
        for scalar in ["", "--double"] {
            work.simod(&format!("generate -o model.ply --vertices 20000 --encoding {encoding} {scalar}"));
            check_moved(&work, "model.ply", 1500);
        }
    }
}

/// Everything that a PLY file may have, at once.
#[test]
fn every_property_element_comment_and_line_end() {
    let work = Workplace::new();
    for encoding in [Encoding::Ascii, Encoding::Little, Encoding::Big] {
        for line_end in ["\n", "\r\n"] {
            let points = sphere(3000);
            let bytes = everything(encoding, line_end, &points);
            // The test's own reader finds what was written.
            let found = Ply::parse(bytes.clone());
            assert!(worst(&points, &found.positions(), |p| p) < 1e-6);
            assert!(worst(&points, &found.normals(), |p| 2.0 * p) < 1e-6);
            work.write("everything.ply", bytes);
            check_moved(&work, "everything.ply", 600);
        }
    }
}

/// Where nothing around a vertex moves, its bytes stay.
#[test]
fn a_still_part_keeps_its_bytes() {
    let work = Workplace::new();
    work.simod("generate -o amphora.ply --vertices 60000");
    work.simod("sample amphora.ply -o amphora.simod --samples 6000");
    work.move_samples("amphora.simod", |p| if p.y > 1.5 { p + DVec3::X * 0.1 } else { p });
    work.simod("reconstruct amphora.simod --deformed deformed.ply -o out.ply");
    let (before, after) = (work.ply("amphora.ply"), work.ply("out.ply"));
    assert!(before.other_bytes() == after.other_bytes());
    let pairs = || before.positions().into_iter().zip(after.positions());
    assert!(pairs().filter(|(p, _)| p.y < 1.3).all(|(p, q)| p == q), "a part moved that should stand still");
    assert!(pairs().filter(|(p, _)| p.y > 1.7).all(|(p, q)| (q - p - DVec3::X * 0.1).length() < 1e-5));
    let normals = || before.positions().into_iter().zip(before.normals().into_iter().zip(after.normals()));
    assert!(normals().filter(|(p, _)| p.y < 1.3).all(|(_, (n, m))| n == m), "a normal turned");
}

#[derive(Clone, Copy, PartialEq)]
enum Encoding {
    Ascii,
    Little,
    Big,
}

/// A file in the making.
struct Writer {
    bytes: Vec<u8>,
    encoding: Encoding,
    line_end: &'static str,
}

impl Writer {
    fn line(&mut self, text: &str) {
        self.bytes.extend_from_slice(text.as_bytes());
        self.bytes.extend_from_slice(self.line_end.as_bytes());
    }

    /// A number, in the bytes that binary files have for it, or as text.
    fn number<const N: usize>(&mut self, value: impl std::fmt::Display, little: [u8; N]) {
        match self.encoding {
            // Blanks as people write them.
            Encoding::Ascii => self.bytes.extend_from_slice(format!("{value}  ").as_bytes()),
            Encoding::Little => self.bytes.extend_from_slice(&little),
            Encoding::Big => self.bytes.extend(little.iter().rev()),
        }
    }

    fn byte(&mut self, x: u8) {
        self.number(x, [x]);
    }

    fn short(&mut self, x: i16) {
        self.number(x, x.to_le_bytes());
    }

    fn index(&mut self, x: u32) {
        self.number(x, x.to_le_bytes());
    }

    fn float(&mut self, x: f64) {
        self.number(x as f32, (x as f32).to_le_bytes());
    }

    fn double(&mut self, x: f64) {
        self.number(x, x.to_le_bytes());
    }

    fn end(&mut self) {
        if self.encoding == Encoding::Ascii {
            self.line("");
        }
    }
}

/// Vertices after another element and with lists among them, properties in a strange order, normals of length
/// 2, faces with texture coordinates, strips, an element without properties' usual names, and bytes after the
/// end.
fn everything(encoding: Encoding, line_end: &'static str, points: &[DVec3]) -> Vec<u8> {
    let mut out = Writer { bytes: Vec::new(), encoding, line_end };
    let format = match encoding {
        Encoding::Ascii => "ascii",
        Encoding::Little => "binary_little_endian",
        Encoding::Big => "binary_big_endian",
    };
    let (vertices, faces) = (points.len(), points.len() - 2);
    let header = format!(
        "ply|format {format} 1.0|comment made by hand|obj_info property float x|element camera 2|\
         property list uchar double x|property int32 focus|element vertex {vertices}|property uchar quality|\
         property list uchar int16 tags|property double z|property float nx|comment in between|\
         property uint8 red|property double y|property float32 nz|property float ny|property float64 x|\
         property list ushort float weights|property float confidence|element face {faces}|\
         property list uchar uint vertex_indices|property list uint8 float texcoord|element tristrips 1|\
         property list int int vertex_indices|element material 1|property float x|end_header"
    );
    header.split('|').for_each(|line| out.line(line));
    for camera in 0..2 {
        out.byte(3);
        (0..3).for_each(|i| out.double(0.1 + f64::from(i)));
        out.index(camera);
        out.end();
    }
    for (i, p) in points.iter().enumerate() {
        out.byte((i % 251) as u8);
        out.byte((i % 4) as u8);
        (0..i % 4).for_each(|tag| out.short(-(tag as i16) - 300));
        out.double(p.z);
        out.float(2.0 * p.x);
        out.byte(77);
        out.double(p.y);
        out.float(2.0 * p.z);
        out.float(2.0 * p.y);
        out.double(p.x);
        out.number((i % 3) as u16, ((i % 3) as u16).to_le_bytes());
        (0..i % 3).for_each(|weight| out.float(weight as f64 / 7.0));
        out.float(0.3 + i as f64);
        out.end();
    }
    for i in 0..faces as u32 {
        out.byte(3);
        (i..i + 3).for_each(|corner| out.index(corner));
        out.byte(2);
        [0.25, 0.1].into_iter().for_each(|t| out.float(t));
        out.end();
    }
    out.index(5);
    [0, 1, 2, u32::from(encoding != Encoding::Ascii) * u32::MAX, 3].into_iter().for_each(|i| out.index(i));
    out.end();
    out.float(9.5);
    out.end();
    out.bytes.extend_from_slice(b"more than the header tells");
    out.bytes
}

/// Points all over the unit sphere.
fn sphere(n: u32) -> Vec<DVec3> {
    let point = |i| {
        let y = 1.0 - 2.0 * (f64::from(i) + 0.5) / f64::from(n);
        let (sin, cos) = (2.399_963_229_728_653 * f64::from(i)).sin_cos();
        DVec3::new(cos * (1.0 - y * y).sqrt(), y, sin * (1.0 - y * y).sqrt())
    };
    (0..n).map(point).collect()
}
