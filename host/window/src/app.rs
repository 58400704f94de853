//! The window as eframe runs it.

use crate::panels;
use crate::panels::legend::Legend;
use crate::settings::Theme;
use crate::viewport::Viewport;
use crate::window::Window;
use crate::{actions, lessons, viewport};
use eframe::egui;
use std::io::Write;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// The program: its window, and the viewport that draws the model.
pub struct App {
    window: Window,
    viewport: Viewport,
    /// Whether the graphics card went away.
    lost: Arc<AtomicBool>,
    told_of_loss: bool,
}

impl App {
    /// Makes the program, with a picture where there is something to draw with.
    pub fn new(cc: &eframe::CreationContext<'_>, window: Window) -> Self {
        let lost = Arc::new(AtomicBool::new(false));
        if let Some(render) = &cc.wgpu_render_state {
            let (flag, ctx) = (lost.clone(), cc.egui_ctx.clone());
            render.device.set_device_lost_callback(move |_, _| {
                flag.store(true, Ordering::Relaxed);
                ctx.request_repaint();
            });
        }
        let viewport = Viewport::new(cc.wgpu_render_state.as_ref());
        Self { window, viewport, lost, told_of_loss: false }
    }

    /// The window's content.
    pub fn window(&self) -> &Window {
        &self.window
    }

    /// The window's content, to be changed.
    pub fn window_mut(&mut self) -> &mut Window {
        &mut self.window
    }

    fn look_after_the_device(&mut self) {
        if !self.lost.load(Ordering::Relaxed) || std::mem::replace(&mut self.told_of_loss, true) {
            return;
        }
        self.window.keep();
        self.viewport.lose();
        let what = "the graphics card went away";
        let hint = "the edit is kept: start simod-viewer again, and recover it";
        self.window.toasts.error(&simod_model::Error::system(what, hint));
    }
}

impl eframe::App for App {
    fn logic(&mut self, ctx: &egui::Context, _: &mut eframe::Frame) {
        self.look_after_the_device();
        self.window.update();
        lessons::update(&mut self.window);
        let dropped = ctx.input(|i| i.raw.dropped_files.first().map(|file| file.path().to_owned()));
        if let Some(path) = dropped {
            self.window.ask_to_open(path);
        }
        if ctx.input(|i| i.viewport().close_requested()) && !self.window.may_close() {
            ctx.send_viewport_cmd(egui::ViewportCommand::CancelClose);
        }
    }

    fn ui(&mut self, ui: &mut egui::Ui, _: &mut eframe::Frame) {
        let window = &mut self.window;
        actions::keys(window);
        window.draw(|window, commands| panels::menu::show(ui, window, commands));
        panels::status::show(ui, window);
        if window.state().scene().is_some() {
            window.draw(|window, commands| panels::tools::show(ui, window, commands));
            window.draw(|window, commands| panels::side::show(ui, window, commands));
            let legend = Legend::find(window);
            window.draw(|window, commands| panels::legend::show(ui, window, commands, legend));
        }
        viewport::show(ui, window, &mut self.viewport);
        panels::floating::show(ui.ctx(), window);
    }

    fn on_exit(&mut self) {
        // An edit that was saved, or is not wanted, is kept no more.
        self.window.keep();
        self.window.keep_settings();
        let slowest = self.window.state().slowest();
        if slowest.felt > 0 {
            // A failure to write is no matter: without a reader of the standard error, nobody need be told.
            let _ = writeln!(std::io::stderr(), "{slowest}");
        }
    }

    fn clear_color(&self, _: &egui::Visuals) -> [f32; 4] {
        match self.window.settings.theme {
            Theme::Dark => [0.16, 0.17, 0.19, 1.0],
            Theme::Light => [0.94, 0.94, 0.95, 1.0],
        }
    }
}
