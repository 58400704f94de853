//! The session that is open, and the errors where none is.

use crate::scene::ViewerScene;
use crate::selection::Adjacency;
use simod_model::Error;
use simod_session::edit::{Editor, Entry};
use std::sync::Arc;

/// The session that is open.
pub(super) struct OpenSession {
    pub editor: Editor,
    pub scene: Arc<ViewerScene>,
    /// Samples of the scene that are next to each sample.
    pub adjacency: Arc<Adjacency>,
}

impl OpenSession {
    pub fn new(editor: Editor, scene: ViewerScene) -> Self {
        let adjacency = Arc::new(Adjacency::of_model(&scene.sampled));
        Self { editor, scene: Arc::new(scene), adjacency }
    }

    pub fn steps(&self) -> &Arc<[Entry]> {
        self.editor.document().steps()
    }
}

/// Error of a command that needs a model.
pub(super) fn nothing_open() -> Error {
    Error::argument("no model is open", "open one")
}
