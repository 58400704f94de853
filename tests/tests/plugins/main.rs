//! Plugins and what their authors rely on, through the real binary: one module for each subject.

mod artists_tools;
mod authors;
mod bad_files;
mod bad_plugins;
mod blendshapes;
mod c_plugins;
mod control_points;
mod curve;
mod elastic;
mod first_interface;
mod hostile_plugins;
mod isolation;
mod own_handles;
mod plugin_check;
mod plugin_new;
mod register;
mod smooth;
mod survey;
