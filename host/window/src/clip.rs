//! The plane that cuts the model open.

use crate::window::{Commands, Window};
use glam::DVec3;
use simod_viewer::{Clip, Command};

/// Opens the model by a plane through its middle that faces the eye, or closes it.
pub fn switch(window: &Window, commands: &mut Commands) {
    let clip = match window.state().clipped() {
        Some(_) => None,
        None => across(window, window.state().camera().axes()[2]),
    };
    commands.apply(Command::Clip(clip));
}

/// A plane through the model's middle.
pub fn across(window: &Window, normal: DVec3) -> Option<Clip> {
    let [from, to] = reach(window, normal)?;
    let scene = window.state().scene()?;
    let [min, max] = scene.bounds();
    let middle = scene.frame().to_model(0.5 * (min + max));
    let normal = normal.normalize_or(DVec3::X);
    // The plane is in the middle of its range.
    let through = middle + normal * (0.5 * (from + to) - normal.dot(middle));
    Some(Clip { normal, through })
}

/// Range in which a plane of this normal meets the model's box, along the normal, in the model's unit.
pub fn reach(window: &Window, normal: DVec3) -> Option<[f64; 2]> {
    let scene = window.state().scene()?;
    let corners = scene.bounds().map(|corner| scene.frame().to_model(corner));
    let normal = normal.normalize_or(DVec3::X);
    let ends = |pick: fn(f64, f64) -> f64| {
        (0..3).map(|i| pick(normal[i] * corners[0][i], normal[i] * corners[1][i])).sum()
    };
    Some([ends(f64::min), ends(f64::max)])
}
