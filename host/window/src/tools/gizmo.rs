//! Arrows and rings that move a handle: a region's, or one that the plugin placed.

use super::place::{GizmoTarget, MovedKind, Several};
use super::{Gesture, MovedPart, Tool, ToolContext};
use crate::viewport::ModelArea;
use crate::window::{Commands, Window};
use eframe::egui::{Color32, Mesh, Pos2, Rgba, epaint};
use glam::{DAffine3, DMat4, DQuat, DVec3};
use simod_session::Motion;
use simod_session::edit::{Change, StepId};
use simod_session::step::HandleMove;
use simod_viewer::held::GrabbedHandles;
use simod_viewer::motion::handle_matrix;
use simod_viewer::skeleton::is_pin;
use simod_viewer::{Command, ViewerScene};
use transform_gizmo::math::{Pos2 as GizmoPos, Rect as GizmoRect, Transform};
use transform_gizmo::{EnumSet, GizmoConfig, GizmoInteraction, GizmoMode, GizmoOrientation, GizmoVisuals};

/// Steps of a turn, with the key for steps held.
const SNAP_DEGREES: f32 = 15.0;
/// Steps of a shift, as a part of the model's size.
const SNAP_DISTANCE: f32 = 0.05;

/// Part in the hand with its place, if anything is in the hand.
pub fn place(window: &Window, commands: &mut Commands) -> Option<GizmoTarget> {
    let (step, id, deformation, _) = window.chosen()?;
    let target = window.tools.target.clone()?;
    let all = simod_plugin_api::Gizmo(!0);
    match &target {
        MovedPart::Region(region) => {
            let motion = deformation.regions.get(*region)?.motion;
            let known = window.tools.pivot.filter(|(of, i, _)| (*of, *i) == (id, *region));
            let pivot = match (motion.pivot, known) {
                (Some(pivot), _) | (None, Some((_, _, pivot))) => pivot,
                // The pivot is found by a pass over all samples.
                (None, None) => window.state().handle_pivot(step, *region)?,
            };
            let known = Some((id, *region, pivot));
            commands.then(move |window| window.tools.pivot = known);
            let matrix = handle_matrix(&motion, pivot);
            Some(GizmoTarget { step, id, target, matrix, kind: MovedKind::Region { pivot }, can: all })
        }
        // Nobody moves a pin.
        MovedPart::Handle(handle) if is_pin(handle) => None,
        MovedPart::Handle(handle) => {
            let (desc, placed) =
                window.state().handles(step).into_iter().find(|(desc, _)| desc.id == handle.as_str())?;
            let (matrix, can) = (placed.matrix(), desc.gizmo);
            Some(GizmoTarget { step, id, target, matrix, kind: MovedKind::Handle(placed), can })
        }
    }
}

/// The handles that the hand holds, with those around them that go along.
pub fn held(window: &Window, step: usize, id: StepId) -> Option<GrabbedHandles> {
    let bounds = window.state().scene()?.sampled.bounds;
    let reach = window.tools.reach * (bounds.max - bounds.min).length();
    GrabbedHandles::new(&window.state().handles(step), &window.tools.handles(id), reach)
}

/// Other handles that move along, as they are now; none if no other does.
fn several(place: &GizmoTarget, window: &Window) -> Option<Several> {
    let tools = &window.tools;
    let alone = tools.reach == 0.0 && tools.handles(place.id).len() < 2;
    if alone || !matches!(place.kind, MovedKind::Handle(_)) {
        return None;
    }
    Some(Several { held: held(window, place.step, place.id)?, from: place.matrix })
}

/// The modes of a tool that a handle takes; shifting if it takes none of them.
fn modes(tool: Tool, can: simod_plugin_api::Gizmo) -> EnumSet<GizmoMode> {
    match tool {
        Tool::Rotate if can.contains(simod_plugin_api::Gizmo::ROTATE) => GizmoMode::all_rotate(),
        Tool::Scale if can.contains(simod_plugin_api::Gizmo::SCALE) => GizmoMode::ScaleUniform.into(),
        _ => GizmoMode::all_translate(),
    }
}

fn rows(m: DMat4) -> [[f64; 4]; 4] {
    m.transpose().to_cols_array_2d()
}

pub fn update(context: &mut ToolContext<'_>) -> bool {
    let (canvas, window) = (context.canvas, context.window);
    let Some(place) = place(window, context.commands) else { return false };
    let Some(scene) = window.state().scene() else { return false };
    let frame = scene.frame();
    context.gesture.gizmo.update_config(config(canvas, window, scene, &place));
    let moved = follow(canvas, context.gesture, transform(&place.matrix, |p| frame.to_local_exact(p)));
    canvas.painter().add(mesh(&context.gesture.gizmo));
    if let Some(to) = moved {
        if !context.gesture.dragging {
            context.gesture.several = several(&place, window);
        }
        let matrix = affine(&to, |p| frame.to_model_exact(p));
        let change = matrix.and_then(|matrix| match &context.gesture.several {
            Some(several) => several.change_to(matrix),
            None => place.change_to(matrix),
        });
        if let Some(change) = change {
            context.gesture.dragging = true;
            context.commands.change(place.step, change, true);
        }
    }
    if context.gesture.dragging && !canvas.is_down() {
        context.gesture.dragging = false;
        context.commands.apply(Command::Rest);
    }
    context.gesture.gizmo.is_focused()
}

/// View of the gizmo, and the motions that the moved part allows.
fn config(canvas: &ModelArea<'_>, window: &Window, scene: &ViewerScene, place: &GizmoTarget) -> GizmoConfig {
    let (camera, size) = (window.state().camera(), window.state().size());
    let near_far = camera.near_far(scene.bounds().map(|corner| corner.as_dvec3()));
    let rect = canvas.rect();
    GizmoConfig {
        view_matrix: rows(camera.view()).into(),
        projection_matrix: rows(camera.projection(size, near_far)).into(),
        viewport: GizmoRect::from_min_max(
            GizmoPos::new(rect.min.x, rect.min.y),
            GizmoPos::new(rect.max.x, rect.max.y),
        ),
        modes: modes(window.tools.tool, place.can),
        orientation: GizmoOrientation::Global,
        snapping: canvas.modifiers().command,
        snap_angle: SNAP_DEGREES.to_radians(),
        snap_distance: SNAP_DISTANCE,
        visuals: visuals(),
        pixels_per_point: 1.0,
        ..GizmoConfig::default()
    }
}

/// Lets the gizmo follow the pointer: returns the new place of the thing at `transform`, if it is dragged.
fn follow(canvas: &ModelArea<'_>, gesture: &mut Gesture, transform: Transform) -> Option<Transform> {
    // The place of the press counts: in a slow picture the pointer may be far from there already.
    let pressed = canvas.is_pressed().then(|| canvas.ctx().input(|i| i.pointer.press_origin())).flatten();
    let at = pressed.or(canvas.pointer_pos()).unwrap_or(Pos2::ZERO);
    let interaction = GizmoInteraction {
        cursor_pos: (at.x, at.y),
        hovered: canvas.is_hovered(),
        drag_started: canvas.is_pressed(),
        dragging: canvas.is_down(),
    };
    // The place at which the button was let go counts, too.
    let released = gesture.dragging && !canvas.is_down();
    let gizmo = &mut gesture.gizmo;
    let moved = gizmo
        .update(GizmoInteraction { dragging: canvas.is_down() || released, ..interaction }, &[transform]);
    if released {
        gizmo.update(interaction, &[transform]);
    }
    moved?.1.first().copied()
}

/// Moves the part in the hand back to its place at rest.
pub fn reset(window: &Window, commands: &mut Commands) {
    let Some(place) = place(window, commands) else { return };
    let change = match (&place.kind, place.target) {
        (MovedKind::Region { pivot }, MovedPart::Region(region)) => {
            Change::MoveRegion { region, motion: Motion { pivot: Some(*pivot), ..Motion::default() } }
        }
        (_, MovedPart::Handle(_)) => {
            let still = |id| HandleMove { id, motion: Motion::default() };
            Change::MoveHandles(window.tools.handles(place.id).into_iter().map(still).collect())
        }
        _ => return,
    };
    commands.change(place.step, change, false);
}

/// The gizmo's transform of a map in model coordinates: local coordinates, as the gizmo has them.
fn transform(matrix: &DAffine3, to_local: impl Fn(DVec3) -> DVec3) -> Transform {
    let scale = matrix.matrix3.determinant().abs().cbrt().max(f64::MIN_POSITIVE);
    let turn = DQuat::from_mat3(&(matrix.matrix3 * scale.recip())).normalize();
    Transform::from_scale_rotation_translation(
        [scale; 3],
        turn.to_array(),
        to_local(matrix.translation).to_array(),
    )
}

fn affine(to: &Transform, to_model: impl Fn(DVec3) -> DVec3) -> Option<DAffine3> {
    let vector = |v: [f64; 3]| DVec3::from_array(v);
    let scale = vector(to.scale.into());
    let turn = DQuat::from_array(to.rotation.into());
    let matrix =
        DAffine3::from_scale_rotation_translation(scale, turn, to_model(vector(to.translation.into())));
    matrix.is_finite().then_some(matrix)
}

fn visuals() -> GizmoVisuals {
    let color = transform_gizmo::Color32::from_rgb;
    GizmoVisuals {
        x_color: color(226, 62, 68),
        y_color: color(96, 172, 40),
        z_color: color(52, 120, 232),
        s_color: color(235, 235, 235),
        inactive_alpha: 0.9,
        highlight_alpha: 1.0,
        highlight_color: Some(color(255, 196, 40)),
        stroke_width: 4.0,
        gizmo_size: 82.0,
    }
}

/// Triangles that the gizmo draws, for egui.
fn mesh(gizmo: &transform_gizmo::Gizmo) -> Mesh {
    let data = gizmo.draw();
    let vertex = |([x, y], [r, g, b, a]): (&[f32; 2], &[f32; 4])| epaint::Vertex {
        pos: Pos2::new(*x, *y),
        uv: epaint::WHITE_UV,
        color: Color32::from(Rgba::from_rgba_premultiplied(*r, *g, *b, *a)),
    };
    let vertices = data.vertices.iter().zip(&data.colors).map(vertex).collect();
    Mesh { indices: data.indices, vertices, texture_id: Default::default() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DMat3;

    #[test]
    fn a_transform_comes_back() {
        let matrix =
            DAffine3 { matrix3: DMat3::from_rotation_y(0.7) * 1.5, translation: DVec3::new(1.0, -2.0, 3.0) };
        let half = |p: DVec3| p * 0.5;
        let back = affine(&transform(&matrix, half), |p| p * 2.0).unwrap();
        assert!(back.abs_diff_eq(matrix, 1e-12));
    }

    #[test]
    fn a_handle_that_cannot_turn_is_shifted() {
        assert_eq!(modes(Tool::Rotate, simod_plugin_api::Gizmo::TRANSLATE), GizmoMode::all_translate());
        assert_eq!(modes(Tool::Rotate, simod_plugin_api::Gizmo::ROTATE), GizmoMode::all_rotate());
    }
}
