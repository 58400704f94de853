//! Parts of a sampled model that are left out.

use std::fs;

use simod_core::sampling::kept_cells::KeptCells;
use simod_core::sampling::{Sampling, Skip, Target};
use simod_generate::Shape;

use crate::body::Body;
use crate::cells::Saved;

fn saved(body: &Body, skip: Skip) -> Saved {
    Saved::new(body, Sampling { target: Target::Samples(1000), skip, ..Sampling::default() })
}

fn samples_file(saved: &Saved) -> Vec<u8> {
    fs::read(saved.folder().join("samples.ply")).unwrap()
}

fn header(saved: &Saved) -> String {
    let bytes = samples_file(saved);
    let text = String::from_utf8_lossy(&bytes);
    text[..text.find("end_header").unwrap()].to_owned()
}

/// The amphora's handles stand in its body, so that there are sheets to tell apart.
const ALL: [&str; 6] = ["cells.bin", "model.ply", "model.simod", "samples.ply", "sheets.bin", "simod.toml"];

#[test]
fn without_triangles_the_samples_are_the_same() {
    let body = Body::generated(Shape::Amphora, 20_000);
    let whole = saved(&body, Skip::default());
    let part = saved(&body, Skip { triangles: true, ..Skip::default() });
    assert!(header(&whole).contains("element face") && !whole.load().triangles.is_empty());
    assert!(!header(&part).contains("face") && part.load().triangles.is_empty());
    assert_eq!(part.names(), ALL);
    let (whole_samples, part_samples) = (whole.load().samples, part.load().samples);
    assert_eq!(whole_samples.positions, part_samples.positions);
    assert_eq!(whole_samples.normals(), part_samples.normals());
    // The cells differ in the key of their samples, and in the ranges of faces.
    let (mut whole, part) =
        (KeptCells::decode(&whole.bytes()).unwrap(), KeptCells::decode(&part.bytes()).unwrap());
    assert!(whole.1.knows_faces && whole.1.cells.iter().all(|cell| !cell.faces.is_empty()));
    whole.1.knows_faces = false;
    whole.1.cells.iter_mut().for_each(|cell| cell.faces.clear());
    assert!(whole.1 == part.1 && whole.0 != part.0);
}

#[test]
fn triangles_come_back_from_the_folder_as_they_were() {
    let body = Body::generated(Shape::Amphora, 20_000);
    let sampling = Sampling { target: Target::Samples(1000), ..Sampling::default() };
    let sampled = body.sampled(sampling);
    assert!(Saved::new(&body, sampling).load().triangles == sampled.triangles);
}

#[test]
fn without_cells_all_else_is_the_same() {
    let body = Body::generated(Shape::Amphora, 20_000);
    let whole = saved(&body, Skip::default());
    let part = saved(&body, Skip { cells: true, ..Skip::default() });
    assert_eq!(whole.names(), ALL);
    assert_eq!(part.names(), ALL[1..]);
    assert!(samples_file(&whole) == samples_file(&part));
    let description = |saved: &Saved| fs::read_to_string(saved.folder().join("simod.toml")).unwrap();
    assert_eq!(description(&whole), description(&part));
    // The cells can be made later.
    assert!(part.cells() == whole.cells() && part.bytes() == whole.bytes());
    assert_eq!(part.names(), ALL);
}

#[test]
fn without_normals_only_estimated_ones_are_left_out() {
    let skip = Skip { normals: true, ..Skip::default() };
    let body = Body::generated(Shape::Amphora, 20_000);
    // The model's own are there in any case.
    assert!(samples_file(&saved(&body, skip)) == samples_file(&saved(&body, Skip::default())));

    let body = body.without_normals();
    let (whole, part) = (saved(&body, Skip::default()), saved(&body, skip));
    assert!(header(&whole).contains("property float nx"));
    assert!(!header(&part).contains("nx"));
    assert_eq!(part.names(), ALL);
    let (whole, part) = (whole.load(), part.load());
    assert_eq!(whole.samples.positions, part.samples.positions);
    assert!(whole.triangles == part.triangles && !part.triangles.is_empty());
    // Normals that were left out are estimated again by whoever needs them.
    assert_eq!(whole.samples.normals(), part.samples.normals());
}

#[test]
fn without_sheets_no_cluster_is_parted() {
    let body = Body::generated(Shape::Amphora, 20_000);
    let whole = saved(&body, Skip::default());
    let part = saved(&body, Skip { sheets: true, ..Skip::default() });
    assert_eq!(part.names(), ALL.into_iter().filter(|name| *name != "sheets.bin").collect::<Vec<_>>());
    let (whole, part) = (whole.load(), part.load());
    assert!(whole.samples.contacts().is_some() && part.samples.contacts().is_none());
    assert_ne!(whole.samples.positions, part.samples.positions);
    assert_eq!(whole.sampling.target, part.sampling.target);
}

#[test]
fn all_can_be_left_out_at_once() {
    let body = Body::generated(Shape::Amphora, 20_000).without_normals();
    let part = saved(&body, Skip { triangles: true, cells: true, normals: true, sheets: true, colors: true });
    assert_eq!(part.names(), ["model.ply", "model.simod", "samples.ply", "simod.toml"]);
    assert!(!header(&part).contains("face") && !header(&part).contains("nx"));
    let whole = saved(&body, Skip { sheets: true, ..Skip::default() });
    assert_eq!(part.load().samples.positions, whole.load().samples.positions);
}
