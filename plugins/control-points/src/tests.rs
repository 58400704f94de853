//! The maps against those that made the landmarks, and the plugin as the host calls it.

use super::*;
use glam::DMat3;
use proptest::prelude::*;
use simod_plugin_api::{HostCalls, Param, ParamKind, Part, Samples};
use std::sync::Mutex;

const BOUNDS: Bounds = Bounds { min: [-1.0; 3], max: [1.0; 3] };

fn landmark(name: &str, source: DVec3, target: DVec3) -> Landmark {
    Landmark { name: name.to_owned(), source, target, weight: 1.0, line: 1 }
}

/// Places that are all over space, or in a plane, or on a line.
fn places(count: usize, directions: usize) -> Vec<DVec3> {
    let at = |i: usize, k: usize| {
        if k < directions { (1.7 * i as f64 + 2.3 * (k * i * i) as f64).sin() } else { 0.25 }
    };
    (0..count).map(|i| DVec3::new(at(i, 0), at(i, 1), at(i, 2))).collect()
}

fn moved(places: &[DVec3], by: impl Fn(DVec3) -> DVec3) -> Vec<Landmark> {
    places.iter().enumerate().map(|(i, p)| landmark(&i.to_string(), *p, by(*p))).collect()
}

fn bend(p: DVec3) -> DVec3 {
    p + DVec3::new(0.2 * p.y * p.y, 0.1 * (2.0 * p.x).sin(), 0.15 * p.x * p.z)
}

fn helmert() -> DAffine3 {
    DAffine3::from_scale_rotation_translation(
        DVec3::splat(1.3),
        glam::DQuat::from_scaled_axis(DVec3::new(0.5, -1.0, 0.3)),
        DVec3::new(0.1, 0.2, -0.7),
    )
}

#[test]
fn each_map_finds_maps_of_its_kind() {
    let shear = DAffine3::from_mat3_translation(
        DMat3::from_cols(DVec3::new(1.0, 0.2, 0.0), DVec3::new(-0.3, 0.8, 0.1), DVec3::new(0.0, 0.4, 1.5)),
        DVec3::X,
    );
    let aside = DAffine3::from_translation(DVec3::new(0.5, -0.25, 3.0));
    let all = [
        MapKind::Translation,
        MapKind::Similarity,
        MapKind::Affine,
        MapKind::ThinPlate,
        MapKind::LocalWeights,
    ];
    for (simplest, truth) in [(0, aside), (1, helmert()), (2, shear)] {
        let landmarks = moved(&places(12, 3), |p| truth.transform_point3(p));
        for kind in &all[simplest..] {
            let map = SpaceMap::fit(*kind, &landmarks, 0.0).unwrap();
            for p in places(40, 3).into_iter().map(|p| 2.0 * p + DVec3::Y) {
                let off = map.apply(p).distance(truth.transform_point3(p));
                assert!(off < 1e-9, "{kind:?}: {off:e}");
            }
            let report = LandmarkReport::new(&map, *kind, &landmarks, 0.0, 10.0);
            assert!(
                report.rms() < 1e-8 && report.left_out_rms().unwrap() < 1e-8 && report.outliers().is_empty()
            );
        }
    }
    // A plane is enough for a similarity, and for local weights.
    let landmarks = moved(&places(8, 2), |p| helmert().transform_point3(p));
    for kind in [MapKind::Similarity, MapKind::LocalWeights] {
        let map = SpaceMap::fit(kind, &landmarks, 0.0).unwrap();
        assert!(map.apply(DVec3::ONE).distance(helmert().transform_point3(DVec3::ONE)) < 1e-9);
    }
}

#[test]
fn splines_and_local_weights_meet_landmarks_and_smoothing_misses_them() {
    let landmarks = moved(&places(30, 3), bend);
    let worst =
        |map: &SpaceMap| landmarks.iter().map(|l| map.apply(l.source).distance(l.target)).fold(0.0, f64::max);
    assert!(worst(&SpaceMap::fit(MapKind::ThinPlate, &landmarks, 0.0).unwrap()) < 1e-12);
    assert!(worst(&SpaceMap::fit(MapKind::LocalWeights, &landmarks, 0.0).unwrap()) < 1e-12);
    let affine = worst(&SpaceMap::fit(MapKind::Affine, &landmarks, 0.0).unwrap());
    let [some, much] = [0.1, 1e6].map(|s| worst(&SpaceMap::fit(MapKind::ThinPlate, &landmarks, s).unwrap()));
    assert!(
        1e-3 < some && some < affine && (much - affine).abs() < 1e-3 * affine,
        "{some}, {much}, {affine}"
    );
    // A landmark without a weight does not take part, but is reported.
    let mut checked = landmarks.clone();
    checked[4].weight = 0.0;
    let map = SpaceMap::fit(MapKind::ThinPlate, &checked, 0.0).unwrap();
    let report = LandmarkReport::new(&map, MapKind::ThinPlate, &checked, 0.0, 1.0);
    assert!(report.rows[4].is_check && report.rows[4].residual > 1e-4 && report.rms() < 1e-12);
}

/// The expected value is that of `scipy.interpolate.RBFInterpolator(sources, targets, kernel="linear",
/// degree=1)`, of SciPy 1.17.1, at (0.3, -0.2, 0.6).
#[test]
fn the_spline_is_scipy_s() {
    let landmarks = moved(&places(20, 3), bend);
    let map = SpaceMap::fit(MapKind::ThinPlate, &landmarks, 0.0).unwrap();
    let expected = DVec3::new(0.3385551995986, -0.1714479271681, 0.5912229100208);
    assert!(
        map.apply(DVec3::new(0.3, -0.2, 0.6)).distance(expected) < 1e-9,
        "{}",
        map.apply(DVec3::new(0.3, -0.2, 0.6))
    );
}

#[test]
fn a_landmark_is_left_out_as_if_it_were_not_there() {
    let landmarks = moved(&places(15, 3), bend);
    for kind in [MapKind::ThinPlate, MapKind::LocalWeights, MapKind::Affine, MapKind::Similarity] {
        for smoothing in [0.0, 0.2] {
            let left_out = SpaceMap::left_out(kind, &landmarks, smoothing);
            for (i, left) in left_out.iter().enumerate() {
                let mut others = landmarks.clone();
                let one = others.remove(i);
                let expected =
                    one.target - SpaceMap::fit(kind, &others, smoothing).unwrap().apply(one.source);
                assert!(left.unwrap().distance(expected) < 1e-9, "{kind:?}, {i}");
            }
        }
    }
    // Each of four landmarks is needed.
    let four = moved(&places(4, 3), bend);
    for kind in [MapKind::ThinPlate, MapKind::Affine] {
        assert!(SpaceMap::left_out(kind, &four, 0.0).iter().all(Option::is_none));
    }
}

#[test]
fn what_cannot_be_determined_is_said_and_the_next_simpler_map_offered() {
    let fit = |kind, landmarks: &[Landmark]| SpaceMap::fit(kind, landmarks, 0.0).unwrap_err();
    for (directions, what, instead) in [
        (2, "one plane", MapKind::Similarity),
        (1, "one line", MapKind::Translation),
        (0, "one place", MapKind::Translation),
    ] {
        let landmarks = moved(&places(9, directions), |p| p + DVec3::X);
        for kind in [MapKind::ThinPlate, MapKind::Affine] {
            let Open { why, instead: offered } = fit(kind, &landmarks);
            let told = why.what;
            assert!(told.contains(what) && offered == Some(instead), "{told}, {offered:?}");
        }
        // The kind that is offered can be had.
        SpaceMap::fit(instead, &landmarks, 0.0).unwrap();
        assert_eq!(SpaceMap::fit(MapKind::Similarity, &landmarks, 0.0).is_ok(), directions > 1);
    }
    // Sources that coincide are named, also where rounding has them apart, and the kind that is offered can
    // be had.
    for (directions, instead) in [(3, MapKind::Affine), (2, MapKind::Similarity), (1, MapKind::Translation)] {
        for apart in [0.0, 1e-12] {
            let mut landmarks = moved(&places(9, directions), |p| p + DVec3::X);
            landmarks[7].source = landmarks[2].source + DVec3::splat(apart);
            landmarks[7].line = 2;
            for kind in [MapKind::ThinPlate, MapKind::LocalWeights] {
                let told = fit(kind, &landmarks);
                let coincide = told.why.what.contains("`2` and `7` coincide");
                assert!(coincide || (kind == MapKind::ThinPlate && directions < 3), "{told:?}");
                assert_eq!(told.instead, Some(instead), "{told:?}");
                SpaceMap::fit(instead, &landmarks, 0.0).unwrap();
            }
        }
    }
    let mut landmarks = moved(&places(9, 3), bend);
    landmarks.iter_mut().for_each(|l| l.weight = 0.0);
    assert!(fit(MapKind::Translation, &landmarks).why.what.contains("weight"));
}

#[test]
fn a_wrong_landmark_stands_out() {
    let mut landmarks = moved(&places(20, 3), |p| {
        helmert().transform_point3(p)
            + 1e-3 * DVec3::new((9.0 * p.x).sin(), (7.0 * p.y).cos(), (5.0 * p.z).sin())
    });
    landmarks[6].target.y += 0.3;
    for kind in [MapKind::Similarity, MapKind::Affine] {
        let map = SpaceMap::fit(kind, &landmarks, 0.0).unwrap();
        let report = LandmarkReport::new(&map, kind, &landmarks, 0.0, 1.0);
        assert_eq!(report.outliers(), ["6"], "{kind:?}");
        assert!(report.lines()[6].contains("an outlier"));
        let row: serde_json::Value = serde_json::from_str(&report.json()[7]).unwrap();
        assert!(row["name"] == "6" && row["outlier"] == true && row["residual"].as_f64().unwrap() > 0.1);
    }
}

/// Host that keeps the messages.
#[derive(Default)]
struct Log(Mutex<Vec<(LogLevel, String)>>);

impl HostCalls for Log {
    fn progress(&self, _: f64) -> bool {
        true
    }
    fn log(&self, level: LogLevel, message: &str) {
        self.0.lock().unwrap().push((level, message.to_owned()));
    }
}

#[expect(clippy::disallowed_methods, reason = "the file is the test's own")]
fn prepare(text: &str, method: &str, report: &str) -> (PluginResult<SpaceMap>, String) {
    let file = std::env::temp_dir().join(format!(
        "simod-landmarks-{}-{:?}.csv",
        std::process::id(),
        std::thread::current().id()
    ));
    std::fs::write(&file, text).unwrap();
    let (smoothing, log) = ([0.0], Log::default());
    let params = [
        Param::text("landmarks", ParamKind::FILE, file.to_str().unwrap()),
        Param::text("method", ParamKind::CHOICE, method),
        Param::numbers("smoothing", ParamKind::FLOAT, &smoothing),
        Param::text("report", ParamKind::CHOICE, report),
    ];
    let frame = ModelFrame { origin: [5e5, 4e6, 100.0], scale: 10.0 };
    let parts = [Part::new(&frame)];
    let input = PrepareInput::new(Samples::new(&[], &[], &[]), BOUNDS, &[], &params).with_parts(&parts);
    let map = ControlPoints::prepare(&input, &Host::new(&log));
    std::fs::remove_file(&file).unwrap();
    let told = log.0.lock().unwrap().iter().map(|(_, text)| text.as_str()).collect::<Vec<_>>().join("\n");
    (map, told)
}

/// Landmarks of a map, in a file's coordinates.
fn csv(places: &[DVec3], by: impl Fn(DVec3) -> DVec3) -> String {
    let line = |(i, p): (usize, &DVec3)| {
        let [s, t] = [*p, by(*p)].map(|p| DVec3::new(5e5, 4e6, 100.0) + 10.0 * p);
        format!("p{i},{},{},{},{},{},{}\n", s.x, s.y, s.z, t.x, t.y, t.z)
    };
    places.iter().enumerate().map(line).collect()
}

#[test]
fn files_are_in_the_model_s_coordinates_and_reports_in_its_unit() {
    let text = csv(&places(20, 3), |p| p + DVec3::new(0.0, 0.0, if p.x > 0.0 { 0.1 } else { -0.1 }));
    let (map, told) = prepare(&text, "translation", "landmarks");
    assert!(map.unwrap().apply(DVec3::ZERO).length() < 0.1);
    assert!(told.contains("rms 1.0") || told.contains("rms 0.9"), "{told}");
    assert_eq!(told.lines().filter(|line| line.contains("residual")).count(), 20);
    let (_, told) = prepare(&text, "thin-plate", "json");
    let first: serde_json::Value = serde_json::from_str(told.lines().next().unwrap()).unwrap();
    assert!(first["landmarks"] == 20 && first["rms"].as_f64().unwrap() < 1e-6, "{told}");
}

#[test]
fn bad_files_are_refused_with_their_lines_and_far_landmarks_told() {
    let refused = |text: &str| prepare(text, "thin-plate", "summary").0.unwrap_err().to_string();
    assert!(refused("a,1,2,3\n").contains("line 1"));
    let far = csv(&places(9, 3), |p| p).replace("p", "q");
    assert!(prepare(&far, "affine", "summary").0.is_ok());
    let off = csv(&places(9, 3).iter().map(|p| *p + DVec3::splat(50.0)).collect::<Vec<_>>(), |p| p);
    assert!(refused(&off).contains("far from the model"));
    let (map, told) = prepare(&(far + off.lines().next().unwrap()), "affine", "summary");
    assert!(map.is_ok() && told.contains("far from the model: `p0`"), "{told}");
    let (_, told) = prepare(&csv(&places(9, 3), |p| DVec3::new(p.y, p.x, p.z)), "affine", "summary");
    assert!(told.contains("inside out"), "{told}");
    let flat: Vec<DVec3> = places(9, 3).iter().map(|p| DVec3::new(p.x, p.y, 1e-3 * p.z)).collect();
    let (_, told) = prepare(&csv(&flat, |p| p), "affine", "summary");
    assert!(told.contains("nearly in a plane"), "{told}");
}

proptest! {
    #[test]
    fn any_landmarks_give_a_map_or_an_offer(
        points in proptest::collection::vec((proptest::array::uniform3(-2_i8..3), proptest::array::uniform3(-2_i8..3), 0_u8..3), 1..12),
        kind in prop::sample::select(vec![
            MapKind::ThinPlate, MapKind::LocalWeights, MapKind::Affine, MapKind::Similarity, MapKind::Translation,
        ]),
        smoothing in prop::sample::select(vec![0.0, 0.1]),
    ) {
        let dense = |p: [i8; 3]| DVec3::from_array(p.map(f64::from));
        let landmarks: Vec<Landmark> = points
            .iter()
            .enumerate()
            .map(|(i, (s, t, w))| Landmark { weight: f64::from(*w), ..landmark(&i.to_string(), dense(*s), dense(*t)) })
            .collect();
        match SpaceMap::fit(kind, &landmarks, smoothing) {
            Ok(map) => {
                prop_assert!(map.apply(DVec3::new(0.1, 0.2, 0.3)).is_finite());
                let report = LandmarkReport::new(&map, kind, &landmarks, smoothing, 1.0);
                prop_assert!(report.rms().is_finite() && report.left_out_rms().is_none_or(f64::is_finite));
            }
            Err(Open { instead: Some(instead), .. }) => {
                prop_assert!(instead != kind && SpaceMap::fit(instead, &landmarks, smoothing).is_ok());
            }
            // A translation is always determined by landmarks that count.
            Err(_) => prop_assert!(landmarks.iter().all(|l| l.weight == 0.0)),
        }
    }
}
