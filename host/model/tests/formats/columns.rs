use glam::DVec3;
use proptest::prelude::*;
use simod_model::open_with_columns;

use super::*;

fn names(model: &dyn Model) -> Vec<String> {
    model.info().attributes.iter().map(|a| a.name.clone()).collect()
}

/// The numbers of all attributes.
fn attributes(model: &dyn Model) -> Vec<Vec<f64>> {
    let mut chunk = VertexChunk::default();
    model.vertices(0..100).unwrap().read(&mut chunk).unwrap();
    let mut values = vec![Vec::new(); model.info().attributes.len()];
    model.attributes(&chunk, &mut values).unwrap();
    values
}

fn positions(text: &str, extension: &str) -> Vec<DVec3> {
    let model = check_whole(text.as_bytes(), extension);
    read(model.as_ref()).unwrap().0
}

#[test]
fn any_separator_and_header_are_understood() {
    let expected = [DVec3::new(1.0, -2.5, 3e2), DVec3::new(4.0, 5.0, 6.0)];
    for (text, extension) in [
        ("1 -2.5 3e2\n4 5 6\n", ".xyz"),
        ("\t1\t-2.5\t3e2\r\n\r\n4 5\t 6", ".txt"),
        ("1,-2.5,3e2\n4, 5 ,6", ".csv"),
        ("1;-2.5;3e2\r4;5;6\r", ".asc"),
        ("x:y:z:t\n1:-2.5:3e2:\n4:5: 6:12\n", ".csv"),
        ("1/-2.5/3e2\n4/5/6\n", ".txt"),
        // Times and dates are no columns.
        ("1 -2.5 3e2 12:30:05\n4 5 6 7:00:00\n", ".xyz"),
        ("day x y z\n2020/01/02 1 -2.5 3e2\n2020/01/03 4 5 6\n", ".txt"),
        ("Points:0 Points:1 Points:2\n1 -2.5 3e2\n4 5 6\n", ".txt"),
        ("X Y Z\n1 -2.5 3e2\n4 5 6\n", ".txt"),
        ("id,\"Y\",\"X [m]\",z (m)\n7,\"-2.5\",1,3e2\n8,5,4,6\n", ".csv"),
        ("// z y x\n3e2 -2.5 1\n6 5 4\n", ".txt"),
        ("# made by hand\n# 1 2 3\n1 -2.5 3e2\n# between\n4 5 6\n", ".xyz"),
        ("easting,northing,height,\"a, b\"\n1,-2.5,3e2,\"q, r\"\n4,5,6,\"\"\n", ".csv"),
        ("\u{feff}1,-2.5,3e2\n4,5,6\n", ".csv"),
        ("\u{feff}y|x|z\n-2.5|1|3e2\n5| 4 |6\n", ".txt"),
        // A line that tells spreadsheets the separator.
        ("sep=;\r\nx;y;z\r\n1;-2.5;3e2\r\n4;5;6\r\n", ".csv"),
        ("\u{feff}SEP=,\n1,-2.5,3e2\n4,5,6\n", ".csv"),
        ("2\n1 -2.5 3e2\n4 5 6\n", ".pts"),
        ("1\n1 -2.5 3e2 9\n1\r\n4 5 6 9\n", ".pts"),
        ("1 -2.5 3e2\n4 5 6\n", ".XYZ"),
        ("name\tx\ty\tz\tn\n\t1\t-2.5\t3e2\t9\na b\t4\t5\t 6 \t\n", ".tsv"),
    ] {
        assert_eq!(positions(text, extension), expected, "{text:?}");
    }
}

#[test]
fn columns_are_named_by_who_knows() {
    let of = |text: &str, extension| {
        let model = open(text.as_bytes(), extension).unwrap();
        (model.info().has_normals, names(model.as_ref()))
    };
    let some = |names: &[&str]| names.iter().map(|n| n.to_string()).collect::<Vec<_>>();
    assert_eq!(of("1 2 3 4 5 6\n", ".xyz"), (false, some(&["column 4", "column 5", "column 6"])));
    assert_eq!(of("1 2 3 0 0 1 9\n", ".xyzn"), (true, some(&["column 7"])));
    assert_eq!(of("1 2 3 4 5 6\n", ".xyzrgb"), (false, some(&["red", "green", "blue"])));
    assert_eq!(of("1\n1 2 3 -7 4 5 6\n", ".pts"), (false, some(&["intensity", "red", "green", "blue"])));
    assert_eq!(of("nx,ny,nz,x,y,z,t\n0,0,1,1,2,3,9\n", ".csv"), (true, some(&["t"])));
    // A name that two columns have is that of the first; what is no number is no attribute.
    let model = open(b"x,y,z,a,a,word\n1,2,3,4,5,six\n7,8,9,1,2,three\n", ".csv").unwrap();
    assert_eq!(names(model.as_ref()), ["a"]);
    assert_eq!(model.info().other_properties, ["a", "a", "word"]);
    assert_eq!(attributes(model.as_ref()), [[4.0, 1.0]]);
    // Columns that nobody reads are told.
    let unread = ["the column \"a\", which is no attribute", "the column \"word\", which is no attribute"];
    assert_eq!(model.besides().unwrap(), unread);
}

/// An empty cell, as pandas writes for a missing number, is no number.
#[test]
fn an_empty_cell_is_no_number() {
    let model = check_whole(b"x,y,z,a,b\n1,2,3,4,\"\"\n5,6,7,,9\n", ".csv");
    assert_eq!(names(model.as_ref()), ["a"]);
    let [a] = &attributes(model.as_ref())[..] else { panic!() };
    assert!(a[0] == 4.0 && a[1].is_nan());
    assert_eq!(model.besides().unwrap(), ["the column \"b\", which is no attribute"]);
    // A separator at the end makes no column.
    for empty in [&b"x;y;z;\n1;2;3;\n"[..], b"x;y;z\n1;2;3;\n", b"1,2,3,\n4,5,6,\n"] {
        assert!(check_whole(empty, ".csv").besides().unwrap().is_empty());
    }
}

#[test]
fn empty_coordinates_are_no_position() {
    // A row of nothing is no header, wherever it stands.
    let rows = "x,y,z,t\n,,,\r\n1,2,3,4\n5,,6,7\n,,,8\n9,1,2,\n7,8,\n";
    for text in [rows.to_owned(), rows[8..].to_owned(), format!(",,,\n{rows}")] {
        let model = check_whole(text.as_bytes(), ".csv");
        let (positions, _) = read(model.as_ref()).unwrap();
        let are_there: Vec<bool> = positions.iter().map(|p| p.is_finite()).collect();
        assert_eq!(are_there, [false, true, false, false, true, false], "{text:?}");
        assert_eq!((positions[1], model.info().attributes.len()), (DVec3::new(1.0, 2.0, 3.0), 1));
        let out = rewrite(model.as_ref(), |e| e.positions[4].z = 2.5).unwrap();
        assert_eq!(String::from_utf8(out).unwrap(), text.replace("9,1,2,", "9,1,2.500000,"));
    }
    let normals = check_whole(b"x;y;z;nx;ny;nz\n1;2;3;;;\n4;5;6;0;0;1\n", ".csv");
    assert!(read(normals.as_ref()).unwrap().1[0].is_nan());
    // A cell that is missing is none that is empty.
    assert_eq!(message(go_over(b"1,2,3\n4,\n", ".csv")), "line 2: vertex 1 has fewer than 3 numbers");
    assert_eq!(message(go_over(b",,,\n", ".csv")), "there is no line of numbers in it");
}

#[test]
fn the_user_may_say_what_columns_are() {
    let mut file = tempfile::Builder::new().suffix(".data").tempfile().unwrap();
    file.write_all(b"9 3 2 1 0 0 1 5\n8 6 5 4 0 1 0 6\n").unwrap();
    let with = |columns| open_with_columns(file.path(), Some(columns));
    let model = with("_,z,y,x,nx,ny,nz,time").unwrap();
    let (positions, normals) = read(model.as_ref()).unwrap();
    assert_eq!(positions, [DVec3::new(1.0, 2.0, 3.0), DVec3::new(4.0, 5.0, 6.0)]);
    assert_eq!((normals[1], names(model.as_ref())), (Vec3::Y, vec!["time".to_string()]));
    assert_eq!(model.columns(), Some("_,z,y,x,nx,ny,nz,time"));
    // Numbers go to their columns, in whatever order these are.
    let out = rewrite(model.as_ref(), |e| e.positions[0] = DVec3::new(-1.0, -2.0, -3.0)).unwrap();
    assert_eq!(
        String::from_utf8(out).unwrap(),
        "9 -3.0000000 -2.0000000 -1.0000000 0 0 1 5\n8 6 5 4 0 1 0 6\n"
    );
    assert_eq!(message(with("x,y")), "no column is z");
    assert!(message(with("x,y,x,z")).ends_with("two columns are x"));
    // Names in the file do not matter then.
    let mut file = tempfile::Builder::new().suffix(".csv").tempfile().unwrap();
    file.write_all(b"x,y,z\n1,2,3\n").unwrap();
    let model = open_with_columns(file.path(), Some("z,y,x")).unwrap();
    assert_eq!(read(model.as_ref()).unwrap().0, [DVec3::new(3.0, 2.0, 1.0)]);
    let mut ply = tempfile::NamedTempFile::new().unwrap();
    ply.write_all(b"ply\n").unwrap();
    assert!(open_with_columns(ply.path(), Some("x,y,z")).is_err());
}

#[test]
fn georeferenced_coordinates_keep_their_digits() {
    let line = |i: usize| {
        format!("{:.3};{:.3};{:.3};{}\r\n", 512_345.678 + i as f64, 5_412_345.678 - i as f64, 101.25, i)
    };
    let text: String = (0..5000).map(line).collect();
    let model = check_whole(text.as_bytes(), ".csv");
    let out = rewrite(model.as_ref(), |e| {
        e.positions.iter_mut().filter(|p| p.x > 514_000.0).for_each(|p| p.z += 0.123_456);
    });
    let out = String::from_utf8(out.unwrap()).unwrap();
    for (i, (new, old)) in out.split_inclusive('\n').zip(text.split_inclusive('\n')).enumerate() {
        let moved = 512_345.678 + i as f64 > 514_000.0;
        assert_eq!(new, if moved { old.replace(";101.250;", ";101.373;") } else { old.to_string() });
    }
}

#[test]
fn what_is_wrong_is_named_with_its_line() {
    let bad = |text: &str, extension| message(go_over(text.as_bytes(), extension));
    assert_eq!(bad("1 2 3\n\n4 5\n", ".xyz"), "line 3: vertex 1 has fewer than 3 numbers");
    assert_eq!(bad("1,2,3\n,4\n", ".csv"), "line 2: vertex 1 has fewer than 3 numbers");
    assert_eq!(bad("1 2 3\n4 5 x\n", ".xyz"), "line 2: vertex 1: \"x\" is no number");
    assert_eq!(bad("# nothing\n", ".xyz"), "there is no line of numbers in it");
    assert_eq!(bad("a,b,c\n1,2,3\n", ".csv"), "line 2: no column is x");
    assert_eq!(bad("one two\n", ".txt"), "line 1: \"one two\" is neither a point nor names of columns");
    assert_eq!(bad("3\n1 2 3\n4 5 6\n", ".pts"), "says that it has 3 points, but it has 2");
    assert_eq!(bad("1\n1 2 3\nmore\n", ".pts"), "line 3: \"more\" is no number of points");
    assert_eq!(bad("1,5;2,5;3,5\n", ".csv"), "there is no line of numbers in it");
    // Text in UTF-16, as some programs of Windows write it, in either byte order.
    let units: Vec<u16> = "\u{feff}x,y,z\n1,2,3\n".encode_utf16().collect();
    for bytes in [u16::to_le_bytes, u16::to_be_bytes].map(|bytes| units.iter().copied().flat_map(bytes)) {
        let utf16 = go_over(&bytes.collect::<Vec<u8>>(), ".csv").unwrap_err();
        assert!(utf16.to_string().ends_with("a text in UTF-16"), "{utf16}");
        assert!(utf16.hint().starts_with("save it as UTF-8"), "{}", utf16.hint());
    }
    // Bytes of zero, as a full disk leaves them.
    assert_eq!(bad("1 2 3\n\n4 5 \0\0\0 6\n7 8 9\n", ".xyz"), "line 3: vertex 1: a byte of zero");
    assert_eq!(bad("1 2 3\n\n\0\0\0\n4 5 6\n", ".xyz"), "line 3: a byte of zero before vertex 1");
    let lines = "1 2 3\r\n".repeat(5000);
    let middle = format!("{lines}4 5\0 6\r\n{lines}");
    assert_eq!(bad(&middle, ".xyz"), "line 5001: vertex 5000: a byte of zero");
    let between = format!("{lines}\0\0\r\n{lines}");
    assert_eq!(bad(&between, ".xyz"), "line 5001: a byte of zero before vertex 5000");
    let long = "1 2 3\n4 5 ".to_string() + &"6".repeat(17 << 20);
    assert_eq!(bad(&long, ".xyz"), "line 2 is longer than 16 MiB");
    let commas = go_over(b"x;y;z\n1,5;2,5;3,5\n", ".csv").unwrap_err();
    assert!(commas.hint().starts_with("write decimals with points"), "{}", commas.hint());
    assert_eq!(bad("1 2 3\n4 1e999 6\n", ".xyz"), "line 2: vertex 1: \"1e999\" is beyond the type double");
    // A coordinate written as infinite or NaN makes a vertex without a position; attributes are not looked
    // at.
    go_over(b"inf 2 3 1e999\n4 nan 6 1e999\n-1.#IND 0 0 1e999\n", ".xyz").unwrap();
}

#[test]
fn bad_files_are_errors_or_sane() {
    check_bad(b"x,y,z,nx,ny,nz,\"a\"\n1,2,3,0,0,1,\"7\"\n\n4,5,6,1,0,0,8\n", ".csv");
    check_bad(b"2\n1.5 2 3 4\n1e2 5 6 4\n", ".pts");
    check_bad(b"# x y z\n1 2 3\n4 5 6\n", ".xyz");
}

proptest! {
    #![proptest_config(cases(64))]

    #[test]
    fn any_numbers_come_back_as_they_are(
        points in prop::collection::vec(prop::array::uniform6(any::<f64>()), 1..50),
        separator in " |\t|,|;|, ",
        end in "\n|\r\n|\r",
        header: bool,
    ) {
        let mut text = if header { ["a", "x", "y", "z", "b", "c"].join(&separator) + &end } else { String::new() };
        for p in &points {
            text += &(p.map(|v| format!("{v:e}")).join(&separator) + &end);
        }
        let model = check_whole(text.as_bytes(), ".csv");
        let first = usize::from(header);
        for (read, written) in read(model.as_ref()).unwrap().0.iter().zip(&points) {
            prop_assert_eq!(read.to_array().map(f64::to_bits), [0, 1, 2].map(|c| written[first + c].to_bits()));
        }
    }
}
