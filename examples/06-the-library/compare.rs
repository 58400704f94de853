//! How many samples does a deformation need? Compares samplings of one model: `library-compare MODEL.ply DIR
//! PLUGIN`.
#![allow(clippy::print_stdout, reason = "a program that tells what it did")]

use simod_compare::{CameraPlace, CompareFile, ComparedMethod, Comparing, MethodWork, compare};
use simod_model::progress::Silent;
use simod_session::plugins::standard_folders;
use simod_session::session_file::SamplingTable;
use simod_session::{PluginOptions, PluginRegistry};
use std::error::Error;
use std::path::PathBuf;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [model, folder, plugin] = arguments.as_slice() else {
        return Err("give a model, a folder for the page, and a plugin's id".into());
    };
    let plugins = PluginRegistry::discover(&PluginOptions::in_process(standard_folders()));
    let method = |samples: u64| ComparedMethod {
        name: format!("{samples} samples"),
        place: "here".to_owned(),
        work: MethodWork::Plugin {
            deform: plugin.clone(),
            state_version: None,
            params: toml::Table::new(),
            folder: PathBuf::new(),
        },
        sampling: SamplingTable { samples: Some(samples), ..SamplingTable::default() },
        reconstruction: Default::default(),
    };
    let file = CompareFile {
        text: String::new(),
        model: model.into(),
        columns: None,
        fingerprint: None,
        regions: Vec::new(),
        camera: CameraPlace::default(),
        crops: Vec::new(),
        runs: 1,
        methods: [20_000, 5_000, 1_000].map(method).into(),
    };

    let comparison = compare(&file, &plugins, Comparing::default(), folder.as_ref(), &Silent)?;
    for method in &comparison.methods {
        let figures = method.figures.as_ref().ok_or_else(|| format!("{} came to nothing", method.name))?;
        let error = figures.transfer_error.as_ref().ok_or("the plugin does not know its map exactly")?;
        println!("{}: off by {:.1e} of the diagonal, {:.1e} at most", method.name, error.rms, error.max);
    }
    println!("{folder}/index.html has it all, with pictures");
    Ok(())
}
