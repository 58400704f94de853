use glam::DVec3;
use proptest::prelude::*;

use super::*;

type Facet = [[f32; 3]; 4];

/// A binary file, each facet's attribute bytes being its number.
fn binary(header: &str, facets: &[Facet], tail: &[u8]) -> Vec<u8> {
    let mut bytes = header.as_bytes().to_vec();
    bytes.resize(80, b' ');
    bytes.extend((facets.len() as u32).to_le_bytes());
    for (i, facet) in facets.iter().enumerate() {
        facet.iter().flatten().for_each(|v| bytes.extend(v.to_le_bytes()));
        bytes.extend((i as u16).to_le_bytes());
    }
    bytes.extend_from_slice(tail);
    bytes
}

fn ascii(facets: &[Facet], end: &str) -> Vec<u8> {
    let mut text = format!("solid a part{end}");
    for [normal, corners @ ..] in facets {
        let numbers = |v: &[f32; 3]| v.map(|v| format!("{v:e}")).join(" ");
        text += &format!("  facet normal {}{end}    outer loop{end}", numbers(normal));
        corners.iter().for_each(|c| text += &format!("      vertex\t{} {end}", numbers(c)));
        text += &format!("    endloop{end}  endfacet{end}");
    }
    (text + &format!("endsolid a part{end}")).into_bytes()
}

/// A bumpy sheet of facets, whose normals are those of its corners.
fn sheet(n: usize) -> Vec<Facet> {
    let at = |i: usize, j: usize| {
        let (u, v) = (i as f32 / n as f32, j as f32 / n as f32);
        [u, v, 0.1 * (7.0 * u).sin() * (5.0 * v).cos()]
    };
    let facet = |a, b, c| [normal([a, b, c]).as_vec3().to_array(), a, b, c];
    let cell = |i, j| {
        let (a, b, c, d) = (at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1));
        [facet(a, b, c), facet(a, c, d)]
    };
    (0..n * n).flat_map(|k| cell(k / n, k % n)).collect()
}

fn normal(corners: [[f32; 3]; 3]) -> DVec3 {
    let [a, b, c] = corners.map(|c| DVec3::from_array(c.map(f64::from)));
    (b - a).cross(c - a).normalize_or_zero()
}

/// The facets of a binary file, and the bytes of their attributes.
fn facets(bytes: &[u8]) -> Vec<(Facet, u16)> {
    let number = |b: &[u8], i: usize| f32::from_le_bytes(b[4 * i..4 * i + 4].try_into().unwrap());
    let facet = |b: &[u8]| {
        let vectors = [0, 1, 2, 3].map(|v| [0, 1, 2].map(|c| number(b, 3 * v + c)));
        (vectors, u16::from_le_bytes([b[48], b[49]]))
    };
    bytes[84..].chunks_exact(50).map(facet).collect()
}

fn bend(p: DVec3) -> DVec3 {
    if p.x > 0.5 { p + DVec3::new(0.0, 0.0, 3.0 * (p.x - 0.5) * (p.x - 0.5)) } else { p }
}

#[test]
fn facets_are_what_was_written() {
    let facets = sheet(20);
    for bytes in
        [binary("a part", &facets, b""), ascii(&facets, "\n"), ascii(&facets, "\r\n"), ascii(&facets, "\r")]
    {
        let model = check_whole(&bytes, ".stl");
        let info = model.info();
        assert_eq!((info.vertices, info.faces, info.has_normals), (2400, 800, false));
        let (positions, _) = read(model.as_ref()).unwrap();
        for (facet, corners) in facets.iter().zip(positions.chunks(3)) {
            let expected = [1, 2, 3].map(|i| DVec3::from_array(facet[i].map(f64::from)).as_vec3());
            assert_eq!(corners.iter().map(|c| c.as_vec3()).collect::<Vec<_>>(), expected);
        }
        let all = triangles(model.as_ref()).unwrap();
        assert_eq!((all.len(), all[799]), (800, [2397, 2398, 2399]));
    }
}

/// Breaks are blanks as others to the format.
#[test]
fn statements_may_stand_in_one_line() {
    let facets = sheet(20);
    let numbers = |model: &dyn Model| read(model).unwrap().0;
    let expected = numbers(open(&ascii(&facets, "\n"), ".stl").unwrap().as_ref());
    let upper = ascii(&facets, "\t").to_ascii_uppercase();
    let divided = String::from_utf8(ascii(&facets, " ")).unwrap().replace("vertex\t", "vertex\n");
    for text in [&ascii(&facets, " "), &upper, divided.as_bytes()] {
        let model = check_whole(text, ".stl");
        assert_eq!((model.info().faces, numbers(model.as_ref())), (800, expected.clone()));
        let up = |p: DVec3| p + DVec3::Z * p.x;
        let out = rewrite(model.as_ref(), |e| e.positions.iter_mut().for_each(|p| *p = up(*p))).unwrap();
        let moved = open(&out, ".stl").unwrap();
        let moved = numbers(moved.as_ref()).into_iter().zip(&expected);
        assert!(moved.into_iter().all(|(new, old)| (new - up(*old)).length() < 1e-5));
        let lines = |text: &[u8]| text.iter().filter(|b| **b == b'\n').count();
        assert_eq!(lines(&out), lines(text));
    }
    let one = "solid facet normal 0 0 1 outer loop vertex 0 0 0 vertex 1 0 0 vertex 0 1 0 endloop endfacet endsolid";
    check_whole(one.as_bytes(), ".stl");
    // Errors are told by their line.
    for (from, to) in [("vertex 1 0 0", ""), ("endloop", "color 1 1 1"), ("1 0 0", "1 0"), ("endsolid", "")] {
        let text = message(go_over(one.replacen(from, to, 1).as_bytes(), ".stl"));
        assert!(text.starts_with("line 1: "), "{text}");
    }
}

#[test]
fn the_content_tells_what_it_is() {
    let facets = sheet(3);
    // The name is nothing to it, nor that a binary header begins as text does.
    for (header, extension) in [("solid of matter", ".stl"), ("solid", ".data"), ("", ".txt")] {
        let model = open(&binary(header, &facets, b""), extension).unwrap();
        assert_eq!(model.info().format, "STL, binary");
    }
    for extension in [".stl", ".data", ".STL"] {
        assert_eq!(open(&ascii(&facets, "\n"), extension).unwrap().info().format, "STL, ascii");
    }
    let marked = [&b"\xef\xbb\xbf"[..], &ascii(&facets, "\n")].concat();
    assert_eq!(check_whole(&marked, ".stl").info().faces, 18);
    // A few bytes more are kept; as many as a facet are a lie, as are fewer.
    check_whole(&binary("solid", &facets, b"\0\r\n"), ".stl");
    let text = message(open(&binary("solid", &facets, &[0; 50]), ".stl"));
    assert_eq!(text, "says 18 facets, which makes 984 bytes of binary STL, but it has 1034");
    let mut lie = binary("solid", &facets, b"");
    lie[83] = 0xff;
    let text = message(open(&lie, ".stl"));
    assert_eq!(text, "says 4278190098 facets, which makes 213909504984 bytes of binary STL, but it has 984");
}

#[test]
fn what_does_not_move_keeps_its_bytes_and_what_moves_gets_its_normal() {
    let rest = sheet(20);
    let bytes = binary("header", &rest, b"end");
    let model = open(&bytes, ".stl").unwrap();
    let out = rewrite(model.as_ref(), |e| e.positions.iter_mut().for_each(|p| *p = bend(*p))).unwrap();
    assert_eq!((out.len(), &out[..84], &out[out.len() - 3..]), (bytes.len(), &bytes[..84], &b"end"[..]));
    let (mut still, mut places) = (0, std::collections::HashMap::new());
    for ((facet, attribute), (old, expected)) in facets(&out).into_iter().zip(facets(&bytes)) {
        assert_eq!(attribute, expected);
        for (now, old) in facet[1..].iter().zip(&old[1..]) {
            // Corners that were equal are equal.
            assert_eq!(*places.entry(old.map(f32::to_bits)).or_insert(*now), *now);
        }
        if old[1..].iter().all(|c| c[0] <= 0.5) {
            assert_eq!(facet, old);
            still += 1;
        } else {
            let expected = normal([facet[1], facet[2], facet[3]]).as_vec3().to_array();
            assert_eq!(facet[0], expected);
        }
    }
    assert_eq!(still, 400);
}

#[test]
fn normals_keep_their_side_and_zeros() {
    let [a, b, c] = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
    let bytes =
        binary("", &[[[0.0, 0.0, -1.0], a, b, c], [[0.0; 3], a, b, c], [[0.0, 0.0, 1.0], a, a, c]], b"");
    let model = open(&bytes, ".stl").unwrap();
    let turned = |p: DVec3| DVec3::new(p.x, p.z, p.y);
    let out = rewrite(model.as_ref(), |e| e.positions.iter_mut().for_each(|p| *p = turned(*p))).unwrap();
    let normals: Vec<[f32; 3]> = facets(&out).iter().map(|f| f.0[0]).collect();
    // The normal of the facet without an area is kept.
    assert_eq!(normals, [[0.0, 1.0, 0.0], [0.0; 3], [0.0, 0.0, 1.0]]);
}

#[test]
fn text_is_kept_but_for_numbers() {
    let text = "solid  Part: 3 facet\n\
        facet normal 0 0 1\nouter loop\n\
        vertex 0.000 0.000 0.000\nvertex 1.000 0.000 0.000 # a word\nvertex 1.000 1.000 0.000\n\
        endloop\nendfacet\n\n\
        FACET NORMAL 0.000000e+00 0.000000e+00 1.000000e+00\r\nOUTER LOOP\r\n\
        VERTEX 2.0E+00 0.0E+00 0.0E+00\nVERTEX 3.0E+00 0 0\nVERTEX 3 1 0\n\
        ENDLOOP\nENDFACET\nendsolid\n solid\n endsolid";
    check_whole(text.as_bytes(), ".stl");
    let model = open(text.as_bytes(), ".stl").unwrap();
    let up = |p: DVec3| if p.x >= 2.0 { p + DVec3::Z * (p.x - 2.0) } else { p };
    let out = rewrite(model.as_ref(), |e| e.positions.iter_mut().for_each(|p| *p = up(*p))).unwrap();
    let expected = text
        .replace("3.0E+00 0 0", "3.0E+00 0 1.000")
        .replace("VERTEX 3 1 0", "VERTEX 3 1 1.000")
        .replace("0.000000e+00 0.000000e+00 1.000000e+00", "-7.071068e-01 0.000000e+00 7.071068e-01");
    assert_eq!(String::from_utf8(out).unwrap(), expected);
}

#[test]
fn what_is_wrong_is_named_with_its_line() {
    let good = "solid\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\nendsolid\n";
    check_whole(good.as_bytes(), ".stl");
    let bad = |from: &str, to: &str| message(go_over(good.replacen(from, to, 1).as_bytes(), ".stl"));
    assert_eq!(bad("vertex 1 0 0", "vertex 1 0"), "line 5: vertex 1 has fewer than 3 numbers");
    assert_eq!(bad("vertex 1 0 0", "vertex 1 x 0"), "line 5: vertex 1: \"x\" is no number");
    assert_eq!(bad("vertex 1 0 0\n", ""), "line 7: \"endfacet\" after 1 facets and 2 corners");
    assert_eq!(bad("endloop", "vertex 1 1 1"), "line 7: \"vertex 1 1 1\" after 1 facets and 4 corners");
    assert_eq!(bad("endloop", "color 1 1 1"), "line 7: \"color 1 1 1\" is nothing of STL");
    assert_eq!(bad("endsolid\n", ""), "line 8: the file ends before endsolid");
    assert_eq!(bad("facet normal 0 0 1\n", ""), "line 3: \"vertex 0 0 0\" after 0 facets and 1 corners");
    let far = bad("vertex 1 0 0\n", &("\n".repeat(300_000) + "vertex 1 0 0\n"));
    assert!(far.starts_with("line 300005: more than 256 KiB lie between"), "{far}");
    // A number that is not finite is left as it is.
    go_over(good.replace("vertex 1 0 0", "vertex inf nan 0").as_bytes(), ".stl").unwrap();
    go_over(good.replace("normal 0 0 1", "normal nan inf none").as_bytes(), ".stl").unwrap();
    let beyond = "\"1e999\" is beyond the type double";
    assert_eq!(bad("vertex 1 0 0", "vertex 1 1e999 0"), format!("line 5: vertex 1: {beyond}"));
    assert_eq!(bad("normal 0 0 1", "normal 0 0 1e999"), format!("line 2: the normal of a facet: {beyond}"));
}

#[test]
fn bad_files_are_errors_or_sane() {
    check_bad(&binary("solid", &sheet(1), b""), ".stl");
    check_bad(&ascii(&sheet(1), "\n"), ".stl");
    let whole = binary("", &sheet(2), b"");
    for end in 1..whole.len() {
        assert!(go_over(&whole[..end], ".stl").is_err(), "{end}");
    }
    let whole = ascii(&sheet(2), "\n");
    for end in 1..whole.len() - 1 {
        // The solid's name may be shorter.
        assert!(go_over(&whole[..end], ".stl").is_err() || end >= whole.len() - 8, "{end}");
    }
}

fn vectors() -> impl Strategy<Value = Facet> {
    let number = prop_oneof![-1e3f32..1e3, Just(0.0), Just(-0.0), any::<f32>()];
    prop::array::uniform4(prop::array::uniform3(number))
}

proptest! {
    #[test]
    fn any_facets_come_back_as_they_are(facets in prop::collection::vec(vectors(), 0..40), end in "\n|\r\n") {
        let written = binary("any", &facets, b"");
        go_over(&written, ".stl").unwrap();
        let text = ascii(&facets, &end);
        go_over(&text, ".stl").unwrap();
        let bits = |model: &dyn Model| -> Vec<_> {
            let (positions, _) = read(model).unwrap();
            positions.iter().map(|p| p.as_vec3().to_array().map(|v| if v.is_nan() { 1 } else { v.to_bits() })).collect()
        };
        let (binary, text) = (open(&written, ".stl").unwrap(), open(&text, ".stl").unwrap());
        prop_assert_eq!(bits(binary.as_ref()), bits(text.as_ref()));
    }
}
