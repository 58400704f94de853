use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use glam::{DAffine3, DMat3, DQuat, Vec4, Vec4Swizzles};
use proptest::prelude::*;
use simod_model::Scalar;

use super::*;

/// A file in the making.
#[derive(Clone, Default)]
struct Glb {
    bin: Vec<u8>,
    views: Vec<String>,
    accessors: Vec<String>,
    meshes: Vec<String>,
    nodes: Vec<String>,
    /// Further members of the document.
    rest: String,
}

const FLOAT: u32 = 5126;

fn floats(rows: &[Vec<f32>]) -> Vec<u8> {
    rows.iter().flatten().flat_map(|v| v.to_le_bytes()).collect()
}

impl Glb {
    fn view(&mut self, bytes: &[u8], stride: Option<usize>) -> usize {
        let stride = stride.map_or(String::new(), |s| format!(",\"byteStride\":{s}"));
        let (at, length) = (self.bin.len(), bytes.len());
        self.views.push(format!("{{\"buffer\":0,\"byteOffset\":{at},\"byteLength\":{length}{stride}}}"));
        self.bin.extend_from_slice(bytes);
        self.bin.resize(self.bin.len().next_multiple_of(4), 0xaa);
        self.views.len() - 1
    }

    fn accessor(
        &mut self,
        view: usize,
        offset: usize,
        kind: u32,
        count: usize,
        shape: &str,
        rest: &str,
    ) -> usize {
        self.accessors.push(format!(
            "{{\"bufferView\":{view},\"byteOffset\":{offset},\"componentType\":{kind},\"count\":{count},\"type\":\"{shape}\"{rest}}}"
        ));
        self.accessors.len() - 1
    }

    /// Adds rows of floats as an accessor of their own.
    fn floats(&mut self, rows: &[Vec<f32>], rest: &str) -> usize {
        let view = self.view(&floats(rows), None);
        let shape = ["", "SCALAR", "VEC2", "VEC3", "VEC4"][rows[0].len()];
        self.accessor(view, 0, FLOAT, rows.len(), shape, rest)
    }

    fn positions(&mut self, points: &[Vec3]) -> usize {
        let rows: Vec<Vec<f32>> = points.iter().map(|p| p.to_array().to_vec()).collect();
        self.floats(&rows, &limits(points))
    }

    fn indices(&mut self, indices: &[u32], kind: u32) -> usize {
        let size = match kind {
            5121 => 1,
            5123 => 2,
            _ => 4,
        };
        let bytes: Vec<u8> = indices.iter().flat_map(|i| i.to_le_bytes()[..size].to_vec()).collect();
        let view = self.view(&bytes, None);
        self.accessor(view, 0, kind, indices.len(), "SCALAR", "")
    }

    fn mesh(&mut self, primitive: &str) -> usize {
        self.meshes.push(format!("{{\"primitives\":[{primitive}]}}"));
        self.meshes.len() - 1
    }

    /// A mesh of one primitive, shown by a node with these further members.
    fn shown(&mut self, primitive: &str, node: &str) {
        let mesh = self.mesh(primitive);
        self.nodes.push(format!("{{\"mesh\":{mesh}{node}}}"));
    }

    fn json(&self, uri: &str) -> String {
        let list = |name: &str, all: &[String]| {
            if all.is_empty() { String::new() } else { format!(",\n \"{name}\" : [\n{}]", all.join(",\n")) }
        };
        format!(
            "{{\"asset\":{{\"version\":\"2.0\",\"generator\":\"by \u{e4} hand\"}},\"buffers\":[{{\"byteLength\":{}{uri}}}]{}{}{}{}{}}}",
            self.bin.len(),
            list("nodes", &self.nodes),
            list("meshes", &self.meshes),
            list("accessors", &self.accessors),
            list("bufferViews", &self.views),
            self.rest
        )
    }

    fn bytes(&self) -> Vec<u8> {
        glb(&self.json(""), &self.bin)
    }
}

fn glb(json: &str, bin: &[u8]) -> Vec<u8> {
    let mut json = json.as_bytes().to_vec();
    json.resize(json.len().next_multiple_of(4), b' ');
    let mut bytes = b"glTF".to_vec();
    let total = 28 + json.len() + bin.len();
    for word in [2, total as u32, json.len() as u32, 0x4E4F_534A] {
        bytes.extend(word.to_le_bytes());
    }
    bytes.extend(&json);
    [bin.len() as u32, 0x004E_4942].iter().for_each(|word| bytes.extend(word.to_le_bytes()));
    bytes.extend(bin);
    bytes
}

/// Members of an accessor that give the least and the largest numbers of these points.
fn limits(points: &[Vec3]) -> String {
    let corner = |of: fn(Vec3, Vec3) -> Vec3| {
        let corner = points.iter().copied().reduce(of).unwrap().to_array();
        corner.map(|c| format!("{c}")).join(", ")
    };
    format!(",\"min\" : [ {} ],\"max\":[{}]", corner(Vec3::min), corner(Vec3::max))
}

fn points(count: usize) -> Vec<Vec3> {
    (0..count).map(|i| Vec3::new((i as f32 * 0.7).sin(), i as f32 * 0.25, (i as f32 * 1.3).cos())).collect()
}

fn rows(points: &[Vec3]) -> Vec<Vec<f32>> {
    points.iter().map(|p| p.to_array().to_vec()).collect()
}

/// The document of a GLB, and its binary data.
fn parts(bytes: &[u8]) -> (serde_json::Value, Vec<u8>) {
    let number = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
    assert_eq!(number(8), bytes.len());
    let end = 20 + number(12);
    let bin = if end < bytes.len() { bytes[end + 8..].to_vec() } else { Vec::new() };
    assert!(end == bytes.len() || number(end) == bin.len());
    (serde_json::from_slice(&bytes[20..end]).unwrap(), bin)
}

/// The numbers of an accessor, row by row, as a reader of its own finds them.
fn values(bytes: &[u8], accessor: usize) -> Vec<Vec<f32>> {
    let (json, bin) = parts(bytes);
    let accessor = &json["accessors"][accessor];
    let view = &json["bufferViews"][accessor["bufferView"].as_u64().unwrap() as usize];
    let number = |value: &serde_json::Value| value.as_u64().unwrap_or_default() as usize;
    let numbers = match accessor["type"].as_str().unwrap() {
        "SCALAR" => 1,
        "VEC2" => 2,
        "VEC3" => 3,
        _ => 4,
    };
    let stride = view["byteStride"].as_u64().map_or(4 * numbers, |s| s as usize);
    let start = number(&view["byteOffset"]) + number(&accessor["byteOffset"]);
    let row = |i: usize| {
        let at = start + i * stride;
        bin[at..at + 4 * numbers].chunks(4).map(|b| f32::from_le_bytes(b.try_into().unwrap())).collect()
    };
    (0..number(&accessor["count"])).map(row).collect()
}

fn vectors(bytes: &[u8], accessor: usize) -> Vec<Vec3> {
    values(bytes, accessor).iter().map(|row| Vec3::from_slice(row)).collect()
}

/// Checks that `min` and `max` are just those of an accessor's numbers.
fn check_limits(bytes: &[u8], accessor: usize) {
    let (json, _) = parts(bytes);
    let all = values(bytes, accessor);
    for (name, of) in [("min", f32::min as fn(f32, f32) -> f32), ("max", f32::max)] {
        let numbers: Vec<f64> = serde_json::from_value(json["accessors"][accessor][name].clone()).unwrap();
        let told: Vec<f32> = numbers.iter().map(|v| *v as f32).collect();
        let column = |c: usize| all.iter().map(|row| row[c]).reduce(of).unwrap();
        assert_eq!(told, (0..all[0].len()).map(column).collect::<Vec<_>>());
    }
}

/// Moves all vertices of the world by a linear map and a shift: normals by its cofactor, tangents by itself.
fn carry(edited: &mut Edited, map: DAffine3) {
    let (linear, side) = (map.matrix3, map.matrix3.determinant().signum());
    edited.positions.iter_mut().for_each(|p| *p = map.transform_point3(*p));
    for n in &mut edited.normals {
        let turned = linear.inverse().transpose() * n.as_dvec3();
        *n = (turned.normalize_or_zero() * n.as_dvec3().length()).as_vec3();
    }
    edited.gradients.fill(linear.as_mat3());
    edited.mirrored = side < 0.0;
}

fn check_near(found: &[Vec3], expected: &[DVec3], bound: f64) {
    assert_eq!(found.len(), expected.len());
    for (i, (found, expected)) in found.iter().zip(expected).enumerate() {
        assert!((found.as_dvec3() - *expected).length() <= bound, "{i}: {found} for {expected}");
    }
}

const PRIMITIVE: &str = "{\"attributes\":{\"POSITION\":0}}";

/// Two meshes: rows with all attributes between each other, and all of them apart; colours, indices of all
/// types, an image, and what nobody knows.
fn rich() -> Glb {
    let mut glb = Glb::default();
    let (all, count) = (points(30), 12);
    glb.bin.extend([1, 2, 3, 4]);
    // Normal, position, something else, tangent.
    let of_row = |i: usize| {
        let (n, p) = (all[i + 3].normalize_or(Vec3::X), all[i]);
        let t = n.any_orthonormal_vector();
        [
            &n.to_array()[..],
            &p.to_array(),
            &[7.5, i as f32],
            &t.to_array(),
            &[if i.is_multiple_of(2) { 1.0 } else { -1.0 }],
        ]
        .concat()
    };
    let together: Vec<Vec<f32>> = (0..count).map(of_row).collect();
    let view = glb.view(&floats(&together), Some(48));
    let of_first = limits(&all[..count]);
    glb.accessor(view, 12, FLOAT, count, "VEC3", &of_first);
    glb.accessor(view, 0, FLOAT, count, "VEC3", "");
    glb.accessor(view, 24, FLOAT, count, "VEC2", "");
    glb.accessor(view, 32, FLOAT, count, "VEC4", "");
    let colours: Vec<u8> = (0..count).flat_map(|i| [i as u8, 10, 255, 40]).collect();
    let colours = glb.view(&colours, None);
    glb.accessor(colours, 0, 5121, count, "VEC4", ",\"normalized\":true");
    glb.indices(&[0, 1, 2, 2, 1, 11, 5, 6, 7], 5121);
    // The second: normals before positions.
    // With how far they reach, as some programs have it.
    glb.floats(&rows(&all[5..25]), &limits(&all[5..25]));
    glb.positions(&all[10..30]);
    let tangents: Vec<Vec<f32>> =
        all[..20].iter().map(|p| p.normalize_or(Vec3::Y).extend(-1.0).to_array().to_vec()).collect();
    // Wrong, as it happens.
    glb.floats(&tangents, ",\"max\":[1,1,1,9]");
    let colours: Vec<u8> = (0..20).flat_map(|i| [3 * i as u8, 20, 30, 0]).collect();
    let colours = glb.view(&colours, Some(4));
    glb.accessor(colours, 0, 5121, 20, "VEC3", ",\"normalized\":true");
    glb.indices(&[0, 1, 2, 3, 4, 19], 5123);
    let image = glb.view(b"\x89PNG no picture", None);
    glb.rest = format!(
        ",\"images\":[{{\"bufferView\":{image},\"mimeType\":\"image/png\"}}],\"extras\":{{\"a\" : [1,  2.50]}}"
    );
    glb.shown(
        "{\"attributes\":{\"POSITION\":0,\"NORMAL\":1,\"TEXCOORD_0\":2,\"TANGENT\":3,\"COLOR_0\":4},\"indices\":5}",
        "",
    );
    glb.shown(
        "{\"attributes\":{\"POSITION\":7,\"NORMAL\":6,\"TANGENT\":8,\"COLOR_0\":9},\"indices\":10,\"mode\":5},\
         {\"attributes\":{\"POSITION\":7,\"NORMAL\":6,\"TANGENT\":8,\"COLOR_0\":9},\"mode\":6}",
        ",\"name\":\"a \\u0041\"",
    );
    glb
}

#[test]
fn a_file_is_read_whole_and_comes_back() {
    let glb = rich();
    let bytes = glb.bytes();
    let model = check_whole(&bytes, ".glb");
    let info = model.info();
    assert_eq!((info.vertices, info.faces, info.has_normals), (32, 3 + 4 + 18, true));
    assert_eq!(info.format, "glTF 2.0, binary, 2 meshes, by by \u{e4} hand");
    assert_eq!(info.position_type, Scalar::F32);
    assert_eq!(info.other_properties, ["float TEXCOORD_0", "uchar COLOR_0"]);
    let names: Vec<&str> = info.attributes.iter().map(|a| a.name.as_str()).collect();
    assert_eq!(names, ["red", "green", "blue"]);
    let (positions, normals) = read(model.as_ref()).unwrap();
    let expected = [vectors(&bytes, 0), vectors(&bytes, 7)].concat();
    assert_eq!(positions, expected.iter().map(|p| p.as_dvec3()).collect::<Vec<_>>());
    assert_eq!(normals, [vectors(&bytes, 1), vectors(&bytes, 6)].concat());
    let mut of_faces = vec![[0, 1, 2], [2, 1, 11], [5, 6, 7]];
    of_faces.extend([[12, 13, 14], [13, 15, 14], [14, 15, 16], [15, 31, 16]]);
    of_faces.extend((12..30).map(|i| [i + 1, i + 2, 12]));
    assert_eq!(triangles(model.as_ref()).unwrap(), of_faces);

    // Colours of chunks that are of one mesh each.
    let mut reader = model.vertices(0..u64::MAX).unwrap();
    let (mut chunk, mut red) = (VertexChunk::default(), Vec::new());
    while reader.read(&mut chunk).unwrap() {
        let mut to = vec![vec![1.0]; 3];
        model.attributes(&chunk, &mut to).unwrap();
        red.append(&mut to[0]);
        // The file has linear light: 10 and 20 of 255.
        assert!(to[1].iter().all(|g| *g == 56.0 || *g == 79.0));
    }
    let linear = (0..12).map(f64::from).chain((0..20).map(|i| f64::from(3 * i)));
    let of_srgb = |x: f64| {
        let x = x / 255.0;
        (255.0 * if x <= 0.0031308 { 12.92 * x } else { 1.055 * x.powf(1.0 / 2.4) - 0.055 }).round()
    };
    assert_eq!(red, linear.map(of_srgb).collect::<Vec<_>>());
}

#[test]
fn a_motion_changes_what_it_should_and_nothing_else() {
    let glb = rich();
    let bytes = glb.bytes();
    let model = open(&bytes, ".glb").unwrap();
    let maps = [
        DAffine3::from_rotation_translation(DQuat::from_rotation_y(0.8), DVec3::new(1.0, -200.0, 3e5)),
        // A shear.
        DAffine3 {
            matrix3: DMat3::from_cols(DVec3::X, DVec3::new(0.7, 1.0, 0.0), DVec3::new(0.0, 0.3, 2.0)),
            translation: DVec3::ZERO,
        },
        // A mirror.
        DAffine3::from_scale(DVec3::new(1.0, 1.0, -1.0)),
    ];
    for map in maps {
        let out = rewrite(model.as_ref(), |edited| carry(edited, map)).unwrap();
        let linear = map.matrix3;
        let mirrors = linear.determinant() < 0.0;
        for accessor in [0, 7] {
            let expected: Vec<DVec3> =
                vectors(&bytes, accessor).iter().map(|p| map.transform_point3(p.as_dvec3())).collect();
            check_near(&vectors(&out, accessor), &expected, 0.02);
            check_limits(&out, accessor);
        }
        check_limits(&out, 6);
        let side = parts(&out).0["accessors"][8]["max"][3].as_f64();
        assert_eq!(side, Some(if mirrors { 1.0 } else { -1.0 }));
        for accessor in [1, 6] {
            let turned = |n: &Vec3| {
                (linear.inverse().transpose() * n.as_dvec3()).normalize_or_zero() * n.as_dvec3().length()
            };
            let expected: Vec<DVec3> = vectors(&bytes, accessor).iter().map(turned).collect();
            check_near(&vectors(&out, accessor), &expected, 1e-6);
        }
        for accessor in [3, 8] {
            let (old, new) = (values(&bytes, accessor), values(&out, accessor));
            for (old, new) in old.iter().zip(&new) {
                let (old, new) = (Vec4::from_slice(old), Vec4::from_slice(new));
                assert_eq!(new.w, if mirrors { -old.w } else { old.w });
                let expected = (linear * old.xyz().as_dvec3()).normalize_or_zero();
                assert!((new.xyz().as_dvec3() - expected).length() < 1e-6);
            }
        }
        assert_eq!(values(&out, 2), values(&bytes, 2));
        // All bytes but those.
        let (of_old, of_new) = (parts(&bytes).1, parts(&out).1);
        let mut changed = vec![false; of_old.len()];
        let mut change = |start: usize, stride: usize, count: usize, size: usize| {
            (0..count).for_each(|i| changed[start + i * stride..start + i * stride + size].fill(true));
        };
        change(4, 48, 12, 24);
        change(4 + 32, 48, 12, 16);
        let at = 4 + 48 * 12 + 48 + 12;
        change(at, 12, 40, 12);
        change(at + 480, 16, 20, 16);
        assert!((0..of_old.len()).all(|i| changed[i] || of_old[i] == of_new[i]));
        // All text but numbers is kept.
        let text = |bytes: &[u8]| {
            let json = &bytes[20..20 + u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize];
            let mut text = String::from_utf8(json.to_vec()).unwrap().trim_end().to_string();
            for name in ["min\" : [", "max\":["] {
                let mut from = 0;
                while let Some(at) = text[from..].find(name) {
                    let start = from + at + name.len();
                    let end = start + text[start..].find(']').unwrap();
                    let kept: String = text[start..end].chars().filter(|c| ", ".contains(*c)).collect();
                    text.replace_range(start..end, &kept);
                    from = start;
                }
            }
            text
        };
        assert_eq!(text(&out), text(&bytes));
        go_over(&out, ".glb").unwrap();
    }
}

#[test]
fn what_does_not_move_keeps_its_bytes() {
    let bytes = rich().bytes();
    let model = open(&bytes, ".glb").unwrap();
    // The first vertex of the second mesh alone.
    let out = rewrite(model.as_ref(), |edited| {
        if edited.positions.len() == 20 && !edited.positions.is_empty() {
            edited.positions[0].x += 5.0;
        }
    })
    .unwrap();
    let (old, new) = (vectors(&bytes, 7), vectors(&out, 7));
    assert_eq!(new[0], old[0] + Vec3::X * 5.0);
    assert_eq!(new[1..], old[1..]);
    for accessor in [0, 1, 3, 6, 8] {
        assert_eq!(values(&bytes, accessor), values(&out, accessor));
    }
    let limits = |bytes: &[u8], i: usize| parts(bytes).0["accessors"][i].clone();
    assert_eq!(limits(&bytes, 0), limits(&out, 0));
    check_limits(&out, 7);
}

/// Nodes that turn, scale without measure, and mirror.
fn placed() -> (Glb, DAffine3) {
    let mut glb = Glb::default();
    let all = points(40);
    glb.positions(&all);
    let normals: Vec<Vec3> = all.iter().map(|p| p.normalize_or(Vec3::X)).collect();
    glb.floats(&rows(&normals), "");
    let tangents: Vec<Vec<f32>> =
        normals.iter().map(|n| n.any_orthonormal_vector().extend(1.0).to_array().to_vec()).collect();
    glb.floats(&tangents, "");
    glb.shown(
        "{\"attributes\":{\"POSITION\":0,\"NORMAL\":1,\"TANGENT\":2}}",
        ",\"rotation\":[0.6,0,0,0.8],\"scale\":[-2,1,0.5]",
    );
    glb.nodes.push("{\"children\":[0],\"matrix\":[1,0,0,0,0,0,1,0,0,-1,0,0,1000,2000,-3,1]}".into());
    let own = DAffine3::from_scale_rotation_translation(
        DVec3::new(-2.0, 1.0, 0.5),
        DQuat::from_xyzw(0.6, 0.0, 0.0, 0.8),
        DVec3::ZERO,
    );
    let parent = DAffine3 {
        matrix3: DMat3::from_cols(DVec3::X, DVec3::Z, DVec3::NEG_Y),
        translation: DVec3::new(1000.0, 2000.0, -3.0),
    };
    (glb, parent * own)
}

#[test]
fn vertices_are_where_nodes_take_them() {
    let (glb, world) = placed();
    let bytes = glb.bytes();
    let model = check_whole(&bytes, ".glb");
    assert_eq!(model.info().position_type, Scalar::F64);
    let (positions, normals) = read(model.as_ref()).unwrap();
    let linear = world.matrix3;
    for (i, p) in vectors(&bytes, 0).iter().enumerate() {
        assert!((positions[i] - world.transform_point3(p.as_dvec3())).length() < 1e-9);
        let normal = (linear.inverse().transpose() * vectors(&bytes, 1)[i].as_dvec3()).normalize_or_zero();
        assert!((normals[i].as_dvec3() - normal).length() < 1e-6);
    }
    // In a mirror, triangles go round the other way.
    assert_eq!(triangles(model.as_ref()).unwrap()[0], [0, 2, 1]);

    for map in [
        DAffine3::from_rotation_translation(DQuat::from_rotation_z(1.0), DVec3::new(5.0, 0.0, 1.0)),
        DAffine3::from_scale(DVec3::new(1.0, -1.0, 1.0)),
        DAffine3::from_scale(DVec3::new(1.0, 3.0, 0.5)),
    ] {
        let out = rewrite(model.as_ref(), |edited| carry(edited, map)).unwrap();
        let local = world.inverse() * map * world;
        let of_local = local.matrix3;
        let expected: Vec<DVec3> =
            vectors(&bytes, 0).iter().map(|p| local.transform_point3(p.as_dvec3())).collect();
        check_near(&vectors(&out, 0), &expected, 1e-3);
        check_limits(&out, 0);
        let turned = |n: &Vec3| (of_local.inverse().transpose() * n.as_dvec3()).normalize_or_zero();
        let expected: Vec<DVec3> = vectors(&bytes, 1).iter().map(turned).collect();
        check_near(&vectors(&out, 1), &expected, 1e-5);
        for (i, tangent) in values(&out, 2).iter().enumerate() {
            let tangent = Vec4::from_slice(tangent);
            let old = Vec4::from_slice(&values(&bytes, 2)[i]);
            assert!(
                (tangent.xyz().as_dvec3() - (of_local * old.xyz().as_dvec3()).normalize_or_zero()).length()
                    < 1e-5
            );
            // The bitangent goes with the surface, too.
            let bitangent = |n: Vec3, t: Vec4| (n.cross(t.xyz()) * t.w).as_dvec3();
            let (before, after) =
                (bitangent(vectors(&bytes, 1)[i], old), bitangent(vectors(&out, 1)[i], tangent));
            assert!((of_local * before).dot(after) > 0.0);
        }
    }
}

#[test]
fn skinned_meshes_stay_in_their_own_frame() {
    let mut glb = Glb::default();
    glb.positions(&points(5));
    let weights: Vec<Vec<f32>> = vec![vec![1.0, 0.0, 0.0, 0.0]; 5];
    glb.floats(&weights, "");
    let joints = glb.view(&[0; 20], None);
    glb.accessor(joints, 0, 5121, 5, "VEC4", "");
    let target = glb.floats(&rows(&points(5)), "");
    let primitive = format!(
        "{{\"attributes\":{{\"POSITION\":0,\"WEIGHTS_0\":1,\"JOINTS_0\":2}},\"targets\":[{{\"POSITION\":{target}}}]}}"
    );
    glb.shown(&primitive, ",\"skin\":0,\"translation\":[7,0,0]");
    glb.rest = ",\"skins\":[{\"joints\":[0]}]".into();
    let bytes = glb.bytes();
    let model = check_whole(&bytes, ".glb");
    let (positions, _) = read(model.as_ref()).unwrap();
    assert_eq!(positions[0], points(1)[0].as_dvec3());
    assert_eq!(
        model.info().other_properties,
        ["float WEIGHTS_0", "uchar JOINTS_0", "morph targets", "skins"]
    );
    let out = rewrite(model.as_ref(), |edited| edited.positions.iter_mut().for_each(|p| p.y += 1.0)).unwrap();
    assert_eq!(values(&out, 1), values(&bytes, 1));
    assert_eq!(values(&out, target), values(&bytes, target));
}

#[test]
fn what_is_shared_counts_once() {
    let mut glb = Glb::default();
    glb.positions(&points(9));
    // The same bytes by another accessor.
    let again = glb.accessor(0, 0, FLOAT, 9, "VEC3", &limits(&points(9)));
    glb.indices(&[0, 1, 2], 5125);
    glb.indices(&[2, 1, 0, 8, 9, 700], 5123);
    glb.shown(
        &format!("{{\"attributes\":{{\"POSITION\":0}},\"indices\":2}},{{\"attributes\":{{\"POSITION\":{again}}},\"indices\":3}},{{\"attributes\":{{\"POSITION\":0}},\"mode\":0}}"),
        "",
    );
    // At the same place twice.
    glb.nodes.push("{\"mesh\":0,\"translation\":[0,0,0]}".into());
    let bytes = glb.bytes();
    let model = check_whole(&bytes, ".glb");
    assert_eq!((model.info().vertices, model.info().faces), (9, 3));
    // An index that is of no vertex.
    assert_eq!(triangles(model.as_ref()).unwrap(), [[0, 1, 2], [2, 1, 0], [8, u32::MAX, u32::MAX]]);
    let out = rewrite(model.as_ref(), |edited| edited.positions.iter_mut().for_each(|p| p.y *= 3.0)).unwrap();
    check_limits(&out, 0);
    check_limits(&out, again);
}

#[test]
fn nodes_that_no_scene_has_show_nothing() {
    let of = |scenes: &str, nodes: &[&str]| {
        let mut glb = Glb::default();
        glb.positions(&points(9));
        glb.positions(&points(5));
        glb.mesh("{\"attributes\":{\"POSITION\":0}}");
        glb.mesh("{\"attributes\":{\"POSITION\":1}}");
        glb.nodes.extend(nodes.iter().map(|node| format!("{{{node}}}")));
        glb.rest = format!(",\"scenes\":[{scenes}]");
        glb.bytes()
    };
    let nodes = ["\"mesh\":0", "\"mesh\":0,\"scale\":[0,0,0]", "\"children\":[3]", "\"mesh\":1"];
    let vertices = |scenes: &str| check_whole(&of(scenes, &nodes), ".glb").info().vertices;
    assert_eq!(vertices("{\"nodes\":[0]}"), 9);
    assert_eq!(vertices("{\"nodes\":[0]},{\"nodes\":[2]}"), 14);
    assert_eq!(vertices("{\"nodes\":[2,2]}"), 5);
    assert_eq!(message(open(&of("{\"nodes\":[4]}", &nodes), ".glb")), "a scene has node 4, of 4");
    // Without a scene, all show what they have.
    for scenes in ["", "{}"] {
        assert_eq!(
            message(open(&of(scenes, &nodes), ".glb")),
            "node 1: its matrix is singular, so that nothing leads back from the world"
        );
        assert_eq!(check_whole(&of(scenes, &["\"mesh\":1"]), ".glb").info().vertices, 5);
    }
    let lie = of("{\"nodes\":[0]}", &["\"mesh\":0", "\"mesh\":7"]);
    assert_eq!(message(open(&lie, ".glb")), "node 1 shows mesh 7, of 2");
}

#[test]
fn normals_that_meshes_share_become_the_mean_or_stay() {
    let mut glb = Glb::default();
    glb.positions(&points(6));
    let moved: Vec<Vec3> = points(6).iter().map(|p| *p + Vec3::X * 10.0).collect();
    glb.positions(&moved);
    let normals = vec![vec![0.0, 0.0, 1.0]; 6];
    glb.floats(&normals, "");
    glb.shown("{\"attributes\":{\"POSITION\":0,\"NORMAL\":2}}", "");
    glb.shown("{\"attributes\":{\"POSITION\":1,\"NORMAL\":2}}", "");
    let bytes = glb.bytes();
    let model = check_whole(&bytes, ".glb");
    // All by the same angle, and the two meshes by others.
    let turned = |angle: f32| Vec3::new(angle.sin(), 0.0, angle.cos());
    let out =
        rewrite(model.as_ref(), |edited| edited.normals.iter_mut().for_each(|n| *n = turned(0.5))).unwrap();
    check_near(&vectors(&out, 2), &[turned(0.5).as_dvec3(); 6], 1e-6);
    let out = rewrite(model.as_ref(), |edited| {
        let normals = edited.positions.iter().map(|p| if p.x > 5.0 { turned(1.0) } else { turned(0.0) });
        edited.normals = normals.take(edited.normals.len()).collect();
    })
    .unwrap();
    assert_eq!(values(&out, 2), normals);
}

#[test]
fn meshes_without_normals_are_among_others() {
    let mut glb = Glb::default();
    glb.positions(&points(4));
    glb.positions(&points(5));
    glb.floats(&vec![vec![0.0, 1.0, 0.0]; 5], "");
    glb.shown(PRIMITIVE, "");
    glb.shown("{\"attributes\":{\"POSITION\":1,\"NORMAL\":2}}", "");
    glb.shown("{\"attributes\":{}}", "");
    let bytes = glb.bytes();
    let model = check_whole(&bytes, ".glb");
    assert!(!model.info().has_normals);
    // But they turn.
    let out = rewrite(model.as_ref(), |edited| edited.normals.iter_mut().for_each(|n| *n = Vec3::X)).unwrap();
    assert_eq!(vectors(&out, 2), [Vec3::X; 5]);
}

#[test]
fn text_is_as_precise_as_it_has_to_be_and_has_room() {
    let mut glb = Glb::default();
    let flat = [Vec3::ZERO, Vec3::X, Vec3::Y];
    glb.floats(&rows(&flat), ",\"max\":[1,1,0],\"min\":[0,0,0]");
    glb.shown(PRIMITIVE, "");
    let bytes = glb.bytes();
    let model = open(&bytes, ".glb").unwrap();
    let shift = DVec3::new(-1.234_567_89e-20, -1.0e20 / 3.0, 0.1);
    let out = rewrite(model.as_ref(), |edited| {
        edited.positions.iter_mut().for_each(|p| *p = (*p + DVec3::ONE) * shift)
    })
    .unwrap();
    check_limits(&out, 0);
    assert_eq!(out.len() % 4, 0);
    let json = String::from_utf8_lossy(&out);
    assert!(json.contains("0.1]"), "{json}");
    // A second time there is other room.
    let model = open(&out, ".glb").unwrap();
    let back = rewrite(model.as_ref(), |edited| {
        edited.positions.iter_mut().for_each(|p| *p = *p / shift - DVec3::ONE)
    })
    .unwrap();
    check_limits(&back, 0);
}

#[test]
fn a_gltf_with_its_buffers_becomes_a_glb() {
    let folder = tempfile::tempdir().unwrap();
    let glb = rich();
    let whole = open(&glb.bytes(), ".glb").unwrap();
    let expected =
        rewrite(whole.as_ref(), |edited| edited.positions.iter_mut().for_each(|p| *p *= 2.0)).unwrap();
    let data = format!(",\"uri\":\"data:application/octet-stream;base64,{}\"", STANDARD.encode(&glb.bin));
    // Two buffers: all views of the second have their place in it.
    let mut two = glb.clone();
    let cut = 4 + 48 * 12;
    for (i, view) in two.views.iter_mut().enumerate().skip(1) {
        let start = view.find("byteOffset\":").unwrap() + 12;
        let end = start + view[start..].find(',').unwrap();
        let at: usize = view[start..end].parse().unwrap();
        let at = at - cut;
        view.replace_range(start..end, &at.to_string());
        *view = view.replace("\"buffer\":0", "\"buffer\" : 1");
        if i == 1 {
            assert_eq!(at, 0);
            *view = view.replace(",\"byteOffset\":0", "");
        }
    }
    let rest = glb.bin.len() - cut;
    let both = two.json(",\"uri\":\"first%20one.bin\"");
    let both = both.replace(
        &format!("\"byteLength\":{},\"uri\"", glb.bin.len()),
        &format!("\"byteLength\":{cut},\"uri\""),
    );
    let both = both
        .replace("one.bin\"}]", &format!("one.bin\"}},{{\"uri\":\"second.bin\",\"byteLength\":{rest}}}]"));
    for (name, json) in [
        ("beside.gltf", glb.json(",\"uri\":\"whole.bin\"")),
        ("within.gltf", glb.json(&data)),
        ("unknown", glb.json(&data)),
        ("two.gltf", both),
    ] {
        let path = folder.path().join(name);
        for (name, bytes) in [
            (name, json.as_bytes()),
            ("whole.bin", &glb.bin),
            ("first one.bin", &glb.bin[..cut]),
            ("second.bin", &glb.bin[cut..]),
        ] {
            std::fs::File::create(folder.path().join(name)).unwrap().write_all(bytes).unwrap();
        }
        let model = simod_model::open(&path).unwrap();
        assert!(model.info().format.contains("with separate buffers"));
        assert_eq!(model.extensions(), ["glb"]);
        let files = if name == "two.gltf" { 2 } else { usize::from(name == "beside.gltf") };
        assert_eq!(model.other_files().len(), files);
        assert_eq!(
            format!("{:?}", read(model.as_ref()).unwrap()),
            format!("{:?}", read(whole.as_ref()).unwrap())
        );
        assert_eq!(triangles(model.as_ref()).unwrap(), triangles(whole.as_ref()).unwrap());
        let out =
            rewrite(model.as_ref(), |edited| edited.positions.iter_mut().for_each(|p| *p *= 2.0)).unwrap();
        go_over(&out, ".glb").unwrap();
        let (json, bin) = parts(&out);
        assert_eq!(json["buffers"].as_array().unwrap().len(), 1);
        assert!(json["buffers"][0].get("uri").is_none());
        assert_eq!(json["accessors"], parts(&expected).0["accessors"]);
        assert_eq!(json["bufferViews"], parts(&expected).0["bufferViews"]);
        assert_eq!(bin, parts(&expected).1);
    }
    // The mark of UTF-8 is no part of the JSON.
    let marked = format!("\u{feff}{}", glb.json(&data));
    let model = open(marked.as_bytes(), ".gltf").unwrap();
    assert_eq!(read(model.as_ref()).unwrap().0, read(whole.as_ref()).unwrap().0);
    // Buffers that are missing, too short, or elsewhere.
    let path = folder.path().join("bad.gltf");
    for (uri, says) in [
        ("missing.bin", "buffer 0, \"missing.bin\""),
        ("second.bin", "buffer 0 says"),
        ("https://example.org/a.bin", "buffer 0 is not a file beside it"),
        ("/etc/passwd", "buffer 0 is not a file beside it"),
        ("%zz", "buffer 0 is not a file beside it"),
        ("data:application/octet-stream;base64,*", "buffer 0 is not correct base64"),
        ("data:text/plain,abc", "buffer 0 is a data URI that is not base64"),
    ] {
        let json = glb.json(&format!(",\"uri\":\"{uri}\""));
        std::fs::File::create(&path).unwrap().write_all(json.as_bytes()).unwrap();
        let says_now = message(simod_model::open(&path));
        assert!(says_now.starts_with(says), "{says_now}");
    }
}

/// A member of an accessor that has so many sparse elements, of the first view's bytes.
fn sparse_of(count: u64, kind: &str, indices: usize, values: usize) -> String {
    format!(
        ",\"sparse\":{{\"count\":{count},\"indices\":{{\"bufferView\":0,\"byteOffset\":{indices},\"componentType\":{kind}}},\
         \"values\":{{\"bufferView\":0,\"byteOffset\":{values}}}}}"
    )
}

#[test]
fn sparse_accessors_become_plain() {
    let base = points(9);
    let others = [(2u32, Vec3::new(7.0, 8.0, 9.0)), (8, Vec3::new(-1.0, 0.5, 2.0))];
    let mut expected = base.clone();
    others.iter().for_each(|(place, p)| expected[*place as usize] = *p);
    for (kind, size) in [(5121, 1), (5123, 2), (5125, 4)] {
        let mut made = Glb::default();
        let places: Vec<u8> =
            others.iter().flat_map(|(place, _)| place.to_le_bytes()[..size].to_vec()).collect();
        let (places, values) =
            (made.view(&places, None), made.view(&floats(&rows(&others.map(|o| o.1))), None));
        let sparse = format!(
            ",\"sparse\":{{\"count\":2,\"indices\":{{\"bufferView\":{places},\"componentType\":{kind}}},\
             \"values\":{{\"bufferView\":{values}}}}}"
        );
        // Between other numbers, as one of which the normals are.
        let both: Vec<Vec<f32>> = base.iter().map(|p| [p.to_array(), [0.0, 0.0, 1.0]].concat()).collect();
        let view = made.view(&floats(&both), Some(24));
        let positions = made.accessor(view, 0, FLOAT, 9, "VEC3", &(limits(&expected) + &sparse));
        let normals = made.accessor(view, 12, FLOAT, 9, "VEC3", "");
        let indices = made.indices(&[0, 1, 2, 2, 8, 5], 5123);
        let of = format!("\"POSITION\":{positions},\"NORMAL\":{normals}");
        made.shown(&format!("{{\"attributes\":{{{of}}},\"indices\":{indices}}}"), "");
        let bytes = made.bytes();
        let model = open(&bytes, ".glb").unwrap();
        assert!(model.info().has_normals && model.info().format.starts_with("glTF 2.0, binary, 1 mesh"));
        let (found, turned) = read(&*model).unwrap();
        check_near(
            &found.iter().map(|p| p.as_vec3()).collect::<Vec<_>>(),
            &expected.iter().map(|p| p.as_dvec3()).collect::<Vec<_>>(),
            0.0,
        );
        assert_eq!(turned, [Vec3::Z; 9]);
        assert_eq!(triangles(&*model).unwrap(), [[0, 1, 2], [2, 8, 5]]);
        let map = DAffine3::from_translation(DVec3::new(1.0, 0.0, -2.0));
        let moved = rewrite(&*model, |edited| carry(edited, map)).unwrap();
        let plain: Vec<DVec3> = expected.iter().map(|p| map.transform_point3(p.as_dvec3())).collect();
        check_near(&vectors(&moved, positions), &plain, 1e-6);
        check_limits(&moved, positions);
        let (document, data) = parts(&moved);
        assert!(
            document["accessors"][0].get("sparse").is_none()
                && document["bufferViews"].as_array().unwrap().len() == 5
        );
        // The data that the sparse accessors were made of are still there.
        let (_, old) = parts(&bytes);
        assert!(data.starts_with(&old[..made.bin.len()]));
        check_whole(&moved, ".glb");
        // A chunk that nobody knows stays behind all.
        let chunk: Vec<u8> =
            [4u32, 0x1234_5678, 0x0bad_cafe].iter().flat_map(|word| word.to_le_bytes()).collect();
        let mut more = [&bytes[..], &chunk].concat();
        more[8..12].copy_from_slice(&(bytes.len() as u32 + 12).to_le_bytes());
        assert!(rewrite(&*open(&more, ".glb").unwrap(), |_| {}).unwrap().ends_with(&chunk));
    }
}

#[test]
fn what_cannot_be_deformed_is_refused() {
    let simple = |positions: &str, node: &str, rest: &str| {
        let mut glb = Glb::default();
        glb.positions(&points(6));
        if !positions.is_empty() {
            glb.accessors[0] = positions.into();
        }
        glb.indices(&[0, 1, 2], 5125);
        glb.shown("{\"attributes\":{\"POSITION\":0},\"indices\":1}", node);
        glb.rest = rest.into();
        glb
    };
    let accessor = |rest: &str| {
        format!("{{\"bufferView\":0,\"count\":6,\"componentType\":5126,\"type\":\"VEC3\"{rest}}}")
    };
    let mut cases: Vec<(Glb, &str)> = vec![
        (simple("", ",\"scale\":[1,0,1]", ""), "node 0: its matrix is singular"),
        (
            simple("", ",\"extensions\":{\"EXT_mesh_gpu_instancing\":{}}", ""),
            "node 0 shows its mesh at many places",
        ),
        (simple("", ",\"children\":[0]", ""), "node 0 is below itself"),
        (simple("", ",\"children\":[7]", ""), "node 0 has node 7 as a child, of 1"),
        (
            simple("{\"componentType\":5126,\"count\":6,\"type\":\"VEC3\"}", "", ""),
            "accessor 0 (POSITION) has no data",
        ),
        (
            simple(&accessor(",\"sparse\":{\"count\":1}"), "", ""),
            "what is sparse of accessor 0 makes no sense: missing field `indices`",
        ),
        (
            simple(
                &accessor(&sparse_of(1, "5125", 0, 0)).replace("\"bufferView\":0,\"count\":6", "\"count\":6"),
                "",
                "",
            ),
            "accessor 0 is sparse, and has no data beneath",
        ),
        (
            simple(&accessor(&sparse_of(1, "5126", 0, 0)), "", ""),
            "the sparse indices of accessor 0 are no whole numbers",
        ),
        (
            simple(&accessor(&sparse_of(1 << 60, "5125", 0, 0)), "", ""),
            "accessor 0 says 1152921504606846976 sparse elements",
        ),
        (
            simple(&accessor(&sparse_of(1, "5125", 70, 0)), "", ""),
            "accessor 0 says 1 sparse elements, but bufferView 0",
        ),
        (
            simple(&accessor(&sparse_of(1, "5125", 9, 0)), "", ""),
            "accessor 0 has 6 elements, but its sparse indices",
        ),
        (simple(&accessor("").replace("5126", "5122"), "", ""), "accessor 0 (POSITION) is quantised"),
        (
            simple(&accessor("").replace("VEC3", "VEC2"), "", ""),
            "accessor 0 (POSITION) is of type VEC2, not VEC3",
        ),
        (simple(&accessor("").replace("VEC3", "VEC7"), "", ""), "accessor 0 is of type \"VEC7\""),
        (
            simple(&accessor("").replace("\"count\":6", "\"count\":7"), "", ""),
            "accessor 0 says 7 elements of 12 bytes",
        ),
        (
            simple(&accessor("").replace("\"count\":6", "\"count\":18446744073709551615"), "", ""),
            "accessor 0 says 18446744073709551615",
        ),
        (simple(&accessor("").replace("\"count\":6", "\"count\":-6"), "", ""), "its JSON makes no sense"),
        (simple(&accessor(",\"byteOffset\":18446744073709551615"), "", ""), "accessor 0 says"),
        (simple(&accessor("").replace("View\":0", "View\":9"), "", ""), "bufferView 9 of 2"),
        (simple(&accessor(",\"min\":[1,2]"), "", ""), "min of accessor 0 is not 3 numbers"),
        (simple("", "", ",\"images\":[{\"bufferView\":0}]"), "image 0 and the vertices from byte"),
        (
            simple("", "", ",\"skins\":[{\"inverseBindMatrices\":0}]"),
            "accessor 0 (matrices of skin 0) and the vertices",
        ),
    ];
    let mut add = |change: &dyn Fn(&mut Glb), says: &'static str| {
        let mut glb = simple("", "", "");
        change(&mut glb);
        cases.push((glb, says));
    };
    add(
        &|glb| glb.nodes.push("{\"mesh\":0,\"translation\":[1,0,0]}".into()),
        "nodes 0 and 1 show mesh 0 at two places",
    );
    add(
        &|glb| glb.shown(PRIMITIVE, ",\"scale\":[2,2,2]"),
        "nodes 0 and 1 show the positions of accessor 0 at two places",
    );
    add(
        &|glb| glb.nodes.extend(["{\"children\":[0]}".into(), "{\"children\":[0]}".into()]),
        "node 0 is a child of node 1 and of node 2",
    );
    add(
        &|glb| glb.nodes.extend(["{\"children\":[2]}".into(), "{\"children\":[1]}".into()]),
        "node 1 is below itself",
    );
    add(&|glb| glb.nodes[0] = "{\"mesh\":5}".into(), "node 0 shows mesh 5, of 1");
    add(&|glb| glb.nodes.clear(), "none of its nodes shows a mesh");
    add(
        &|glb| glb.meshes[0] = "{\"primitives\":[{\"attributes\":{\"POSITION\":0},\"mode\":9}]}".into(),
        "mesh 0, primitive 0 is of mode 9",
    );
    add(
        &|glb| glb.meshes[0] = "{\"primitives\":[{\"attributes\":{\"POSITION\":44}}]}".into(),
        "accessor 44 of 2",
    );
    add(
        &|glb| glb.meshes[0] = "{\"primitives\":[{\"attributes\":{\"POSITION\":0},\"indices\":0}]}".into(),
        "accessor 0 (indices) is of type VEC3",
    );
    add(
        &|glb| {
            glb.meshes[0] =
                "{\"primitives\":[{\"attributes\":{\"POSITION\":0},\"targets\":[{\"POSITION\":0}]}]}".into()
        },
        "accessor 0 (POSITION of a morph target of mesh 0",
    );
    add(
        &|glb| {
            glb.meshes[0] = "{\"primitives\":[{\"attributes\":{\"POSITION\":0},\"extensions\":{\"KHR_draco_mesh_compression\":{}}}]}".into()
        },
        "mesh 0 is compressed (KHR_draco_mesh_compression)",
    );
    add(
        &|glb| glb.views[0].insert_str(1, "\"extensions\":{\"EXT_meshopt_compression\":{}},"),
        "bufferView 0 is compressed",
    );
    add(&|glb| glb.views[0] = "{\"buffer\":0,\"byteLength\":9999}".into(), "bufferView 0 says 9999 bytes");
    add(
        &|glb| glb.views[0] = "{\"buffer\":0,\"byteOffset\":18446744073709551615,\"byteLength\":72}".into(),
        "bufferView 0 says 72 bytes",
    );
    add(&|glb| glb.views[0] = "{\"buffer\":3,\"byteLength\":72}".into(), "bufferView 0 is of buffer 3");
    add(
        &|glb| glb.views[0] = "{\"buffer\":0,\"byteLength\":72,\"byteStride\":8}".into(),
        "bufferView 0 has a byteStride of 8",
    );
    add(
        &|glb| glb.views[0] = "{\"buffer\":0,\"byteLength\":72,\"byteStride\":4000000000}".into(),
        "bufferView 0 has a byteStride",
    );
    // Positions over each other, in part.
    add(
        &|glb| {
            let more = glb.accessor(0, 12, FLOAT, 5, "VEC3", "");
            glb.shown(&format!("{{\"attributes\":{{\"POSITION\":{more}}}}}"), "");
        },
        "the positions from byte",
    );
    // Normals that are the positions, and too few of them.
    add(
        &|glb| glb.meshes[0] = "{\"primitives\":[{\"attributes\":{\"POSITION\":0,\"NORMAL\":0}}]}".into(),
        "the positions from byte",
    );
    add(
        &|glb| {
            let normals = glb.floats(&rows(&points(5)), "");
            glb.meshes[0] =
                format!("{{\"primitives\":[{{\"attributes\":{{\"POSITION\":0,\"NORMAL\":{normals}}}}}]}}");
        },
        "mesh 0, primitive 0: 5 NORMAL (accessor 2) for 6 positions",
    );
    for (glb, says) in cases {
        let opened = open(&glb.bytes(), ".glb");
        assert!(opened.is_err(), "no error for {says}");
        let found = message(opened);
        assert!(found.starts_with(says), "{found}\n   for {says}");
    }
    let bytes = simple("", "", "").bytes();
    let json = simple("", "", "").json("");
    let bad = |at: usize, value: u32| {
        let mut bytes = bytes.clone();
        bytes[at..at + 4].copy_from_slice(&value.to_le_bytes());
        message(open(&bytes, ".glb"))
    };
    assert!(bad(4, 1).starts_with("GLB of version 1"));
    assert!(bad(8, bytes.len() as u32 + 1).starts_with("says "));
    assert!(bad(12, u32::MAX).starts_with("the chunk at byte 12 says 4294967295 bytes"));
    assert!(bad(16, 7).starts_with("its first chunk is not JSON"));
    let bin_at = 20 + json.len().next_multiple_of(4);
    assert!(bad(bin_at, 0x4000_0000).starts_with(&format!("the chunk at byte {bin_at} says")));
    assert!(bad(bin_at + 4, 7).starts_with("buffer 0 says"));
    for (old, new, says) in [
        ("\"version\":\"2.0\"", "\"version\":\"1.0\"", "glTF of version \"1.0\""),
        ("\"version\":\"2.0\"", "\"version\":\"2.0\",\"minVersion\":\"2.1\"", "glTF of version \"2.1\""),
        ("\"asset\":{", "\"assets\":{", "its JSON makes no sense: missing field `asset`"),
    ] {
        let json = json.replacen(old, new, 1);
        let found = message(open(&glb(&json, &rich().bin), ".glb"));
        assert!(found.starts_with(says), "{found}\n   for {says}");
    }
}

#[test]
fn vertices_that_do_not_fit_are_refused() {
    let model = open(&rich().bytes(), ".glb").unwrap();
    let result = rewrite(model.as_ref(), |edited| edited.positions[1].y = 1e39);
    assert_eq!(message(result), "vertex 1 moves to 1e39, too far for the type float of the file");
    let mut edits = 0;
    let result = rewrite(model.as_ref(), |edited| {
        edits += 1;
        edited.positions[3].z = f64::NAN;
    });
    assert!(message(result).contains("vertex 3") || edits > 1);
    let how = Rewriting { normals: Normals::Drop, ..Rewriting::default() };
    let refused = model.rewrite(&mut [], how, &|_: &VertexChunk, _: &mut [Edited]| Ok(()), &Silent);
    assert_eq!(message(refused), "normals cannot be left out of a file of this format");
}

#[test]
fn what_is_left_of_a_file_is_an_error_or_sane() {
    check_bad(&placed().0.bytes(), ".glb");
    let text = placed().0.json(",\"uri\":\"data:application/octet-stream;base64,AAAA\"");
    for end in 1..text.len() {
        let _ = open(&text.as_bytes()[..end], ".gltf");
    }
}

proptest! {
    #[test]
    fn bit_flips_are_errors_or_sane(flips in prop::collection::vec((any::<prop::sample::Index>(), 0u32..8), 1..4)) {
        let mut bytes = rich().bytes();
        for (at, bit) in flips {
            let at = at.index(bytes.len());
            bytes[at] ^= 1 << bit;
        }
        let _ = go_over(&bytes, ".glb");
    }

    #[test]
    fn any_layout_is_patched(
        spec in prop::collection::vec((1usize..50, any::<bool>(), any::<bool>(), 0usize..3, 0usize..3, any::<bool>()), 1..5),
        seed in any::<u32>(),
    ) {
        // For each mesh: vertices, whether it has normals and tangents, padding, order, and whether they lie
        // between each other.
        let mut glb = Glb::default();
        let number = |i: usize| ((i as u32).wrapping_mul(2_654_435_761).wrapping_add(seed) >> 8) as f32 / 1e6 - 8.0;
        let mut meshes = Vec::new();
        for (m, (count, has_normals, has_tangents, padding, order, together)) in spec.into_iter().enumerate() {
            let mut kinds = vec![("POSITION", 3)];
            kinds.extend(has_normals.then_some(("NORMAL", 3)));
            kinds.extend(has_tangents.then_some(("TANGENT", 4)));
            kinds.push(("TEXCOORD_0", 2));
            let turn = order % kinds.len();
            kinds.rotate_left(turn);
            let value = |i: usize, c: usize| number(m * 100_000 + i * 16 + c);
            let mut found = Vec::new();
            if together {
                let width: usize = kinds.iter().map(|(_, n)| n).sum::<usize>() + padding;
                let rows: Vec<Vec<f32>> = (0..count).map(|i| (0..width).map(|c| value(i, c)).collect()).collect();
                let view = glb.view(&floats(&rows), Some(4 * width));
                let mut offset = 0;
                for (name, numbers) in kinds {
                    let shape = ["", "", "VEC2", "VEC3", "VEC4"][numbers];
                    found.push((name, glb.accessor(view, offset, FLOAT, count, shape, "")));
                    offset += 4 * numbers;
                }
            } else {
                for (k, (name, numbers)) in kinds.into_iter().enumerate() {
                    let rows: Vec<Vec<f32>> = (0..count).map(|i| (0..numbers).map(|c| value(i, 50 * k + c)).collect()).collect();
                    found.push((name, glb.floats(&rows, "")));
                }
            }
            let names: Vec<String> = found.iter().map(|(name, accessor)| format!("\"{name}\":{accessor}")).collect();
            glb.shown(&format!("{{\"attributes\":{{{}}}}}", names.join(",")), "");
            meshes.push(found);
        }
        let bytes = glb.bytes();
        let model = check_whole(&bytes, ".glb");
        let map = DAffine3::from_rotation_translation(DQuat::from_rotation_x(0.3), DVec3::new(0.0, 1.0, -2.0));
        let linear = map.matrix3;
        let out = rewrite(model.as_ref(), |edited| carry(edited, map)).unwrap();
        for (name, accessor) in meshes.concat() {
            let pairs = values(&bytes, accessor).into_iter().zip(values(&out, accessor));
            for (old, new) in pairs {
                if name == "TEXCOORD_0" {
                    prop_assert_eq!(old, new);
                    continue;
                }
                let (p, q) = (Vec3::from_slice(&old).as_dvec3(), Vec3::from_slice(&new).as_dvec3());
                let expected = if name == "POSITION" { map.transform_point3(p) } else { linear * p };
                prop_assert!((q - expected).length() < 1e-5, "{} {}: {} for {}", name, accessor, q, expected);
            }
        }
    }
}
