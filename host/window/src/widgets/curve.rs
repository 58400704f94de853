//! A curve through points that are dragged.

use super::values::{ListRequest, list};
use eframe::egui::{Color32, Id, Pos2, Rect, Role, Sense, Shape, Stroke, StrokeKind, Ui, WidgetInfo, vec2};
use simod_plugin_api::Curve;
use toml::Value;

const HEIGHT: f32 = 120.0;
/// Least distance of points from left to right.
const APART: f64 = 0.01;
const REACH: f32 = 10.0;

fn value(points: &[[f64; 2]]) -> Value {
    Value::Array(points.iter().map(|p| list(p)).collect())
}

/// The curve: points are dragged, added by a double click, and removed by one with the right button.
pub fn show(ui: &mut Ui, name: &str, mut points: Vec<[f64; 2]>) -> Option<ListRequest> {
    let size = vec2(ui.available_width(), HEIGHT);
    let (outer, response) = ui.allocate_exact_size(size, Sense::click_and_drag());
    response.widget_info(|| WidgetInfo::labeled(Role::Canvas, true, name));
    let rect = outer.shrink(8.0);
    let at = |p: &[f64; 2]| {
        Pos2::new(rect.left() + p[0] as f32 * rect.width(), rect.bottom() - p[1] as f32 * rect.height())
    };
    let point = |p: Pos2| {
        let x = f64::from((p.x - rect.left()) / rect.width()).clamp(0.0, 1.0);
        [x, f64::from((rect.bottom() - p.y) / rect.height()).clamp(0.0, 1.0)]
    };
    let pointer = response.interact_pointer_pos().or_else(|| response.hover_pos());
    let nearest = pointer.and_then(|pointer| {
        let near = points.iter().enumerate().map(|(i, p)| (i, at(p).distance(pointer)));
        near.filter(|(_, d)| *d < REACH).min_by(|a, b| a.1.total_cmp(&b.1)).map(|(i, _)| i)
    });
    let id: Id = response.id.with("held");
    if response.drag_started() {
        ui.data_mut(|data| data.insert_temp(id, nearest));
    }
    let held = ui.data(|data| data.get_temp::<Option<usize>>(id)).flatten();
    let mut asked = None;
    let stopped = response.drag_stopped();
    if let (true, Some(i), Some(pointer)) = (response.dragged() || stopped, held, pointer)
        && i < points.len()
    {
        let [x, y] = point(pointer);
        let low = i.checked_sub(1).map_or(0.0, |left| points[left][0] + APART);
        let high = points.get(i + 1).map_or(1.0, |right| right[0] - APART);
        points[i] = [x.clamp(low, high.max(low)), y];
        let value = value(&points);
        asked = Some(if stopped { ListRequest::Rest(Some(value)) } else { ListRequest::Drag(value) });
    } else if let (true, None, Some(pointer)) = (response.double_clicked(), nearest, pointer) {
        let new = point(pointer);
        let place = points.partition_point(|p| p[0] < new[0]);
        let free = points.iter().all(|p| (p[0] - new[0]).abs() > APART);
        if free {
            points.insert(place, new);
            asked = Some(ListRequest::Set(Some(value(&points))));
        }
    } else if let (true, Some(i)) = (response.secondary_clicked() && points.len() > 2, nearest) {
        points.remove(i);
        asked = Some(ListRequest::Set(Some(value(&points))));
    }
    draw(ui, outer, rect, &points, nearest, at);
    response.on_hover_text("Drag points. Double click adds one, the right button removes one.");
    asked
}

fn draw(
    ui: &Ui,
    outer: Rect,
    rect: Rect,
    points: &[[f64; 2]],
    hovered: Option<usize>,
    at: impl Fn(&[f64; 2]) -> Pos2,
) {
    let visuals = ui.visuals();
    let painter = ui.painter();
    let line = Stroke::new(1.0, visuals.weak_text_color().gamma_multiply(0.3));
    painter.rect(outer, 4.0, visuals.extreme_bg_color, line, StrokeKind::Inside);
    for i in 1..4 {
        let t = i as f32 / 4.0;
        painter.vline(rect.left() + t * rect.width(), rect.y_range(), line);
        painter.hline(rect.x_range(), rect.top() + t * rect.height(), line);
    }
    let color = visuals.selection.bg_fill;
    if let Some(curve) = Curve::new(points) {
        let sample = |i: usize| {
            let x = i as f64 / 96.0;
            at(&[x, curve.at(x)])
        };
        painter.add(Shape::line((0..=96).map(sample).collect(), Stroke::new(2.0, color)));
    }
    for (i, p) in points.iter().enumerate() {
        let radius = if hovered == Some(i) { 6.0 } else { 4.5 };
        painter.circle(at(p), radius, Color32::WHITE, Stroke::new(1.5, color));
    }
}
