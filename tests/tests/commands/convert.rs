//! Models written in other formats than their own: what both hold comes back, and what one does not is named
//! before anything is written.

use std::io::Cursor;

use glam::DVec3;
use las::point::Format;
use las::{Builder, Color, Point, Reader, Transform, Vector, Vlr, Writer};
use simod_tests::Workplace;

/// A cloud with all that a point format has, with or without a coordinate reference system.
fn write_cloud(work: &Workplace, name: &str, (minor, format): (u8, u8), with_crs: bool, count: u64) {
    let mut builder = Builder::from((1, minor));
    builder.point_format = Format::new(format).expect("a format");
    builder.point_format.is_compressed = name.ends_with(".laz");
    let [x, y, z] = [412_000.0, 5_318_000.0, 0.0].map(|offset| Transform { scale: 0.001, offset });
    builder.transforms = Vector { x, y, z };
    if with_crs {
        let data = b"PROJCS[\"ETRS89 / UTM zone 32N\"]\0".to_vec();
        let (user_id, description) = ("LASF_Projection".to_owned(), String::new());
        builder.vlrs.push(Vlr { user_id, record_id: 2112, description, data });
    }
    let header = builder.into_header().expect("a header");
    let file = std::fs::File::create(work.path(name)).expect("a file");
    let mut writer = Writer::new(std::io::BufWriter::new(file), header).expect("a writer");
    for i in 0..count {
        let (u, v) = ((i % 300) as f64 / 3.0, (i / 300) as f64 / 3.0);
        let color = Color::new(i as u16, (i / 3) as u16, 65535 - (i % 1000) as u16);
        let point = Point {
            x: 412_345.678 + u,
            y: 5_318_765.432 + v,
            z: 500.0 + (u / 9.0).sin() * 5.0,
            intensity: (i % 4000) as u16,
            return_number: 1 + (i % 3) as u8,
            number_of_returns: 3,
            is_edge_of_flight_line: i % 7 == 0,
            is_withheld: i % 11 == 0,
            scan_angle: (i % 60) as f32 - 30.0,
            user_data: i as u8,
            gps_time: builder_has_time(format).then_some(3e8 + i as f64 * 1e-5),
            color: Some(color).filter(|_| matches!(format, 2 | 3 | 7)),
            point_source_id: (i / 1000) as u16,
            ..Point::default()
        };
        writer.write_point(point).expect("a point");
    }
    writer.close().expect("a file");
}

fn builder_has_time(format: u8) -> bool {
    !matches!(format, 0 | 2)
}

fn points(bytes: Vec<u8>) -> (las::Header, Vec<Point>) {
    let mut reader = Reader::new(Cursor::new(bytes)).expect("a reader");
    let header = reader.header().clone();
    let all = reader.read_all().expect("points");
    let points = all.points().map(|point| point.expect("a point")).collect();
    (header, points)
}

const OBJ: &str = "v 0 0 0\nv 1.25 0 0\nv 0 1 0.125\nv 1 1 0\nf 1 2 3\nf 3 2 4\n";

#[test]
fn a_cloud_comes_back_from_ply_with_its_integers() {
    for format in [(2, 0), (2, 1), (2, 2), (2, 3), (4, 6), (4, 7)] {
        for name in ["a.las", "a.laz"] {
            let work = Workplace::new();
            write_cloud(&work, name, format, false, 120_000);
            let report = work.report(&format!("convert {name} a.ply"));
            assert_eq!(
                (&report["vertices"], report["lost"].as_array().map(Vec::len)),
                (&120_000.into(), Some(0))
            );
            let grid = "--step 0.001 --origin 412000,5318000,0";
            work.simod(&format!("convert a.ply back.laz {grid}"));
            work.simod(&format!("convert a.ply back.las {grid} --threads 1"));
            let (before, old) = points(work.read(name));
            for back in ["back.laz", "back.las"] {
                let (after, new) = points(work.read(back));
                assert!(old == new, "{name} {format:?} {back}");
                assert_eq!(before.point_format().to_u8().ok(), after.point_format().to_u8().ok());
                assert_eq!(before.number_of_points(), after.number_of_points());
                for number in 1..4 {
                    let of = |h: &las::Header| h.number_of_points_by_return(number);
                    assert_eq!(of(&before), of(&after), "{name} {format:?} {back}, return {number}");
                }
                let near = |a: f64, b: f64| (a - b).abs() < 1e-6;
                let [a, b] = [before.bounds(), after.bounds()];
                assert!(near(a.min.x, b.min.x) && near(a.max.z, b.max.z), "{a:?} {b:?}");
            }
            // Another number of threads gives the same bytes.
            let once = work.read("back.laz");
            work.simod(&format!("convert a.ply back.laz {grid} --threads 5"));
            assert!(work.read("back.laz") == once);
        }
    }
}

#[test]
fn las_and_laz_keep_everything() {
    for format in [(2, 1), (2, 3), (4, 6), (4, 7)] {
        let work = Workplace::new();
        write_cloud(&work, "a.las", format, true, 120_000);
        let report = work.report("convert a.las a.laz");
        assert_eq!(report["lost"].as_array().map(Vec::len), Some(0));
        let (las, laz) = (points(work.read("a.las")), points(work.read("a.laz")));
        assert!(las.1 == laz.1);
        assert_eq!(las.0.vlrs().len(), laz.0.vlrs().iter().filter(|v| v.record_id != 22204).count());
        assert!(work.simod("info a.laz").stdout.contains("ETRS89 / UTM zone 32N"));
        work.simod("convert a.laz back.las");
        assert!(work.read("back.las") == work.read("a.las"), "{format:?}");
        // Columns lose the reference system; PLY as text keeps it.
        work.refuses("convert a.laz a.csv", &["the coordinate reference system ETRS89 / UTM zone 32N"]);
        work.simod("convert a.laz a.ply");
        // A deformation on the way: the points that it writes in its own format.
        work.simod("sample a.las -o m.simod --samples 2000");
        work.move_samples("m.simod", |p| p + DVec3::new(0.0, 0.0, 0.01 * (p.x - 412_345.678)));
        for out in ["out.las", "out.laz"] {
            work.simod(&format!("reconstruct m.simod --deformed deformed.ply -o {out}"));
        }
        assert!(points(work.read("out.las")).1 == points(work.read("out.laz")).1);
    }
}

#[test]
fn a_mesh_goes_through_formats() {
    let work = Workplace::new();
    work.write("m.obj", OBJ);
    work.simod("convert m.obj m.ply");
    work.simod("convert m.ply back.obj");
    assert_eq!(String::from_utf8(work.read("back.obj")).expect("text"), OBJ);
    work.simod("convert m.ply m.off");
    let off = "OFF\n4 2 0\n0 0 0\n1.25 0 0\n0 1 0.125\n1 1 0\n3 0 1 2\n3 2 1 3\n";
    assert_eq!(String::from_utf8(work.read("m.off")).expect("text"), off);
    work.refuses("convert m.obj m.stl", &["which corners are one vertex"]);
    let outcome = work.simod("convert m.obj m.stl --lossy");
    assert!(outcome.stderr.contains("what was lost: which corners"), "{}", outcome.stderr);
    assert_eq!(work.read("m.stl").len(), 84 + 2 * 50);
    // Soup is soup in STL, and goes there and back.
    work.simod("convert m.stl soup.ply");
    work.simod("convert soup.ply back.stl");
    assert!(work.read("back.stl") == work.read("m.stl"));
    work.simod("convert m.obj m.obj.ply");
    assert!(work.read("m.obj.ply") == work.read("m.ply"));
    work.write("c.csv", "x,y,z,nx,ny,nz,red,heat\n0.5,1,2,0,0,1,255,-3.25\n1,1e-7,3,0,1,0,3,7\n");
    work.simod("convert c.csv c.ply");
    work.simod("convert c.ply back.csv");
    let text = String::from_utf8(work.read("back.csv")).expect("text");
    assert_eq!(text, "x,y,z,nx,ny,nz,red,heat\n0.5,1,2,0,0,1,255,-3.25\n1,1e-7,3,0,1,0,3,7\n");
    work.simod("convert c.ply c.pcd");
    work.simod("convert c.pcd pcd.csv");
    assert!(work.read("pcd.csv") == work.read("back.csv"));
    // Colours of bytes are one number there.
    work.simod("generate -o g.ply --vertices 2000");
    work.simod("convert g.ply g.pcd --lossy");
    work.simod("convert g.pcd g2.ply");
    work.simod("convert g2.ply g2.pcd");
    assert!(work.read("g.pcd") == work.read("g2.pcd"));
    assert!(String::from_utf8_lossy(&work.read("g.pcd")).contains("normal_z rgb\n"));
    work.refuses("convert c.csv c.xyz", &["the normals", "the attribute red (double)", "the attribute heat"]);
}

/// Red, green, blue and alpha behind the positions, as other programs read them.
#[test]
fn colours_go_to_obj_and_off() {
    let work = Workplace::new();
    let header = |numbers: &str| {
        let names = numbers.split(' ').map(|kind_and_name| {
            let (kind, name) = kind_and_name.split_once('_').expect("a type and a name");
            format!("property {kind} {name}\n")
        });
        format!("ply\nformat ascii 1.0\nelement vertex 2\n{}end_header\n", names.collect::<String>())
    };
    let position = "float_x float_y float_z";
    let normal = "float_nx float_ny float_nz";
    let bytes = header(&format!("{position} {normal} uchar_red uchar_green uchar_blue uchar_alpha"));
    work.write("bytes.ply", bytes + "0 0 0 0 0 1 255 0 51 7\n1 2 3 0 1 0 1 2 3 255\n");
    work.simod("convert bytes.ply bytes.off");
    let text = |name: &str| String::from_utf8(work.read(name)).expect("text");
    let off = "CNOFF\n2 0 0\n0 0 0 0 0 1 255 0 51 7\n1 2 3 0 1 0 1 2 3 255\n";
    assert_eq!(text("bytes.off"), off);
    // There and back.
    let report = work.report("convert bytes.off back.ply");
    assert_eq!(report["lost"].as_array().map(Vec::len), Some(0));
    work.simod("convert back.ply again.off");
    assert_eq!(text("again.off"), off);
    let back = String::from_utf8_lossy(&work.read("back.ply")).into_owned();
    assert!(back.contains("property uchar red\n"), "{back}");

    work.refuses("convert bytes.ply bytes.obj", &["would lose: the attribute alpha (uchar)"]);
    work.simod("convert bytes.ply bytes.obj --lossy");
    // Of fractions, and of numbers whose type nobody said, it is looked whether bytes hold them.
    work.simod("convert bytes.obj fractions.off");
    assert_eq!(text("fractions.off"), off.replace(" 7\n", " 255\n"));
    work.write("whole.csv", "x,y,z,red,green,blue\n0,0,0,255,0,51\n1,2,3,1,2,3\n");
    work.simod("convert whole.csv whole.off");
    assert_eq!(text("whole.off"), "COFF\n2 0 0\n0 0 0 255 0 51 255\n1 2 3 1 2 3 255\n");
    work.write("part.csv", "x,y,z,red,green,blue\n0,0,0,255,0,51\n1,2,3,1,2.5,3\n");
    work.refuses("convert part.csv part.off", &["digits of the colours (double), which become bytes"]);
    let obj = "v 0 0 0 1 0 0.2\nvn 0 0 1\nv 1 2 3 0.003921569 0.007843138 0.011764706\nvn 0 1 0\n";
    assert_eq!(text("bytes.obj"), obj);
    work.simod("convert bytes.obj again.obj");
    let numbers =
        |text: String| -> Vec<f32> { text.split_whitespace().filter_map(|w| w.parse().ok()).collect() };
    assert_eq!(numbers(text("again.obj")), numbers(obj.to_owned()));

    let words = header(&format!("{position} ushort_red ushort_green ushort_blue"));
    work.write("words.ply", words + "0 0 0 65535 0 32768\n1 2 3 1 2 3\n");
    work.refuses("convert words.ply words.off", &["digits of the colours (ushort), which become bytes"]);
    work.simod("convert words.ply words.off --lossy");
    assert_eq!(text("words.off"), "COFF\n2 0 0\n0 0 0 255 0 128 255\n1 2 3 0 0 0 255\n");
    work.simod("convert words.ply words.obj");
    assert!(text("words.obj").starts_with("v 0 0 0 1 0 0.5000076\n"), "{}", text("words.obj"));
    // As Open3D reads them.
    work.simod("convert words.ply words.xyzrgb");
    assert!(text("words.xyzrgb").starts_with("0 0 0 1 0 0.5000076\n"), "{}", text("words.xyzrgb"));
}

/// Of 3 to 300 corners, as many as there are in no byte.
#[test]
fn polygons_stay_polygons() {
    let work = Workplace::new();
    let corners = |face: usize| 3 + [0, 1, 0, 297, 2, 9, 14, 1][face % 8];
    // Beyond what is read at a time.
    let faces: Vec<Vec<usize>> =
        (0..4000).map(|face| (0..corners(face)).map(|i| (7 * face + 3 * i) % 1000).collect()).collect();
    let line = |face: &Vec<usize>, more: usize| {
        face.iter().map(|corner| format!(" {}", corner + more)).collect::<String>() + "\n"
    };
    let vertices: String = (0..1000).map(|i| format!("{} {} {}\n", i % 40, i / 40, (i * i) % 7)).collect();
    let of_off: String = faces.iter().map(|face| format!("{}{}", face.len(), line(face, 0))).collect();
    work.write("m.off", format!("OFF\n1000 {} 0\n{vertices}{of_off}", faces.len()));
    for steps in [["m.off", "a.ply", "b.obj", "c.off"], ["m.off", "d.obj", "e.ply", "f.off"]] {
        for pair in steps.windows(2) {
            let report = work.report(&format!("convert {} {}", pair[0], pair[1]));
            assert_eq!(report["lost"].as_array().map(Vec::len), Some(0), "{pair:?}: {report}");
        }
        assert!(work.read(steps[3]) == work.read("m.off"), "{steps:?}");
    }
    let obj = String::from_utf8(work.read("d.obj")).expect("text");
    let of_obj: String = faces.iter().map(|face| format!("f{}", line(face, 1))).collect();
    assert!(obj.ends_with(&of_obj));
    // Without such large faces, their number of corners is a byte, which all programs know.
    work.write("small.off", format!("OFF\n1000 1 0\n{vertices}5 0 1 2 3 4\n"));
    work.simod("convert small.off small.ply");
    let head = String::from_utf8_lossy(&work.read("small.ply")).into_owned();
    assert!(head.contains("element face 1\nproperty list uchar int vertex_indices\n"), "{head}");

    let triangles: usize = faces.iter().map(|face| face.len() - 2).sum();
    let lost = format!("which of the {triangles} triangles are one of 4000 faces");
    work.refuses("convert m.off m.stl", &[&lost]);
    // A face of two corners is no triangle, and would be lost.
    work.write("few.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2\nf 1 2 3\n");
    work.refuses("convert few.obj few.ply", &["would lose: 1 face of fewer than three corners"]);
    // Strips are triangles in other formats.
    let ply = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n\
               element tristrips 1\nproperty list int int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n1 1 0\n4 0 1 2 3\n";
    work.write("strip.ply", ply);
    work.refuses("convert strip.ply strip.obj", &["which of the 2 triangles are one of 1 faces"]);
}

#[test]
fn what_would_be_lost_is_named() {
    let work = Workplace::new();
    let head = "mtllib a.mtl\n# one\n# two\n";
    work.write("rich.obj", format!("{head}{OBJ}vt 0 0\ng left\ns 1\nf 1/1 2/1 4/1 3/1\nf 1 2 9\n"));
    let losses = [
        "1 material statement (mtllib); ",
        "2 comments; ",
        "1 texture coordinate (vt)",
        "1 group statement (g)",
        "1 smoothing group statement (s)",
        "1 triangle with a corner that is no vertex",
    ];
    work.refuses("convert rich.obj rich.ply", &losses);
    let report = work.report("convert rich.obj rich.ply --lossy");
    assert_eq!(
        (&report["triangles"], report["lost"].as_array().map(Vec::len)),
        (&4.into(), Some(losses.len()))
    );
    assert_eq!(work.ply("rich.ply").len(), 4);
    work.simod("convert rich.ply rich.off");
    let off = String::from_utf8(work.read("rich.off")).expect("text");
    assert!(off.ends_with("\n3 0 1 2\n3 2 1 3\n4 0 1 3 2\n"), "{off}");

    let ply = "ply\nformat ascii 1.0\ncomment by hand\nelement vertex 3\nproperty double x\nproperty double y\n\
               property double z\nproperty uchar red\nproperty list uchar int seen_by\nelement face 1\n\
               property list uchar int vertex_indices\nproperty int material\nelement edge 1\nproperty int a\n\
               end_header\n0 0 0 1 0\n0.3333333333333 0 0 2 1 7\n0 1 0 3 0\n3 0 1 2 5\n4\n";
    work.write("rich.ply", ply);
    let of_ply = [
        "1 comment; ",
        "the property list uchar int seen_by of \"vertex\"",
        "the property int material of \"face\"",
        "the element \"edge\"",
    ];
    work.refuses("convert rich.ply out.obj", &[&of_ply[..], &["the attribute red (uchar)"]].concat());
    let outcome =
        work.refuses("convert rich.ply out.laz", &[&of_ply[..], &["1 face; ", "rounded to"]].concat());
    assert!(outcome.hint().contains("--step"), "{}", outcome.hint());
    work.refuses("convert rich.ply out.pcd", &[&of_ply[..], &["1 face"]].concat());
    // To another file of the same format as well.
    work.refuses("convert rich.ply out.ply", &of_ply);
    work.simod("convert rich.ply out.ply --lossy");
    work.simod("convert out.ply again.ply");
    assert!(work.read("out.ply") == work.read("again.ply"));
}

#[test]
fn what_cannot_be_written() {
    let work = Workplace::new();
    work.write("m.obj", OBJ);
    work.write("c.xyz", "0 0 0\n1 2 3\n4 5 6\n");
    let outcome = work.refuses("convert m.obj m.glb", &["m.glb", "cannot be written"]);
    assert!(outcome.hint().contains("ply, las, laz"), "{}", outcome.hint());
    work.refuses("convert m.obj m", &["cannot be written"]);
    work.refuses("convert m.obj m.obj", &["m.obj is read by this command"]);
    work.refuses("convert m.obj missing/m.ply", &["missing"]);
    work.refuses("convert c.xyz c.stl --lossy", &["has no faces"]);
    work.refuses("convert c.xyz c.las --step 0", &["the step between positions is not above 0"]);
    work.refuses(
        "convert c.xyz c.las --step 1e-9 --origin 0,0,0",
        &["vertex 1", "(1, 2, 3)", "the step 0.000000001"],
    );
    work.write("letter.ply", "Dear reader,\n");
    work.refuses("convert m.obj letter.ply", &["letter.ply is there, and is no model"]);
    let nan = "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\n\
               end_header\n0 0 0\nnan 0 1\n";
    work.write("nan.ply", nan);
    work.simod("convert nan.ply out.pcd");
    for out in ["out.las --step 0.1", "out.obj", "out.csv"] {
        work.refuses(&format!("convert nan.ply {out}"), &["vertex 1", "NaN"]);
    }
    // A return that there is no room for.
    work.write("r.csv", "x,y,z,return_number\n0,0,0,9\n0,0,1,31\n");
    work.refuses("convert r.csv r.las --step 1", &["return_number (double)", "whole numbers from 0 to 15"]);
    work.simod("convert r.csv r.las --step 1 --lossy");
    let returns: Vec<u8> = points(work.read("r.las")).1.iter().map(|p| p.return_number).collect();
    assert_eq!(returns, [9, 15]);
    #[cfg(unix)]
    {
        work.simod("generate -o large.ply --vertices 60000");
        work.refuses_beyond(1 << 20, "convert large.ply large.obj", &["large.obj"]);
    }
}

#[test]
fn whole_numbers_that_doubles_do_not_hold_are_a_loss() {
    let work = Workplace::new();
    let text = |id: &str| format!("x,y,z,id,time\n0,0,0,1,0.12345678901234567\n1,0,0,{id},0\n0,1,0,3,0\n");
    for id in ["9007199254740993", "-18446744073709551615"] {
        work.write("wide.csv", text(id));
        let losses = ["wide.ply would lose: digits of \"id\", which has whole numbers beyond 2^53"];
        let outcome = work.refuses("convert wide.csv wide.ply", &losses);
        assert!(outcome.hint().contains("in its own format, .csv"), "{}", outcome.hint());
        work.simod("convert wide.csv lossy.ply --lossy");
    }
    work.write("narrow.csv", text("9007199254740992"));
    work.simod("convert narrow.csv narrow.ply");
}

#[test]
fn numbers_beyond_their_type_give_no_output() {
    let work = Workplace::new();
    work.write("far.xyz", "0 0 0\n1 -1e999 0\n0 1 0\n");
    for line in ["sample far.xyz -o far.simod --samples 2", "convert far.xyz far.ply", "info far.xyz"] {
        work.refuses(line, &["far.xyz: line 2: vertex 1: \"-1e999\" is beyond the type double"]);
    }
    assert!(!work.path("far.simod").exists() && !work.path("far.ply").exists());
}

/// As scanners write what came back from nowhere.
#[test]
fn vertices_without_a_position_are_left_out_where_that_may_be() {
    let work = Workplace::new();
    let head = "ply\nformat ascii 1.0\nelement vertex 120000\nproperty double x\nproperty double y\n\
                property double z\nproperty uchar return_number\n";
    let is_there = |i: usize| i % 7 != 3 && !(50_000..100_000).contains(&i);
    let x = |i: usize| if is_there(i) { i.to_string() } else { "nan".to_owned() };
    let rows: String = (0..120_000).map(|i| format!("{} 1 2 {}\n", x(i), 1 + i % 3)).collect();
    work.write("m.ply", format!("{head}end_header\n{rows}"));
    let there: Vec<usize> = (0..120_000).filter(|i| is_there(*i)).collect();
    for out in ["out.las", "out.laz"] {
        let line = format!("convert m.ply {out} --step 1");
        let outcome = work.refuses(&line, &["vertex 3", "NaN"]);
        assert!(outcome.hint().contains("--lossy"), "{}", outcome.hint());
        let outcome = work.simod(&format!("{line} --lossy"));
        let left_out = format!("{} vertices without a position were left out", 120_000 - there.len());
        assert!(outcome.stderr.contains(&left_out), "{}", outcome.stderr);
        let (header, points) = points(work.read(out));
        assert_eq!(header.number_of_points() as usize, there.len());
        assert_eq!((header.bounds().min.x, header.bounds().max.x), (0.0, 119_999.0));
        let of_return = |n: usize| there.iter().filter(|i| 1 + *i % 3 == n).count() as u64;
        assert_eq!(header.number_of_points_by_return(2), Some(of_return(2)));
        let is_own = |(p, i): (&Point, &usize)| p.x == *i as f64 && usize::from(p.return_number) == 1 + i % 3;
        assert!(points.len() == there.len() && points.iter().zip(&there).all(is_own), "{out}");
    }
    let report = work.report("convert m.ply out.csv --lossy");
    assert_eq!(report["vertices"], there.len());
    let expected: String = there.iter().map(|i| format!("{i},1,2,{}\n", 1 + i % 3)).collect();
    assert!(work.read("out.csv") == format!("x,y,z,return_number\n{expected}").as_bytes());
    work.simod("convert m.ply out.obj --lossy");
    // Not where faces refer to them by their number.
    let face = "element face 1\nproperty list uchar int vertex_indices\n";
    work.write("f.ply", format!("{head}{face}end_header\n{rows}3 0 1 2\n"));
    work.refuses("convert f.ply out.obj --lossy", &["vertex 3"]);
}

fn bend(p: DVec3) -> DVec3 {
    p + DVec3::new(0.0, 0.1 * p.x * p.x, 0.3)
}

/// A deformation comes out the same whatever format it is written in.
#[test]
fn deformed_models_are_written_in_other_formats() {
    let work = Workplace::new();
    work.simod("generate -o m.ply --vertices 150000");
    work.simod("sample m.ply -o m.simod --samples 3000");
    work.move_samples("m.simod", bend);
    let line = "reconstruct m.simod --deformed deformed.ply -o";
    work.simod(&format!("{line} own.ply"));
    // Colours and all.
    work.simod(&format!("{line} out.obj"));
    work.simod("convert out.obj back.ply");
    let (own, back) = (work.ply("own.ply").positions(), work.ply("back.ply").positions());
    assert!(own.len() == back.len() && own.iter().zip(&back).all(|(p, q)| p.distance(*q) < 1e-6));
    let once = work.read("out.obj");
    for threads in [1, 7] {
        work.simod(&format!("{line} out.obj --lossy --threads {threads}"));
        assert!(work.read("out.obj") == once, "{threads} threads");
    }
    work.simod("bind m.simod");
    work.simod(&format!("{line} out.obj --lossy"));
    assert!(work.read("out.obj") == once, "bound");
    // Several at a time, with what becomes of each vertex.
    work.simod("reconstruct m.simod --deformed deformed.ply m.simod/samples.ply -o {}.off --normals drop --lossy --diagnostics d-{}.ply");
    assert!(work.read("samples.off").starts_with(b"COFF\n") && work.ply("d-deformed.ply").len() == own.len());
    work.refuses(
        &format!("{line} out.stl"),
        &["the normals of the vertices", "which corners are one vertex"],
    );
    work.simod(&format!("{line} out.stl --lossy"));
    work.refuses(
        "reconstruct m.simod --deformed deformed.ply m.simod/samples.ply -o {}.stl --lossy",
        &["one at a time"],
    );
    work.refuses(&format!("{line} out.laz"), &["faces", "the normals", "rounded to"]);
    work.simod(&format!("{line} out.laz --lossy"));
    let cloud = points(work.read("out.laz")).1;
    assert!(own.iter().zip(&cloud).all(|(p, q)| p.distance(DVec3::new(q.x, q.y, q.z)) < 1e-6));

    work.write_session("m.ply", 3000, "");
    work.refuses("run edit.toml -o run.laz", &["run.laz", "faces"]);
    work.simod("run edit.toml -o run.obj --measure --lossy");
    work.simod("convert m.ply same.obj --lossy");
    assert!(work.read("run.obj") == work.read("same.obj"));
}

/// Interrupted conversions are gone on with, as in the model's own format.
#[test]
fn conversions_on_the_way_are_resumed() {
    let work = Workplace::new();
    write_cloud(&work, "a.laz", (4, 7), false, 400_000);
    work.simod("sample a.laz -o m.simod --samples 3000");
    work.move_samples("m.simod", |p| p + DVec3::new(0.0, 0.0, 0.01 * (p.x - 412_345.678)));
    for out in ["out.ply", "out.las"] {
        let line = format!("reconstruct m.simod --deformed deformed.ply -o {out} --resume --part-size 64K");
        work.simod(&line);
        let whole = work.read(out);
        std::fs::remove_file(work.path(out)).expect("a file");
        let outcome = work.run_beyond(11 << 20, &line);
        assert_eq!(outcome.code, Some(1), "{}", outcome.stderr);
        let report = work.report(&line);
        assert!(report["resumed_bytes"].as_u64().is_some_and(|bytes| bytes > 1 << 20), "{out}: {report}");
        assert!(work.read(out) == whole, "{out}");
    }
}

/// The error that is told is the first one in the file, whatever the threads were at.
#[test]
fn errors_do_not_depend_on_the_threads() {
    let work = Workplace::new();
    let row = |i: usize| format!("v {} {} 0\n", i % 500, i / 500);
    let mut text: String = (0..400_000).map(row).collect();
    (1..300_000).step_by(7).for_each(|i| text += &format!("f {i} {} {}\n", i + 1, i + 501));
    let [first, second] = [30, 330_000].map(row);
    let broken = text.replacen(&second, "v 1 abc 3\n", 1);
    assert!(broken != text);
    work.write("m.obj", &broken);
    for out in ["o.ply", "o.stl", "o.laz --step 1", "o.csv"] {
        for threads in [1, 2, 8] {
            let line = format!("convert m.obj {out} --lossy --threads {threads}");
            work.refuses(&line, &["line 330001", "vertex 330000", "abc"]);
        }
    }
    work.write("m.obj", broken.replacen(&first, "v 1 xyz 3\n", 1));
    work.refuses("convert m.obj o.stl --lossy --threads 8", &["vertex 30", "xyz"]);
}

#[test]
fn damaged_models_give_no_other_ones() {
    let work = Workplace::new();
    work.write("m.obj", OBJ);
    work.simod("convert m.obj m.ply");
    let whole = work.read("m.ply");
    for cut in [whole.len() - 1, whole.len() - 20, whole.len() / 2, 3, 1] {
        work.write("cut.ply", &whole[..cut]);
        work.refuses("convert cut.ply out.obj", &["cut.ply"]);
    }
}

/// Pieces of a conversion end within facets.
#[test]
fn soups_of_many_facets_are_deformed_into_other_formats() {
    let work = Workplace::new();
    work.simod("generate -o g.ply --vertices 20000");
    work.simod("convert g.ply g.stl --lossy");
    work.simod("sample g.stl -o m.simod --samples 500");
    work.simod("reconstruct m.simod --deformed m.simod/samples.ply -o out.ply");
    work.simod("convert g.stl expected.ply");
    assert!(work.ply("out.ply").len() > 100_000 && work.read("out.ply") == work.read("expected.ply"));
}

/// Vectors in extra bytes turn, and what is said of their reach follows, whether points become compressed,
/// or are no longer, or stay as they are.
#[test]
fn what_follows_turns_between_las_and_laz() {
    let work = Workplace::new();
    let names = ["x", "y", "z", "d_x", "d_y", "d_z"];
    let types = ["double", "double", "double", "float", "float", "float"];
    let mut text = "ply\nformat ascii 1.0\nelement vertex 3000\n".to_owned();
    names.iter().zip(types).for_each(|(name, kind)| text += &format!("property {kind} {name}\n"));
    text += "end_header\n";
    for i in 0..3000 {
        let (u, v) = (f64::from(i % 60) / 60.0, f64::from(i / 60) / 50.0);
        text += &format!("{u} {v} {} {} {} 0\n", 0.1 * (9.0 * u).sin(), (7.0 * v).cos(), (7.0 * v).sin());
    }
    work.write("v.ply", text);
    work.simod("convert v.ply v.las --step 1e-6");
    let mut bytes = work.read("v.las");
    // The descriptions are the only VLR of the file, behind its header and the VLR's own.
    for (axis, description) in bytes[375 + 54..][..3 * 192].chunks_mut(192).enumerate() {
        description[3] = 6;
        let reach = if axis < 2 { [-1.0, 1.0] } else { [0.0, 0.0] };
        description[64..72].copy_from_slice(&f64::to_le_bytes(reach[0]));
        description[88..96].copy_from_slice(&f64::to_le_bytes(reach[1]));
    }
    work.write("v.las", &bytes);
    work.simod("convert v.las v.laz");
    work.simod("sample v.las -o las.simod --samples 300");
    work.simod("sample v.laz -o laz.simod --samples 300");
    let turned = |p: DVec3| DVec3::new(p.x, -p.z, p.y);
    for from in ["las", "laz"] {
        work.move_samples(&format!("{from}.simod"), turned);
        for to in ["las", "laz"] {
            let line = format!("reconstruct {from}.simod --deformed deformed.ply --follow d_=direction");
            work.simod(&format!("{line} -o {from}.{to}"));
        }
        work.simod(&format!("convert {from}.laz {from}-back.las"));
        assert!(work.read(&format!("{from}-back.las")) == work.read(&format!("{from}.las")), "{from}");
    }
    assert!(work.read("las.las") == work.read("laz.las"));
    let out = work.read("las.las");
    let reach = |axis: usize, end: usize| {
        let at = 375 + 54 + 192 * axis + 64 + 24 * end;
        f64::from_le_bytes(out[at..at + 8].try_into().expect("eight bytes"))
    };
    assert!(
        reach(1, 0).abs() < 1e-3 && reach(1, 1).abs() < 1e-3 && reach(2, 0) < -0.99 && reach(2, 1) > 0.99
    );
    work.simod("convert las.las las.csv --lossy");
    let text = String::from_utf8(work.read("las.csv")).expect("text");
    for (i, line) in text.lines().skip(1).enumerate() {
        let numbers: Vec<f64> = line.split(',').map(|word| word.parse().expect("a number")).collect();
        let [.., x, y, z] = numbers[..] else { panic!("{line}") };
        let v = (i / 60) as f64 / 50.0;
        let off = DVec3::new(x, y, z).distance(turned(DVec3::new((7.0 * v).cos(), (7.0 * v).sin(), 0.0)));
        assert!(off < 1e-3, "{line}");
    }
}

/// The coordinate reference system goes through PLY, as a comment.
#[test]
fn a_reference_system_goes_through_ply() {
    let work = Workplace::new();
    write_cloud(&work, "a.las", (4, 6), true, 1000);
    let mut bytes = work.read("a.las");
    let wkt = b"PROJCS[\"ETRS89 / UTM zone 32N\"]";
    let at = bytes.windows(wkt.len()).position(|some| some == wkt).expect("a text");
    bytes[at + wkt.len() - 1] = b',';
    let more = format!("UNIT[\"US survey foot\",0.3048],{}]", "REMARK[\"as long as it may be\"],".repeat(20));
    bytes.splice(at + wkt.len()..at + wkt.len(), more.bytes());
    let length = u16::from_le_bytes([bytes[at - 34], bytes[at - 33]]) + more.len() as u16;
    bytes[at - 34..at - 32].copy_from_slice(&length.to_le_bytes());
    let start = u32::from_le_bytes([bytes[96], bytes[97], bytes[98], bytes[99]]) + more.len() as u32;
    bytes[96..100].copy_from_slice(&start.to_le_bytes());
    work.write("a.las", &bytes);
    work.simod("convert a.las a.ply");
    // No line is longer than other programs read.
    let head = String::from_utf8_lossy(&work.read("a.ply")[..2000]).into_owned();
    assert!(head.lines().take_while(|line| *line != "end_header").all(|line| line.len() < 250), "{head}");
    let check = |name: &str| {
        let report = work.report(&format!("info {name}"));
        assert_eq!(report["crs"], "ETRS89 / UTM zone 32N", "{name}");
        assert_eq!(report["details"][0], "unit: US survey foot", "{name}");
    };
    check("a.las");
    check("a.ply");
    work.simod("convert a.ply b.ply");
    check("b.ply");
    assert!(work.read("a.ply") == work.read("b.ply"));
    // Of all the text, there and back.
    work.simod("convert a.ply back.laz --step 0.001 --origin 412000,5318000,0");
    check("back.laz");
    assert!(points(work.read("a.las")).1 == points(work.read("back.laz")).1);
    let of_crs = |name: &str| {
        let vlrs = points(work.read(name)).0.vlrs().clone();
        vlrs.into_iter().find(|vlr| vlr.record_id == 2112).expect("a reference system").data
    };
    assert!(of_crs("a.las") == of_crs("back.laz"));
    work.refuses(
        "convert a.ply a.pcd",
        &["would lose: the coordinate reference system ETRS89 / UTM zone 32N"],
    );
    for model in ["a.las", "a.ply"] {
        work.simod(&format!("sample {model} -o m.simod --samples 100"));
        check("m.simod");
    }
    std::fs::remove_file(work.path("a.ply")).expect("a file");
    assert!(work.report("info m.simod")["crs"].is_null());
    // A comment on who wrote a file is no loss.
    let outcome = work.run("convert m.simod/samples.ply s.las");
    assert!(!outcome.stderr.contains("comment"), "{}", outcome.stderr);
}

/// Descriptions of extra bytes and of times in LAS go through PLY, and are named where they are lost.
#[test]
fn what_is_said_of_extra_bytes_goes_through_ply() {
    let work = Workplace::new();
    let number =
        |description: &mut [u8], at: usize, bytes: [u8; 8]| description[at..at + 8].copy_from_slice(&bytes);
    // Heights in centimetres above 100, and echoes.
    let mut descriptions = vec![0; 2 * 192];
    let (height, echo) = descriptions.split_at_mut(192);
    (height[2], height[3]) = (4, 1 | 2 | 4 | 8 | 16);
    height[4..13].copy_from_slice(b"height of");
    number(height, 40, (-9999i64).to_le_bytes());
    number(height, 64, (-50i64).to_le_bytes());
    number(height, 88, 949i64.to_le_bytes());
    number(height, 112, 0.01f64.to_le_bytes());
    number(height, 136, 100f64.to_le_bytes());
    height[160..172].copy_from_slice(b"above ground");
    echo[2] = 1;
    echo[4..8].copy_from_slice(b"echo");
    echo[160..169].copy_from_slice(b"amplitude");
    let mut builder = Builder::from((1, 4));
    builder.point_format = Format::new(6).expect("a format");
    builder.point_format.extra_bytes = 3;
    builder.gps_time_type = las::GpsTimeType::Standard;
    let transform = Transform { scale: 0.001, offset: 0.0 };
    builder.transforms = Vector { x: transform, y: transform, z: transform };
    let (user_id, description) = ("LASF_Spec".to_owned(), String::new());
    builder.vlrs.push(Vlr { user_id, record_id: 4, description, data: descriptions.clone() });
    let file = std::fs::File::create(work.path("e.las")).expect("a file");
    let header = builder.into_header().expect("a header");
    let mut writer = Writer::new(std::io::BufWriter::new(file), header).expect("a writer");
    for i in 0..1000i16 {
        let [low, high] = (i - 50).to_le_bytes();
        let (x, y) = (f64::from(i % 40), f64::from(i / 40));
        let (gps_time, extra_bytes) = (Some(2e8 + x), vec![low, high, i as u8]);
        let returns = (1, 1);
        let (return_number, number_of_returns) = returns;
        let point =
            Point { x, y, gps_time, extra_bytes, return_number, number_of_returns, ..Point::default() };
        writer.write_point(point).expect("a point");
    }
    writer.close().expect("a file");

    work.simod("convert e.las e.ply");
    let head = String::from_utf8_lossy(&work.read("e.ply")[..2000]).into_owned();
    for line in [
        "comment gps-time adjusted\n",
        "comment extra-bytes height_of type short scale 0.01 offset 100 no-data -9999 least -50 most 949 \
         name \"height of\" description above ground\n",
        "comment extra-bytes echo description amplitude\n",
        "property double height_of\n",
    ] {
        assert!(head.contains(line), "{line} in {head}");
    }
    work.simod("convert e.ply again.ply");
    assert!(work.read("e.ply") == work.read("again.ply"));
    // Back from PLY, and on another grid without it: also as values that moved to a finer one.
    for line in [
        "e.ply back.las --step 0.001 --origin 0,0,0",
        "e.las back.las --step 0.0001",
        "e.ply back.laz --step 0.001",
    ] {
        work.simod(&format!("convert {line}"));
        let out = line.split(' ').nth(1).expect("a name");
        let ((before, old), (after, new)) = (points(work.read("e.las")), points(work.read(out)));
        assert!(old == new, "{line}");
        assert_eq!(before.gps_time_type(), after.gps_time_type(), "{line}");
        let of = |header: &las::Header| {
            header.vlrs().iter().find(|vlr| vlr.record_id == 4).expect("descriptions").data.clone()
        };
        assert!(of(&before) == of(&after), "{line}");
    }
    let lost =
        ["that GPS times are adjusted standard ones; ", "what LAS says of the extra bytes height of, echo: "];
    let outcome = work.refuses("convert e.las e.csv", &lost);
    assert!(!outcome.stderr.contains("the attribute"), "{}", outcome.stderr);
    work.refuses("convert e.ply e.pcd", &lost);
    // Numbers that the scale does not give are kept instead of it.
    let mut bytes = work.read("e.ply");
    let end = bytes.len() - 1;
    bytes[end - 8..end].copy_from_slice(&100.005f64.to_le_bytes());
    work.write("other.ply", &bytes);
    work.refuses("convert other.ply other.las --step 0.001", &["height of was a short with a scale"]);
    work.simod("convert other.ply other.las --step 0.001 --lossy");
    work.simod("convert other.las other.csv --lossy");
    let text = String::from_utf8(work.read("other.csv")).expect("text");
    assert!(text.trim_end().lines().last().is_some_and(|line| line.contains(",100.005,")), "{text}");
}

/// Descriptions of times are not written for points that have none, and those of an attribute go to that
/// one.
#[test]
fn remarks_go_to_what_they_are_of() {
    let work = Workplace::new();
    let properties = ["x", "y", "z", "h_a", "h_a_2"].map(|name| format!("property double {name}\n")).concat();
    let head = "ply\nformat ascii 1.0\ncomment gps-time adjusted\ncomment extra-bytes h_a description one\n";
    let header = format!("{head}element vertex 2\n{properties}end_header\n");
    work.write("a.ply", format!("{header}0 0 0 1 2\n1 2 3 4 5\n"));
    work.refuses("convert a.ply a.las --step 0.01", &["that GPS times are adjusted standard ones"]);
    work.simod("convert a.ply a.las --step 0.01 --lossy");
    let header = Reader::new(Cursor::new(work.read("a.las"))).expect("LAS").header().clone();
    assert_eq!(header.gps_time_type(), las::GpsTimeType::Week);
    let said = header.vlrs().iter().find(|vlr| vlr.record_id == 4).expect("descriptions").data.clone();
    assert!(said.len() == 2 * 192 && said[160..164] == *b"one\0" && said[192 + 160] == 0);
}

/// However fine the step of LAS is, text has all digits of its positions.
#[test]
fn text_has_the_digits_of_fine_steps() {
    let work = Workplace::new();
    let digits = ["-0.52573111", "0.85065081", "0.00000001"];
    work.write("p.obj", format!("v {}\nv 1.5 1 0\nv -1 0 0.25\n", digits.join(" ")));
    for step in ["1e-8", "0.00000005", "2e-9"] {
        work.simod(&format!("convert p.obj p.las --step {step} --lossy"));
        work.simod("convert p.las p.csv --lossy");
        let text = String::from_utf8(work.read("p.csv")).expect("text");
        let numbers: Vec<f64> = text
            .lines()
            .nth(1)
            .expect("a line")
            .split(',')
            .map(|word| word.parse().expect("a number"))
            .collect();
        let step: f64 = step.parse().expect("a number");
        for (number, digits) in numbers.iter().zip(digits) {
            let expected: f64 = digits.parse().expect("a number");
            assert!((number - expected).abs() <= 0.5 * step + 1e-15, "step {step}: {text}");
        }
    }
    work.simod("convert p.obj p.las --step 1e-8");
    work.simod("convert p.las p.xyz --lossy");
    let text = String::from_utf8(work.read("p.xyz")).expect("text");
    assert_eq!(text.lines().next(), Some("-0.52573111 0.85065081 0.00000001"));
}

/// Losses of positions are told in the model's unit and as a fraction of its diagonal.
#[test]
fn coarser_positions_are_told_as_lengths_and_fractions() {
    let work = Workplace::new();
    write_cloud(&work, "a.las", (4, 6), false, 1000);
    let diagonal = work.report("info a.las")["diagonal"].as_f64().expect("a length");
    let check = |line: &str, step: f64| {
        let report = work.report(line);
        let text = format!(
            "which are rounded to {step} in the model's unit, {:.1e} of the diagonal",
            step / diagonal
        );
        assert!(report["lost"].to_string().contains(&text), "{line}: {report}");
        let near = |a: &serde_json::Value, b: f64| a.as_f64().is_some_and(|a| (a / b - 1.0).abs() < 1e-9);
        assert!(near(&report["rounding"]["step"], step / diagonal), "{line}: {report}");
        assert!(near(&report["rounding"]["lengths"]["step"], step), "{line}: {report}");
    };
    // A step that is asked for needs no other word.
    check("convert a.las b.las --step 0.01", 0.01);
    check("convert a.las b.laz --origin 412000.00000003,5318000,0 --lossy", 1e-6);
    work.refuses(
        "convert a.las b.laz --origin 412000.00000003,5318000,0",
        &["would lose: digits of the positions"],
    );
    for line in ["convert a.las b.las --step 0.0005", "convert a.las b.las --origin 412000,5318000,0"] {
        let report = work.report(line);
        assert!(
            report["lost"].as_array().is_some_and(Vec::is_empty) && report["rounding"].is_null(),
            "{report}"
        );
    }
    // Tiles have one line, of the coarsest.
    write_cloud(&work, "t-1.las", (4, 6), false, 100);
    write_cloud(&work, "t-2.las", (4, 6), false, 2000);
    let report = work.report("convert t-*.las out --to las --step 0.01");
    assert_eq!(report["lost"].as_array().map(Vec::len), Some(1), "{report}");
    // Singles far from the origin are as far apart as this.
    let far = "v 412000 5318000.1 1\nv 412001 5318000 0\nv 412000 5318001 0\nf 1 2 3\n";
    work.write("far.obj", far);
    work.refuses(
        "convert far.obj far.stl",
        &["which are rounded to 0.5 in the model's unit, 2.9e-1 of the diagonal"],
    );
    work.write("near.obj", far.replace(".1", ""));
    work.simod("convert near.obj near.stl");
}

/// Numbers that LAS has places for are no loss, whatever type a text gives them.
#[test]
fn what_las_holds_of_a_text_needs_no_word() {
    let work = Workplace::new();
    let text = |intensity: &str, x: &str| {
        format!(
            "x,y,z,intensity,classification\n{x},5318765.432,5.1,{intensity},2\n412346.789,5318766,6,65535,31\n"
        )
    };
    work.write("c.csv", text("17", "412345.678"));
    let report = work.report("convert c.csv c.las");
    assert_eq!(report["lost"].as_array().map(Vec::len), Some(0), "{report}");
    let found = points(work.read("c.las")).1;
    assert_eq!((found[0].intensity, found[1].intensity, u8::from(found[1].classification)), (17, 65535, 31));
    let off = DVec3::new(found[0].x - 412_345.678, found[0].y - 5_318_765.432, found[1].x - 412_346.789);
    // By a unit in the last place of a double, as sums are.
    assert!(off.abs().max_element() < 1e-9, "{found:?}");
    for (intensity, x, lost) in [
        ("17.5", "412345.678", "digits of the attribute intensity (double), which become whole numbers"),
        ("65536", "412345.678", "digits of the attribute intensity (double)"),
        ("-1", "412345.678", "digits of the attribute intensity (double)"),
        ("17", "412345.678901234", "digits of the positions, which are rounded to"),
    ] {
        work.write("d.csv", text(intensity, x));
        let outcome = work.refuses("convert d.csv d.las", &[lost]);
        assert!(!outcome.stderr.contains("classification"), "{}", outcome.stderr);
    }
}

/// Options that ask for something in vain, and names that promise what is not there, are told.
#[test]
fn names_and_options_that_promise_too_much_are_told() {
    let work = Workplace::new();
    write_cloud(&work, "a.laz", (4, 6), false, 1000);
    let told = |line: &str| work.simod(line).lines("note: ").join("\n");
    assert!(told("convert a.laz b.ply --step 0.1").contains("--step and --origin are of no use here"));
    assert_eq!(told("convert a.laz b.ply"), "");
    assert_eq!(told("convert b.ply b.las --step 0.001"), "");
    assert!(told("convert a.laz b.copc.laz").contains("without the octree"));
    work.simod("sample a.laz -o m.simod --samples 100");
    work.move_samples("m.simod", |p| p + DVec3::new(1e7, 0.0, 0.0));
    let line = "reconstruct m.simod --deformed deformed.ply --offset auto -o";
    assert!(told(&format!("{line} out.copc.laz")).contains("without the octree"));
    assert!(told(&format!("{line} out.las")).contains("integers are written anew"));
    for out in ["out.ply", "out.csv"] {
        assert!(!told(&format!("{line} {out}")).contains("integers"), "{out}");
    }
}
