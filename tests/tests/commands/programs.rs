//! Samples that other programs deform: they show colours, may come in another order if they have their ids,
//! and all have to come back.

use glam::DVec3;
use simod_tests::Workplace;

/// Rows and columns of the mesh.
const N: usize = 100;

/// A wavy sheet whose colour is its place.
fn model(colors: &str) -> String {
    let mut text = format!("ply\nformat ascii 1.0\nelement vertex {}\n", N * N);
    ["x", "y", "z"].iter().for_each(|name| text += &format!("property float {name}\n"));
    if !colors.is_empty() {
        ["red", "green", "blue"].iter().for_each(|name| text += &format!("property {colors} {name}\n"));
    }
    text += &format!("element face {}\nproperty list uchar uint vertex_indices\n", 2 * (N - 1) * (N - 1));
    text += "end_header\n";
    for k in 0..N * N {
        let (u, v) = (k / N, k % N);
        text += &format!("{u} {v} {}", 5.0 * (u as f64 / 20.0).sin());
        text += &match colors {
            "uchar" => format!(" {} {} 7\n", 2 * u, 2 * v),
            "ushort" => format!(" {} {} 1799\n", 514 * u, 514 * v),
            "float" => format!(" {} {} 0.02745\n", 2.0 * u as f64 / 255.0, 2.0 * v as f64 / 255.0),
            _ => "\n".to_owned(),
        };
    }
    for k in (0..N * (N - 1)).filter(|k| k % N < N - 1) {
        text += &format!("3 {k} {} {}\n3 {} {} {}\n", k + N, k + 1, k + 1, k + N, k + N + 1);
    }
    text
}

/// A binary PLY file in three parts: its header, the records of its vertices, and what follows.
struct Records {
    header: String,
    vertices: Vec<Vec<u8>>,
    rest: Vec<u8>,
    /// Properties: for each its offset in a record, its type and its name.
    properties: Vec<(usize, String, String)>,
}

impl Records {
    fn from_bytes(bytes: &[u8]) -> Self {
        let end = bytes.windows(11).position(|w| w == b"end_header\n").expect("a header") + 11;
        let header = String::from_utf8(bytes[..end].to_vec()).expect("text");
        let (mut properties, mut stride, mut count) = (Vec::new(), 0, 0);
        for line in header.lines() {
            match line.split(' ').collect::<Vec<_>>()[..] {
                ["element", "vertex", n] => count = n.parse().expect("a count"),
                ["property", kind, name] => {
                    properties.push((stride, kind.to_owned(), name.to_owned()));
                    stride += match kind {
                        "uchar" => 1,
                        "float" | "int" => 4,
                        "double" => 8,
                        other => panic!("{other}"),
                    };
                }
                _ => {}
            }
        }
        let vertices = bytes[end..end + count * stride].chunks(stride).map(<[u8]>::to_vec).collect();
        Self { header, vertices, rest: bytes[end + count * stride..].to_vec(), properties }
    }

    fn place(&self, name: &str) -> usize {
        self.properties.iter().find(|(.., n)| n == name).unwrap_or_else(|| panic!("no {name}")).0
    }

    fn ids(&self) -> Vec<u32> {
        let at = self.place("id");
        self.vertices.iter().map(|v| u32::from_le_bytes([v[at], v[at + 1], v[at + 2], v[at + 3]])).collect()
    }

    fn color(&self, vertex: usize) -> [u8; 3] {
        ["red", "green", "blue"].map(|name| self.vertices[vertex][self.place(name)])
    }

    fn position(&self, vertex: usize) -> DVec3 {
        let at = self.place("x");
        let axis = |i: usize| {
            let at = at + 4 * i;
            f64::from(f32::from_le_bytes(self.vertices[vertex][at..at + 4].try_into().expect("four")))
        };
        DVec3::new(axis(0), axis(1), axis(2))
    }

    /// The file, without faces, with the ids as another type and by another name.
    fn bytes(&self, kind: &str, name: &str) -> Vec<u8> {
        let at = self.place("id");
        let head = self.header.split("element face").next().expect("a header");
        let head =
            head.replace("property int id", &format!("property {kind} {name}")).replace("end_header\n", "");
        let count = head.lines().find(|l| l.starts_with("element vertex")).expect("a count").to_owned();
        let head = head.replace(&count, &format!("element vertex {}", self.vertices.len()));
        let mut bytes = (head + "end_header\n").into_bytes();
        for (vertex, id) in self.vertices.iter().zip(self.ids()) {
            bytes.extend_from_slice(&vertex[..at]);
            match kind {
                "float" => bytes.extend_from_slice(&(id as f32).to_le_bytes()),
                "double" => bytes.extend_from_slice(&f64::from(id).to_le_bytes()),
                _ => bytes.extend_from_slice(&id.to_le_bytes()),
            }
        }
        bytes
    }

    fn shuffle(&mut self) {
        let count = self.vertices.len();
        for i in 0..count {
            self.vertices.swap(i, (i * 7919 + 13) % count);
        }
    }
}

const RECONSTRUCT: &str = "reconstruct m.simod --deformed deformed.ply -o";

/// A coloured model, its samples, and deformed ones.
fn deformed() -> (Workplace, Records) {
    let work = Workplace::new();
    work.write("m.ply", model("uchar"));
    work.simod("sample m.ply -o m.simod --samples 900");
    work.move_samples("m.simod", |p| p + DVec3::new(0.0, 0.002 * p.x * p.x, 0.1 * p.y));
    let records = Records::from_bytes(&work.read("deformed.ply"));
    (work, records)
}

#[test]
fn samples_have_ids_and_the_colours_of_their_model() {
    for (kind, samples) in [("uchar", "900"), ("ushort", "900"), ("float", "900"), ("uchar", "20000")] {
        let work = Workplace::new();
        work.write("m.ply", model(kind));
        work.simod(&format!("sample m.ply -o m.simod --samples {samples}"));
        let samples = Records::from_bytes(&work.read("m.simod/samples.ply"));
        let names: Vec<&str> = samples.properties.iter().map(|(.., name)| name.as_str()).collect();
        assert_eq!(names, ["x", "y", "z", "nx", "ny", "nz", "red", "green", "blue", "id"]);
        assert!(samples.ids().into_iter().eq(0..samples.vertices.len() as u32));
        for i in 0..samples.vertices.len() {
            let (p, [r, g, b]) = (samples.position(i), samples.color(i));
            // A sample stands for a few rows and columns.
            let off = (f64::from(r) - 2.0 * p.x).abs().max((f64::from(g) - 2.0 * p.y).abs());
            assert!(off < 8.0 && b == 7, "{kind}: {p} has {r} {g} {b}");
        }
        // Refined ones keep theirs, and new ones have some.
        work.simod("refine m.simod --box 0,0,-9,40,40,9 --factor 2");
        let refined = Records::from_bytes(&work.read("m.simod/samples.ply"));
        assert!(refined.vertices[..samples.vertices.len()] == samples.vertices[..]);
        for i in samples.vertices.len()..refined.vertices.len() {
            let (p, [r, g, b]) = (refined.position(i), refined.color(i));
            let off = (f64::from(r) - 2.0 * p.x).abs().max((f64::from(g) - 2.0 * p.y).abs());
            assert!(off < 8.0 && b == 7, "{kind}: new, {p} has {r} {g} {b}");
        }
    }
    let work = Workplace::new();
    work.write("m.ply", model(""));
    work.simod("sample m.ply -o m.simod --samples 900");
    let bare = Records::from_bytes(&work.read("m.simod/samples.ply"));
    assert!(!bare.header.contains("red") && bare.header.contains("property int id"));
    work.write("m.ply", model("uchar"));
    work.simod("sample m.ply -o m.simod --samples 900 --skip colors");
    assert!(
        work.read("m.simod/samples.ply")
            == [bare.header.into_bytes(), bare.vertices.concat(), bare.rest].concat()
    );
}

#[test]
fn ids_tell_which_sample_is_which() {
    let (work, mut records) = deformed();
    work.simod(&format!("{RECONSTRUCT} expected.ply"));
    let expected = work.read("expected.ply");
    records.shuffle();
    for (kind, name) in [
        ("uint", "id"),
        ("int", "id"),
        ("float", "ID"),
        ("double", "Id"),
        ("float", "scalar_id"),
        ("float", "scalar_Id"),
    ] {
        work.write("deformed.ply", records.bytes(kind, name));
        work.simod(&format!("{RECONSTRUCT} out.ply"));
        assert!(work.read("out.ply") == expected, "{kind} {name}");
        // A refinement goes on from them, and writes all in their order.
        work.simod("refine m.simod --box 0,0,-99,40,99,99 --factor 2 --deformed deformed.ply -o more.ply --into n.simod");
        let more = Records::from_bytes(&work.read("more.ply"));
        assert!(more.ids().into_iter().eq(0..more.vertices.len() as u32));
        work.simod("reconstruct n.simod --deformed more.ply -o more-out.ply");
        let (out, was) = (work.ply("more-out.ply").positions(), work.ply("expected.ply").positions());
        assert!(out.iter().zip(&was).all(|(p, q)| p.distance(*q) < 0.1));
    }
    // Without ids the order counts, as ever.
    work.write("deformed.ply", records.bytes("uint", "other"));
    work.simod(&format!("{RECONSTRUCT} out.ply"));
    assert!(work.read("out.ply") != expected);
}

#[test]
fn samples_that_do_not_come_back_are_named() {
    let (work, records) = deformed();
    let all = records.vertices.len();
    let line = &format!("{RECONSTRUCT} out.ply");
    let with = |change: &dyn Fn(&mut Records), kind: &str, name: &str| {
        let mut records =
            Records { vertices: records.vertices.clone(), ..Records::from_bytes(&work.read("deformed.ply")) };
        change(&mut records);
        work.write("broken.ply", records.bytes(kind, name));
        line.replace("deformed.ply", "broken.ply")
    };
    let samples = format!("there are {all} samples");
    let drop = |records: &mut Records| drop(records.vertices.drain(40..47));
    let outcome = work.refuses(&with(&drop, "uint", "id"), &[&samples, "7 are gone", "id 40"]);
    for habit in ["merges", "removes unreferenced", "splits"] {
        assert!(outcome.hint().contains(habit), "{}", outcome.hint());
    }
    let double =
        |records: &mut Records| (3..6).for_each(|i| records.vertices.push(records.vertices[i].clone()));
    work.refuses(&with(&double, "float", "id"), &[&samples, "3 have an id that another one has", "id is 3"]);
    let both = |records: &mut Records| records.vertices[9] = records.vertices[8].clone();
    work.refuses(&with(&both, "float", "scalar_id"), &["1 are gone", "id 9", "1 have an id", "id is 8"]);
    for (change, what) in [(&drop as &dyn Fn(&mut Records), "7 are gone"), (&double, "3 are too many")] {
        let outcome = work.refuses(&with(change, "uint", "other"), &[&samples, what]);
        assert!(outcome.hint().contains("merge"));
    }
    let at = records.place("id");
    let wrong =
        |records: &mut Records| records.vertices[5][at..at + 4].copy_from_slice(&70_000u32.to_le_bytes());
    work.refuses(&with(&wrong, "double", "id"), &["the id 70000", "vertex 5", &samples]);
    let mut bytes = records.bytes("float", "id");
    let last = bytes.len() - 4;
    bytes[last..].copy_from_slice(&1.5f32.to_le_bytes());
    work.write("broken.ply", &bytes);
    work.refuses(
        &line.replace("deformed.ply", "broken.ply"),
        &["no whole number", "1.5", &format!("{}", all - 1)],
    );
    bytes[last..].copy_from_slice(&f32::NAN.to_le_bytes());
    work.write("broken.ply", &bytes);
    work.refuses(
        "refine m.simod --box 0,0,0,9,9,9 --factor 2 --deformed broken.ply -o more.ply",
        &["no whole number", "NaN"],
    );
}

/// Folders of former versions, whose samples have no ids.
#[test]
fn samples_without_ids_are_taken_in_their_order() {
    let (work, records) = deformed();
    work.simod(&format!("{RECONSTRUCT} expected.ply"));
    work.write("deformed.ply", records.bytes("uint", "other"));
    work.simod(&format!("{RECONSTRUCT} out.ply"));
    assert!(work.read("out.ply") == work.read("expected.ply"));
}

/// Far from the origin, single precision is half a metre: what did not move stays, and what moves is told to
/// be coarse.
#[test]
fn samples_that_come_back_coarser_stay_where_they_did_not_move() {
    let work = Workplace::new();
    let header = "ply\nformat ascii 1.0\nelement vertex 10000\nproperty double x\nproperty double y\nproperty double z\n";
    let at = |k: usize| {
        let (u, v) = ((k % N) as f64, (k / N) as f64);
        DVec3::new(412_345.678 + 3.1 * u, 5_318_765.432 + 2.9 * v, 500.0 + 5.0 * (u / 20.0).sin())
    };
    let row = |p: DVec3, digits: usize| format!("{:.*} {:.*} {:.*}\n", digits, p.x, digits, p.y, digits, p.z);
    let text: String = (0..N * N).map(|k| row(at(k), 9)).collect();
    work.write("m.ply", format!("{header}end_header\n{text}"));
    work.simod("sample m.ply -o m.simod --samples 800");
    let samples = work.ply("m.simod/samples.ply").positions();
    let write = |kind: &str, to: &dyn Fn(DVec3) -> String| {
        let count = samples.len();
        let mut text = format!("ply\nformat ascii 1.0\nelement vertex {count}\n");
        ["x", "y", "z"].iter().for_each(|name| text += &format!("property {kind} {name}\n"));
        text += "end_header\n";
        samples.iter().for_each(|p| text += &to(*p));
        work.write("deformed.ply", text);
        work.simod(&format!("{RECONSTRUCT} out.ply --json"))
    };
    let same = |kind: &str, to: &dyn Fn(DVec3) -> String| {
        let outcome = write(kind, to);
        assert!(work.read("out.ply") == work.read("m.ply"), "{kind}");
        let notes = outcome.lines("note: ").join("\n");
        assert!(outcome.lines("warning: ").is_empty(), "{}", outcome.stderr);
        notes
    };
    let single = |p: DVec3| format!("{} {} {}\n", p.x as f32, p.y as f32, p.z as f32);
    let notes = same("float", &single);
    assert!(notes.contains("5.0e-1 apart") && notes.contains("double precision"), "{notes}");
    // As a program that writes singles as doubles does, or few decimals, or six digits.
    let outcome = write("double", &|p| row(p.as_vec3().as_dvec3(), 6));
    assert!(outcome.stderr.contains("5.0e-1 apart"), "{}", outcome.stderr);
    let found = work.ply("out.ply").positions();
    assert!(found.iter().enumerate().all(|(k, p)| p.distance(at(k)) < 1e-4));
    assert!(same("double", &|p| row(p, 2)).contains("1.0e-2 apart"));
    let six = |p: DVec3| {
        let number = |x: f64| format!("{:.5e}", x);
        format!("{} {} {}\n", number(p.x), number(p.y), number(p.z))
    };
    assert!(same("double", &six).contains("1.0e1 apart"));
    assert_eq!(same("double", &|p| row(p, 9)), "");
    // Vertices move along the given axis alone.
    let outcome = write("float", &|p| single(p + DVec3::new(0.0, 0.0, 7.25)));
    assert!(outcome.stderr.contains("more samples do not help"), "{}", outcome.stderr);
    let found = work.ply("out.ply").positions();
    assert!(found.iter().enumerate().all(|(k, p)| {
        let off = *p - at(k) - DVec3::new(0.0, 0.0, 7.25);
        off.x.abs().max(off.y.abs()) < 1e-6 && off.z.abs() < 1e-3
    }));
}
