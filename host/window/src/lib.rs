//! `simod-viewer`: the window to edit a model in.
//!
//! The state changes by [`Command`](simod_viewer::Command)s alone, through [`Window::apply`]. Panels, tools
//! and actions see the window as it is, and give commands (`window/commands.rs`) that are done once they
//! are drawn. The state of this crate is the window's own: the tool in the hand, the panels that are open,
//! the preset for the camera, the user's settings.
//!
//! ```text
//! main ── arguments ──▶ start ──▶ App (eframe) ──▶ Window ──Command──▶ simod_viewer::State
//!                                  │                │
//!                                  │                └ actions: all that has a name, for menus, keys, palette
//!                                  └ panels, viewport (picture, navigation), tools (in the picture)
//! ```

mod actions;
mod app;
mod arguments;
mod axis;
mod clip;
pub mod dialogs;
mod example;
mod in_turn;
pub mod lessons;
mod numbers;
mod panels;
mod plugins;
mod regions;
mod rendering;
pub mod screenshot;
mod settings;
mod start;
mod steps;
mod theme;
mod tools;
pub mod turntable;
mod viewport;
mod widgets;
mod window;
mod wording;

pub use app::App;

pub use settings::WindowSettings;
pub use start::main;
pub use tools::Tool;
pub use tools::measure::summary as measure_summary;
pub use window::Window;
