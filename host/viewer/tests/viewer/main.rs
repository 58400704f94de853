//! The viewer without its window, on models that are made here, with the plugins that are built here.
#![allow(clippy::unwrap_used, clippy::disallowed_methods, reason = "a test that cannot go on shall stop")]

mod colors;
mod comparing;
mod edits;
mod errors;
mod helpers;
mod looking;
mod preview;
mod selecting;

use glam::DVec3;
use helpers::{LONG, done, model, open, plugins, state};
use simod_viewer::State;

/// The pixel of a point, model coordinates.
fn pixel(state: &State, p: DVec3) -> [f64; 2] {
    let local = state.scene().unwrap().frame().to_local_exact(p);
    state.camera().project(local, state.size()).unwrap().0.to_array()
}
