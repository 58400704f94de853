//! Making regions of the selection.

use crate::tools::{MovedPart, Tool};
use crate::window::{Commands, Window};
use simod_core::refinement::Finer;
use simod_session::edit::Entry;
use simod_session::step::Role;
use simod_viewer::Command;

/// Factor by which the number of samples in a selection grows at once.
const FINER: f64 = 4.0;

/// Whether a region of this role can be made of the selection: something is selected, and the chosen step
/// takes such regions.
pub fn can_make(window: &Window, role: Role) -> bool {
    !window.state().selection().is_empty() && takes(window, role)
}

/// Whether the chosen step takes regions of this role.
pub fn takes(window: &Window, role: Role) -> bool {
    let Some((_, _, _, Some(plugin))) = window.chosen() else { return false };
    let consumes = plugin.consumes();
    match role {
        Role::Fixed => consumes.fixed_regions,
        Role::Handle => consumes.handle_regions,
        Role::Mask => true,
    }
}

/// Message about the regions that a step needs and does not have yet.
pub fn missing(window: &Window, entry: &Entry) -> Option<&'static str> {
    let deformation = entry.step.deformation()?;
    let consumes = window.state().plugins().get(&deformation.deform).ok()?.consumes();
    let number = |role| deformation.regions.iter().filter(|r| r.role == role).count();
    let handles = consumes.min_handles as usize > number(Role::Handle);
    let fixed = consumes.min_fixed as usize > number(Role::Fixed);
    match (handles, fixed) {
        (true, true) => {
            Some("It needs a handle and a fixed region: select samples, and make them of the selection.")
        }
        (true, false) => Some("It needs a handle region: select samples, and make it of the selection."),
        (false, true) => Some("It needs a fixed region: select samples, and make it of the selection."),
        _ => None,
    }
}

/// Makes a region of the selection. A handle is taken into the hand.
pub fn make(window: &Window, commands: &mut Commands, role: Role) {
    let Some((step, _, deformation, _)) = window.chosen() else { return };
    let region = deformation.regions.len();
    commands.apply_then(Command::MakeRegion { step, role, falloff: 0.0, replaces: None }, move |window| {
        window.draw(|window, commands| match role {
            Role::Handle => take_into_hand(window, commands, region),
            _ => select_none(commands),
        });
    });
}

/// Makes a handle of the selection, and fixes all that is farther from the handle than the band that bends.
/// The handle is taken into the hand.
pub fn make_handle(window: &Window, commands: &mut Commands) {
    let Some((step, _, deformation, _)) = window.chosen() else { return };
    let Some(scene) = window.state().scene() else { return };
    let band = window.tools.band * scene.sampled.bounds.diagonal();
    let region = deformation.regions.len();
    commands.apply_then(Command::MakeHandle { step, band }, move |window| {
        window.draw(|window, commands| take_into_hand(window, commands, region));
    });
}

/// Takes a handle region that was made of the selection into the hand; nothing is selected any more.
fn take_into_hand(window: &Window, commands: &mut Commands, region: usize) {
    let takes_tool = !window.tools.tool.is_gizmo();
    commands.then(move |window| {
        window.tools.target = Some(MovedPart::Region(region));
        if takes_tool {
            window.tools.take(Tool::Move);
        }
    });
    select_none(commands);
}

fn select_none(commands: &mut Commands) {
    commands.apply(Command::Select {
        area: simod_viewer::command::Area::None,
        combine: Default::default(),
        visible: false,
        goes_on: true,
    });
}

/// Adds samples in the selection.
pub fn refine(commands: &mut Commands) {
    commands.apply(Command::RefineSelection { finer: Finer::Factor(FINER) });
}
