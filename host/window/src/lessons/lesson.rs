//! A lesson: parts to be done on a generated model.

use crate::window::{Commands, Window};
use simod_generate::Shape;
use simod_viewer::Camera;

/// A lesson: exercises, one after the other.
pub struct Lesson {
    /// What the user reads of it in menus.
    pub title: &'static str,
    /// The lesson's subject.
    pub about: &'static str,
    /// The model that it is done on.
    pub shape: Shape,
    /// The name of its file.
    pub file: &'static str,
    /// The exercises.
    pub parts: &'static [Exercise],
    /// What is left to say.
    pub ends: &'static str,
}

/// A thing to do in a lesson.
pub struct Exercise {
    /// The text that the user reads.
    pub text: &'static str,
    /// Whether it is done, from where the camera was when it began.
    pub done: fn(&Window, &Camera) -> bool,
    /// Commands for it.
    pub run: fn(&Window, &mut Commands),
}
