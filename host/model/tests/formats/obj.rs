use glam::DVec3;
use proptest::prelude::*;

use super::*;

/// Place of the normals in the file.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Layout {
    None,
    /// `vn` before or behind each `v`.
    Before,
    Behind,
    /// All normals behind all vertices.
    Apart,
    /// Several objects, each with its vertices, normals and faces.
    Objects,
    /// As many normals as vertices, but corners use others than their vertex'.
    Shared,
}
use Layout::{Apart, Before, Behind, None, Objects, Shared};

const LAYOUTS: [Layout; 6] = [None, Before, Behind, Apart, Objects, Shared];

fn vertex(i: usize) -> (String, String) {
    let t = i as f64 * 0.01;
    let v = format!("v {:.6} {:.6} {:.6}", t.sin(), t.cos(), 0.01 * t);
    (v, format!("vn {:.4} {:.4} {:.4}", t.sin(), t.cos(), 0.0))
}

/// A strip of triangles; every third face is a square.
fn faces(text: &mut String, vertices: Range<usize>, layout: Layout, relative: bool, end: &str) {
    let last = vertices.end;
    for i in vertices.start..last.saturating_sub(3) {
        let corners = if i % 3 == 0 { vec![i, i + 1, i + 3, i + 2] } else { vec![i, i + 1, i + 2] };
        let corner = |i: &usize| {
            let number = |i: usize| if relative { i as i64 - last as i64 } else { i as i64 + 1 };
            let normal = if layout == Shared { (i + 1) % last } else { *i };
            match (layout, i % 2) {
                (None, 0) => format!("{}", number(*i)),
                (None, _) => format!("{}/7", number(*i)),
                (_, 0) => format!("{}//{}", number(*i), number(normal)),
                _ => format!("{}/1/{}", number(*i), number(normal)),
            }
        };
        let words: Vec<String> = corners.iter().map(corner).collect();
        *text += &format!("f {}{end}", words.join(" "));
    }
}

fn build(count: usize, layout: Layout, relative: bool, end: &str) -> Vec<u8> {
    let mut text = format!("# by hand{end}mtllib a.mtl{end}o thing{end}vt 0.5 0.5{end}");
    let objects = if layout == Objects { 3 } else { 1 };
    for object in 0..objects {
        let range = count * object / objects..count * (object + 1) / objects;
        text += &format!("g group {object}{end}usemtl m{end}");
        let mut normals = String::new();
        for (v, n) in range.clone().map(vertex) {
            match layout {
                None => text += &format!("{v}{end}"),
                Before => text += &format!("{n}{end}{v}{end}"),
                Behind => text += &format!("{v}{end}{n}{end}"),
                Apart | Objects | Shared => {
                    text += &format!("{v}{end}");
                    normals += &format!("{n}{end}");
                }
            }
        }
        text += &normals;
        text += &format!("s off{end}");
        faces(&mut text, range, layout, relative, end);
    }
    (text + "l 1 2").into_bytes()
}

#[test]
fn all_layouts_are_read_alike() {
    for layout in LAYOUTS {
        for (relative, end) in [(false, "\n"), (true, "\r\n"), (true, "\r")] {
            let bytes = build(5000, layout, relative, end);
            let model = check_whole(&bytes, ".obj");
            let (positions, normals) = read(model.as_ref()).unwrap();
            assert_eq!(positions.len(), 5000, "{layout:?}");
            let has_normals = !matches!(layout, None | Shared);
            assert_eq!(
                (model.info().has_normals, normals.len()),
                (has_normals, if has_normals { 5000 } else { 0 })
            );
            assert!((positions[700] - DVec3::new(7f64.sin(), 7f64.cos(), 0.07)).length() < 1e-6);
            if has_normals {
                assert!((normals[700] - DVec3::new(7f64.sin(), 7f64.cos(), 0.0).as_vec3()).length() < 1e-4);
            }
            let objects = if layout == Objects { 3 } else { 1 };
            let all = triangles(model.as_ref()).unwrap();
            assert_eq!(model.info().faces, 5000 - 3 * objects);
            assert_eq!(all[..4], [[0, 1, 3], [0, 3, 2], [1, 2, 3], [2, 3, 4]], "{layout:?} {relative}");
            assert!(all.iter().flatten().all(|c| *c < 5000));
        }
    }
}

#[test]
fn numbers_of_v_and_vn_change_and_nothing_else() {
    for layout in LAYOUTS {
        let bytes = build(3000, layout, true, "\n");
        let model = open(&bytes, ".obj").unwrap();
        // Vertices that move are turned by a right angle.
        let moves = |p: DVec3| p.x > 0.5;
        let out = rewrite(model.as_ref(), |e| {
            for i in 0..e.positions.len() {
                let p = e.positions[i];
                if moves(p) {
                    e.positions[i] = DVec3::new(p.y, -p.x, p.z);
                    if let Some(n) = e.normals.get_mut(i) {
                        *n = Vec3::new(n.y, -n.x, n.z);
                    }
                }
            }
        });
        let out = String::from_utf8(out.unwrap()).unwrap();
        let text = String::from_utf8(bytes).unwrap();
        assert_eq!(out.lines().count(), text.lines().count());
        let (mut vertices, mut normals) = (0, 0);
        let number = |word: &str| word.parse::<f64>().unwrap();
        for (new, old) in out.lines().zip(text.lines()) {
            let words: Vec<&str> = old.split(' ').collect();
            let index = match words[0] {
                "v" => &mut vertices,
                "vn" => &mut normals,
                _ => {
                    assert_eq!(new, old);
                    continue;
                }
            };
            // Corners with other normals: a normal goes with the vertex before.
            let place = if layout == Shared && words[0] == "vn" { (*index + 2999) % 3000 } else { *index };
            let position = vertex(place).0;
            let moved = moves(DVec3::X * number(position.split(' ').nth(1).unwrap()));
            let decimals = words[1].len() - words[1].find('.').unwrap() - 1;
            let expected = if moved {
                let number = |v: f64| {
                    let word = format!("{v:.decimals$}");
                    if number(&word) == 0.0 { word.replace('-', "") } else { word }
                };
                format!(
                    "{} {} {} {}",
                    words[0],
                    number(self::number(words[2])),
                    number(-self::number(words[1])),
                    words[3]
                )
            } else {
                old.to_string()
            };
            *index += 1;
            assert_eq!(new, expected, "{layout:?}");
        }
    }
}

fn number(word: &str) -> f64 {
    word.parse().unwrap()
}

#[test]
fn a_shared_normal_is_the_mean_of_its_places_where_they_agree() {
    // The first is of two places that agree, the second of two that do not, the third of none, the fourth of
    // one.
    let text = "v 0.000 0 0\nv 1.000 0 0\nv 2.000 0 0\nv 3.000 0 0\nvn 0 0 1.00000\nvn 0 0 1.00000\nvn 0 0 1.00000\n\
        vn 0 0 2.00000\nf 1//1 2//1 3//2\nf 3//2 -1//-3 4//4\n";
    let model = check_whole(text.as_bytes(), ".obj");
    assert!(!model.info().has_normals);
    let edit = |chunk: &VertexChunk, versions: &mut [Edited]| {
        for edited in versions {
            for (normal, p) in edited.normals.iter_mut().zip(&chunk.positions) {
                // By eight degrees for each unit, but by more beyond.
                let angle = (8.0 * p.x + if p.x > 2.5 { 20.0 } else { 0.0 }).to_radians() as f32;
                *normal = normal.length() * Vec3::new(angle.sin(), 0.0, angle.cos());
            }
        }
        Ok(())
    };
    let notes = Notes::default();
    let mut out = Vec::new();
    model.rewrite(&mut [&mut out], Rewriting::default(), &edit, &notes).unwrap();
    let expected = text
        .replacen("vn 0 0 1.00000", "vn 0.0697565 0 0.99756", 1)
        .replace("vn 0 0 2.00000", "vn 1.3893167 0 1.43868");
    let near = |a: &str, b: &str| match (a.parse::<f64>(), b.parse::<f64>()) {
        (Ok(a), Ok(b)) => (a - b).abs() < 2e-5,
        _ => a == b,
    };
    let out = String::from_utf8(out).unwrap();
    assert!(out.split_whitespace().zip(expected.split_whitespace()).all(|(a, b)| near(a, b)), "{out}");
    assert!(out.starts_with("v 0.000 0 0\n") && out.contains("\nvn 0 0 1.00000\nvn 0 0 1.00000\n"));
    let notes = notes.0.into_inner().unwrap();
    // Four positions, and pairs for five corners.
    assert!(
        notes[0].contains("which corners share which normal is written into a temporary file"),
        "{notes:?}"
    );
    assert!(notes[0].contains("which takes 144 bytes, and 48 bytes besides"), "{notes:?}");
    assert_eq!(notes.len(), 2);
    assert!(notes[1].ends_with("turn apart by more than 5\u{b0}: 1 normal kept"), "{notes:?}");
}

/// Notes that the user gets.
#[derive(Default)]
pub struct Notes(pub Mutex<Vec<String>>);

impl simod_model::Progress for Notes {
    fn begin(&self, _: &str, _: u64) {}

    fn advance(&self, _: u64) {}

    fn is_cancelled(&self) -> bool {
        false
    }

    fn note(&self, text: &str) {
        self.0.lock().unwrap().push(text.into());
    }
}

#[test]
fn strange_statements_pass_through() {
    let text = "\u{feff}# a mark before\n v  1.500 2.50\t3.50 0.1 0.2 0.3 # red\r\nv 4.25 5.25 6.25 0.4 0.5 0.6\nV 1 2 3\n\
        v 7.00 \\\n 8.00 9.00 0.7 0.8 0.9\nvp 1 2\nf 1 2 3 # a face\nf \\\r\n-3 -2 \\\n 9\ncurv 0 1 1 2\n#v 1 2 3\n\
        f 1 2\nf 0 1 4294967296 2\ncall other.obj\nf\n";
    let model = check_whole(text.as_bytes(), ".obj");
    let info = model.info();
    assert_eq!((info.vertices, info.faces, info.other_properties.len()), (3, 5, 3));
    let all = triangles(model.as_ref()).unwrap();
    // A corner without a vertex is given as it is, or as a number that no vertex can have.
    assert_eq!(all, [[0, 1, 2], [0, 1, 8], [u32::MAX, 0, u32::MAX], [u32::MAX, u32::MAX, 1]]);
    let mut chunk = VertexChunk::default();
    model.vertices(0..3).unwrap().read(&mut chunk).unwrap();
    let mut colours = vec![Vec::new(); 2];
    model.attributes(&chunk, &mut colours).unwrap();
    assert_eq!(colours, [[0.1, 0.4, 0.7], [0.2, 0.5, 0.8]]);
    let out = rewrite(model.as_ref(), |e| e.positions[2] += DVec3::new(0.0, 0.125, -18.0)).unwrap();
    assert_eq!(String::from_utf8(out).unwrap(), text.replace("8.00 9.00", "8.125 -9.000"));
}

/// A mark of UTF-8 is no part of the first statement, and a comment does not go on, though it ends as a
/// path does.
#[test]
fn the_first_vertex_counts_whatever_stands_before_it() {
    for start in ["\u{feff}", "# C:\\folder\\\n", "\u{feff} \t#\\\r\n"] {
        for faces in ["f 1 2 3\n", "f -3 -2 -1\n", "vn 0 0 1\nvn 0 0 1\nvn 0 0 1\nf 1//1 2//2 3//3\n"] {
            let text = format!("{start}v 1.000000 2 3\nv 4 5 6\nv 7 8 10\n{faces}");
            let model = check_whole(text.as_bytes(), ".obj");
            assert_eq!(model.info().vertices, 3, "{text:?}");
            assert_eq!(triangles(model.as_ref()).unwrap(), [[0, 1, 2]], "{text:?}");
            let out = rewrite(model.as_ref(), |e| e.positions[0].x = 9.0).unwrap();
            assert_eq!(String::from_utf8(out).unwrap(), text.replace("v 1.000000 2 3", "v 9.000000 2 3"));
        }
    }
}

#[test]
fn bytes_of_zero_at_the_end_are_told() {
    let what = message(go_over(b"v 1 2 3\nv 4 5 6\0\0\0", ".obj"));
    assert_eq!(what, "bytes of zero from byte 15 on, as far as the file goes");
    let long = [b"1 2 3\n".to_vec(), vec![0; 1 << 20]].concat();
    assert!(message(go_over(&long, ".xyz")).ends_with(" on, as far as the file goes"));
}

#[test]
fn the_content_tells_what_it_is_if_the_name_does_not() {
    let at = |text: &str, extension: &str| open(text.as_bytes(), extension).map(|m| m.info().format.clone());
    assert_eq!(at("# a\nv 1 2 3\n", ".data").unwrap(), "OBJ");
    assert_eq!(at("mtllib x\nv 1 2 3\n", ".data").unwrap(), "OBJ");
    assert_eq!(at("anything\n", ".obj").unwrap(), "OBJ");
    assert!(at("anything\n", ".data").is_err());
    assert!(at("v for victory\n", ".data").is_err());
}

#[test]
fn what_is_wrong_is_named_with_its_line() {
    let bad = |text: &str| message(go_over(text.as_bytes(), ".obj"));
    assert_eq!(bad("# a\n\nv 1 2 3\nv 1 2\n"), "line 4: vertex 1 has fewer than 3 numbers");
    assert_eq!(bad("# a\n\nv 1 2 3\nv 1 2 x\n# b\n"), "line 4: vertex 1: \"x\" is no number");
    assert_eq!(bad("v 1 2 3\nv 1 2 3\nvn 0 0 1\n\nvn 0 0 z\n"), "line 5: normal 1: \"z\" is no number");
    assert_eq!(bad("v 1 2 3\nf 1 1 x\n"), "line 2: \"x\" is no corner of a face");
    assert_eq!(bad("v 1 2 3\nf 1 1 1.5\n"), "line 2: \"1.5\" is no corner of a face");
    let long = "v 1 2 3\n# ".to_string() + &"x".repeat(17 << 20);
    assert_eq!(bad(&long), "line 2 is longer than 16 MiB");
    let beyond = "is beyond the type double";
    assert_eq!(bad("v 1 2 3\nv -1e999 2 3\n"), format!("line 2: vertex 1: \"-1e999\" {beyond}"));
    assert_eq!(bad("v 1 2 3\nvn 0 0 1e999\n"), format!("line 2: normal 0: \"1e999\" {beyond}"));
    let apart = "v 1 2 3\nv 1 2 3\nvn 0 0 1\nvn 0 1e999 1\n";
    assert_eq!(bad(apart), format!("line 4: normal 1: \"1e999\" {beyond}"));
    go_over(b"v inf nan 0\nv 0 0 0\nvt 1e999 0\n", ".obj").unwrap();
    // Normals of corners are not read to sample a model, and not found wrong only when it is written.
    for word in ["1e999".to_owned(), "-1E+0400".to_owned(), "9".repeat(310)] {
        let shared = format!("v 1 2 3\nv 4 5 6\nvn 0 0 1e-300\n\nvn 0 {word} 1\nf 1//1 2//1 1//1\n");
        let error = open(shared.as_bytes(), ".obj").err().unwrap();
        assert!(error.to_string().contains("line 5: normal 1: \""), "{error}");
        assert!(error.to_string().ends_with(beyond) && error.hint().starts_with("write a normal"), "{error}");
    }
    go_over(b"v 1 2 3\nvn 0 nan 1e+005\nf 1//1 1//1 1//1\n", ".obj").unwrap();
}

#[test]
fn bad_files_are_errors_or_sane() {
    for layout in [Before, Apart, Shared] {
        check_bad(&build(4, layout, layout == Apart, "\n"), ".obj");
    }
}

#[test]
fn a_polygon_of_any_length_is_a_fan() {
    let n = 200_000;
    let mut text = "v 0 0 0\nv 1 0 0\nv 1 1 0\n".to_string() + "f";
    (0..n).for_each(|i| text += &format!(" {}", i % 3 + 1));
    let model = open(text.as_bytes(), ".obj").unwrap();
    let all = triangles(model.as_ref()).unwrap();
    assert_eq!(all.len(), n - 2);
    assert!(all.iter().enumerate().all(|(i, t)| *t == [0, (i as u32 + 1) % 3, (i as u32 + 2) % 3]));
    check_marks(model.as_ref());
}

proptest! {
    #![proptest_config(cases(64))]

    #[test]
    fn any_lines_come_back_as_they_are(
        lines in prop::collection::vec(prop_oneof![
            4 => prop::array::uniform3(any::<f32>()).prop_map(|v| format!("v {:e} {} {}", v[0], v[1], v[2])),
            2 => prop::array::uniform3(-1f32..1.0).prop_map(|v| format!("vn {} {:.3} {}", v[0], v[1], v[2])),
            2 => prop::array::uniform4(-9i64..9).prop_map(|c| format!("f {}//{} {} {} \\\n {}", c[0], c[1], c[2], c[3], c[0])),
            1 => "[ -~]{0,20}".prop_map(|s| format!("#{s}")),
            1 => Just(String::new()),
        ], 0..60),
        end in "\n|\r\n|\r",
        gap in prop_oneof![4 => Just(0usize), 1 => Just(300_000)],
    ) {
        let middle = lines.len() / 2;
        let mut text = lines[..middle].join(&end);
        text += &format!("{end}#{}{end}", " ".repeat(gap));
        text += &lines[middle..].join(&end);
        check_whole(text.as_bytes(), ".obj");
    }
}
