//! A lesson: parts to be done on a generated model.

use crate::window::{Commands, Window};
use simod_generate::Shape;
use simod_viewer::Camera;

/// A lesson: exercises, one after the other.
pub struct Lesson {
    /// Title of the lesson in menus.
    pub title: &'static str,
    /// The lesson's subject.
    pub about: &'static str,
    /// Shape of the generated model on which the lesson is done.
    pub shape: Shape,
    /// Name of the model's file.
    pub file: &'static str,
    /// The exercises.
    pub parts: &'static [Exercise],
    /// Text that is shown once all exercises are done.
    pub ends: &'static str,
}

/// A thing to do in a lesson.
pub struct Exercise {
    /// The text that the user reads.
    pub text: &'static str,
    /// Whether the exercise is done, given the camera at the time when the exercise began.
    pub done: fn(&Window, &Camera) -> bool,
    /// Commands that do the exercise.
    pub run: fn(&Window, &mut Commands),
}
