//! Edits a model as a program with a window would: steps that are added, changed and undone, of which each is
//! done anew as far as it has to be: `library-edit MODEL OUT SESSION.toml`.
#![allow(clippy::print_stdout, reason = "a program that tells what it did")]

use simod_core::reconstruction::Reconstruction;
use simod_model::progress::Silent;
use simod_plugin_api::Effort;
use simod_session::edit::{Change, EditCommand, Editor, Evaluated, Evaluation};
use simod_session::plugins::standard_folders;
use simod_session::session_file::SamplingTable;
use simod_session::{PluginOptions, PluginRegistry, SessionFile};
use std::error::Error;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<PathBuf> = std::env::args_os().skip(1).map(PathBuf::from).collect();
    let [model, output, session] = arguments.as_slice() else {
        return Err("give a model, a file for the edited one, and one for the session".into());
    };

    let sampling = SamplingTable { samples: Some(20_000), ..SamplingTable::default() };
    let new = SessionFile { model: Some(model.clone()), sampling, ..SessionFile::default() };
    let plugins = Arc::new(PluginRegistry::discover(&PluginOptions::in_process(standard_folders())));
    // The editor has the steps, and the evaluation does them: it may as well be on a thread of its own.
    let (mut editor, evaluation) = Editor::open(new, None, plugins.clone(), &Silent)?;
    let mut work = Work { evaluation, plugins };

    let bend = r#"deform = "warp"
        params = { operation = "bend", angle = 60 }"#;
    let twist = r#"deform = "warp"
        params = { operation = "twist", angle = 45 }"#;
    for (at, text) in [bend, twist].into_iter().enumerate() {
        let mut steps = SessionFile::parse(&format!("[[step]]\n{text}"), Path::new("steps.toml"))?.steps;
        editor.document_mut().apply(EditCommand::Add { at, step: Box::new(steps.remove(0)) })?;
    }
    work.tell("two steps", &editor)?;

    // A slider is dragged: a draft for each position, the full result when it rests. All of it is undone as
    // one.
    for degrees in [50, 55, 60] {
        let change = Change::SetParam { id: "angle".to_owned(), value: Some(degrees.into()) };
        editor.document_mut().apply(EditCommand::Change { at: 1, change })?;
        work.update(&editor, Effort::DRAFT)?;
    }
    editor.document_mut().rest();
    work.tell("a drag", &editor)?;
    let undone = editor.document_mut().undo().unwrap_or_default();
    work.tell(&format!("undone: {undone}"), &editor)?;

    let full = work.update(&editor, Effort::FULL)?;
    full.write(editor.model(), &editor.follow(), output, &Reconstruction::default(), &Silent)?;
    editor.save(session)?;
    println!("wrote {} and {}", output.display(), session.display());
    Ok(())
}

/// The evaluation that does the steps, and all that it needs.
struct Work {
    evaluation: Evaluation,
    plugins: Arc<PluginRegistry>,
}

impl Work {
    fn update(&mut self, editor: &Editor, effort: Effort) -> simod_model::Result<Evaluated> {
        self.evaluation.update(editor.document().steps(), &self.plugins, effort, &Silent)
    }

    fn tell(&mut self, what: &str, editor: &Editor) -> Result<(), Box<dyn Error>> {
        let start = Instant::now();
        let evaluated = self.update(editor, Effort::FULL)?;
        if let Some((_, error)) = evaluated.failure() {
            return Err(format!("{error}: {}", error.hint()).into());
        }
        let (samples, took) = (evaluated.positions.len(), start.elapsed().as_millis());
        println!("{what}: {} steps on {samples} samples in {took} ms", evaluated.statuses.len());
        Ok(())
    }
}
