//! Deformation by a cage: a coarse closed surface about the model, whose vertices are handles.
//!
//! T. Ju, S. Schaefer, J. Warren, *Mean value coordinates for closed triangular meshes*, SIGGRAPH 2005, or,
//! where details are to keep their shape, J. Chen, F. de Goes, M. Desbrun, *Somigliana coordinates*,
//! SIGGRAPH 2023.
//! Each sample's coordinates are found once, in `prepare`; a motion then costs one product for each sample
//! and each vertex, with mean value coordinates for each vertex that moves otherwise than the last time.

mod made;
mod mean_value;
mod mesh;
mod panels;
mod pose;
mod somigliana;
mod sums;

use glam::DVec3;
use mean_value::SeenCage;
use mesh::Cage;
use simod_plugin_api::{
    Affine, Choice, Consumes, DeformInput, Deformer, Descriptor, Evaluate, HandleDesc, HandleFaces, Handles,
    Host, IsIdentity, ParamDesc, ParamSet, PluginError, PluginResult, PrepareInput,
};
use somigliana::{CageBody, Coordinates};
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use sums::CageSums;

/// Number of samples whose coordinates lie together: those for one vertex follow each other, so that a
/// vertex which does not move is not read.
const TILE: usize = 1024;
/// Greatest size of the table of coordinates, in bytes: four for each sample and vertex, or 40.
const LARGEST_TABLE: usize = 1 << 30;
/// Number of points between two looks at the host's wish to stop.
const BLOCK: usize = 256;

/// The plugin.
struct CagePlugin;

/// Parameters of a cage.
#[derive(ParamSet)]
struct CageSettings {
    /// Shape of the cage that is made, where `file` names none
    #[param(default = CageShape::Hull, invalidates_preparation)]
    cage: CageShape,
    /// Number of vertices of a cage that is made, approximately
    #[param(default = 40, hard = 6..=400, soft = 6..=150, invalidates_preparation)]
    detail: i64,
    /// Distance of a cage that is made from the model; the edges of a near one show
    #[param(default = 0.05, unit = "diagonal", hard = 0.001..=1.0, soft = 0.01..=0.1, invalidates_preparation)]
    margin: f64,
}

impl CageSettings {
    /// Approximate number of vertices.
    fn vertices(&self) -> PluginResult<usize> {
        usize::try_from(self.detail).map_err(|_| PluginError::parameter("detail", "is negative"))
    }
}

#[derive(Choice, Clone, Copy)]
enum CageShape {
    #[choice(label = "About the model")]
    Hull,
    #[choice(label = "A box")]
    Box,
}

/// Parameters of the samples' coordinates in a cage.
#[derive(ParamSet)]
struct Followed {
    /// Coordinates of the samples; Somigliana's keep the shape of details, and take more memory and time
    ///
    /// The model then follows the cage as an elastic body does; mean values shear details.
    #[param(default = CageCoordinates::MeanValue, invalidates_preparation)]
    coordinates: CageCoordinates,
    /// Poisson's ratio, for Somigliana; low ones keep details' shape, high ones the volume at vertices drawn
    /// out
    #[param(default = -0.25, hard = -0.9..=0.49, soft = -0.5..=0.45, invalidates_preparation)]
    poisson: f64,
}

#[derive(Choice, Clone, Copy)]
enum CageCoordinates {
    #[choice(label = "Mean value")]
    MeanValue,
    #[choice(label = "Somigliana")]
    Somigliana,
}

/// A cage with the coordinates of all samples.
struct PreparedCage {
    cage: Cage,
    table: SampleCoordinates,
    /// Number that tells this state from other ones of this process.
    id: u64,
}

/// Coordinates of all samples.
enum SampleCoordinates {
    /// Mean value coordinates tile by tile, vertex by vertex, sample by sample; the last tile is as long as
    /// the others.
    MeanValue(Vec<f32>),
    /// Somigliana coordinates in the order of [`CageBody::tabulate`].
    Somigliana(CageBody, Vec<f32>),
}

/// The cage that the parameters describe.
fn cage(input: &PrepareInput<'_>) -> PluginResult<Cage> {
    let params = input.params();
    if let Some(path) = params.file("file")? {
        let frame = input.frame().ok_or_else(|| {
            PluginError::input("this version of SIMOD does not tell where the file's coordinates are")
                .hint("use a newer one, or a cage that is made")
        })?;
        return Cage::read(path, |p| frame.to_local(p.into()).into());
    }
    let made: CageSettings = params.read()?;
    let make = match made.cage {
        CageShape::Hull => made::hull,
        CageShape::Box => made::divided_box,
    };
    make(&input.bounds, input.samples.positions(), made.margin * input.bounds.diagonal(), made.vertices()?)
}

/// Displacement of each vertex.
fn displacements(cage: &Cage, motions: &[Affine]) -> PluginResult<Vec<DVec3>> {
    if motions.len() != cage.vertices.len() {
        let message = format!("{} motions of {} vertices", motions.len(), cage.vertices.len());
        return Err(PluginError::internal(message));
    }
    let displacement = |(p, motion): (&DVec3, &Affine)| {
        // A vertex that does not move shall not move by rounding either.
        let still = *motion == Affine::IDENTITY;
        if still { DVec3::ZERO } else { DVec3::from(motion.apply((*p).into())) - *p }
    };
    Ok(cage.vertices.iter().zip(motions).map(displacement).collect())
}

/// Refuses tables beyond the bound, of `numbers` numbers for each sample.
fn check_size(samples: usize, vertices: usize, numbers: usize) -> PluginResult<()> {
    let most = LARGEST_TABLE / size_of::<f32>() / numbers;
    if samples.div_ceil(TILE).saturating_mul(TILE) <= most {
        return Ok(());
    }
    let message = format!("{samples} samples times {vertices} vertices of the cage are too many");
    Err(PluginError::input(&message)
        .hint(format!("take less than {most} samples, or a cage with less vertices")))
}

/// Mean value coordinates of samples, and number of the samples that lie outside.
fn tabulate(cage: &Cage, samples: &[[f32; 3]], host: &Host<'_>) -> PluginResult<(Vec<f32>, usize)> {
    let vertices = cage.vertices.len();
    let mut table = vec![0.0; samples.len().div_ceil(TILE) * TILE * vertices];
    let (outside, total) = (AtomicUsize::new(0), samples.len().max(1) as f64);
    host.parallel_blocks(&mut table, TILE * vertices, |first, tile| {
        let first = first / vertices;
        // The wish to stop is looked after by the code that hands out the blocks.
        let _ = host.progress(first as f64 / total);
        let (mut view, mut weights) = (SeenCage::default(), vec![0.0; vertices]);
        for (i, p) in samples[first..].iter().take(TILE).enumerate() {
            let is_outside = cage.coordinates(DVec3::from(p.map(f64::from)), &mut view, &mut weights);
            outside.fetch_add(usize::from(is_outside), Ordering::Relaxed);
            weights.iter().enumerate().for_each(|(v, w)| tile[v * TILE + i] = *w as f32);
        }
    })?;
    Ok((table, outside.into_inner()))
}

impl Deformer for CagePlugin {
    type State = PreparedCage;
    type Scratch = CageSums;

    fn descriptor() -> Descriptor {
        Descriptor::new("cage", "Cage", env!("CARGO_PKG_VERSION"))
            .summary("Bends the model by the vertices of a coarse cage about it")
            .citation(
                "T. Ju, S. Schaefer, J. Warren, Mean value coordinates for closed triangular meshes, SIGGRAPH 2005; J. Chen, \
                 F. de Goes, M. Desbrun, Somigliana coordinates, SIGGRAPH 2023",
            )
            .param_set::<CageSettings>()
            .param_set::<Followed>()
            .param(
                ParamDesc::file("file", "File", &["obj"])
                    .hint("A closed surface of polygons in the model's coordinates; its vertices are the handles 0, 1, 2, ..."),
            )
            .consumes(Consumes { frame: true, ..Consumes::default() })
    }

    fn prepare(input: &PrepareInput<'_>, host: &Host<'_>) -> PluginResult<PreparedCage> {
        let cage = cage(input)?;
        let Followed { coordinates, poisson } = input.params().read()?;
        let (samples, vertices) = (input.samples.positions(), cage.vertices.len());
        let (table, outside) = match coordinates {
            CageCoordinates::MeanValue => {
                check_size(samples.len(), vertices, vertices)?;
                let (table, outside) = tabulate(&cage, samples, host)?;
                (SampleCoordinates::MeanValue(table), outside)
            }
            CageCoordinates::Somigliana => {
                let body = CageBody::new(&cage, poisson);
                check_size(samples.len(), vertices, somigliana::NUMBERS * vertices)?;
                let (table, outside) = body.tabulate(&cage, samples, host)?;
                (SampleCoordinates::Somigliana(body, table), outside)
            }
        };
        match outside {
            0 => {}
            all if all == samples.len() => host.warn(
                "the model lies outside of the cage: the file has to be in the model's own coordinates",
            ),
            some => host.warn(&format!(
                "{some} of {} samples lie outside of the cage, and may move against its vertices",
                samples.len()
            )),
        }
        static STATES: AtomicU64 = AtomicU64::new(1);
        Ok(PreparedCage { cage, table, id: STATES.fetch_add(1, Ordering::Relaxed) })
    }

    fn deform(
        state: &PreparedCage,
        input: &DeformInput<'_>,
        sums: &mut CageSums,
        out: &mut [[f32; 3]],
        host: &Host<'_>,
    ) -> PluginResult<()> {
        let displacements = displacements(&state.cage, input.handle_motions())?;
        let (cage, rest, vertices) = (&state.cage, input.samples.positions(), state.cage.vertices.len());
        let expect = |length: usize, tile: usize, numbers: usize| {
            let is_right = rest.len() == out.len() && length == out.len().div_ceil(tile) * tile * numbers;
            is_right
                .then_some(())
                .ok_or_else(|| PluginError::internal("the samples are not those of the preparation"))
        };
        let table = match &state.table {
            SampleCoordinates::MeanValue(table) => table,
            SampleCoordinates::Somigliana(body, table) => {
                let numbers = somigliana::NUMBERS * vertices;
                expect(table.len(), somigliana::TILE, numbers)?;
                if displacements.iter().all(|d| *d == DVec3::ZERO) {
                    out.copy_from_slice(rest);
                    return Ok(());
                }
                let pose = body.pose(cage, &displacements);
                return host.parallel_blocks(out, somigliana::TILE, |first, out| {
                    let table = &table[first * numbers..][..somigliana::TILE * numbers];
                    somigliana::deform(cage, &pose, table, &rest[first..][..out.len()], out);
                });
            }
        };
        expect(table.len(), TILE, vertices)?;
        sums.update(state.id, table, &displacements, host)?;
        let sums = sums.all();
        host.parallel_blocks(out, TILE, |first, out| {
            let tile = &sums[first / TILE];
            for (i, (o, p)) in out.iter_mut().zip(&rest[first..]).enumerate() {
                *o = std::array::from_fn(|axis| (f64::from(p[axis]) + tile[axis][i]) as f32);
            }
        })
    }
}

impl Evaluate for CagePlugin {
    fn evaluate(
        state: &PreparedCage,
        input: &DeformInput<'_>,
        points: &mut [[f64; 3]],
        host: &Host<'_>,
    ) -> PluginResult<()> {
        let displacements = displacements(&state.cage, input.handle_motions())?;
        if displacements.iter().all(|d| *d == DVec3::ZERO) {
            return Ok(());
        }
        let cage = &state.cage;
        let (mut view, mut weights) = (SeenCage::default(), vec![0.0; cage.vertices.len()]);
        let mut found = Coordinates::default();
        let posed = match &state.table {
            SampleCoordinates::MeanValue(_) => None,
            SampleCoordinates::Somigliana(body, _) => Some((body, body.pose(cage, &displacements))),
        };
        for points in points.chunks_mut(BLOCK) {
            host.progress(0.0)?;
            for p in points {
                let x = DVec3::from(*p);
                *p = if let Some((body, pose)) = &posed {
                    body.coordinates(cage, x, &mut found);
                    found.apply(cage, pose, x)
                } else {
                    cage.coordinates(x, &mut view, &mut weights);
                    displacements.iter().zip(&weights).fold(x, |q, (d, w)| q + *w * *d)
                }
                .into();
            }
        }
        Ok(())
    }
}

impl Handles for CagePlugin {
    fn handles(input: &PrepareInput<'_>, _: &Host<'_>) -> PluginResult<Vec<HandleDesc>> {
        let vertices = cage(input)?.vertices;
        let handle = |(v, p): (usize, &DVec3)| HandleDesc::new(&v.to_string(), (*p).into());
        Ok(vertices.iter().enumerate().map(handle).collect())
    }
}

impl HandleFaces for CagePlugin {
    fn handle_faces(input: &PrepareInput<'_>, _: &Host<'_>) -> PluginResult<Vec<Vec<u32>>> {
        let (params, made) = (input.params(), input.params().read::<CageSettings>()?);
        // A hull's vertices take several passes over all samples; its faces take none.
        if params.file("file")?.is_none() && matches!(made.cage, CageShape::Hull) {
            return Ok(made::hull_faces(made.vertices()?));
        }
        Ok(cage(input)?.faces)
    }
}

impl IsIdentity for CagePlugin {
    fn is_identity(input: &DeformInput<'_>) -> PluginResult<bool> {
        Ok(input.handle_motions().iter().all(|motion| *motion == Affine::IDENTITY))
    }
}

simod_plugin_api::export_plugin!(CagePlugin, evaluate, handles, handle_faces, is_identity);

#[cfg(test)]
mod tests;
