//! Look of the window: colours with a meaning, and egui's style.

use crate::settings::Theme;
use eframe::egui::{
    self, Color32, CornerRadius, FontFamily, FontId, Shadow, Stroke, TextStyle, Visuals, vec2,
};
use simod_session::step::Role;

/// Colour of selected things.
pub const SELECTED: [u8; 3] = [255, 138, 30];
/// Colour of the surface where no other is shown; as the renderer's clay.
pub const CLAY: [u8; 3] = [197, 189, 180];

/// Tint of samples, and its share, where other parts are shown in full.
pub const SAMPLES: [u8; 3] = [96, 116, 150];
pub const SAMPLES_SHARE: f32 = 0.3;

/// Colour and size in pixels of the dots for samples over vertices that are shown in full.
pub const SAMPLE_DOTS: [u8; 4] = [255, 214, 90, 255];
pub const SAMPLE_DOT_SIZE: f32 = 3.0;

/// Colour of the surface where samples stand for it and other parts are shown in full.
pub fn samples_clay() -> [u8; 3] {
    mixed(CLAY, SAMPLES, SAMPLES_SHARE)
}

/// A colour between two.
pub fn mixed(a: [u8; 3], b: [u8; 3], t: f32) -> [u8; 3] {
    std::array::from_fn(|i| (f32::from(a[i]) * (1.0 - t) + f32::from(b[i]) * t).round() as u8)
}

/// The colour of a region's samples and its name.
pub fn role_color(role: Role) -> [u8; 3] {
    match role {
        Role::Fixed => [92, 130, 196],
        Role::Handle => [64, 176, 112],
        Role::Mask => [168, 112, 204],
    }
}

/// A role's name.
pub fn role_name(role: Role) -> &'static str {
    match role {
        Role::Fixed => "Fixed",
        Role::Handle => "Handle",
        Role::Mask => "Mask",
    }
}

/// 8-bit sRGB for egui.
pub fn color([r, g, b]: [u8; 3]) -> Color32 {
    Color32::from_rgb(r, g, b)
}

/// Colour of chosen things, and of the one button that goes on.
pub const ACCENT: Color32 = Color32::from_rgb(62, 124, 214);

/// Colours of a theme: the darkest first in the dark one, and in reverse order in the light one.
struct Palette {
    dark: bool,
    panel: Color32,
    field: Color32,
    button: Color32,
    hovered: Color32,
    line: Color32,
    text: Color32,
    strong: Color32,
    weak: Color32,
}

const DARK: Palette = Palette {
    dark: true,
    panel: Color32::from_rgb(42, 44, 48),
    field: Color32::from_rgb(28, 29, 32),
    button: Color32::from_rgb(62, 65, 71),
    hovered: Color32::from_rgb(78, 82, 90),
    line: Color32::from_rgb(28, 29, 32),
    text: Color32::from_rgb(214, 216, 220),
    strong: Color32::from_rgb(244, 245, 247),
    weak: Color32::from_rgb(158, 162, 170),
};

const LIGHT: Palette = Palette {
    dark: false,
    panel: Color32::from_rgb(240, 240, 242),
    field: Color32::from_rgb(255, 255, 255),
    button: Color32::from_rgb(222, 223, 227),
    hovered: Color32::from_rgb(206, 208, 214),
    line: Color32::from_rgb(206, 207, 211),
    text: Color32::from_rgb(44, 46, 52),
    strong: Color32::from_rgb(16, 17, 20),
    weak: Color32::from_rgb(98, 102, 110),
};

impl Palette {
    fn visuals(&self) -> Visuals {
        let mut v = if self.dark { Visuals::dark() } else { Visuals::light() };
        (v.panel_fill, v.window_fill) = (self.panel, self.panel);
        (v.extreme_bg_color, v.text_edit_bg_color) = (self.field, Some(self.field));
        v.faint_bg_color = self.button.gamma_multiply(0.4);
        v.window_stroke = Stroke::new(1.0, self.line);
        v.weak_text_color = Some(self.weak);
        v.hyperlink_color = if self.dark { Color32::from_rgb(120, 174, 255) } else { ACCENT };
        v.warn_fg_color =
            if self.dark { Color32::from_rgb(245, 190, 80) } else { Color32::from_rgb(150, 92, 0) };
        v.error_fg_color =
            if self.dark { Color32::from_rgb(255, 120, 110) } else { Color32::from_rgb(184, 32, 28) };
        v.selection.bg_fill = ACCENT;
        v.selection.stroke = Stroke::new(1.0, Color32::WHITE);
        (v.window_corner_radius, v.menu_corner_radius) = (CornerRadius::same(6), CornerRadius::same(5));
        let shadow = Shadow { offset: [0, 4], blur: 16, spread: 0, color: Color32::from_black_alpha(90) };
        (v.window_shadow, v.popup_shadow) = (shadow, shadow);
        v.slider_trailing_fill = true;
        v.indent_has_left_vline = false;
        let w = &mut v.widgets;
        for widget in [&mut w.noninteractive, &mut w.inactive, &mut w.hovered, &mut w.active, &mut w.open] {
            widget.corner_radius = CornerRadius::same(4);
            widget.expansion = 0.0;
            widget.bg_stroke = Stroke::NONE;
            widget.fg_stroke = Stroke::new(1.0, self.text);
        }
        w.noninteractive.bg_stroke = Stroke::new(1.0, self.line);
        (w.inactive.bg_fill, w.inactive.weak_bg_fill) = (self.button, self.button);
        w.inactive.bg_stroke = Stroke::new(1.0, self.hovered.gamma_multiply(0.8));
        for widget in [&mut w.hovered, &mut w.active, &mut w.open] {
            (widget.bg_fill, widget.weak_bg_fill) = (self.hovered, self.hovered);
            widget.fg_stroke = Stroke::new(1.0, self.strong);
        }
        w.active.bg_fill = ACCENT;
        v
    }
}

/// Gives egui the look of a theme.
pub fn apply(ctx: &egui::Context, theme: Theme) {
    let (theme, palette) = match theme {
        Theme::Dark => (egui::Theme::Dark, &DARK),
        Theme::Light => (egui::Theme::Light, &LIGHT),
    };
    ctx.set_theme(theme);
    ctx.style_mut_of(theme, |style| {
        style.visuals = palette.visuals();
        let sizes = [
            (TextStyle::Small, 11.5),
            (TextStyle::Body, 13.5),
            (TextStyle::Button, 13.5),
            (TextStyle::Heading, 16.0),
        ];
        for (text, size) in sizes {
            style.text_styles.insert(text, FontId::new(size, FontFamily::Proportional));
        }
        let spacing = &mut style.spacing;
        spacing.item_spacing = vec2(6.0, 5.0);
        spacing.button_padding = vec2(8.0, 3.0);
        spacing.interact_size = vec2(36.0, 22.0);
        spacing.slider_rail_height = 4.0;
        spacing.menu_width = 220.0;
        spacing.tooltip_width = 320.0;
        style.interaction.tooltip_delay = 0.4;
    });
}
