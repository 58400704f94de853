//! Maps that come out exactly, or as exactly as floats are.

use simod_benches::process::Result;
use simod_benches::{Map, error_figure, head, row};
use simod_model::{Model, VertexChunk};

use crate::Arguments;
use crate::accuracy::transfer_error;
use crate::scene::Scene;

const MAPS: [Map; 3] = [Map::Rigid, Map::Similarity, Map::Affine];

/// Measures, and prints a table.
pub fn measure(arguments: &Arguments) -> Result<()> {
    let Arguments { model, small_vertices, small_samples, folder, .. } = arguments;
    let scene = Scene::of_file_or_amphora(model.as_deref(), *small_vertices, *small_samples, folder)?;
    println!("{}; the worst error as a fraction of the diagonal\n", scene.title());
    let titles = ["method", "identity: vertices that differ"];
    println!("{}", head(&titles.into_iter().chain(MAPS.map(Map::name)).collect::<Vec<_>>()));
    for method in scene.methods() {
        scene.transfer(method, &Map::Identity.deform(&scene.sampled))?;
        let differ = vertices_that_differ(scene.model.as_ref(), scene.result()?.as_ref())?;
        let worst = |map: Map| {
            scene.transfer(method, &map.deform(&scene.sampled))?;
            Ok(error_figure(transfer_error(&scene, map)?.max))
        };
        let worst = MAPS.into_iter().map(worst).collect::<Result<Vec<_>>>()?;
        println!("{}", row([method.name().to_owned(), differ.to_string()].into_iter().chain(worst)));
    }
    Ok(())
}

/// The number of vertices that are not the same, bit by bit, in position or normal; all, where other bytes
/// differ.
fn vertices_that_differ(model: &dyn Model, other: &dyn Model) -> Result<usize> {
    let vertices = model.info().vertices;
    let (mut readers, mut chunks) = (
        [model.vertices(0..vertices)?, other.vertices(0..vertices)?],
        [VertexChunk::default(), VertexChunk::default()],
    );
    let mut differ = 0;
    while readers[0].read(&mut chunks[0])? | readers[1].read(&mut chunks[1])? {
        let [a, b] = &chunks;
        if a.raw() != b.raw() {
            let same =
                |i: &usize| a.positions[*i] == b.positions[*i] && a.normals.get(*i) == b.normals.get(*i);
            let changed = (0..a.len()).filter(|i| !same(i)).count();
            differ += if changed == 0 { a.len() } else { changed };
        }
    }
    Ok(differ)
}
