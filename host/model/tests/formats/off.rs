use proptest::prelude::*;

use super::*;

const CUBE: &str = "OFF # a comment\n8 6 12\n# vertices\n0.000 0.000 0.000\n1.000 0.000 0.000\n1.000 1.000 0.000\n\
    0.000 1.000 0.000\n\n0.000 0.000 1.000 # one\n1.000 0.000 1.000\n1.000 1.000 1.000\n0.000 1.000 1.000\n4 0 3 2 1\n\
    4  4 5 6 7 255 0 0\n# a face\n4 0 1 5 4\n4 1 2 6 5\r\n3 2 3 7\n2 7 6\nand more\n";

#[test]
fn faces_are_fans_and_all_else_is_kept() {
    let model = check_whole(CUBE.as_bytes(), ".off");
    let info = model.info();
    assert_eq!((info.format.as_str(), info.vertices, info.faces), ("OFF", 8, 6));
    let all = triangles(model.as_ref()).unwrap();
    assert_eq!(all[..4], [[0, 3, 2], [0, 2, 1], [4, 5, 6], [4, 6, 7]]);
    assert_eq!(all.len(), 9);
    let out = rewrite(model.as_ref(), |e| e.positions[4].z = 1.25).unwrap();
    assert_eq!(String::from_utf8(out).unwrap(), CUBE.replace("1.000 # one", "1.250 # one"));
}

#[test]
fn letters_say_what_vertices_have() {
    let of = |letters: &str, numbers: &str| {
        let text = format!("{letters}\n2 0 0\n{numbers}\n{numbers}\n");
        let model = check_whole(text.as_bytes(), ".data");
        let names: Vec<String> = model.info().attributes.iter().map(|a| a.name.clone()).collect();
        (model.info().format.clone(), read(model.as_ref()).unwrap().1.len(), names.join(" "))
    };
    let is = |format: &str, normals, names: &str| (format.to_string(), normals, names.to_string());
    assert_eq!(of("OFF", "1 2 3"), is("OFF", 0, ""));
    assert_eq!(of("OFF", "1 2 3 4 5 6"), is("OFF", 0, "red green blue"));
    assert_eq!(of("NOFF", "1 2 3 0 0 1"), is("NOFF", 2, ""));
    assert_eq!(of("COFF", "1 2 3 255 0 0 255"), is("COFF", 0, "red green blue alpha"));
    assert_eq!(of("CNOFF", "1 2 3 0 0 1 0.5 0.5 0.5"), is("CNOFF", 2, "red green blue"));
    assert_eq!(of("STOFF", "1 2 3 0.5 0.25"), is("STOFF", 0, "s t"));
    // The letters as MeshLab has them.
    assert_eq!(of("CSTOFF", "1 2 3 9 8 7 6 0.5 0.25"), is("STCOFF", 0, "red green blue alpha s t"));
    assert_eq!(of("STCNOFF", "1 2 3 0 0 1 9 8 7 6 0.5 0.25"), is("STCNOFF", 2, "red green blue alpha s t"));
}

/// Colours come before normals, in letters and numbers, as MeshLab writes them.
#[test]
fn colours_may_come_before_normals() {
    let lines = "1 2 3 3 0 99 255 0 0 1\n4 2 3 255 9 8 255 0.6 0 0.8\n";
    let model = check_whole(format!("NCOFF\n2 0 0\n{lines}").as_bytes(), ".off");
    assert_eq!(model.info().format, "NCOFF");
    let (_, normals) = read(model.as_ref()).unwrap();
    assert_eq!(normals, [Vec3::Z, Vec3::new(0.6, 0.0, 0.8)]);
    // The attributes are unknown also where a vertex has a place in a table of colours.
    let by_index = check_whole(b"NCOFF\n2 0 0\n1 2 3 7 0 0 1\n4 2 3 8 0.6 0 0.8\n", ".off");
    assert_eq!(read(by_index.as_ref()).unwrap().1, normals);
    assert!(by_index.info().attributes.is_empty());
    let names: Vec<&str> = model.info().attributes.iter().map(|a| a.name.as_str()).collect();
    assert_eq!(names, ["red", "green", "blue", "alpha"]);
    assert!(model.info().attributes.iter().all(|a| a.kind == simod_model::Type::U8));
    simod_model::for_vertices(model.as_ref(), |chunk| {
        let mut numbers = vec![Vec::new(); 4];
        model.attributes(chunk, &mut numbers)?;
        assert_eq!(numbers, [[3.0, 255.0], [0.0, 9.0], [99.0, 8.0], [255.0, 255.0]]);
        Ok(())
    })
    .unwrap();
    let out = rewrite(model.as_ref(), |e| {
        e.positions[0].x = 1.5;
        e.normals[0] = Vec3::X;
    })
    .unwrap();
    let expected = lines.replace("1 2 3 3 0 99 255 0 0 1", "1.5000000 2 3 3 0 99 255 1.0000000 0 0.0000000");
    assert_eq!(String::from_utf8(out).unwrap(), format!("NCOFF\n2 0 0\n{expected}"));
}

#[test]
fn whole_numbers_of_colours_are_bytes() {
    use simod_model::Type::{F64, U8};
    let of = |letters: &str, lines: [&str; 2]| -> Vec<simod_model::Type> {
        let text = format!("{letters}\n2 0 0\n{}\n{} # 1.5\n", lines[0], lines[1]);
        let model = check_whole(text.as_bytes(), ".off");
        model.info().attributes.iter().map(|a| a.kind).collect()
    };
    assert_eq!(of("COFF", ["1 2 3 1 0 0 1", "1 2 3 0 255 9 1"]), [U8; 4]);
    assert_eq!(of("STCOFF", ["1 2 3 1 0 2 0.5 1", "1 2 3 0 255 9 1 0"]), [U8, U8, U8, F64, F64]);
    // Fractions: none is more than 1, or one is no whole number; and no byte.
    assert_eq!(of("COFF", ["1 2 3 1 0 0 1", "1 2 3 0 1 1 1"]), [F64; 4]);
    assert_eq!(of("COFF", ["1 2 3 9 0 0", "1 2 3 0 1 0.5"]), [F64; 3]);
    assert_eq!(of("COFF", ["1 2 3 9 0 0", "1 2 3 0 1 256"]), [F64; 3]);
}

/// The first word is glued to the counts or left out, as Geomview allows it, and ModelNet has it.
#[test]
fn the_first_word_may_be_glued_or_left_out() {
    let rest = " 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n";
    for start in ["OFF3", "3", "# by hand\n3", "OFF # by hand\n3", "\u{feff}OFF\n3"] {
        let text = format!("{start}{rest}");
        let model = check_whole(text.as_bytes(), ".off");
        assert_eq!(
            (model.info().vertices, triangles(model.as_ref()).unwrap()),
            (3, vec![[0, 1, 2]]),
            "{start}"
        );
    }
    for counts in ["3\n1\n0\n", "3 1\n\n0 # edges\n", "3\n1 0\n", "3 # vertices\n1\n"] {
        let text = format!("OFF\n{counts}{}", &rest[5..]);
        let model = check_whole(text.as_bytes(), ".data");
        assert_eq!((model.info().vertices, model.info().faces), (3, 1), "{counts:?}");
        assert_eq!(read(model.as_ref()).unwrap().0[1], DVec3::X, "{counts:?}");
    }
    let model = check_whole(format!("COFF3{}", rest.replace("0\n", "0 9 9 9 9\n")).as_bytes(), ".off");
    assert_eq!(model.info().attributes.len(), 4);
    assert_eq!(
        message(go_over(format!("off 3{rest}").as_bytes(), ".off")),
        "line 1: \"off\" is neither OFF nor a count"
    );
}

#[test]
fn colours_of_faces_are_told() {
    let text = "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2 255 0 0 # red\n";
    assert_eq!(check_whole(text.as_bytes(), ".off").besides().unwrap(), ["the colours of faces"]);
    let text = text.replace("255 0 0", "");
    assert!(check_whole(text.as_bytes(), ".off").besides().unwrap().is_empty());
}

#[test]
fn what_is_wrong_is_named() {
    let bad = |text: &str| message(go_over(text.as_bytes(), ".off"));
    assert_eq!(
        bad("4OFF\n1 0 0\n0 0 0 1\n"),
        "line 1: \"4OFF\" has vertices of another dimension than three"
    );
    assert_eq!(bad("nOFF\n3 1 0 0\n"), "line 1: \"nOFF\" has vertices of another dimension than three");
    assert_eq!(bad("CCOFF\n1 0 0\n0 0 0\n"), "line 1: \"CCOFF\" is neither OFF nor a count");
    assert_eq!(bad("OFF BINARY\n\0\0\0\x01"), "line 1: binary OFF cannot be read");
    assert_eq!(
        bad("OFF\n2 1 0\n0 0 0\n1 1 1\n"),
        "says 2 vertices and 1 faces, but it has 2 and 0 lines of them"
    );
    assert_eq!(
        bad("OFF\n99999999999999999999 1 0\n0 0 0\n").split(" but").next(),
        Some("says 9223372036854775807 vertices and 1 faces,")
    );
    assert_eq!(bad("OFF\n2 -1 0\n0 0 0\n"), "line 2: \"-1\" is no count");
    assert_eq!(bad("OFF\n2"), "the file ends before the counts of vertices and faces");
    assert_eq!(bad("OFF\n1 1 0\n0 0 0\n3 0 0\n"), "line 4: a face has fewer corners than it says");
    assert_eq!(bad("OFF\n1 1 0\n0 0 0\n-3 0 0\n"), "line 4: a face of -3 corners");
    assert_eq!(bad("OFF\n1 1 0\n0 0 0\n3 0 0.5 0\n"), "line 4: \"0.5\" is no whole number");
    assert_eq!(bad("OFF\n2 0 0\n0 0\n1 1 1\n"), "line 3: vertex 0 has fewer than 3 numbers");
    let one = "0 ".repeat(30);
    assert_eq!(bad(&format!("OFF\n10 0 0\n{one}\n")), "line 3: 30 numbers in the line of a vertex");
    // Corners are not checked here.
    go_over(b"OFF 1 1 0\n0 0 0\n3 0 7 -9\n", ".off").unwrap();
}

#[test]
fn bad_files_are_errors_or_sane() {
    check_bad(CUBE.as_bytes(), ".off");
    let end = CUBE.find("and more").unwrap();
    for end in 1..end - 3 {
        assert!(go_over(&CUBE.as_bytes()[..end], ".off").is_err(), "{end}");
    }
    check_bad(b"CNOFF\n1 1 0\n1 2 3 0 0 1 9 9 9\n3 0 0 0\n", ".off");
}

proptest! {
    #![proptest_config(cases(64))]

    #[test]
    fn any_mesh_comes_back_as_it_is(
        points in prop::collection::vec(prop::array::uniform3(any::<f64>()), 0..50),
        faces in prop::collection::vec(prop::collection::vec(0u32..60, 0..7), 0..50),
        end in "\n|\r\n|\r",
    ) {
        let mut text = format!("OFF{end}{} {} 0{end}", points.len(), faces.len());
        points.iter().for_each(|p| text += &(p.map(|v| format!("{v:?}")).join(" ") + &end));
        for face in &faces {
            let corners: String = face.iter().map(|c| format!(" {c}")).collect();
            text += &format!("{}{corners}{end}", face.len());
        }
        let model = check_whole(text.as_bytes(), ".off");
        for (read, written) in read(model.as_ref()).unwrap().0.iter().zip(&points) {
            prop_assert_eq!(read.to_array().map(f64::to_bits), written.map(f64::to_bits));
        }
        let fans: Vec<[u32; 3]> =
            faces.iter().flat_map(|f| (2..f.len()).map(|i| [f[0], f[i - 1], f[i]])).collect();
        prop_assert_eq!(triangles(model.as_ref()).unwrap(), fans);
    }
}
