//! Handles as dots: those that the chosen step's plugin placed, and the middles of its handle regions; and
//! the knobs of the planes between which it works along an axis.

use super::ModelArea;
use crate::axis::{Axis, PLANES};
use crate::theme;
use crate::tools::{MovedPart, Tool, ToolContext};
use crate::window::{Commands, Window};
use eframe::egui::{Color32, CursorIcon, Pos2, Rect, Shape, Stroke, pos2, vec2};
use glam::DVec3;
use simod_session::edit::Change;
use simod_session::step::Role;
use simod_viewer::Command;
use simod_viewer::motion::handle_matrix;
use simod_viewer::skeleton::is_pin;
use std::collections::{BTreeSet, HashMap};

/// Distance within which the pointer takes a handle, in points of the screen.
const REACH: f32 = 11.0;

/// The colour of dots that are not chosen.
const DOT: Color32 = Color32::from_rgb(90, 160, 235);

/// A dot.
struct HandleDot {
    target: MovedPart,
    at: Pos2,
    depth: f64,
    /// Ends of the bone that leads to the joint from its parent, on the screen, where it has one.
    bone: Option<[Pos2; 2]>,
}

impl HandleDot {
    /// Whether the dot is of a pin, which nobody moves.
    fn is_pin(&self) -> bool {
        matches!(&self.target, MovedPart::Handle(id) if is_pin(id))
    }
}

fn dots(canvas: &ModelArea<'_>, window: &Window) -> Vec<HandleDot> {
    let state = window.state();
    let (Some((step, _, deformation, _)), Some(scene)) = (window.chosen(), state.scene()) else {
        return Vec::new();
    };
    let (frame, camera, size) = (scene.frame(), state.camera(), state.size());
    let seen = |p: DVec3| {
        let (pixel, depth) = camera.project(p, size)?;
        Some((canvas.in_points(pixel), depth))
    };
    let project = |p: DVec3| seen(frame.to_local_exact(p));
    let mut dots = Vec::new();
    for (i, region) in deformation.regions.iter().enumerate().filter(|(_, r)| r.role == Role::Handle) {
        // A region without a pivot is left out: it would take a pass over all samples to find its middle.
        let Some(pivot) = region.motion.pivot else { continue };
        if let Some((at, depth)) = project(handle_matrix(&region.motion, pivot).translation) {
            dots.push(HandleDot { target: MovedPart::Region(i), at, depth, bone: None });
        }
    }
    let placed = state.handles(step);
    // Bones that an end bends are drawn in the body; the end's handle is drawn where the hand put it.
    let posed = state.posed(step).filter(|posed| posed.len() == placed.len());
    let is_joint = |id: &str| deformation.joints.iter().any(|joint| joint.id == id);
    let place_of = |i: usize| match (posed, placed.get(i)?) {
        (Some(posed), (desc, _)) if is_joint(&desc.id) => seen(posed[i]),
        (_, (_, place)) => project(place.position()),
    };
    for (i, (desc, place)) in placed.iter().enumerate() {
        // An end is drawn where the hand wants it, whether its bones get there or not.
        let is_end = posed.is_none() || placed.iter().all(|(other, _)| other.parent as usize != i);
        let shown = if is_end { project(place.position()) } else { place_of(i) };
        let Some((at, depth)) = shown else { continue };
        let bone = place_of(desc.parent as usize).and_then(|from| Some([from.0, place_of(i)?.0]));
        let target = MovedPart::Handle(desc.id.to_string());
        dots.push(HandleDot { target, at, depth, bone });
    }
    // Dots in front are drawn last.
    dots.sort_by(|a, b| b.depth.total_cmp(&a.depth));
    dots
}

fn is_shown(window: &Window) -> bool {
    let tool = window.tools.tool;
    !tool.selects() && tool != Tool::Stroke || window.tools.picks_handles()
}

fn nearest<'a>(canvas: &ModelArea<'_>, dots: &'a [HandleDot]) -> Option<&'a HandleDot> {
    let pointer = canvas.pointer_pos().filter(|_| canvas.is_hovered())?;
    let near = dots.iter().filter(|dot| !dot.is_pin() && dot.at.distance(pointer) < REACH);
    near.min_by(|a, b| a.at.distance(pointer).total_cmp(&b.at.distance(pointer)))
}

/// Colour and radius of a dot: smaller where there are `many`, fainter the farther it is, `far` from 0 to
/// 1.
fn look(chosen: bool, hovered: bool, many: bool, far: f32) -> (Color32, f32) {
    match (chosen, hovered) {
        (true, _) => (theme::color(theme::SELECTED), 6.0),
        (_, true) => (Color32::WHITE, 6.5),
        _ if many => (DOT.gamma_multiply(1.0 - 0.6 * far), 3.0),
        _ => (DOT.gamma_multiply(1.0 - 0.5 * far), 5.0),
    }
}

/// Draws the handles of the chosen step.
pub fn draw(canvas: &ModelArea<'_>, window: &Window) {
    if !is_shown(window) {
        return;
    }
    let in_hand = window.chosen().map(|(_, step, ..)| window.tools.handles(step)).unwrap_or_default();
    let dots = dots(canvas, window);
    let painter = canvas.painter();
    let hovered = nearest(canvas, &dots).map(|dot| dot.target.clone());
    for [from, to] in dots.iter().filter_map(|dot| dot.bone) {
        bone(canvas, from, to);
    }
    grid(canvas, &dots);
    let [nearest, farthest] = dots
        .iter()
        .fold([f64::INFINITY, f64::NEG_INFINITY], |[a, b], dot| [a.min(dot.depth), b.max(dot.depth)]);
    let share = |depth: f64| ((depth - nearest) / (farthest - nearest).max(1e-9)) as f32;
    surface(canvas, window, &dots, share);
    let many = dots.len() > 200;
    for dot in &dots {
        if dot.is_pin() {
            pin(canvas, dot.at, window.tools.target.as_ref() == Some(&dot.target));
            continue;
        }
        let is_held = matches!(&dot.target, MovedPart::Handle(id) if in_hand.contains(id));
        let chosen = is_held || window.tools.target.as_ref() == Some(&dot.target);
        let hovered = hovered.as_ref() == Some(&dot.target);
        let (color, radius) = look(chosen, hovered, many, share(dot.depth));
        let outline = Stroke::new(1.2, Color32::from_black_alpha(if chosen || hovered { 220 } else { 140 }));
        match dot.target {
            MovedPart::Handle(_) => painter.circle(dot.at, radius, color, outline),
            MovedPart::Region(_) => {
                let r = radius + 1.5;
                let corners = [(0.0, -r), (r, 0.0), (0.0, r), (-r, 0.0)];
                let corners = corners.map(|(x, y)| pos2(dot.at.x + x, dot.at.y + y)).to_vec();
                let color =
                    if chosen || hovered { color } else { theme::color(theme::role_color(Role::Handle)) };
                painter.add(Shape::convex_polygon(corners, color, outline))
            }
        };
    }
    if let Some(MovedPart::Handle(name)) = &hovered {
        canvas.response.clone().on_hover_text_at_pointer(name);
    }
}

/// Handles whose ids are three whole numbers, as `3,3,3`, are the points of a grid: lines between neighbours.
fn grid(canvas: &ModelArea<'_>, dots: &[HandleDot]) {
    let place = |dot: &HandleDot| {
        let MovedPart::Handle(id) = &dot.target else { return None };
        let numbers: Vec<i32> = id.split(',').map(str::parse).collect::<Result<_, _>>().ok()?;
        <[i32; 3]>::try_from(numbers).ok()
    };
    let places: HashMap<[i32; 3], Pos2> = dots.iter().filter_map(|dot| Some((place(dot)?, dot.at))).collect();
    let last = places.keys().fold([0; 3], |last: [i32; 3], place| [0, 1, 2].map(|a| last[a].max(place[a])));
    for (place, at) in &places {
        for axis in 0..3 {
            let mut next = *place;
            next[axis] += 1;
            let Some(to) = places.get(&next) else { continue };
            // The edges of the box around all points are the easiest to see.
            let is_edge = (0..3).all(|a| a == axis || place[a] == 0 || place[a] == last[a]);
            let (width, share) = if is_edge { (1.8, 0.8) } else { (1.0, 0.3) };
            canvas.painter().line_segment([*at, *to], Stroke::new(width, DOT.gamma_multiply(share)));
        }
    }
}

/// Draws the faces between handles that the plugin gave, with their edges: a cage. `far` gives the place of
/// a depth between that of the nearest dot, 0, and of the farthest one, 1.
fn surface(canvas: &ModelArea<'_>, window: &Window, dots: &[HandleDot], far: impl Fn(f64) -> f32) {
    let own = window.chosen().and_then(|(step, ..)| window.state().own_handles(step));
    let Some(own) = own.filter(|own| !own.faces.is_empty()) else { return };
    let seen: HashMap<&str, &HandleDot> = dots
        .iter()
        .filter_map(|dot| match &dot.target {
            MovedPart::Handle(id) => Some((id.as_str(), dot)),
            MovedPart::Region(_) => None,
        })
        .collect();
    let dot = |corner: &u32| seen.get(own.descs.get(*corner as usize)?.id.as_str()).copied();
    let painter = canvas.painter();
    let mut edges = BTreeSet::new();
    for face in &own.faces {
        // A face with a corner behind the eye is not drawn.
        let corners: Option<Vec<&HandleDot>> = face.iter().map(dot).collect();
        let Some(corners) = corners else { continue };
        // A fan, as the picture of a face that is bent need not be convex.
        for pair in corners[1..].windows(2) {
            let triangle = vec![corners[0].at, pair[0].at, pair[1].at];
            painter.add(Shape::convex_polygon(triangle, DOT.gamma_multiply(0.05), Stroke::NONE));
        }
        let ends = face.iter().zip(face.iter().cycle().skip(1));
        edges.extend(ends.map(|(a, b)| [*a.min(b), *a.max(b)]));
    }
    for [a, b] in edges {
        let (Some(a), Some(b)) = (dot(&a), dot(&b)) else { continue };
        let shade = 0.9 - 0.6 * far(0.5 * (a.depth + b.depth));
        painter.line_segment([a.at, b.at], Stroke::new(1.5, DOT.gamma_multiply(shade)));
    }
}

/// Draws a pin, whose point is where it holds the body.
fn pin(canvas: &ModelArea<'_>, at: Pos2, chosen: bool) {
    let color = if chosen { theme::SELECTED } else { theme::role_color(Role::Fixed) };
    let (head, color) = (at + vec2(0.0, -13.0), theme::color(color));
    let outline = Stroke::new(1.2, Color32::from_black_alpha(200));
    canvas.painter().line_segment([at, head], Stroke::new(2.5, color));
    canvas.painter().circle(head, 5.0, color, outline);
    canvas.painter().circle_filled(at, 1.8, color);
}

/// Draws a bone: thick at the parent, thin at the child.
fn bone(canvas: &ModelArea<'_>, from: Pos2, to: Pos2) {
    let way = to - from;
    let side = way.normalized().rot90() * (0.08 * way.length()).clamp(2.0, 7.0);
    let thick = from + 0.16 * way;
    let corners = vec![from, thick + side, to, thick - side];
    let fill = Color32::from_rgba_unmultiplied(90, 160, 235, 110);
    canvas.painter().add(Shape::convex_polygon(
        corners,
        fill,
        Stroke::new(1.0, Color32::from_black_alpha(150)),
    ));
}

/// The joint of the chosen step that is seen at a pixel.
pub fn joint_at(canvas: &ModelArea<'_>, window: &Window, pixel: glam::DVec2) -> Option<String> {
    let (_, _, deformation, _) = window.chosen()?;
    let at = canvas.in_points(pixel);
    let is_joint = |id: &String| deformation.joints.iter().any(|joint| joint.id == *id);
    dots(canvas, window).into_iter().find_map(|dot| match dot.target {
        MovedPart::Handle(id) if dot.at.distance(at) < REACH && is_joint(&id) && !is_pin(&id) => Some(id),
        _ => None,
    })
}

/// Takes the handle under the pointer, or the handle region to which the surface there belongs. Returns
/// whether there is one.
pub fn take(canvas: &ModelArea<'_>, window: &Window, commands: &mut Commands) -> bool {
    let dots = dots(canvas, window);
    let target = match nearest(canvas, &dots) {
        Some(dot) => Some(dot.target.clone()),
        None => region_under(canvas, window),
    };
    let found = target.is_some();
    if found {
        take_also(canvas, window, commands, target);
        if window.tools.tool == Tool::Orbit {
            commands.then(|window| window.tools.take(Tool::Move));
        }
    }
    found
}

/// Takes a handle instead of those in the hand; with Shift in addition to them, or out of the hand if it is
/// in it.
fn take_also(canvas: &ModelArea<'_>, window: &Window, commands: &mut Commands, target: Option<MovedPart>) {
    let (Some(MovedPart::Handle(id)), Some((_, step, ..))) = (&target, window.chosen()) else {
        commands.then(|window| window.tools.target = target);
        return;
    };
    let mut all = if canvas.modifiers().shift { window.tools.handles(step) } else { BTreeSet::new() };
    let first = if all.remove(id) { None } else { Some(id.clone()) };
    commands.then(move |window| window.tools.take_handles(step, first, all));
}

/// The handles that the chosen step's plugin placed and that are seen in a part of the picture.
pub fn within(canvas: &ModelArea<'_>, window: &Window, rect: Rect) -> BTreeSet<String> {
    let id = |dot: HandleDot| match dot.target {
        MovedPart::Handle(id) if rect.contains(dot.at) && !is_pin(&id) => Some(id),
        _ => None,
    };
    dots(canvas, window).into_iter().filter_map(id).collect()
}

fn region_under(canvas: &ModelArea<'_>, window: &Window) -> Option<MovedPart> {
    let (step, _, deformation, _) = window.chosen()?;
    let has_handle = deformation.regions.iter().any(|r| r.role == Role::Handle);
    let hit = window.state().pick(canvas.pointer().filter(|_| has_handle)?)?;
    let at = window.state().in_step(step, &hit)?;
    let holds =
        |region: &simod_session::step::Region| region.role == Role::Handle && region.shapes.weight(at) > 0.5;
    deformation.regions.iter().position(holds).map(MovedPart::Region)
}

/// Half a side of a plane, as a part of the model's diagonal.
const SIDE: f64 = 0.22;
/// Segments of a line, as a line may go behind the eye.
const SEGMENTS: usize = 16;

/// Draws the axis along which the chosen step works, with its planes.
pub fn draw_axis(canvas: &ModelArea<'_>, window: &Window) {
    let Some(axis) = Axis::find(window).filter(|_| is_shown(window)) else { return };
    let (camera, size) = (window.state().camera(), window.state().size());
    let project = |p: DVec3| camera.project(p, size).map(|(pixel, _)| canvas.in_points(pixel));
    let painter = canvas.painter();
    let line = |from: f64, to: f64, stroke: Stroke| {
        let place = |i: usize| axis.point(from + (to - from) * i as f64 / SEGMENTS as f64);
        let points: Vec<Option<Pos2>> = (0..=SEGMENTS).map(|i| project(place(i))).collect();
        for pair in points.windows(2) {
            if let [Some(a), Some(b)] = pair {
                painter.line_segment([*a, *b], stroke);
            }
        }
    };
    let [from, to] = axis.places;
    let beyond = 0.12 * axis.diagonal;
    line(from - beyond, to + beyond, Stroke::new(1.0, DOT.gamma_multiply(0.5)));
    line(from, to, Stroke::new(2.5, DOT));
    let (u, v) = axis.direction.any_orthonormal_pair();
    let side = SIDE * axis.diagonal;
    let hovered = canvas.pointer_pos().filter(|_| canvas.is_hovered());
    for (k, place) in axis.places.into_iter().enumerate() {
        let middle = axis.point(place);
        let corners = [u + v, v - u, -u - v, u - v].map(|way| project(middle + way * side));
        let corners: Vec<Pos2> = corners.into_iter().flatten().collect();
        if corners.len() == 4 {
            painter.add(Shape::convex_polygon(
                corners,
                DOT.gamma_multiply(0.12),
                Stroke::new(1.2, DOT.gamma_multiply(0.8)),
            ));
        }
        if let Some(at) = project(middle) {
            let held = window.tools.gesture.plane == Some(k);
            let near = hovered.is_some_and(|p| p.distance(at) < REACH);
            let (color, radius) = match (held, near) {
                (true, _) => (theme::color(theme::SELECTED), 6.0),
                (_, true) => (Color32::WHITE, 6.5),
                _ => (DOT, 5.0),
            };
            painter.circle(at, radius, color, Stroke::new(1.2, Color32::from_black_alpha(160)));
        }
    }
}

/// The plane whose knob is at a place of the screen.
fn plane_under(canvas: &ModelArea<'_>, window: &Window, axis: &Axis, p: Pos2) -> Option<usize> {
    let (camera, size) = (window.state().camera(), window.state().size());
    let near = |place: f64| {
        let at = canvas.in_points(camera.project(axis.point(place), size)?.0);
        Some(at.distance(p)).filter(|distance| *distance < REACH)
    };
    match axis.places.map(near) {
        [Some(a), Some(b)] => Some(usize::from(b < a)),
        [Some(_), None] => Some(0),
        [None, Some(_)] => Some(1),
        [None, None] => None,
    }
}

/// Lets the knobs of the planes follow the hand. Returns whether the pointer belongs to the knobs.
pub fn drag_planes(context: &mut ToolContext<'_>) -> bool {
    let (canvas, window) = (context.canvas, context.window);
    let Some(axis) = Axis::find(window).filter(|_| is_shown(window)) else {
        context.gesture.plane = None;
        return false;
    };
    let under = |p: Pos2| plane_under(canvas, window, &axis, p);
    if canvas.is_pressed()
        && let Some(at) = canvas.ctx().input(|i| i.pointer.press_origin()).or(canvas.pointer_pos())
    {
        context.gesture.plane = under(at);
    }
    let Some(plane) = context.gesture.plane else {
        if canvas.is_hovered() && canvas.pointer_pos().and_then(under).is_some() {
            canvas.ctx().set_cursor_icon(CursorIcon::Grab);
        }
        return false;
    };
    let moved = canvas.trail().last().copied();
    if let Some(place) = moved.and_then(|pixel| axis.place_under(window, pixel)) {
        // The first plane stays before the other one: the step works between them.
        let least = 1e-3 * axis.diagonal;
        let place =
            if plane == 0 { place.min(axis.places[1] - least) } else { place.max(axis.places[0] + least) };
        let value = Some((place / axis.diagonal).into());
        context.commands.change(axis.step, Change::SetParam { id: PLANES[plane].to_owned(), value }, true);
        context.gesture.drags_plane = true;
    }
    if !canvas.is_down() {
        context.gesture.plane = None;
        if std::mem::take(&mut context.gesture.drags_plane) {
            context.commands.apply(Command::Rest);
        }
    }
    true
}
