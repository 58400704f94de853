use glam::DVec3;
use proptest::prelude::*;
use simod_model::{Rewriting, progress::Silent};

use super::*;

/// x, y, z, a colour, a time of 64 bits, three numbers, and the normal.
const HEADER: &str = "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\n\
    FIELDS x y z rgb time fpfh normal_x normal_y normal_z\nSIZE 4 4 4 4 8 2 4 4 4\nTYPE F F F F U I F F F\n\
    COUNT 1 1 1 1 1 3 1 1 1\nWIDTH 2\nHEIGHT 3\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 6\n";

fn position(i: usize) -> [f32; 3] {
    if i == 3 { [f32::NAN; 3] } else { [i as f32 * 0.25, 1.5, -(i as f32)] }
}

fn ascii() -> Vec<u8> {
    let point = |i: usize| {
        let [x, y, z] = position(i);
        format!("{x} {y} {z} 4.8e-38 {} 1 2 3 0 0.6 0.8\n", i as u64 * 1_600_000_000_000)
    };
    (HEADER.to_string() + "DATA ascii\n" + &(0..6).map(point).collect::<String>()).into_bytes()
}

/// The fields of each point.
fn fields(i: usize) -> Vec<Vec<u8>> {
    let float = |v: f32| v.to_le_bytes().to_vec();
    let mut fields: Vec<Vec<u8>> = position(i).map(float).to_vec();
    fields.push(vec![10, 20, i as u8, 0]);
    fields.push((i as u64 * 1_600_000_000_000).to_le_bytes().to_vec());
    fields.push([1i16, 2, 3].iter().flat_map(|v| v.to_le_bytes()).collect());
    fields.extend([0.0, 0.6, 0.8].map(float));
    fields
}

fn binary() -> Vec<u8> {
    let mut bytes = (HEADER.to_string() + "DATA binary\n").into_bytes();
    (0..6).for_each(|i| bytes.extend(fields(i).concat()));
    bytes
}

/// Compresses as LibLZF would be understood: runs of bytes, and copies of the last place where three are
/// the same.
fn lzf(bytes: &[u8]) -> Vec<u8> {
    let (mut packed, mut run, mut at) = (Vec::new(), Vec::new(), 0);
    let put_run = |packed: &mut Vec<u8>, run: &mut Vec<u8>| {
        for part in run.chunks(32) {
            packed.push(part.len() as u8 - 1);
            packed.extend_from_slice(part);
        }
        run.clear();
    };
    while at < bytes.len() {
        let length = |from: usize| {
            (0..264.min(bytes.len() - at)).take_while(|i| bytes[from + i] == bytes[at + i]).count()
        };
        let found = (at.saturating_sub(8192)..at).rev().take(3000).max_by_key(|from| length(*from));
        match found.map(|from| (from, length(from))).filter(|(_, length)| *length >= 3) {
            None => {
                run.push(bytes[at]);
                at += 1;
            }
            Some((from, length)) => {
                put_run(&mut packed, &mut run);
                let (back, short) = (at - from - 1, length - 2);
                packed.push((short.min(7) << 5 | back >> 8) as u8);
                if short >= 7 {
                    packed.push((short - 7) as u8);
                }
                packed.push(back as u8);
                at += length;
            }
        }
    }
    put_run(&mut packed, &mut run);
    packed
}

fn compressed_of(header: &str, points: &[Vec<Vec<u8>>]) -> Vec<u8> {
    let columns: Vec<u8> = (0..points.first().map_or(0, Vec::len))
        .flat_map(|f| points.iter().flat_map(move |p| p[f].clone()))
        .collect();
    let packed = lzf(&columns);
    let mut bytes = (header.to_string() + "DATA binary_compressed\n").into_bytes();
    bytes.extend((packed.len() as u32).to_le_bytes());
    bytes.extend((columns.len() as u32).to_le_bytes());
    bytes.extend(packed);
    bytes
}

fn compressed() -> Vec<u8> {
    compressed_of(HEADER, &(0..6).map(fields).collect::<Vec<_>>())
}

fn check_points(model: &dyn Model) {
    let (positions, normals) = read(model).unwrap();
    for (i, p) in positions.iter().enumerate() {
        let expected = DVec3::from_array(position(i).map(f64::from));
        assert!(*p == expected || (i == 3 && p.is_nan()));
    }
    assert_eq!((positions.len(), normals[5]), (6, Vec3::new(0.0, 0.6, 0.8)));
    let fields = ["F4 rgb", "U8 time", "I2 fpfh (3)"];
    assert_eq!(model.info().other_properties, fields);
}

#[test]
fn any_comment_may_come_first() {
    let text = "# by hand\n".to_owned() + HEADER.split_once('\n').unwrap().1;
    let text = text.replace("VERSION", &("# ".to_owned() + &"long ".repeat(30) + "\nVERSION"));
    let body = String::from_utf8(ascii()).unwrap();
    let text = text + body.strip_prefix(HEADER).unwrap();
    assert_eq!(check_whole(text.as_bytes(), ".pcd").info().vertices, 6);
}

#[test]
fn the_mark_of_utf_8_is_kept() {
    const MARK: &[u8] = b"\xef\xbb\xbf";
    let headless = HEADER.split_once('\n').unwrap().1.split_once('\n').unwrap().1.len();
    for bytes in [ascii(), binary(), binary()[HEADER.len() - headless..].to_vec()] {
        let marked = [MARK, &bytes].concat();
        let model = check_whole(&marked, ".data");
        check_points(model.as_ref());
        let how = Rewriting { normals: simod_model::Normals::Drop, ..Rewriting::default() };
        let mut out = Written::default();
        let keep = |_: &VertexChunk, _: &mut [Edited]| Ok(());
        model.rewrite(&mut [&mut out], how, &keep, &Silent).unwrap();
        assert!(out.0.starts_with(MARK));
        assert!(!open(&out.0, ".data").unwrap().info().has_normals);
    }
    let packed = open(&[MARK, &compressed()].concat(), ".data").unwrap();
    check_points(packed.as_ref());
    assert!(rewrite(packed.as_ref(), |_| {}).unwrap() == [MARK, &binary()].concat());
}

#[test]
fn all_encodings_hold_the_same_points() {
    for (bytes, name) in [(ascii(), "PCD 0.7, ascii"), (binary(), "PCD 0.7, binary")] {
        let model = check_whole(&bytes, ".data");
        assert_eq!(model.info().format, name);
        check_points(model.as_ref());
    }
    let model = open(&compressed(), ".pcd").unwrap();
    assert_eq!(model.info().format, "PCD 0.7, binary_compressed");
    check_points(model.as_ref());
    // The written file is the same, but not compressed.
    assert!(rewrite(model.as_ref(), |_| {}).unwrap() == binary());
}

#[test]
fn colours_are_numbers_of_their_own() {
    let model = open(&binary(), ".pcd").unwrap();
    let names: Vec<&str> = model.info().attributes.iter().map(|a| a.name.as_str()).collect();
    assert_eq!(names, ["blue", "green", "red"]);
    let mut chunk = VertexChunk::default();
    model.vertices(0..6).unwrap().read(&mut chunk).unwrap();
    let mut colours = vec![Vec::new(); 3];
    model.attributes(&chunk, &mut colours).unwrap();
    assert_eq!(colours[2], [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]);
}

#[test]
fn colours_of_text_are_the_bytes_of_a_number() {
    let colours = |text: &str| {
        let model = open(text.as_bytes(), ".pcd").unwrap();
        let names: Vec<String> = model.info().attributes.iter().map(|a| a.name.clone()).collect();
        let mut chunk = VertexChunk::default();
        model.vertices(0..2).unwrap().read(&mut chunk).unwrap();
        let mut colours = vec![Vec::new(); names.len()];
        model.attributes(&chunk, &mut colours).unwrap();
        assert!(rewrite(model.as_ref(), |_| {}).unwrap() == text.as_bytes());
        (names.join(" "), colours)
    };
    let file = |name: &str, kind: &str, values: [&str; 2]| {
        let [a, b] = values;
        format!(
            "VERSION 0.7\nFIELDS x y z {name} i\nSIZE 4 4 4 4 4\nTYPE F F F {kind} F\nCOUNT 1 1 1 1 1\nWIDTH 2\n\
             HEIGHT 1\nPOINTS 2\nDATA ascii\n1 2 3 {a} 0.5\n4 5 6 {b} 0.25\n"
        )
    };
    let bytes = u32::from_le_bytes([30, 20, 10, 0]);
    let as_float = format!("{:e}", f32::from_bits(bytes));
    let expected = vec![vec![30.0, 1.0], vec![20.0, 2.0], vec![10.0, 3.0], vec![0.5, 0.25]];
    let other = u32::from_le_bytes([1, 2, 3, 0]);
    let float = file("rgb", "F", [&as_float, &format!("{:e}", f32::from_bits(other))]);
    assert_eq!(colours(&float), ("blue green red i".to_owned(), expected.clone()));
    let whole = file("rgb", "U", [&bytes.to_string(), &other.to_string()]);
    assert_eq!(colours(&whole), ("blue green red i".to_owned(), expected));
    // Opaque, and what is left of that in text where it was written as float.
    let (names, found) = colours(&file("rgba", "U", ["4278190335", "0"]));
    assert_eq!(
        (names.as_str(), found[0][0], found[3].clone()),
        ("blue green red alpha i", 255.0, vec![255.0, 0.0])
    );
    let (_, found) = colours(&file("rgb", "F", ["nan", "0"]));
    assert_eq!(found[2], [0.0, 0.0]);
}

#[test]
fn what_moves_changes_and_normals_can_be_left_out() {
    let text = String::from_utf8(ascii()).unwrap();
    let model = open(&ascii(), ".pcd").unwrap();
    let out = rewrite(model.as_ref(), |e| {
        e.positions[1].x = 7.125;
        e.normals[1] = Vec3::X;
    });
    assert_eq!(
        String::from_utf8(out.unwrap()).unwrap(),
        text.replacen("0.25 1.5 -1 ", "7.125 1.5 -1 ", 1).replacen(
            "1600000000000 1 2 3 0 0.6 0.8",
            "1600000000000 1 2 3 1 0 0",
            1
        )
    );
    for bytes in [ascii(), binary()] {
        let model = open(&bytes, ".pcd").unwrap();
        let how = Rewriting { normals: Normals::Drop, ..Rewriting::default() };
        let mut out = Vec::new();
        model.rewrite(&mut [&mut out], how, &|_: &VertexChunk, _: &mut [Edited]| Ok(()), &Silent).unwrap();
        let without = check_whole(&out, ".pcd");
        let (positions, normals) = read(without.as_ref()).unwrap();
        assert_eq!((positions[5].z, normals.len()), (-5.0, 0));
        assert!(out.windows(30).any(|w| w == b"FIELDS x y z rgb time fpfh\nSIZ"));
        assert!(out.windows(30).any(|w| w == b"COUNT 1 1 1 1 1 3\nWIDTH 2\nHEIG"[..30].as_ref()));
    }
}

#[test]
fn what_is_wrong_is_named() {
    let bad = |from: &str, to: &str| {
        let text = String::from_utf8(ascii()).unwrap().replacen(from, to, 1);
        message(go_over(text.as_bytes(), ".pcd"))
    };
    assert_eq!(
        bad("POINTS 6", "POINTS 7"),
        "line 11 of the header: says 7 points, but also 6, by width and height"
    );
    assert_eq!(bad("DATA ascii", "DATA text"), "line 11 of the header: unknown DATA \"text\"");
    assert_eq!(
        bad("SIZE 4 4 4 4", "SIZE 4 4 4"),
        "line 11 of the header: 9 fields, but 8 sizes, 9 types and 9 counts"
    );
    assert_eq!(
        bad("TYPE F F F F U", "TYPE F F F F F F"),
        "line 11 of the header: 9 fields, but 9 sizes, 10 types and 9 counts"
    );
    assert_eq!(
        bad("TYPE F F F F U", "TYPE F F F X U"),
        "line 11 of the header: field \"rgb\" has the unknown type \"X\" of 4 bytes"
    );
    assert_eq!(
        bad("1 1 3 1", "1 1 99999999999 1"),
        "line 11 of the header: more than 16384 numbers for each point"
    );
    assert_eq!(bad("FIELDS x", "FIELDS q"), "the vertices have no property x");
    assert_eq!(
        bad("HEIGHT 3\n", "HEIGHT 99\n"),
        "line 11 of the header: says 6 points, but also 198, by width and height"
    );
    assert!(
        bad("HEIGHT 3\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 6", "HEIGHT 9\nPOINTS 18")
            .starts_with("says 18 records")
    );
    let mut lie = compressed();
    let at = HEADER.len() + "DATA binary_compressed\n".len();
    lie[at] = lie[at].wrapping_add(1);
    assert!(message(open(&lie, ".pcd")).contains("compressed points, but only"));
    lie[at + 4] ^= 1;
    assert!(message(open(&lie, ".pcd")).starts_with("says 6 points of"));
}

#[test]
fn bad_files_are_errors_or_sane() {
    check_bad(&ascii(), ".pcd");
    check_bad(&binary(), ".pcd");
    let whole = compressed();
    for end in 1..whole.len() {
        assert!(open(&whole[..end], ".pcd").is_err());
    }
    for at in 0..whole.len() {
        for other in [0, 31, 32, 0xe0, 0xff] {
            let mut bad = whole.clone();
            bad[at] = other;
            if let Ok(model) = open(&bad, ".pcd") {
                let _ = read(model.as_ref());
            }
        }
    }
}

proptest! {
    #![proptest_config(cases(32))]

    #[test]
    fn what_was_compressed_is_unpacked(values in prop::collection::vec((0u8..4, any::<f32>()), 1..3000)) {
        let header = format!("VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH {}\n", values.len());
        let point = |(a, b): &(u8, f32)| [f32::from(*a), *b, 1.0].map(|v| v.to_le_bytes().to_vec()).to_vec();
        let points: Vec<Vec<Vec<u8>>> = values.iter().map(point).collect();
        let model = open(&compressed_of(&header, &points), ".pcd").unwrap();
        let out = rewrite(model.as_ref(), |_| {}).unwrap();
        let expected = [(header + "DATA binary\n").into_bytes(), points.concat().concat()].concat();
        prop_assert!(out == expected);
    }
}
