//! The context that a tool works with.

use super::Gesture;
use crate::viewport::ModelArea;
use crate::window::{Commands, Window};

/// The picture that a tool is over, the window, what it asks for, and what the pointer has begun.
pub struct ToolContext<'a> {
    pub canvas: &'a ModelArea<'a>,
    pub window: &'a Window,
    pub commands: &'a mut Commands,
    pub gesture: &'a mut Gesture,
}
