//! The error of smooth maps at every vertex, and what it costs.

use glam::DVec3;
use simod_benches::process::Result;
use simod_benches::{Map, error_figure, head, row};
use simod_core::reconstruction::transfer_error::{self, TransferError};
use simod_model::progress::Silent;

use crate::Arguments;
use crate::scene::Scene;

const COLUMNS: [&str; 8] = [
    "method",
    "map",
    "rms",
    "99.9 % below",
    "worst",
    "jump",
    "vertices per CPU second",
    "preparation, CPU s",
];

/// Measures, and prints a table.
pub fn measure(arguments: &Arguments) -> Result<()> {
    let Arguments { model, vertices, samples, folder, .. } = arguments;
    let scene = Scene::of_file_or_amphora(model.as_deref(), *vertices, *samples, folder)?;
    println!("{}; errors as fractions of the diagonal\n\n{}", scene.title(), head(&COLUMNS));
    for map in [Map::Twist, Map::Bend, Map::Bump(scene.front())] {
        let deformed = map.deform(&scene.sampled);
        for method in scene.methods() {
            let cost = scene.transfer(method, &deformed)?;
            let error = transfer_error(&scene, map)?;
            let figures = [error.rms, error.p999, error.max, error.jump].map(error_figure);
            let rate = format!("{:.0}", scene.positions.len() as f64 / cost.transfer);
            println!(
                "{}",
                row([method.name().to_owned(), map.name().to_owned()]
                    .into_iter()
                    .chain(figures)
                    .chain([rate, format!("{:.2}", cost.preparation)]))
            );
        }
    }
    Ok(())
}

/// The error of the scene's last result.
pub fn transfer_error(scene: &Scene, map: Map) -> Result<TransferError> {
    let bounds = scene.sampled.bounds;
    let truth = |points: &mut [DVec3]| {
        points.iter_mut().for_each(|p| *p = map.apply(&bounds, *p));
        Ok(())
    };
    let result = scene.result()?;
    Ok(transfer_error::measure(
        scene.model.as_ref(),
        result.as_ref(),
        (bounds.diagonal(), None),
        &truth,
        &Silent,
    )?)
}
