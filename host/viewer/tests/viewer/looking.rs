//! Tools for looking besides the camera: the model cut open, and measures on it.

use super::{done, model, open, pixel, plugins, state};
use glam::{DVec2, DVec3};
use simod_generate::Shape;
use simod_session::edit::{self, Change};
use simod_viewer::camera::Standard;
use simod_viewer::command::{Area, CameraMove};
use simod_viewer::measured::distance;
use simod_viewer::selection::Combine;
use simod_viewer::{Clip, Command, State};

fn opened(shape: Shape) -> State {
    let folder = tempfile::tempdir().unwrap();
    let mut state = state(plugins());
    done(&mut state, open(&model(folder.path(), shape, 40_000), 5000));
    state.apply(Command::Camera(CameraMove::Look(Standard::Front))).unwrap();
    state.apply(Command::Camera(CameraMove::FrameAll)).unwrap();
    state
}

/// Middle of the samples, model coordinates.
fn middle(state: &State) -> DVec3 {
    let scene = state.scene().unwrap();
    let [min, max] = scene.bounds();
    scene.frame().to_model(0.5 * (min + max))
}

#[test]
fn what_is_cut_away_is_neither_picked_nor_selected() {
    let mut state = opened(Shape::Bar);
    let middle = middle(&state);
    let at = DVec2::from(pixel(&state, middle));
    let front = state.pick(at).unwrap();
    assert!(front.normal.z > 0.9 && front.at.z > middle.z);
    let clip = Clip { normal: DVec3::Z, through: middle };
    state.apply(Command::Clip(Some(clip))).unwrap();
    assert_eq!(state.clipped(), Some(clip));
    // Its back is seen from inside.
    let back = state.pick(at).unwrap();
    assert!(back.at.z < middle.z && back.normal.z < -0.9, "{back:?}");
    let everywhere = Area::Box { from: [0.0; 2], to: state.size() };
    for visible in [true, false] {
        let area = everywhere.clone();
        let select = Command::Select { area, combine: Combine::Replace, visible, goes_on: false };
        state.apply(select).unwrap();
        let (scene, selection) = (state.scene().unwrap(), state.selection());
        let frame = scene.frame();
        let beyond = |p: glam::Vec3| frame.to_model(p).z > middle.z;
        assert!(!selection.is_empty());
        assert!(scene.positions.iter().zip(0..).all(|(p, i)| !(beyond(*p) && selection.contains(i))));
    }
    assert!(state.apply(Command::Clip(Some(Clip { normal: DVec3::ZERO, ..clip }))).is_err());
    state.apply(Command::Clip(Some(clip.flipped()))).unwrap();
    assert_eq!(state.pick(at).unwrap().at, front.at);
    state.apply(Command::Clip(None)).unwrap();
    assert_eq!(state.pick(at), Some(front));
}

#[test]
fn what_is_measured_goes_along_with_the_surface() {
    let mut state = opened(Shape::Amphora);
    let size = state.scene().unwrap().sampled.bounds;
    let (middle, height) = (middle(&state), size.max.y - size.min.y);
    let places = [0.25, -0.1, -0.3].map(|y| DVec2::from(pixel(&state, middle + DVec3::Y * y * height)));
    let hits = places.map(|at| state.pick(at).unwrap());
    let points: Vec<DVec3> = hits.iter().map(|hit| state.at_rest(hit).unwrap()).collect();
    state.apply(Command::Measure { points: points.clone() }).unwrap();
    let measured = state.measured();
    assert!(measured.iter().zip(&hits).all(|(point, hit)| point.rest.distance(hit.at) < 1e-9 * height));
    assert!(measured.iter().all(|point| point.now == point.rest), "nothing has moved");
    let before = distance(&measured[0], &measured[2]);
    assert!(!before.is_changed() && (0.4..0.8).contains(&(before.now / height)), "{before:?}");

    // A bend brings the bar's ends nearer to each other; the measure at rest stays.
    done(&mut state, Command::AddStep { plugin: "warp".into(), at: None });
    for (id, value) in [("operation", toml::Value::from("bend")), ("angle", 120.0.into())] {
        let change = Change::SetParam { id: id.into(), value: Some(value) };
        done(&mut state, Command::Edit(edit::EditCommand::Change { at: 0, change }));
    }
    let measured = state.measured();
    let after = distance(&measured[0], &measured[2]);
    assert!(after.is_changed() && after.now < 0.98 * before.now, "{after:?} from {before:?}");
    assert_eq!(after.rest, before.rest);
    // A point that is picked on the deformed surface is found there again.
    let mut found = 0;
    for (x, y) in (0..12).flat_map(|x| (0..8).map(move |y| (100.0 * f64::from(x), 100.0 * f64::from(y)))) {
        let Some(hit) = state.pick(DVec2::new(x, y)) else { continue };
        let points = vec![state.at_rest(&hit).unwrap()];
        state.apply(Command::Measure { points }).unwrap();
        let off = state.measured()[0].now.distance(hit.at) / height;
        assert!(off < 2e-3, "{off} at {x}, {y}");
        found += 1;
    }
    assert!(found > 5);
    assert!(state.apply(Command::Measure { points: vec![DVec3::NAN] }).is_err());
    assert_eq!(state.measured().len(), 1);
}
