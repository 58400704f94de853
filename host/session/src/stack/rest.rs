//! Samples as a layer finds them, and as they are passed to a plugin.

use glam::{DAffine3, Vec3};
use rayon::prelude::*;
use simod_core::attributes::SampleAttributes;
use simod_core::sampling::NeighbourGraph;
use simod_model::bounds::Bounds;
use simod_model::frame::Frame;
use simod_model::{Error, ErrorKind, Result};
use simod_plugin_api as api;
use std::path::Path;
use std::sync::Arc;

/// Derives unit normals, one per sample, from changed positions (local coordinates).
pub(crate) type Renormal<'a> = dyn Fn(&[Vec3]) -> Vec<Vec3> + Sync + 'a;

/// Effort of a deformation, and its time in a sequence.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Moment {
    pub effort: api::Effort,
    pub time: api::Time,
}

/// Samples as they were taken, at rest.
#[derive(Clone, Copy)]
pub(crate) struct RestShape<'a> {
    /// Local positions; all finite.
    pub positions: &'a [Vec3],
    /// Unit normals, one per sample, or none at all.
    pub normals: &'a [Vec3],
    /// Distance to the nearest other samples, one per sample, or none at all.
    pub spacing: &'a [f32],
    /// Triangles between the samples, or none.
    pub triangles: &'a [[u32; 3]],
    /// The samples' nearest neighbours.
    pub neighbours: Option<&'a NeighbourGraph>,
    /// Colours and other attributes of the samples, where they were asked for.
    pub attributes: Option<&'a Arc<SampleAttributes>>,
    /// Folder in which temporary files without a name are made, for other models that plugins take; the
    /// system's own folder if it is empty.
    pub folder: &'a Path,
    /// The map between model and local coordinates.
    pub frame: Frame,
    /// The model's box, model coordinates.
    pub bounds: Bounds,
    /// Function for normals of changed positions, for layers that need them after others. Without it such
    /// layers get the old normals.
    pub renormal: Option<&'a Renormal<'a>>,
}

/// A layer's rest shape, local coordinates.
#[derive(Debug, Clone)]
pub(crate) struct LayerRest {
    pub positions: Arc<[Vec3]>,
    pub normals: Arc<[Vec3]>,
    /// Whether the normals are those of the positions.
    pub normals_fit: bool,
    pub spacing: Arc<[f32]>,
    pub bounds: api::Bounds,
    /// Key that stands for the rest shape: a hash of all that it came from.
    pub key: u64,
}

impl LayerRest {
    pub fn samples(&self) -> api::Samples<'_> {
        api::Samples::new(
            bytemuck::cast_slice(&self.positions),
            bytemuck::cast_slice(&self.normals),
            &self.spacing,
        )
    }
}

/// Lists of samples that do not fit together.
pub(crate) fn not_one_per_sample(what: &str) -> Error {
    let what = format!("there is not one {what} per sample");
    Error::mismatch(what, "sample the model again")
}

impl RestShape<'_> {
    /// Rest shape of the first layer; `key` stands for it.
    pub(crate) fn rest(&self, key: u64) -> Result<LayerRest> {
        self.rest_at(self.positions.into(), key)
    }

    /// Rest shape of a layer at other positions, as layers before have left them.
    pub(crate) fn rest_at(&self, positions: Arc<[Vec3]>, key: u64) -> Result<LayerRest> {
        self.check()?;
        let corner = |p| self.frame.to_local_exact(p).to_array();
        Ok(LayerRest {
            normals_fit: *positions == *self.positions,
            positions,
            normals: self.normals.into(),
            spacing: self.spacing.into(),
            bounds: api::Bounds { min: corner(self.bounds.min), max: corner(self.bounds.max) },
            key,
        })
    }

    /// Rest shape of a layer at new positions, with all else as in `former`.
    pub(crate) fn rest_again(
        &self,
        former: &LayerRest,
        positions: Arc<[Vec3]>,
        key: u64,
    ) -> Result<LayerRest> {
        self.check_finite(&positions)?;
        Ok(LayerRest { normals_fit: *positions == *self.positions, positions, key, ..former.clone() })
    }

    fn check(&self) -> Result<()> {
        let count = self.positions.len();
        if count == 0 {
            let hint = "sample the model more finely";
            return Err(Error::degenerate("there are no samples to deform", hint));
        }
        if ![0, count].contains(&self.normals.len()) {
            return Err(not_one_per_sample("normal"));
        }
        if ![0, count].contains(&self.spacing.len()) {
            return Err(not_one_per_sample("spacing distance"));
        }
        self.check_finite(self.positions)
    }

    fn check_finite(&self, positions: &[Vec3]) -> Result<()> {
        let finite = positions.par_iter().all(|p| p.is_finite());
        if !(finite && self.frame.is_valid() && self.bounds.min.is_finite() && self.bounds.max.is_finite()) {
            let what = "a sample, the frame or the bounding box is not finite";
            return Err(Error::degenerate(what, "sample the model again"));
        }
        Ok(())
    }
}

/// Index of each sample's first neighbour, and the neighbours of all samples.
pub fn neighbour_lists(graph: &NeighbourGraph, samples: usize) -> (Vec<u32>, &[u32]) {
    ((0..=samples).map(|i| (i * graph.k()) as u32).collect(), graph.all())
}

/// Error of a layer, with its place; that of a cancellation gets none.
pub(crate) fn located(place: &str, e: Error) -> Error {
    if e.kind() == ErrorKind::Cancelled {
        return e;
    }
    let what = format!("{place}: {e}");
    e.saying(what)
}

/// A map in the layout of the plugin interface: rows of the matrix, with the translation.
pub fn rows(map: DAffine3) -> api::Affine {
    let (m, t) = (map.matrix3, map.translation);
    let row = |i: usize| [m.x_axis[i], m.y_axis[i], m.z_axis[i], t[i]];
    api::Affine { rows: [row(0), row(1), row(2)] }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    #[test]
    fn samples_that_cannot_be_deformed_are_refused() {
        let shape = RestShape {
            positions: &[Vec3::X, Vec3::Y],
            normals: &[],
            spacing: &[],
            triangles: &[],
            neighbours: None,
            attributes: None,
            folder: Path::new(""),
            frame: Frame { origin: DVec3::ZERO, scale: 1.0 },
            bounds: Bounds { min: DVec3::ZERO, max: DVec3::ONE },
            renormal: None,
        };
        assert!(shape.rest(0).is_ok());
        let refused = |shape: RestShape<'_>| shape.rest(0).unwrap_err().kind();
        assert_eq!(refused(RestShape { positions: &[], ..shape }), ErrorKind::Degenerate);
        assert_eq!(refused(RestShape { positions: &[Vec3::NAN], ..shape }), ErrorKind::Degenerate);
        let bounds = Bounds { max: DVec3::INFINITY, ..shape.bounds };
        assert_eq!(refused(RestShape { bounds, ..shape }), ErrorKind::Degenerate);
        assert_eq!(refused(RestShape { normals: &[Vec3::X; 3], ..shape }), ErrorKind::Mismatch);
        assert_eq!(refused(RestShape { spacing: &[1.0], ..shape }), ErrorKind::Mismatch);
    }
}
