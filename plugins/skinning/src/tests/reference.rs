//! Results are those of libigl, and of the published algorithm: `tests/reference/skinning.py` says how the
//! figures came about.

use super::scene::{Scene, at};
use glam::DVec3;
use serde_json::Value;
use simod_plugin_api::{Affine, Joint};
use std::fmt::Write as _;
use std::io::Write;
use std::path::Path;

/// Largest difference from the reference results, as a fraction of the diagonal.
const AGREES: f64 = 1e-6;

fn figures(name: &str) -> Value {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/reference/skinning.json");
    let mut all: Value = serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap();
    all[name].take()
}

/// FNV-1a, as the script has it.
fn fingerprint(points: &[[f32; 3]], weights: &[Vec<f64>]) -> String {
    let points = points.as_flattened().iter().flat_map(|x| x.to_le_bytes());
    let weights = weights.iter().flatten().flat_map(|x| (*x as f32).to_le_bytes());
    let hash = points
        .chain(weights)
        .fold(0xcbf2_9ce4_8422_2325_u64, |h, byte| (h ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3));
    format!("{hash:016x}")
}

fn number(x: &Value) -> f64 {
    x.as_f64().unwrap()
}

/// Holds a model with weights, by its joints but the last, against the figures.
fn agrees(name: &str, mut scene: Scene, weights: &[Vec<f64>], ids: &[&str]) {
    let figures = figures(name);
    assert_eq!(figures["fingerprint"], fingerprint(&scene.points, weights), "another {name}");
    let mut text = format!("x y z {}\n", ids.join(" "));
    for (p, weights) in scene.points.iter().zip(weights) {
        let numbers = p.iter().map(f32::to_string).chain(weights.iter().map(f64::to_string));
        writeln!(text, "{}", numbers.collect::<Vec<_>>().join(" ")).unwrap();
    }
    let mut file = tempfile::NamedTempFile::new().unwrap();
    file.write_all(text.as_bytes()).unwrap();
    scene.weights = file.path().to_str().unwrap().to_owned();
    scene.reach = "none";
    let state = scene.prepare();
    let every = figures["every"].as_u64().unwrap() as usize;
    let diagonal = number(&figures["diagonal"]);
    for (method, pose, of) in [
        ("linear", "motions", "linear"),
        ("dual-quaternion", "motions", "dual-quaternion"),
        ("linear", "scaled", "linear, scaled"),
    ] {
        let motion =
            |m: &Value| Affine { rows: std::array::from_fn(|r| std::array::from_fn(|c| number(&m[r][c]))) };
        let mut motions: Vec<Affine> = figures[pose].as_array().unwrap().iter().map(motion).collect();
        // The end goes along with the joint that it hangs on.
        motions.push(motions[motions.len() - 1]);
        scene.method = method;
        let found = scene.try_deform(&state, &motions).unwrap();
        let expected = figures["positions"][of].as_array().unwrap();
        let kept: Vec<_> = found.iter().step_by(every).collect();
        assert_eq!(kept.len(), expected.len());
        let miss = |(p, q): (&&[f32; 3], &Value)| {
            at(**p).distance(DVec3::from_array(std::array::from_fn(|k| number(&q[k]))))
        };
        let worst = kept.iter().zip(expected).map(miss).fold(0.0, f64::max) / diagonal;
        println!("{name}, {of}: {worst:.1e} of the diagonal");
        assert!(worst < AGREES, "{name}, {of}: {worst:.1e}");
    }
}

/// As the script makes it.
#[test]
fn a_tube_goes_where_it_should() {
    let (mut points, mut weights) = (Vec::new(), Vec::new());
    for i in 0..31 {
        for k in 0..12 {
            let (x, t) = (f64::from(i) / 30.0, (f64::from(k) - 5.5) / 3.0);
            let (y, z) = ((1.0 - t * t) / (1.0 + t * t) / 8.0, 2.0 * t / (1.0 + t * t) / 8.0);
            points.push([x, y, z].map(|x| x as f32));
            let all = [0.2, 0.55, 0.85].map(|middle: f64| 1.0 / (0.05 + (x - middle).powi(2)).powi(2));
            weights.push(all.map(|w| w / all.iter().sum::<f64>()).to_vec());
        }
    }
    let joint = |id, x, parent| (id, [x, 0.0, 0.0], parent);
    let joints = [joint("a", 0.0, Joint::ROOT), joint("b", 0.4, 0), joint("c", 0.7, 1), joint("tip", 1.0, 2)];
    agrees("tube", Scene::new((points, Vec::new()), &joints), &weights, &["a", "b", "c"]);
}

/// libigl's, where it is.
#[test]
fn the_arm_goes_where_libigl_has_it() {
    let files = ["arm.obj", "arm-weights.dmat", "arm.tgf"].map(simod_tests::real_model);
    let [Some(model), Some(dmat), Some(skeleton)] = files else { return };
    let model = std::fs::read_to_string(model).unwrap();
    let points = model.lines().filter_map(|line| line.strip_prefix("v ")).map(|line| {
        let mut x = line.split_whitespace().map(|x| x.parse::<f64>().unwrap() as f32);
        std::array::from_fn(|_| x.next().unwrap())
    });
    let points: Vec<[f32; 3]> = points.collect();
    let dmat = std::fs::read_to_string(dmat).unwrap();
    let numbers: Vec<f64> = dmat.split_whitespace().skip(2).map(|x| x.parse().unwrap()).collect();
    let bones = numbers.len() / points.len();
    let weights = (0..points.len()).map(|v| {
        let all: Vec<f64> = (0..bones).map(|b| numbers[b * points.len() + v]).collect();
        let sum: f64 = all.iter().sum();
        all.iter().map(|w| w / sum).collect()
    });
    let weights: Vec<Vec<f64>> = weights.collect();
    let mut scene = Scene::new((points, Vec::new()), &[]);
    scene.skeleton = skeleton.to_str().unwrap().to_owned();
    agrees("arm", scene, &weights, &["1", "2", "3", "4"]);
}
