//! Tests of inputs that are refused, and of the errors that say so.

use super::scene::{Listener, Scene, at, rows};
use super::solids::{LIMB, limb};
use glam::{DAffine3, DVec3};
use simod_plugin_api::ErrorCode;
use std::io::Write;

fn refused(scene: &Scene, parts: &[&str]) {
    let error = scene.try_prepare(&Listener::default()).err().expect("an error");
    for part in parts {
        assert!(error.message.contains(part), "{part}: {error}");
    }
    assert!(!error.hint.is_empty(), "{error}");
}

fn file(text: &str) -> tempfile::NamedTempFile {
    let mut file = tempfile::NamedTempFile::new().unwrap();
    file.write_all(text.as_bytes()).unwrap();
    file
}

#[test]
fn skeletons_that_cannot_be() {
    let mut scene = Scene { joints: Vec::new(), ..Scene::new(limb(), &LIMB) };
    refused(&scene, &["no joints"]);
    assert!(scene.try_handles().unwrap_err().hint.contains("[[step.joint]]"));
    scene.joints = LIMB.to_vec();
    scene.joints[1].1 = scene.joints[0].1;
    refused(&scene, &["`upper` and `lower`", "one place"]);
    scene.joints[1].1 = [f64::NAN; 3];
    assert!(scene.try_prepare(&Listener::default()).err().unwrap().message.contains("`lower`"));
}

#[test]
fn files_are_read_and_their_errors_told() {
    let skeleton = file("upper -0.95 0 0\nlower 0 0 0\ntip 0.95 0 0\n#\nupper lower\nlower tip\n");
    let path = |f: &tempfile::NamedTempFile| f.path().to_str().unwrap().to_owned();
    let from_file = Scene { joints: Vec::new(), skeleton: path(&skeleton), ..Scene::new(limb(), &LIMB) };
    let placed = Scene::new(limb(), &LIMB);
    assert_eq!(from_file.try_handles().unwrap(), placed.try_handles().unwrap());

    let weights = file("x y z upper lower\n-1 0 0 1 0\n1 0 0 0 x\n");
    refused(&Scene { weights: path(&weights), ..placed.clone() }, &["`lower`", "line 3", &path(&weights)]);
    let far = file("x y z upper lower\n-100 0 0 1 0\n100 0 0 0 1\n");
    refused(&Scene { weights: path(&far), ..placed.clone() }, &["no place near the model", &path(&far)]);
    let some = file("x y z upper lower\n-1 0 0 1 0\n-0.9 0 0 1 1\n");
    let host = Listener::default();
    let scene = Scene { weights: path(&some), ..placed };
    assert!(
        scene.try_prepare(&host).is_err() || host.lines.into_inner().unwrap().concat().contains("far from")
    );
}

#[test]
fn motions_that_cannot_be() {
    let mut scene = Scene { resolution: 48.0, reach: "none", ..Scene::new(limb(), &LIMB) };
    let state = scene.prepare();
    let flat = rows(DAffine3::from_scale(DVec3::new(1.0, 0.0, 1.0)));
    let error = scene.try_deform(&state, &[flat; 3]).unwrap_err();
    assert!(
        error.message.contains("`upper` mirrors or flattens") && error.hint.contains("linear"),
        "{error}"
    );
    scene.method = "linear";
    let moved = scene.try_deform(&state, &[flat; 3]).unwrap();
    assert!(moved.iter().zip(&scene.points).all(|(q, p)| at(*q).distance(at([p[0], 0.0, p[2]])) < 1e-6));
    assert_eq!(scene.try_deform(&state, &[flat; 2]).unwrap_err().code, ErrorCode::INTERNAL);
}

#[test]
fn samples_that_cannot_be_and_some_that_can() {
    let mut scene = Scene::new(limb(), &LIMB);
    scene.points[7][1] = f32::INFINITY;
    let error = scene.try_prepare(&Listener::default()).err().unwrap();
    assert!(error.message.contains("sample 7"), "{error}");
    // All in one place, on a line, and only one.
    for points in
        [vec![[0.5, 0.0, 0.0]; 40], (0..40).map(|i| [0.02 * i as f32, 0.0, 0.0]).collect(), vec![[0.1; 3]]]
    {
        let scene = Scene::new((points, Vec::new()), &LIMB);
        let moved = scene.deform(&scene.prepare(), &[("upper", DAffine3::from_translation(DVec3::Y))]);
        for (p, q) in scene.points.iter().zip(moved) {
            assert!(at(q).distance(at(*p) + DVec3::Y) < 1e-6);
        }
    }
    let finest = Scene { resolution: 256.0, ..Scene::new(limb(), &LIMB) };
    finest.prepare();
    let stopped = Listener { stop: true, ..Listener::default() };
    let error = Scene::new(limb(), &LIMB).try_prepare(&stopped).err().unwrap();
    assert_eq!(error.code, ErrorCode::CANCELLED);
}
