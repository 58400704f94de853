//! glTF: the same mesh as GLB and as PLY becomes the same samples, and comes back deformed as PLY does.

use std::process::Stdio;
use std::time::Duration;

use glam::{DVec3, Vec3};
use simod_tests::{MANY, Workplace};

/// Rows and columns of the mesh.
const N: usize = 120;

fn vertex(k: usize) -> Vec3 {
    let (u, v) = ((k / N) as f32 / N as f32, (k % N) as f32 / N as f32);
    Vec3::new(u, v, 0.2 * (5.0 * u).sin() * (4.0 * v).cos())
}

fn normal(k: usize) -> Vec3 {
    let (u, v) = ((k / N) as f32 / N as f32, (k % N) as f32 / N as f32);
    Vec3::new(-(5.0 * u).cos() * (4.0 * v).cos(), 0.8 * (5.0 * u).sin() * (4.0 * v).sin(), 1.0)
        .normalize_or(Vec3::Z)
}

/// Along u.
fn tangent(k: usize) -> Vec3 {
    let n = normal(k);
    Vec3::new(n.z, 0.0, -n.x).normalize_or(Vec3::X)
}

fn faces() -> Vec<[u32; 3]> {
    let cell = |k: u32| [[k, k + N as u32, k + 1], [k + 1, k + N as u32, k + N as u32 + 1]];
    (0..(N * (N - 1)) as u32).filter(|k| *k as usize % N < N - 1).flat_map(cell).collect()
}

fn moved(p: DVec3) -> DVec3 {
    p + DVec3::new(0.1 * p.y * p.y, 0.3 * p.x, 1.0 + p.x * p.y)
}

fn bytes(rows: &[Vec<f32>]) -> Vec<u8> {
    rows.iter().flatten().flat_map(|v| v.to_le_bytes()).collect()
}

fn row(v: Vec3) -> Vec<f32> {
    v.to_array().to_vec()
}

/// A GLB of these accessors (shape, stride, offset in the view, view), which have a mesh; the bytes of views.
fn glb(views: &[(Vec<u8>, usize)], accessors: &str, primitive: &str, node: &str) -> Vec<u8> {
    let (mut bin, mut of_views) = (Vec::new(), Vec::new());
    for (bytes, stride) in views {
        let stride = if *stride > 0 { format!(",\"byteStride\":{stride}") } else { String::new() };
        of_views.push(format!(
            "{{\"buffer\":0,\"byteOffset\":{},\"byteLength\":{}{stride}}}",
            bin.len(),
            bytes.len()
        ));
        bin.extend_from_slice(bytes);
    }
    let mut json = format!(
        "{{\"asset\":{{\"version\":\"2.0\"}},\"scene\":0,\"scenes\":[{{\"nodes\":[0]}}],\"nodes\":[{{\"mesh\":0{node}}}],\
         \"meshes\":[{{\"primitives\":[{primitive}]}}],\"accessors\":[{accessors}],\"bufferViews\":[{}],\"buffers\":[{{\"byteLength\":{}}}]}}",
        of_views.join(","),
        bin.len()
    )
    .into_bytes();
    json.resize(json.len().next_multiple_of(4), b' ');
    let mut file = b"glTF".to_vec();
    let total = 28 + json.len() + bin.len();
    [2, total as u32, json.len() as u32, 0x4E4F_534A].iter().for_each(|w: &u32| file.extend(w.to_le_bytes()));
    file.extend(json);
    [bin.len() as u32, 0x004E_4942].iter().for_each(|w: &u32| file.extend(w.to_le_bytes()));
    file.extend(bin);
    file
}

/// The JSON of a GLB, and where its binary data begin.
fn json(file: &[u8]) -> (serde_json::Value, usize) {
    let number = |at: usize| u32::from_le_bytes(file[at..at + 4].try_into().expect("four bytes")) as usize;
    assert_eq!(number(8), file.len());
    let end = 20 + number(12);
    (serde_json::from_slice(&file[20..end]).expect("JSON"), end + 8)
}

/// Rows of so many bytes.
fn read(file: &[u8], start: usize, stride: usize, count: usize) -> Vec<Vec3> {
    let at = json(file).1 + start;
    let number = |at: usize| f32::from_le_bytes(file[at..at + 4].try_into().expect("four bytes"));
    (0..count)
        .map(|i| at + i * stride)
        .map(|at| Vec3::new(number(at), number(at + 4), number(at + 8)))
        .collect()
}

fn limits(points: &[Vec3]) -> String {
    let corner = |of: fn(Vec3, Vec3) -> Vec3| points.iter().copied().reduce(of).expect("points").to_array();
    format!(",\"min\":{:?},\"max\":{:?}", corner(Vec3::min), corner(Vec3::max))
}

fn accessor(view: usize, offset: usize, kind: u32, count: usize, shape: &str, rest: &str) -> String {
    format!(
        "{{\"bufferView\":{view},\"byteOffset\":{offset},\"componentType\":{kind},\"count\":{count},\"type\":\"{shape}\"{rest}}}"
    )
}

const FLOAT: u32 = 5126;
const PRIMITIVE: &str = "{\"attributes\":{\"POSITION\":0,\"NORMAL\":1,\"TANGENT\":2},\"indices\":3}";

/// Positions, normals, tangents and faces, apart.
fn apart(at: impl Fn(Vec3) -> Vec3, node: &str) -> Vec<u8> {
    let count = N * N;
    let positions: Vec<Vec3> = (0..count).map(|k| at(vertex(k))).collect();
    let of = |f: &dyn Fn(usize) -> Vec<f32>| (bytes(&(0..count).map(f).collect::<Vec<_>>()), 0);
    let indices: Vec<u8> = faces().iter().flatten().flat_map(|i| i.to_le_bytes()).collect();
    let tangents = of(&|k| at(tangent(k)).extend(1.0).to_array().to_vec());
    let views = [of(&|k| row(at(normal(k)))), of(&|k| row(positions[k])), tangents, (indices, 0)];
    let accessors = [
        accessor(1, 0, FLOAT, count, "VEC3", &limits(&positions)),
        accessor(0, 0, FLOAT, count, "VEC3", ""),
        accessor(2, 0, FLOAT, count, "VEC4", ""),
        accessor(3, 0, 5125, 3 * faces().len(), "SCALAR", ""),
    ];
    glb(&views, &accessors.join(","), PRIMITIVE, node)
}

/// Samples a model, deforms the samples, and writes the deformed model; returns the samples' file.
fn edit(work: &Workplace, model: &str, extension: &str) -> Vec<u8> {
    work.simod(&format!("sample {model} -o {model}.simod --samples 1500"));
    work.move_samples(&format!("{model}.simod"), moved);
    work.simod(&format!("reconstruct {model}.simod --deformed deformed.ply -o {model}-out.{extension}"));
    work.read(&format!("{model}.simod/samples.ply"))
}

fn check_near(found: &[Vec3], expected: &[DVec3], bound: f64, what: &str) {
    assert_eq!(found.len(), expected.len(), "{what}");
    for (i, (found, expected)) in found.iter().zip(expected).enumerate() {
        assert!((found.as_dvec3() - *expected).length() <= bound, "{what} {i}: {found} for {expected}");
    }
}

#[test]
fn meshes_become_what_ply_becomes() {
    let work = Workplace::new();
    let count = N * N;
    let mut text = format!("ply\nformat ascii 1.0\nelement vertex {count}\n");
    ["x", "y", "z", "nx", "ny", "nz"].iter().for_each(|name| text += &format!("property float {name}\n"));
    text += &format!("element face {}\nproperty list uchar uint vertex_indices\nend_header\n", faces().len());
    for k in 0..count {
        let (p, n) = (vertex(k), normal(k));
        text += &format!("{} {} {} {} {} {}\n", p.x, p.y, p.z, n.x, n.y, n.z);
    }
    faces().iter().for_each(|[a, b, c]| text += &format!("3 {a} {b} {c}\n"));
    work.write("model.ply", text);
    let samples = edit(&work, "model.ply", "ply");
    let expected = work.ply("model.ply-out.ply");

    work.write("apart.glb", apart(|p| p, ""));
    // All between each other, and something else.
    let rows = |k: usize| {
        [row(normal(k)), vec![7.5], row(vertex(k)), tangent(k).extend(-1.0).to_array().to_vec()].concat()
    };
    let together = (bytes(&(0..count).map(rows).collect::<Vec<_>>()), 44);
    let indices = faces().iter().flatten().flat_map(|i| (*i as u16).to_le_bytes()).collect();
    let positions: Vec<Vec3> = (0..count).map(vertex).collect();
    let accessors = [
        accessor(0, 16, FLOAT, count, "VEC3", &limits(&positions)),
        accessor(0, 0, FLOAT, count, "VEC3", ""),
        accessor(0, 28, FLOAT, count, "VEC4", ""),
        accessor(1, 0, 5123, 3 * faces().len(), "SCALAR", ""),
    ];
    work.write("together.glb", glb(&[together, (indices, 0)], &accessors.join(","), PRIMITIVE, ""));
    let of_apart = (12 * count, 12, 0, 12, 24 * count, 16);
    let of_expected = expected.normals();
    for (model, (position, stride, normal, of_normals, tangent_at, of_tangents)) in
        [("apart.glb", of_apart), ("together.glb", (16, 44, 0, 44, 28, 44))]
    {
        assert!(edit(&work, model, "glb") == samples, "{model}");
        let out = work.read(&format!("{model}-out.glb"));
        check_near(&read(&out, position, stride, count), &expected.positions(), 0.0, model);
        check_near(&read(&out, normal, of_normals, count), &expected.normals(), 1e-6, model);
        // Along u still, as the exact map has it, and perpendicular.
        let tangents = read(&out, tangent_at, of_tangents, count);
        for (k, t) in tangents.iter().enumerate() {
            let (p, old, n) = (vertex(k).as_dvec3(), tangent(k).as_dvec3(), of_expected[k]);
            let step = 1e-5 * old;
            let along = (moved(p + step) - moved(p - step)).normalize_or_zero();
            assert!(
                (t.as_dvec3() - along).length() < 2e-2 && t.as_dvec3().dot(n).abs() < 1e-4,
                "{model} {k}: {t}"
            );
        }
        let number = |value: &serde_json::Value| value.as_f64().expect("a number") as f32;
        let told = &json(&out).0["accessors"][0];
        let found = read(&out, position, stride, count);
        for axis in 0..3 {
            let all = || found.iter().map(|p| p[axis]);
            assert_eq!(number(&told["min"][axis]), all().fold(f32::INFINITY, f32::min));
            assert_eq!(number(&told["max"][axis]), all().fold(f32::NEG_INFINITY, f32::max));
        }
        // Nothing moved, nothing changed.
        work.simod(&format!("reconstruct {model}.simod --deformed {model}.simod/samples.ply -o same.glb"));
        assert!(work.read("same.glb") == work.read(model));
        let report = work.report(&format!("info {model}"));
        assert_eq!(report["faces"].as_u64(), Some(faces().len() as u64));
        assert_eq!(report["normals"].as_bool(), Some(true));
    }

    // Below a node that mirrors and turns, all is where it was in the world.
    let local = |p: Vec3| Vec3::new(p.y, p.x, p.z);
    work.write("placed.glb", apart(local, ",\"matrix\":[0,1,0,0,1,0,0,0,0,0,1,0,0,0,0,1]"));
    edit(&work, "placed.glb", "glb");
    let out = work.read("placed.glb-out.glb");
    let back: Vec<Vec3> = read(&out, 12 * count, 12, count).into_iter().map(local).collect();
    check_near(&back, &expected.positions(), 1e-6, "placed.glb");
    let back: Vec<Vec3> = read(&out, 0, 12, count).into_iter().map(local).collect();
    check_near(&back, &expected.normals(), 1e-4, "placed.glb");
}

#[test]
fn an_identity_by_the_exact_map_makes_no_room() {
    let work = Workplace::new();
    work.write("a.glb", apart(|p| p, ""));
    for (params, changes) in [("params = { angle = 0 }", false), ("", true)] {
        work.write_session("a.glb", 500, &format!("[[step]]\ndeform = \"warp\"\n{params}"));
        work.simod("run edit.toml --exact -o out.glb --force");
        assert_eq!(work.read("out.glb") != work.read("a.glb"), changes, "{params}");
    }
}

#[test]
fn a_mirror_changes_the_side_of_the_bitangent() {
    let work = Workplace::new();
    let count = N * N;
    work.write("a.glb", apart(|p| p, ""));
    work.simod("sample a.glb -o a.simod --samples 1500");
    work.move_samples("a.simod", |p| DVec3::new(p.x, p.y, -p.z));
    work.simod("reconstruct a.simod --deformed deformed.ply -o out.glb");
    let out = work.read("out.glb");
    let start = json(&out).1 + 24 * count;
    for (k, row) in out[start..start + 16 * count].chunks(16).enumerate() {
        let t: Vec<f32> =
            row.chunks(4).map(|b| f32::from_le_bytes(b.try_into().expect("four bytes"))).collect();
        let expected = tangent(k) * Vec3::new(1.0, 1.0, -1.0);
        assert!((Vec3::from_slice(&t) - expected).length() < 1e-3 && t[3] == -1.0, "{k}: {t:?}");
    }
}

#[test]
fn a_gltf_becomes_a_glb_and_keeps_its_files() {
    let work = Workplace::new();
    let glb = apart(|p| p, "");
    let (_, start) = json(&glb);
    let text = String::from_utf8(glb[20..start - 8].to_vec()).expect("text");
    work.write("a.gltf", text.replace("\"buffers\":[{", "\"buffers\":[{\"uri\":\"a.bin\","));
    work.write("a.bin", &glb[start..]);
    work.simod("sample a.gltf -o a.simod --samples 500");
    work.move_samples("a.simod", moved);
    let line = "reconstruct a.simod --deformed deformed.ply -o";
    let outcome = work.simod(&format!("{line} out.glb"));
    assert!(outcome.stderr.contains("it becomes one GLB file"), "{}", outcome.stderr);
    work.refuses(&format!("{line} out.gltf"), &["out.gltf is named as if of another format"]);
    work.refuses(&format!("{line} a.bin"), &["a.bin"]);
    work.refuses(&format!("{line} a.bin --force"), &["a.bin"]);
    work.simod("sample out.glb -o b.simod --samples 500");
    // The output is that of the same file as GLB, but for the text.
    work.write("whole.glb", &glb);
    work.simod("sample whole.glb -o whole.simod --samples 500");
    work.move_samples("whole.simod", moved);
    work.simod("reconstruct whole.simod --deformed deformed.ply -o whole-out.glb");
    let (out, whole) = (work.read("out.glb"), work.read("whole-out.glb"));
    assert!(out[json(&out).1..] == whole[json(&whole).1..]);
    assert_eq!(json(&out).0["accessors"], json(&whole).0["accessors"]);
    // As a tile, too, whose name says then what it is; it may be written over, and found with the others.
    work.write(
        "more.ply",
        "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\n\
         property float z\nend_header\n0 0 0\n",
    );
    work.simod("sample a.gltf more.ply -o tiles.simod --samples 500");
    work.move_samples("tiles.simod", moved);
    for _ in 0..2 {
        work.simod("reconstruct tiles.simod --deformed deformed.ply -o out");
    }
    assert!(work.read("out/a.glb").starts_with(b"glTF") && work.path("out/more.ply").exists());
    assert!(!work.path("out/a.gltf").exists(), "a GLB is named .gltf");
    work.write("moved/a.gltf", work.read("a.gltf"));
    work.write("moved/a.bin", work.read("a.bin"));
    work.write("moved/more.ply", work.read("more.ply"));
    work.simod("reconstruct tiles.simod --model moved --deformed deformed.ply -o again");
    assert!(work.read("again/a.glb") == work.read("out/a.glb"));
}

#[test]
fn killed_and_gone_on_with() {
    let work = Workplace::new();
    let count = MANY / 4;
    let positions: Vec<Vec3> =
        (0..count).map(|k| vertex(k as usize % (N * N)) + Vec3::Z * (k / 20_000) as f32).collect();
    let rows: Vec<Vec<f32>> = positions.iter().map(|p| row(*p)).collect();
    let normals = vec![vec![0.0, 0.0, 1.0]; positions.len()];
    let accessors = [
        accessor(0, 0, FLOAT, positions.len(), "VEC3", &limits(&positions)),
        accessor(1, 0, FLOAT, positions.len(), "VEC3", ""),
    ];
    let primitive = "{\"attributes\":{\"POSITION\":0,\"NORMAL\":1},\"mode\":0}";
    work.write("a.glb", glb(&[(bytes(&rows), 0), (bytes(&normals), 0)], &accessors.join(","), primitive, ""));
    work.simod("sample a.glb -o model.simod --samples 2000");
    work.move_samples("model.simod", moved);
    let line = "reconstruct model.simod --deformed deformed.ply -o out.glb --part-size 100K";
    work.simod(line);
    let expected = work.read("out.glb");
    let mut gone_on = 0;
    for parts in [1, 3, 5] {
        std::fs::remove_file(work.path("out.glb")).expect("an output");
        kill_after(&work, line, ".simod-out.glb.journal", parts);
        let report = work.report(&format!("{line} --resume"));
        gone_on += u32::from(report["resumed_bytes"].as_u64().is_some_and(|bytes| bytes > 0));
        assert!(work.read("out.glb") == expected, "killed after {parts} parts");
    }
    assert!(gone_on > 0, "it was never killed in the midst of it");
}

/// Starts a reconstruction and kills it once its journal lists so many parts.
fn kill_after(work: &Workplace, line: &str, journal: &str, parts: usize) {
    let mut command = work.command(line);
    let mut child = command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().expect("a start");
    let listed = || {
        let journal = std::fs::read_to_string(work.path(journal)).unwrap_or_default();
        journal.lines().filter(|line| line.starts_with("part ")).count()
    };
    while listed() < parts && child.try_wait().expect("a child").is_none() {
        std::thread::sleep(Duration::from_micros(200));
    }
    child.kill().expect("a child");
    child.wait().expect("an end");
}

#[test]
fn what_cannot_be_deformed_leaves_nothing() {
    let work = Workplace::new();
    let file = apart(|p| p, "");
    for end in [3, 11, 100, 700, file.len() / 2, file.len() - 1] {
        work.write("bad.glb", &file[..end]);
        work.refuses("sample bad.glb -o bad.simod", &["bad.glb"]);
    }
    let text = String::from_utf8(file[20..json(&file).1 - 8].to_vec()).expect("text");
    let with = |old: &str, new: &str| {
        // Of the same length, so that nothing else has to change.
        let text = text.trim_end().replacen(old, new, 1);
        let mut text = text.into_bytes();
        text.resize(json(&file).1 - 28, b' ');
        [&file[..20], &text, &file[json(&file).1 - 8..]].concat()
    };
    work.write("bad.glb", with("\"POSITION\":0", "\"POSITION\":3"));
    work.refuses("sample bad.glb -o bad.simod", &["accessor 3 (POSITION)"]);
    work.write("bad.glb", with("\"NORMAL\":1,", "\"NORMAL\":0,"));
    work.refuses("sample bad.glb -o bad.simod", &["positions", "normals", "lie over"]);
    // A file that changes between sampling and reconstruction.
    work.write("a.glb", &file);
    work.simod("sample a.glb -o a.simod --samples 500");
    let mut other = file.clone();
    let at = json(&file).1 + 12 * N * N + 5;
    other[at] ^= 1;
    work.write("a.glb", &other);
    work.refuses("reconstruct a.simod --deformed a.simod/samples.ply -o out.glb", &["a.glb"]);
    assert!(!work.names().contains(&"out.glb".to_owned()));
}
