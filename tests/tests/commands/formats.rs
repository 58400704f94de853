//! Models of every format: the same mesh, written by hand, becomes the same samples, and comes back deformed
//! as PLY does.

use glam::DVec3;
use simod_tests::Workplace;

/// Rows and columns of the mesh.
const N: usize = 120;

fn vertex(k: usize) -> [f64; 3] {
    let (u, v) = ((k / N) as f64 / N as f64, (k % N) as f64 / N as f64);
    let at = DVec3::new(u, v, 0.2 * (5.0 * u).sin() * (4.0 * v).cos());
    // As all text here has them.
    at.to_array().map(|c| format!("{c:.6}").parse().expect("a number"))
}

fn normal(k: usize) -> [f64; 3] {
    let (u, v) = ((k / N) as f64 / N as f64, (k % N) as f64 / N as f64);
    let n = DVec3::new(-(5.0 * u).cos() * (4.0 * v).cos(), 0.8 * (5.0 * u).sin() * (4.0 * v).sin(), 1.0);
    n.normalize_or_zero().to_array()
}

fn faces() -> Vec<[usize; 3]> {
    let cell = |k: usize| [[k, k + N, k + 1], [k + 1, k + N, k + N + 1]];
    (0..N * (N - 1)).filter(|k| k % N < N - 1).flat_map(cell).collect()
}

fn row(values: [f64; 3], separator: &str) -> String {
    values.map(|v| format!("{v:.6}")).join(separator)
}

/// A file with these vertices, normals and faces as PLY.
fn ply(kind: &str, vertices: &[String], normals: bool, faces: &[[usize; 3]]) -> String {
    let mut text = format!("ply\nformat ascii 1.0\nelement vertex {}\n", vertices.len());
    let names = if normals {
        "xyz".chars().map(String::from).chain(["nx", "ny", "nz"].map(String::from)).collect()
    } else {
        vec!["x".to_string(), "y".into(), "z".into()]
    };
    names.iter().for_each(|name| text += &format!("property {kind} {name}\n"));
    if !faces.is_empty() {
        text += &format!("element face {}\nproperty list uchar uint vertex_indices\n", faces.len());
    }
    text += "end_header\n";
    vertices.iter().for_each(|v| text += &format!("{v}\n"));
    faces.iter().for_each(|[a, b, c]| text += &format!("3 {a} {b} {c}\n"));
    text
}

fn moved(p: DVec3) -> DVec3 {
    p + DVec3::new(0.1 * p.y * p.y, 0.3 * p.x, 1.0 + p.x * p.y)
}

/// Samples a model, deforms the samples, and writes the deformed model; returns the samples' file.
fn edit(work: &Workplace, model: &str, options: &str) -> Vec<u8> {
    let extension = model.rsplit('.').next().expect("an extension");
    work.simod(&format!("sample {model} -o {model}.simod --samples 1500 {options}"));
    work.move_samples(&format!("{model}.simod"), moved);
    work.simod(&format!("reconstruct {model}.simod --deformed deformed.ply -o {model}-out.{extension}"));
    work.read(&format!("{model}.simod/samples.ply"))
}

/// The numbers of the lines that begin so, behind that.
fn numbers(text: &str, start: &str) -> Vec<DVec3> {
    let lines = text.lines().filter_map(|line| line.strip_prefix(start));
    let vector = |line: &str| {
        let mut words =
            line.split([' ', ',', '\t']).filter(|w| !w.is_empty()).map(|word| word.parse::<f64>());
        let mut next = || words.next().and_then(Result::ok);
        Some(DVec3::new(next()?, next()?, next()?))
    };
    lines.filter_map(vector).collect()
}

fn check_near(found: &[DVec3], expected: &[DVec3], bound: f64, what: &str) {
    assert_eq!(found.len(), expected.len(), "{what}");
    for (i, (found, expected)) in found.iter().zip(expected).enumerate() {
        assert!((*found - *expected).abs().max_element() <= bound, "{what} {i}: {found} for {expected}");
    }
}

/// More than half a digit of numbers with six decimals.
const DIGIT: f64 = 0.51e-6;

#[test]
fn meshes_of_text_become_what_ply_becomes() {
    let work = Workplace::new();
    let count = N * N;
    let positions: Vec<String> = (0..count).map(|k| row(vertex(k), " ")).collect();
    let normals: Vec<String> = (0..count).map(|k| row(normal(k), " ")).collect();
    let faces = faces();
    let both = |k: usize| format!("{} {}", positions[k], normals[k]);
    work.write("model.ply", ply("double", &(0..count).map(both).collect::<Vec<_>>(), true, &faces));
    work.write("bare.ply", ply("double", &positions, false, &faces));
    let samples = edit(&work, "model.ply", "");
    let bare = edit(&work, "bare.ply", "");
    let (expected, of_bare) = (work.ply("model.ply-out.ply"), work.ply("bare.ply-out.ply"));

    // OBJ with normals beside, and apart from, the vertices; and without.
    let corner =
        |i: usize, normals: bool| if normals { format!("{0}//{0}", i + 1) } else { format!("{}", i + 1) };
    let of_faces = |normals: bool| -> String {
        faces.iter().map(|f| format!("f {}\n", f.map(|i| corner(i, normals)).join(" "))).collect()
    };
    let beside: String = (0..count).map(|k| format!("vn {}\nv {}\n", normals[k], positions[k])).collect();
    work.write("beside.obj", format!("mtllib m.mtl\n{beside}usemtl a\n{}", of_faces(true)));
    let lines = |letter: &str, rows: &[String]| -> String {
        rows.iter().map(|r| format!("{letter} {r}\n")).collect()
    };
    work.write("apart.obj", lines("v", &positions) + &lines("vn", &normals) + &of_faces(true));
    work.write("bare.obj", lines("v", &positions) + &of_faces(false));
    for (model, samples, expected, has_normals) in [
        ("beside.obj", &samples, &expected, true),
        ("apart.obj", &samples, &expected, true),
        ("bare.obj", &bare, &of_bare, false),
    ] {
        assert!(edit(&work, model, "") == *samples, "{model}");
        let out = String::from_utf8(work.read(&format!("{model}-out.obj"))).expect("text");
        check_near(&numbers(&out, "v "), &expected.positions(), DIGIT, model);
        if has_normals {
            check_near(&numbers(&out, "vn "), &expected.normals(), DIGIT, model);
        }
        let report = work.report(&format!("info {model}"));
        assert_eq!(
            (report["format"].as_str(), report["normals"].as_bool()),
            (Some("OBJ"), Some(has_normals))
        );
        assert_eq!(report["faces"].as_u64(), Some(faces.len() as u64));
        // Nothing moved, nothing changed.
        work.simod(&format!("reconstruct {model}.simod --deformed {model}.simod/samples.ply -o same.obj"));
        assert!(work.read("same.obj") == work.read(model));
    }

    // OFF, with and without normals.
    let of_faces: String = faces.iter().map(|[a, b, c]| format!("3 {a} {b} {c}\n")).collect();
    let counts = format!("{count} {} 0\n", faces.len());
    let rows = |rows: &dyn Fn(usize) -> String| -> String { (0..count).map(|k| rows(k) + "\n").collect() };
    work.write("normals.off", format!("NOFF\n{counts}{}{of_faces}", rows(&both)));
    work.write("bare.off", format!("OFF {counts}{}{of_faces}", rows(&|k| positions[k].clone())));
    for (model, samples, expected) in [("normals.off", &samples, &expected), ("bare.off", &bare, &of_bare)] {
        assert!(edit(&work, model, "") == *samples, "{model}");
        let out = String::from_utf8(work.read(&format!("{model}-out.off"))).expect("text");
        let (_, lines) = out.split_once(&counts).expect("the counts");
        check_near(&numbers(lines, "")[..count], &expected.positions(), DIGIT, model);
        assert!(out.ends_with(&of_faces));
    }
}

#[test]
fn points_become_what_ply_becomes() {
    let work = Workplace::new();
    let count = N * N;
    let both = |k: usize| format!("{} {}", row(vertex(k), " "), row(normal(k), " "));
    work.write("model.ply", ply("double", &(0..count).map(both).collect::<Vec<_>>(), true, &[]));
    let samples = edit(&work, "model.ply", "");
    let expected = work.ply("model.ply-out.ply").positions();
    let lines = |line: &dyn Fn(usize) -> String| -> String { (0..count).map(|k| line(k) + "\n").collect() };
    work.write("a.xyzn", lines(&both));
    work.write(
        "b.csv",
        "id,x,y,z,nx,ny,nz,class\n".to_string()
            + &lines(&|k| format!("{k},{},{},7", row(vertex(k), ","), row(normal(k), ","))),
    );
    work.write("c.txt", lines(&|k| format!("{} 9 {}", row(normal(k), " "), row(vertex(k), " "))));
    let header = format!(
        "VERSION 0.7\nFIELDS x y z normal_x normal_y normal_z\nSIZE 8 8 8 8 8 8\nTYPE F F F F F F\nWIDTH {count}\nHEIGHT 1\n"
    );
    work.write("d.pcd", header.clone() + "DATA ascii\n" + &lines(&both));
    let rounded =
        |k| row(normal(k), " ").split(' ').map(|w| w.parse::<f64>().expect("a number")).collect::<Vec<_>>();
    let point = |k: usize| [vertex(k).to_vec(), rounded(k)].concat().into_iter().flat_map(f64::to_le_bytes);
    work.write(
        "e.pcd",
        [(header + "DATA binary\n").into_bytes(), (0..count).flat_map(point).collect()].concat(),
    );
    for (model, options) in
        [("a.xyzn", ""), ("b.csv", ""), ("c.txt", "--columns nx,ny,nz,_,x,y,z"), ("d.pcd", ""), ("e.pcd", "")]
    {
        assert!(edit(&work, model, options) == samples, "{model}");
        let name = format!("{model}-out.{}", model.rsplit('.').next().expect("an extension"));
        let out = work.read(&name);
        let text = String::from_utf8_lossy(&out);
        let found = match model {
            "b.csv" => {
                text.lines().skip(1).map(|l| numbers(l.split_once(',').expect("a comma").1, "")[0]).collect()
            }
            "c.txt" => {
                text.lines().map(|l| numbers(l.splitn(5, ' ').last().expect("five columns"), "")[0]).collect()
            }
            "e.pcd" => {
                let at = out.len() - count * 48;
                let number = |b: &[u8]| f64::from_le_bytes(b.try_into().expect("eight bytes"));
                out[at..]
                    .chunks(48)
                    .map(|p| DVec3::new(number(&p[..8]), number(&p[8..16]), number(&p[16..24])))
                    .collect()
            }
            _ => numbers(&text, ""),
        };
        check_near(&found, &expected, DIGIT, model);
        let info = work.report(&format!("info {model} {options}"));
        assert_eq!(info["vertices"].as_u64(), Some(count as u64));
    }
    // The names of columns are kept with the samples.
    let described = String::from_utf8(work.read("c.txt.simod/simod.toml")).expect("text");
    assert!(described.contains("columns = \"nx,ny,nz,_,x,y,z\""), "{described}");
    work.refuses("sample c.txt -o again.simod --columns x,y", &["no column is z"]);
    work.refuses("sample e.pcd -o again.simod --columns x,y,z", &["e.pcd is no text in columns"]);
}

#[test]
fn soups_become_what_ply_becomes() {
    let work = Workplace::new();
    let faces = faces();
    let corners: Vec<[f32; 3]> = faces.iter().flatten().map(|k| vertex(*k).map(|v| v as f32)).collect();
    let rows: Vec<String> = corners.iter().map(|c| format!("{} {} {}", c[0], c[1], c[2])).collect();
    let in_order: Vec<[usize; 3]> = (0..faces.len()).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
    work.write("model.ply", ply("float", &rows, false, &in_order));
    let samples = edit(&work, "model.ply", "");
    let expected = work.ply("model.ply-out.ply").positions();

    let mut bytes = vec![b' '; 80];
    bytes.extend((faces.len() as u32).to_le_bytes());
    let mut text = "solid\n".to_string();
    for (facet, rows) in corners.chunks(3).zip(rows.chunks(3)) {
        bytes.extend([0.0f32, 0.0, 1.0].iter().chain(facet.iter().flatten()).flat_map(|v| v.to_le_bytes()));
        bytes.extend([7, 7]);
        text += "facet normal 0 0 1\nouter loop\n";
        rows.iter().for_each(|row| text += &format!("vertex {row}\n"));
        text += "endloop\nendfacet\n";
    }
    work.write("binary.stl", &bytes);
    work.write("ascii.stl", text + "endsolid\n");
    assert!(edit(&work, "binary.stl", "") == samples);
    edit(&work, "ascii.stl", "");
    let out = work.read("binary.stl-out.stl");
    let number = |b: &[u8]| f64::from(f32::from_le_bytes(b.try_into().expect("four bytes")));
    let vector = |b: &[u8]| DVec3::new(number(&b[..4]), number(&b[4..8]), number(&b[8..12]));
    let found: Vec<DVec3> =
        out[84..].chunks(50).flat_map(|f| [12, 24, 36].map(|at| vector(&f[at..]))).collect();
    assert!(found == expected);
    assert!(out[84..].chunks(50).all(|f| {
        let [a, b, c] = [12, 24, 36].map(|at| vector(&f[at..]));
        let normal = (b - a).cross(c - a).normalize_or_zero();
        (normal - vector(f)).length() < 1e-6 && f[48..] == [7, 7]
    }));
    let text = String::from_utf8(work.read("ascii.stl-out.stl")).expect("text");
    check_near(&numbers(&text, "vertex "), &expected, 2e-6, "ascii.stl");
}

#[test]
fn a_model_is_written_in_its_own_format_and_name() {
    let work = Workplace::new();
    work.write("m.obj", "v 0 0 0\nv 0.333333333333333 0 0\nv 0 1 0\nf 1 2 3\n");
    work.simod("sample m.obj -o m.simod");
    let line = "reconstruct m.simod --deformed m.simod/samples.ply -o";
    let outcome = work.refuses(&format!("{line} out.pts"), &["out.pts", "cannot be written anew"]);
    assert!(outcome.hint().contains("obj"));
    work.refuses(&format!("{line} out.las"), &["out.las would lose", "1 face; "]);
    work.simod(&format!("{line} out.obj"));
    // A model of any format may be replaced, and nothing else.
    work.simod(&format!("{line} out.obj"));
    work.write("letter.obj", "Dear reader,\n");
    work.refuses(&format!("{line} letter.obj"), &["letter.obj is there, and is no model"]);
}

#[test]
fn normals_that_corners_share_are_said_to_be_kept() {
    let work = Workplace::new();
    let mut text: String = (0..N * N).map(|k| format!("v {}\n", row(vertex(k), " "))).collect();
    text += "vn 0 0 1\n";
    faces().iter().for_each(|f| text += &format!("f {}\n", f.map(|i| format!("{}//1", i + 1)).join(" ")));
    work.write("m.obj", &text);
    work.simod("sample m.obj -o m.simod --samples 500");
    work.move_samples("m.simod", moved);
    let outcome = work.simod("reconstruct m.simod --deformed deformed.ply -o out.obj");
    assert!(
        outcome
            .stderr
            .contains("corners that share a normal (vn) turn apart by more than 5\u{b0}: 1 normal kept"),
        "{}",
        outcome.stderr
    );
    let out = String::from_utf8(work.read("out.obj")).expect("text");
    assert!(out.contains("\nvn 0 0 1\n"));
}

/// A text whose columns only the user knows, through a session, and back.
#[test]
fn sessions_say_what_columns_are() {
    let work = Workplace::new();
    let text: String = (0..N * N).map(|k| format!("{} {}\n", 1000 + k, row(vertex(k), " "))).collect();
    work.write("cloud.txt", &text);
    let model = "[model]\npath = \"cloud.txt\"\ncolumns = \"_,x,y,z\"\n";
    let rest = "[sampling]\nsamples = 1500\n[[step]]\ndeform = \"warp\"\n[output]\npath = \"out.txt\"\n";
    work.write("edit.toml", format!("{model}{rest}"));
    let report = work.report("run edit.toml --measure");
    let worst = report["transfer_error"]["max"].as_f64().expect("a number");
    assert!(worst < 1e-3, "{worst:e}");
    let number = |value: &serde_json::Value| value.as_f64().expect("a number");
    let diagonal = number(&report["diagonal"]);
    for (error, one) in [("transfer_error", "max"), ("transfer_error", "rms"), ("expected_error", "worst")] {
        assert_eq!(number(&report[error]["lengths"][one]), number(&report[error][one]) * diagonal);
    }
    let out = String::from_utf8(work.read("out.txt")).expect("text");
    let ids = |text: &str| -> Vec<String> {
        text.lines().map(|line| line.split(' ').next().expect("a word").to_owned()).collect()
    };
    assert!(ids(&out) == ids(&text) && out != text);
    work.write("edit.toml", format!("[model]\npath = \"cloud.txt\"\ncolumns = \"_,x\"\n{rest}"));
    let line = "run edit.toml -o none.txt";
    work.run(line).refused(line, &["cloud.txt"]);
}

#[test]
fn methods_are_compared_on_models_of_any_format() {
    let work = Workplace::new();
    let vertices: String = (0..N * N).map(|k| format!("v {}\n", row(vertex(k), " "))).collect();
    let faces: String =
        faces().iter().map(|f| format!("f {}\n", f.map(|i| (i + 1).to_string()).join(" "))).collect();
    work.write("model.obj", vertices + &faces);
    let methods = "[[method]]\nname = \"a\"\ndeform = \"warp\"\n[[method]]\nname = \"b\"\ndeform = \"warp\"\n\
        reconstruction = \"projected-barycentric\"\n";
    let text = format!("[model]\npath = \"model.obj\"\n[sampling]\nsamples = 1500\n{methods}");
    work.write("compare.toml", text);
    work.simod("compare compare.toml -o done --keep-models");
    for method in ["a", "b"] {
        let out = String::from_utf8(work.read(&format!("done/{method}.obj"))).expect("text");
        assert_eq!(numbers(&out, "v ").len(), N * N);
    }
    let page = String::from_utf8(work.read("done/index.html")).expect("text");
    assert!(page.contains("2 methods on model.obj"));
}
