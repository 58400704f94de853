//! Takes more samples about a point of the model: `library-refine DIR DIR2 X Y Z RADIUS`.
#![allow(clippy::print_stdout, reason = "a program that tells what it did")]

use glam::DVec3;
use simod_core::refinement::{Finer, Refining, SpaceSelection, refine};
use simod_core::sampled_model::SampledModel;
use simod_model::progress::Silent;
use std::error::Error;
use std::path::PathBuf;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [folder, into, numbers @ ..] = arguments.as_slice() else {
        return Err("give a sampled model, a folder, a point and a radius".into());
    };
    let numbers = numbers.iter().map(|x| x.parse::<f64>()).collect::<Result<Vec<_>, _>>()?;
    let [x, y, z, radius] = *numbers.as_slice() else {
        return Err("give three coordinates and a radius".into());
    };
    let (folder, into) = (PathBuf::from(folder), PathBuf::from(into));

    let mut sampled = SampledModel::load(&folder)?;
    sampled.hold_cells(sampled.cells_or_resample(&folder, None, &Silent)?);
    let model = sampled.open_source(None, &Silent)?;
    // Any function of space says what is selected: here the distance to a ball.
    let distance = |p: DVec3| p.distance(DVec3::new(x, y, z)) - radius;
    let selection = SpaceSelection { distance: &distance, so_far: None, at_rest: true };
    let how = Refining { finer: Finer::Factor(10.0), memory_limit: None, shapes: Vec::new() };
    let refined = refine(&sampled, model.as_ref(), selection, &how, &std::env::temp_dir(), &Silent)?;

    println!("{} samples more; {} bytes were read", refined.added, refined.vertex_bytes + refined.face_bytes);
    refined.sampled.as_ref().unwrap_or(&sampled).save(&into)?;
    Ok(())
}
