//! The sessions of `benches/survey`: all can be run, and what they make is what their pages say.

use std::fs;
use std::path::PathBuf;

use glam::DVec3;
use simod_tests::{Ply, Workplace, workspace};

/// A workplace with the sessions, on fewer samples, and the models that they name.
fn with_sessions() -> (Workplace, Vec<String>) {
    with_sessions_of("benches/survey")
}

/// The same of the sessions in another folder.
fn with_sessions_of(folder: &str) -> (Workplace, Vec<String>) {
    let work = Workplace::new();
    let mut sessions = Vec::new();
    for entry in fs::read_dir(workspace().join(folder)).expect("the folder of the sessions") {
        let path: PathBuf = entry.expect("an entry").path();
        if path.is_dir() {
            continue;
        }
        let name = path.file_name().and_then(|n| n.to_str()).expect("a name").to_owned();
        let text = fs::read_to_string(&path).expect("a text");
        work.write(&name, text.replace("samples = 20000", "samples = 4000"));
        if name.ends_with(".toml") {
            sessions.push(name);
        }
    }
    sessions.sort();
    for shape in ["bumpy-plane", "cylinder", "bar", "cactus"] {
        work.simod(&format!("generate --shape {shape} --vertices 10000 -o {shape}.ply"));
    }
    (work, sessions)
}

/// The signed volume of a generated closed model of one body, in binary.
fn volume(work: &Workplace, name: &str) -> f64 {
    let (bytes, positions) = (work.read(name), work.ply(name).positions());
    // As many triangles as Euler's formula says, at the end: a count and three indices each.
    let faces = bytes[bytes.len() - 13 * (2 * positions.len() - 4)..].chunks_exact(13);
    let corner = |face: &[u8], i: usize| {
        let index = u32::from_le_bytes(face[1 + 4 * i..5 + 4 * i].try_into().expect("four bytes"));
        positions[index as usize]
    };
    faces.map(|face| corner(face, 0).cross(corner(face, 1)).dot(corner(face, 2)) / 6.0).sum()
}

#[test]
fn every_session_can_be_run() {
    let (work, sessions) = with_sessions();
    assert!(sessions.len() >= 15, "{sessions:?}");
    for session in sessions {
        work.simod(&format!("run {session} -o edited.ply"));
        let model = ["bumpy-plane", "cylinder", "bar", "cactus"].iter().find(|m| session.starts_with(**m));
        let rest = work.ply(&format!("{}.ply", model.expect("a shape"))).positions();
        let edited = work.ply("edited.ply").positions();
        let far = rest.iter().zip(&edited).filter(|(p, q)| p.distance(**q) > 0.1).count();
        assert!(10 * far > rest.len(), "{session}: {far} of {} vertices moved", rest.len());
    }
}

/// Sessions of tools that take no handles, with the files that their pages say have to be made first.
#[test]
fn sessions_without_handles_can_be_run() {
    let (work, sessions) = with_sessions_of("benches/survey/others");
    let lifting = fs::read_to_string(workspace().join("benches/survey/bumpy-plane.toml")).expect("a text");
    work.write("bumpy-plane.toml", lifting.replace("samples = 20000", "samples = 4000"));
    work.simod("sample bumpy-plane.ply -o bumpy-plane.simod --samples 4000");
    work.simod("deform bumpy-plane.simod --session bumpy-plane.toml -o bumpy-plane-samples.ply");
    work.simod("run cactus-target.toml -o cactus-target.edited.ply");
    assert!(sessions.len() >= 7, "{sessions:?}");
    for session in sessions {
        work.simod(&format!("run {session} -o edited.ply"));
        let model = ["bumpy-plane", "cactus"].iter().find(|m| session.starts_with(**m));
        let rest = work.ply(&format!("{}.ply", model.expect("a shape")));
        let edited = work.ply("edited.ply").positions();
        let far = 0.003 * rest.diagonal();
        let moved = rest.positions().iter().zip(&edited).filter(|(p, q)| p.distance(**q) > far).count();
        assert!(10 * moved > edited.len(), "{session}: {moved} of {} vertices moved", edited.len());
    }
}

#[test]
fn a_bar_twisted_as_rigid_as_possible_keeps_its_ends_and_nearly_its_volume() {
    let (work, _) = with_sessions();
    work.simod("run bar.toml -o edited.ply");
    let (rest, edited) = (work.ply("bar.ply"), work.ply("edited.ply"));
    let turn = glam::DQuat::from_rotation_y(135f64.to_radians());
    let (mut held, mut turned) = (0, 0);
    for (p, q) in rest.positions().into_iter().zip(edited.positions()) {
        if p.y < 0.1 {
            assert_eq!(p, q);
            held += 1;
        } else if p.y > 1.8 {
            assert!(q.distance(turn * p) < 1e-4, "{p} went to {q}");
            turned += 1;
        }
    }
    assert!(held > 200 && turned > 500, "{held} held, {turned} turned");
    assert!((volume(&work, "bar.ply") / 0.18 - 1.0).abs() < 1e-3);
    let change = volume(&work, "edited.ply") / volume(&work, "bar.ply") - 1.0;
    assert!((-0.15..0.02).contains(&change), "the volume changes by {change}");

    // Sections in the middle keep their width.
    let wide = |ply: &Ply| {
        let radius = |p: &DVec3| DVec3::new(p.x, 0.0, p.z).length();
        ply.positions().iter().filter(|p| (0.9..1.1).contains(&p.y)).map(radius).fold(0.0, f64::max)
    };
    assert!(wide(&edited) > 0.85 * wide(&rest), "{} of {}", wide(&edited), wide(&rest));
}

/// Steps of before `smooth-arap` that state a bending length go on as they were, and are told so; without one
/// they are as rigid as possible as it is published, which is told, too.
#[test]
fn a_bending_length_keeps_the_hybrid_under_its_new_name() {
    let (work, _) = with_sessions();
    let text = String::from_utf8(work.read("bar.toml")).expect("a text");
    let smooth = "mode = \"smooth-arap\"";
    assert!(text.contains(smooth), "{text}");
    let run = |params: &str| {
        work.write("edit.toml", text.replace(smooth, params));
        let said = work.report("run edit.toml -o edited.ply")["warnings"].to_string();
        (work.read("edited.ply"), said)
    };
    let (expected, said) = run(smooth);
    assert!(!said.contains("smooth-arap"), "{said}");
    let (found, said) = run("mode = \"arap\", bending = 0.03");
    assert!(found == expected && said.contains("smooth-arap"), "{said}");
    let (published, said) = run("mode = \"arap\"");
    assert!(published != expected && said.contains("spokes-and-rims"), "{said}");
    assert!(said.contains("was added, as they mean something else now"), "{said}");
    // A session that names its surroundings gets no advice on them.
    let (spokes, said) = run("mode = \"arap\", surroundings = \"spokes\"");
    assert!(spokes != published && !said.contains("arap"), "{said}");
    // The window writes which version of the plugin's parameters a step has: nothing is told then.
    let now = text.replace("[[step]]", "[[step]]\nstate-version = 2").replace(smooth, "mode = \"arap\"");
    work.write("edit.toml", now);
    let said = work.report("run edit.toml -o edited.ply")["warnings"].to_string();
    assert!(!said.contains("arap") && work.read("edited.ply") == published, "{said}");
}
