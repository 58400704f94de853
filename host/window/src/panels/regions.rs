//! The chosen step's regions, handles and joints; and the selection, of which regions are made.

use super::{count, parts};
use crate::regions as make;
use crate::theme;
use crate::tools::{MovedPart, Tool};
use crate::window::{Commands, Window};
use eframe::egui::{
    self, Align, Button, CornerRadius, DragValue, Frame, Key, Layout, Margin, RichText, Sense, Slider,
    Stroke, TextEdit, Ui, vec2,
};
use simod_session::edit::{Change, EditCommand};
use simod_session::step::{Deformation, Region, Role};
use simod_session::{Motion, RegionShape};
use simod_viewer::command::Area;
use simod_viewer::skeleton::{is_pin, mirrored};
use simod_viewer::{Command, Overlay};

/// Joints that are nearer to the middle than this part of the model's diagonal have no other side.
const NEAR_MIDDLE: f64 = 0.01;

const ROLES: [Role; 3] = [Role::Fixed, Role::Handle, Role::Mask];

/// Shows the panel.
pub fn show(ui: &mut Ui, window: &Window, commands: &mut Commands) {
    let chosen = window.chosen();
    if let Some((step, _, deformation, Some(plugin))) = &chosen {
        parts::part(ui);
        parts::heading(ui, "Regions", |_| ());
        let text = "It acts on the whole model. A mask keeps it to a part.";
        if deformation.regions.is_empty() && plugin.consumes().min_handles == 0 {
            ui.label(RichText::new(text).weak());
        }
        for (i, region) in deformation.regions.iter().enumerate() {
            row(ui, window, commands, *step, deformation, i, region);
        }
    }
    selection(ui, window, commands);
    if let Some((step, _, deformation, _)) = chosen {
        handle(ui, window, commands, step, &deformation);
        joints(ui, window, commands, step, &deformation);
    }
}

fn row(
    ui: &mut Ui,
    window: &Window,
    commands: &mut Commands,
    step: usize,
    deformation: &Deformation,
    i: usize,
    region: &Region,
) {
    let is_target = window.tools.target == Some(MovedPart::Region(i));
    let (fill, stroke) = if is_target {
        let color = ui.visuals().selection.bg_fill;
        (color.gamma_multiply(0.28), Stroke::new(1.0, color))
    } else {
        (ui.visuals().widgets.inactive.bg_fill.gamma_multiply(0.5), Stroke::NONE)
    };
    let frame = Frame::NONE.fill(fill).stroke(stroke).corner_radius(CornerRadius::same(5));
    frame.inner_margin(Margin::symmetric(8, 4)).show(ui, |ui| {
        ui.set_min_width(ui.available_width());
        ui.horizontal(|ui| {
            let (dot, _) = ui.allocate_exact_size(vec2(12.0, 12.0), Sense::hover());
            ui.painter().circle_filled(dot.center(), 5.0, theme::color(theme::role_color(region.role)));
            let name = format!("{} {}", theme::role_name(region.role), i + 1);
            let grab = ui.add(Button::new(RichText::new(&name).strong()).frame(false));
            let hint = if region.role == Role::Handle { "Grab it" } else { "Show its weight on the surface" };
            if grab.on_hover_text(hint).clicked() {
                choose(window, commands, i, region.role);
            }
            ui.label(RichText::new(what(region)).weak().small());
            ui.with_layout(Layout::right_to_left(Align::Center), |ui| {
                more(ui, window, commands, step, deformation, i, region);
            });
        });
        ui.horizontal(|ui| {
            ui.add_space(18.0);
            falloff(ui, window, commands, step, deformation, i);
        });
    });
    ui.add_space(1.0);
}

fn choose(window: &Window, commands: &mut Commands, i: usize, role: Role) {
    if role == Role::Handle {
        commands.then(move |window| {
            window.tools.target = Some(MovedPart::Region(i));
            if !window.tools.tool.is_gizmo() {
                window.tools.take(Tool::Move);
            }
        });
    } else {
        let shown = window.state().overlay() == Overlay::Region(i);
        commands.apply(Command::Show(if shown { Overlay::None } else { Overlay::Region(i) }));
    }
}

/// Shapes of a region, in words.
fn what(region: &Region) -> String {
    let name = |shape: &RegionShape| match shape {
        RegionShape::HalfSpace { .. } => "half-space".to_owned(),
        RegionShape::Sphere { .. } => "sphere".to_owned(),
        RegionShape::Box { .. } => "box".to_owned(),
        RegionShape::Selection(picked) => format!("{} samples", count(picked.inside().len() as u64)),
    };
    region.shapes.shapes.iter().map(name).collect::<Vec<_>>().join(", ")
}

fn falloff(
    ui: &mut Ui,
    window: &Window,
    commands: &mut Commands,
    step: usize,
    deformation: &Deformation,
    i: usize,
) {
    let Some(scene) = window.state().scene() else { return };
    let size = (scene.sampled.bounds.max - scene.sampled.bounds.min).length();
    ui.label(RichText::new("Falloff").small());
    let id = ui.scope_id().with(("falloff", i));
    let name = format!("Falloff of region {}", i + 1);
    let falloff = deformation.regions[i].shapes.falloff;
    let (response, changed) = parts::held(ui, id, &name, falloff, |x| {
        DragValue::new(x).range(0.0..=size).speed(0.001 * size).max_decimals(4)
    });
    if let Some(falloff) = changed {
        let mut regions = deformation.regions.clone();
        regions[i].shapes.falloff = falloff;
        commands.change(step, Change::SetRegions(regions), false);
    }
    response.on_hover_text("Distance beyond its border over which the region fades out, in the model's unit");
}

/// Entries of a menu for the roles that a region can have; the one that was chosen.
fn chosen_role(ui: &mut Ui, window: &Window, now: Role) -> Option<Role> {
    let mut chosen = None;
    for role in ROLES {
        let button = Button::selectable(now == role, theme::role_name(role));
        if ui.add_enabled(make::takes(window, role), button).clicked() {
            chosen = Some(role);
        }
    }
    chosen
}

fn more(
    ui: &mut Ui,
    window: &Window,
    commands: &mut Commands,
    step: usize,
    deformation: &Deformation,
    i: usize,
    region: &Region,
) {
    let menu = ui.menu_button("\u{2026}", |ui| {
        if let Some(role) = chosen_role(ui, window, region.role) {
            let mut regions = deformation.regions.clone();
            regions[i].role = role;
            commands.change(step, Change::SetRegions(regions), false);
            ui.close();
        }
        ui.separator();
        let selected = !window.state().selection().is_empty();
        if ui.add_enabled(selected, Button::new("Replace by Selection")).clicked() {
            let (role, falloff) = (region.role, region.shapes.falloff);
            commands.apply(Command::MakeRegion { step, role, falloff, replaces: Some(i) });
            ui.close();
        }
        let still = region.motion == Motion { pivot: region.motion.pivot, ..Motion::default() };
        if ui.add_enabled(!still, Button::new("Reset Motion")).clicked() {
            let motion = Motion { pivot: region.motion.pivot, ..Motion::default() };
            commands.change(step, Change::MoveRegion { region: i, motion }, false);
            ui.close();
        }
        if ui.button("Select Its Samples").clicked() {
            let (area, combine) = (Area::Region { step, region: i }, Default::default());
            commands.apply(Command::Select { area, combine, visible: false, goes_on: false });
            ui.close();
        }
        if ui.button("Show Weight").clicked() {
            commands.apply(Command::Show(Overlay::Region(i)));
            ui.close();
        }
        ui.separator();
        if ui.button("Remove").clicked() {
            let mut regions = deformation.regions.clone();
            regions.remove(i);
            commands.change(step, Change::SetRegions(regions), false);
            commands.then(|window| window.tools.target = None);
            ui.close();
        }
    });
    let name = format!("More on region {}", i + 1);
    menu.response.widget_info(|| egui::WidgetInfo::labeled(egui::Role::Button, true, &name));
}

/// Buttons for what can be made of the selected samples.
fn selection(ui: &mut Ui, window: &Window, commands: &mut Commands) {
    let selected = window.state().selection().count();
    if selected == 0 {
        return;
    }
    parts::part(ui);
    parts::heading(ui, &format!("Selection: {} samples", count(selected as u64)), |_| ());
    ui.horizontal_wrapped(|ui| {
        for role in ROLES {
            let text = format!("Make {}", theme::role_name(role));
            let can = make::can_make(window, role);
            let why = if can { "" } else { "The chosen step takes no such region" };
            let button = ui.add_enabled(can, Button::new(text)).on_disabled_hover_text(why);
            if button.clicked() {
                make::make(window, commands, role);
            }
        }
        if ui.button("Refine").on_hover_text("Adds samples in the selection, as a step of its own").clicked()
        {
            make::refine(commands);
        }
    });
    if !(make::can_make(window, Role::Handle) && make::takes(window, Role::Fixed)) {
        return;
    }
    ui.horizontal(|ui| {
        let hint =
            "Makes a handle of the selection, and fixes what is farther from it than the band that bends";
        if ui.button("Make Handle, Fix Around").on_hover_text(hint).clicked() {
            make::make_handle(window, commands);
        }
        ui.spacing_mut().slider_width = 60.0;
        let mut band = window.tools.band;
        let slider = Slider::new(&mut band, 0.01..=0.5).logarithmic(true).max_decimals(2);
        let hint = "Width of the band, as a part of the model\u{2019}s diagonal";
        let response = ui.add(slider).on_hover_text(hint);
        response.ctx.accesskit_node_builder(response.id, |node| node.set_label("Band that bends"));
        if response.changed() {
            commands.then(move |window| window.tools.band = band);
        }
    });
}

/// Fields of a motion's numbers, for a model whose diagonal is `size`; one response for each number.
fn motion_rows(ui: &mut Ui, to: &mut Motion, size: f64) -> Vec<egui::Response> {
    let mut rows: Vec<egui::Response> = Vec::new();
    egui::Grid::new("motion").num_columns(2).spacing([12.0, 5.0]).show(ui, |ui| {
        ui.label("Move");
        ui.horizontal(|ui| {
            for (x, axis) in [&mut to.translate.x, &mut to.translate.y, &mut to.translate.z]
                .into_iter()
                .zip(["x", "y", "z"])
            {
                let drag = DragValue::new(x).speed(0.001 * size).max_decimals(4).prefix(format!("{axis} "));
                rows.push(ui.add_sized([64.0, ui.spacing().interact_size.y], drag));
            }
        });
        ui.end_row();
        ui.label("Turn");
        rows.push(ui.add(DragValue::new(&mut to.degrees).speed(0.5).suffix("\u{b0}").max_decimals(2)));
        ui.end_row();
        ui.label("Scale");
        rows.push(ui.add(DragValue::new(&mut to.scale).speed(0.005).range(0.001..=1000.0).max_decimals(4)));
        ui.end_row();
    });
    rows
}

/// Fields of the motion of what the gizmo moves.
fn handle(ui: &mut Ui, window: &Window, commands: &mut Commands, step: usize, deformation: &Deformation) {
    let Some(target) = window.tools.target.clone() else { return };
    let (name, motion) = match &target {
        MovedPart::Region(i) => match deformation.regions.get(*i) {
            Some(region) => (format!("Handle {}", i + 1), region.motion),
            None => return,
        },
        MovedPart::Handle(id) if is_pin(id) => return,
        MovedPart::Handle(id) => {
            let moved = deformation.handles.iter().find(|handle| handle.id == *id);
            (format!("Handle {id}"), moved.map_or(Motion::default(), |moved| moved.motion))
        }
    };
    parts::part(ui);
    parts::heading(ui, &name, |ui| {
        if ui.small_button("Reset").on_hover_text("Back to where it is at rest").clicked() {
            crate::tools::gizmo::reset(window, commands);
        }
    });
    let Some(scene) = window.state().scene() else { return };
    let size = (scene.sampled.bounds.max - scene.sampled.bounds.min).length();
    let mut to = motion;
    let rows = motion_rows(ui, &mut to, size);
    for (response, name) in rows.iter().zip(["Move x", "Move y", "Move z", "Turn", "Scale"]) {
        response.ctx.accesskit_node_builder(response.id, |node| node.set_label(name));
        let change = || match target.clone() {
            MovedPart::Region(region) => Change::MoveRegion { region, motion: to },
            MovedPart::Handle(id) => Change::MoveHandle { id, motion: to },
        };
        if response.changed() {
            commands.change(step, change(), response.dragged() || response.drag_stopped());
        }
        if response.drag_stopped() {
            commands.apply(Command::Rest);
        }
    }
}

fn joints(ui: &mut Ui, window: &Window, commands: &mut Commands, step: usize, deformation: &Deformation) {
    if deformation.joints.is_empty() {
        return;
    }
    parts::part(ui);
    parts::heading(ui, "Joints", |ui| {
        ui.menu_button("Mirror", |ui| mirror(ui, window, commands, step, deformation));
    });
    for (i, joint) in deformation.joints.iter().enumerate() {
        ui.horizontal(|ui| {
            if name(ui, window, commands, step, &joint.id) {
                return;
            }
            let chosen = window.tools.target == Some(MovedPart::Handle(joint.id.clone()));
            let label = ui.selectable_label(chosen, &joint.id).on_hover_text("A double click renames it");
            if label.double_clicked() {
                begin_naming(commands, &joint.id);
            } else if label.clicked() {
                let target = Some(MovedPart::Handle(joint.id.clone()));
                commands.then(move |window| window.tools.target = target);
            }
            if let Some(parent) = &joint.parent {
                ui.label(RichText::new(format!("on {parent}")).weak().small());
            }
            ui.with_layout(Layout::right_to_left(Align::Center), |ui| {
                let remove = ui.small_button("\u{d7}").on_hover_text("Remove it");
                remove.widget_info(|| {
                    egui::WidgetInfo::labeled(egui::Role::Button, true, format!("Remove {}", joint.id))
                });
                let rename = ui.small_button("Rename");
                rename.widget_info(|| {
                    egui::WidgetInfo::labeled(egui::Role::Button, true, format!("Rename {}", joint.id))
                });
                if rename.clicked() {
                    begin_naming(commands, &joint.id);
                }
                if remove.clicked() {
                    let mut joints = deformation.joints.clone();
                    let gone = joints.remove(i);
                    // Joints that hung on the removed joint hang on its parent from now on.
                    for other in joints.iter_mut().filter(|j| j.parent.as_ref() == Some(&gone.id)) {
                        other.parent.clone_from(&gone.parent);
                    }
                    commands.change(step, Change::SetJoints(joints), false);
                    commands.then(|window| window.tools.target = None);
                }
            });
        });
    }
}

/// Buttons that mirror the joints of one side to the other one.
fn mirror(ui: &mut Ui, window: &Window, commands: &mut Commands, step: usize, deformation: &Deformation) {
    let Some(scene) = window.state().scene() else { return };
    let bounds = scene.sampled.bounds;
    let near = NEAR_MIDDLE * (bounds.max - bounds.min).length();
    ui.label(RichText::new("Across the middle of the model").weak().small());
    for (axis, text) in
        ["X: left and right", "Y: below and above", "Z: front and back"].into_iter().enumerate()
    {
        if ui.button(text).clicked() {
            let middle = 0.5 * (bounds.min[axis] + bounds.max[axis]);
            let joints = mirrored(&deformation.joints, axis, middle, near);
            commands.change(step, Change::SetJoints(joints), false);
            ui.close();
        }
    }
}

/// Has a joint's name typed.
fn begin_naming(commands: &mut Commands, id: &str) {
    let naming = Some((id.to_owned(), id.to_owned()));
    commands.then(move |window| window.tools.naming = naming);
}

/// Field of a joint's name while the name is typed, until Enter or Escape, or a click elsewhere. Returns
/// whether it is typed.
fn name(ui: &mut Ui, window: &Window, commands: &mut Commands, step: usize, id: &str) -> bool {
    let naming = window.tools.naming.clone().filter(|(of, _)| of == id);
    let Some((of, mut text)) = naming else { return false };
    let response = ui.add(TextEdit::singleline(&mut text).desired_width(180.0));
    response.ctx.accesskit_node_builder(response.id, |node| node.set_label(format!("Name of {id}")));
    let ends = response.lost_focus();
    if !ends {
        response.request_focus();
    }
    let is_wanted = ends && !ui.input(|i| i.key_pressed(Key::Escape));
    commands.then(move |window| {
        // The name of another joint may be typed by now.
        if window.tools.naming.take_if(|(now, _)| *now == of).is_none() {
            return;
        }
        if !ends {
            window.tools.naming = Some((of, text));
        } else if is_wanted {
            window.draw(|window, commands| rename(window, commands, step, of, text.trim()));
        }
    });
    true
}

/// Renames a joint; it stays in the hand.
fn rename(window: &Window, commands: &mut Commands, step: usize, from: String, to: &str) {
    if to == from {
        return;
    }
    let was_target = window.tools.target == Some(MovedPart::Handle(from.clone()));
    let target = Some(MovedPart::Handle(to.to_owned())).filter(|_| was_target);
    let change = Change::RenameJoint { from, to: to.to_owned() };
    commands.apply_then(Command::Edit(EditCommand::Change { at: step, change }), |window| {
        window.tools.target = target.or(window.tools.target.take());
    });
}
