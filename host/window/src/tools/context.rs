//! The context that a tool works with.

use super::Gesture;
use crate::viewport::ModelArea;
use crate::window::{Commands, Window};

/// Context of a tool: the picture that it is over, the window, the tool's commands, and the gesture of the
/// pointer.
pub struct ToolContext<'a> {
    pub canvas: &'a ModelArea<'a>,
    pub window: &'a Window,
    pub commands: &'a mut Commands,
    pub gesture: &'a mut Gesture,
}
