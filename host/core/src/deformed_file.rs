//! Deformed samples as other programs give them back.
//!
//! Each sample has its number in the property `id` of `samples.ply`. A program that keeps it may bring the
//! vertices in any order, and turn it into a floating-point number, or call it `scalar_id`, as CloudCompare
//! does, in capitals or not. Without an id the order counts. Whichever it is, all samples have to come back,
//! each once.

use std::path::Path;

use glam::DVec3;
use simod_model::{Attribute, Error, Model, Result, Scalar, VertexChunk};

/// Largest number of samples that are read: they are held, with some hundred bytes each.
const MOST: u64 = 1 << 29;

/// The attribute with the number of each vertex' sample: `id`, which programs also call `ID`, `scalar_id` or
/// `scalar_Id`; the plainest name where there are several.
pub fn place_of_ids(attributes: &[Attribute]) -> Option<usize> {
    let is_id = |a: &Attribute| a.name.to_ascii_lowercase().trim_start_matches("scalar_") == "id";
    let of_ids = attributes.iter().enumerate().filter(|(_, a)| is_id(a));
    of_ids.min_by_key(|(_, a)| (a.name.len(), a.name.to_ascii_lowercase() != a.name)).map(|(place, _)| place)
}

/// Whole numbers up to here are exact in single precision.
const EXACT: usize = 1 << 24;

/// Advice to the user where samples are lost or doubled.
const HABITS: &str = "all samples have to come back, each once: switch off what merges close or equal vertices, removes unreferenced \
                      or isolated ones, or splits them by normals or texture, on import and on export (often called merge, weld, \
                      clean or process); with the property id kept, their order does not matter";

/// Deformed samples as a file has them.
pub struct DeformedFile<'a> {
    /// The file.
    pub path: &'a Path,
    /// Positions in the model's coordinates, and in the file's order.
    positions: Vec<DVec3>,
    /// The number of each vertex' sample, if the file has it.
    ids: Option<Vec<f64>>,
    /// Number type in which the file stores positions.
    pub scalar: Scalar,
}

/// Opens a file of samples, which are few enough to be held.
///
/// # Errors
/// The file is no model, or has too many vertices.
pub fn open(path: &Path) -> Result<Box<dyn Model>> {
    let model = simod_model::open(path)?;
    let vertices = model.info().vertices;
    if vertices > MOST {
        return Err(Error::format(
            format!("{} has {vertices} vertices, and samples are {MOST} at most", path.display()),
            "give a file of samples, not the model",
        ));
    }
    Ok(model)
}

impl<'a> DeformedFile<'a> {
    /// Reads a file, of whatever samples.
    ///
    /// # Errors
    /// The file cannot be read, or has too many vertices.
    pub fn read(path: &'a Path) -> Result<Self> {
        let model = open(path)?;
        let info = model.info();
        let place = place_of_ids(&info.attributes);
        let (mut positions, mut ids) = (Vec::new(), Vec::new());
        let mut lists = vec![Vec::new(); place.map_or(0, |place| place + 1)];
        let mut reader = model.vertices(0..info.vertices)?;
        let mut chunk = VertexChunk::default();
        while reader.read(&mut chunk)? {
            positions.extend_from_slice(&chunk.positions);
            model.attributes(&chunk, &mut lists)?;
            ids.extend_from_slice(lists.last().map_or(&[][..], Vec::as_slice));
        }
        Ok(Self { path, positions, ids: place.map(|_| ids), scalar: info.position_type })
    }

    /// Positions of the deformed samples, in the order of P_S and in the model's coordinates.
    ///
    /// # Errors
    /// Samples are missing, or there more than once; an id is none.
    pub fn into_ordered(self, samples: usize) -> Result<Vec<DVec3>> {
        let Self { path, positions, ids, .. } = self;
        if let Some(ids) = ids {
            return in_order(positions, &ids, samples).map_err(|what| refused(path, &what));
        }
        if positions.len() == samples {
            return Ok(positions);
        }
        let (there, difference) = (positions.len(), positions.len().abs_diff(samples));
        let became = if there < samples { "are gone" } else { "are too many" };
        let what = format!("{there} vertices, but there are {samples} samples: {difference} {became}");
        Err(refused(path, &what))
    }
}

fn refused(path: &Path, what: &str) -> Error {
    Error::mismatch(format!("{} has {what}", path.display()), HABITS)
}

/// Puts each position at the place that its id says; the error text follows on "the file has".
fn in_order(positions: Vec<DVec3>, ids: &[f64], samples: usize) -> Result<Vec<DVec3>, String> {
    let vertices = positions.len();
    // Ids in ascending order from 0, as most programs leave them.
    if vertices == samples && ids.iter().zip(0u32..).all(|(id, i)| *id == f64::from(i)) {
        return Ok(positions);
    }
    // None of a position could be told from a sample that is there twice.
    let (mut ordered, mut is_there) = (vec![DVec3::ZERO; samples], vec![false; samples]);
    let (mut doubled, mut first_doubled) = (0, 0);
    for (vertex, (id, position)) in ids.iter().zip(positions).enumerate() {
        let place = *id as usize;
        if *id != place as f64 {
            return Err(format!("an id that is no whole number: {id}, of vertex {vertex}"));
        }
        if place >= samples {
            return Err(format!(
                "the id {id}, of vertex {vertex}, but there are {samples} samples, from 0 on"
            ));
        }
        if std::mem::replace(&mut is_there[place], true) {
            if doubled == 0 {
                first_doubled = place;
            }
            doubled += 1;
        }
        ordered[place] = position;
    }
    let missing = is_there.iter().filter(|is_there| !**is_there).count();
    if (missing, doubled) == (0, 0) {
        return Ok(ordered);
    }
    let mut what = format!("{vertices} vertices, but there are {samples} samples");
    if let Some(first) = is_there.iter().position(|is_there| !is_there) {
        what += &format!(": {missing} are gone, the first is that with id {first}");
    }
    if doubled > 0 {
        what += &format!("; {doubled} have an id that another one has, the first id is {first_doubled}");
    }
    if doubled > 0 && samples > EXACT {
        what += "; ids of single precision are the same beyond 16777216";
    }
    Err(what)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use simod_model::Type;

    fn positions(count: usize) -> Vec<DVec3> {
        (0..count).map(|i| DVec3::splat(i as f64)).collect()
    }

    fn error(ids: &[f64], samples: usize) -> String {
        in_order(positions(ids.len()), ids, samples).unwrap_err()
    }

    proptest! {
        #[test]
        fn any_order_is_put_right(order in Just((0..200usize).collect::<Vec<_>>()).prop_shuffle()) {
            let ids: Vec<f64> = order.iter().map(|i| *i as f64).collect();
            let shuffled = order.iter().map(|i| DVec3::splat(*i as f64)).collect();
            prop_assert_eq!(in_order(shuffled, &ids, 200).unwrap(), positions(200));
        }

        #[test]
        fn ids_that_are_not_each_sample_once_are_refused(
            ids in proptest::collection::vec(prop_oneof![
                (0..12u32).prop_map(f64::from),
                prop::sample::select(vec![-1.0, 0.5, f64::NAN, f64::INFINITY, 1e300, -0.0]),
            ], 0..14),
        ) {
            let mut sorted: Vec<f64> = ids.iter().map(|id| id.abs()).collect();
            sorted.sort_by(f64::total_cmp);
            let is_whole = sorted.iter().copied().eq((0..10).map(f64::from)) && ids.iter().all(|id| *id >= 0.0);
            prop_assert_eq!(in_order(positions(ids.len()), &ids, 10).is_ok(), is_whole);
        }
    }

    #[test]
    fn ids_are_found_by_any_of_their_names() {
        let place = |names: &[&str]| {
            let attribute = |name: &&str| Attribute { name: (*name).to_owned(), kind: Type::F32 };
            place_of_ids(&names.iter().map(attribute).collect::<Vec<_>>())
        };
        for name in ["id", "ID", "Id", "scalar_id", "scalar_Id", "Scalar_ID", "scalar_scalar_id"] {
            assert_eq!(place(&["red", name]), Some(1), "{name}");
        }
        assert_eq!(place(&["scalar_id", "ID", "id"]), Some(2));
        assert_eq!(place(&["scalar_id", "ID"]), Some(1));
        assert_eq!(place(&["identity", "point_id", "scalar_"]), None);
    }

    #[test]
    fn the_first_that_is_wrong_is_named() {
        assert_eq!(error(&[0.0, 1.5], 2), "an id that is no whole number: 1.5, of vertex 1");
        assert_eq!(error(&[0.0, -1.0], 2), "an id that is no whole number: -1, of vertex 1");
        assert_eq!(error(&[0.0, f64::NAN], 2), "an id that is no whole number: NaN, of vertex 1");
        assert_eq!(error(&[0.0, 2.0], 2), "the id 2, of vertex 1, but there are 2 samples, from 0 on");
        assert_eq!(
            error(&[3.0, 0.0], 4),
            "2 vertices, but there are 4 samples: 2 are gone, the first is that with id 1"
        );
        assert_eq!(
            error(&[1.0, 0.0, 1.0, 0.0], 2),
            "4 vertices, but there are 2 samples; 2 have an id that another one has, the first id is 1"
        );
        assert_eq!(
            error(&[1.0, 2.0, 1.0], 3),
            "3 vertices, but there are 3 samples: 1 are gone, the first is that with id 0; 1 have an id that another \
             one has, the first id is 1"
        );
    }
}
