//! Free-form deformation: a lattice of control points about the model, or a part of it, bends the space
//! inside.
//!
//! T. W. Sederberg, S. R. Parry, *Free-form deformation of solid geometric models*, SIGGRAPH 1986, with the
//! basis of Bernstein's polynomials; J. Griessmair, W. Purgathofer, *Deformation of solids with trivariate
//! B-splines*, Eurographics 1989. The control points are handles. Nothing is prepared but the lattice's
//! place.

mod basis;
mod frame;
mod moved;

use basis::{Basis, Beyond, MOST};
use frame::LatticeFrame;
use glam::DVec3;
use moved::MovedPoints;
use simod_plugin_api::{
    Affine, Choice, DeformInput, Deformer, Descriptor, Evaluate, HandleDesc, Handles, Host, IsIdentity,
    ParamSet, PluginError, PluginResult, PrepareInput,
};

/// Number of samples that are deformed at once on one thread.
const BLOCK: usize = 4096;

/// The plugin.
struct LatticePlugin;

/// Parameters: the lattice's resolution, its functions, its box, and the continuation outside.
#[derive(ParamSet)]
struct LatticeSettings {
    /// Number of control points along this axis of the box
    #[param(default = 4, hard = 2..=MOST as i64, soft = 2..=10, group = "Lattice", invalidates_preparation)]
    resolution_x: i64,
    /// Number of control points along this axis of the box
    #[param(default = 4, hard = 2..=MOST as i64, soft = 2..=10, group = "Lattice", invalidates_preparation)]
    resolution_y: i64,
    /// Number of control points along this axis of the box
    #[param(default = 4, hard = 2..=MOST as i64, soft = 2..=10, group = "Lattice", invalidates_preparation)]
    resolution_z: i64,
    /// Functions of the control points, which reach over some cells of the lattice, or over all of it
    #[param(default = BasisKind::BSpline, group = "Lattice", invalidates_preparation)]
    basis: BasisKind,
    /// Centre of the box
    #[param(point, name = "Centre", default = [0.5; 3], unit = "model-length", group = "Box")]
    #[param(invalidates_preparation)]
    center: [f64; 3],
    /// Size of the box along this axis of its own; 0 for what the whole model needs
    #[param(default = 0.0, unit = "diagonal", hard = 0.0..=100.0, soft = 0.0..=1.0, group = "Box")]
    #[param(invalidates_preparation)]
    size_x: f64,
    /// Size of the box along this axis of its own; 0 for what the whole model needs
    #[param(default = 0.0, unit = "diagonal", hard = 0.0..=100.0, soft = 0.0..=1.0, group = "Box")]
    #[param(invalidates_preparation)]
    size_y: f64,
    /// Size of the box along this axis of its own; 0 for what the whole model needs
    #[param(default = 0.0, unit = "diagonal", hard = 0.0..=100.0, soft = 0.0..=1.0, group = "Box")]
    #[param(invalidates_preparation)]
    size_z: f64,
    /// Axis about which the box is turned
    #[param(direction, default = [0.0, 1.0, 0.0], group = "Box", invalidates_preparation)]
    axis: [f64; 3],
    /// Angle by which the box is turned
    #[param(default = 0.0, unit = "degrees", soft = -180.0..=180.0, group = "Box", invalidates_preparation)]
    angle: f64,
    /// Continuation beyond the faces: as inside and fading to rest, or as the nearest point of the box
    ///
    /// Where the two outermost layers of control points rest, there is no crease.
    #[param(default = Outside::Smooth, group = "Outside", invalidates_preparation)]
    outside: Outside,
    /// Length over which a smooth deformation fades outside, as a part of the box' size
    #[param(default = 0.25, unit = "ratio", hard = 0.01..=10.0, soft = 0.05..=1.0, group = "Outside")]
    #[param(invalidates_preparation)]
    reach: f64,
}

#[derive(Choice, Clone, Copy)]
enum BasisKind {
    #[choice(label = "Cubic B-splines (local)")]
    BSpline,
    #[choice(label = "Bernstein (global)")]
    Bernstein,
}

#[derive(Choice, Clone, Copy)]
enum Outside {
    #[choice(label = "Smooth, fading")]
    Smooth,
    #[choice(label = "As the nearest face")]
    Clamped,
}

/// A lattice at rest.
struct ControlLattice {
    frame: LatticeFrame,
    bases: [Basis; 3],
}

impl ControlLattice {
    fn new(input: &PrepareInput<'_>) -> PluginResult<Self> {
        let settings: LatticeSettings = input.params().read()?;
        let beyond = match settings.outside {
            Outside::Smooth => Beyond::Smooth { reach: settings.reach },
            Outside::Clamped => Beyond::Clamped,
        };
        let along = |id: &str, count: i64| match usize::try_from(count) {
            Ok(count) if (2..=MOST).contains(&count) => Ok(match settings.basis {
                BasisKind::BSpline => Basis::b_spline(count, beyond),
                BasisKind::Bernstein => Basis::bernstein(count, beyond),
            }),
            _ => Err(PluginError::parameter(id, &format!("is not from 2 to {MOST}"))),
        };
        let bases = [
            along("resolution-x", settings.resolution_x)?,
            along("resolution-y", settings.resolution_y)?,
            along("resolution-z", settings.resolution_z)?,
        ];
        Ok(Self { frame: LatticeFrame::new(&settings, &input.bounds, input.samples.positions())?, bases })
    }

    /// Control points along each axis.
    fn counts(&self) -> [usize; 3] {
        self.bases.each_ref().map(Basis::count)
    }

    /// The number of control points.
    fn len(&self) -> usize {
        self.counts().iter().product()
    }

    /// The control points' indices, in the handles' order.
    fn indices(&self) -> impl Iterator<Item = [usize; 3]> {
        let [nx, ny, nz] = self.counts();
        (0..nx * ny * nz).map(move |n| [n / nz / ny, n / nz % ny, n % nz])
    }

    /// Place of a control point at rest.
    fn control_point(&self, index: [usize; 3]) -> DVec3 {
        self.frame.point(std::array::from_fn(|axis| self.bases[axis].place_of(index[axis])))
    }
}

impl Deformer for LatticePlugin {
    type State = ControlLattice;
    type Scratch = ();

    fn descriptor() -> Descriptor {
        Descriptor::new("lattice", "Lattice", env!("CARGO_PKG_VERSION"))
            .summary("Bends space by the control points of a lattice about the model, or a part of it")
            .citation(
                "T. W. Sederberg, S. R. Parry, Free-form deformation of solid geometric models, SIGGRAPH 1986; \
                 J. Griessmair, W. Purgathofer, Deformation of solids with trivariate B-splines, Eurographics 1989",
            )
            .param_set::<LatticeSettings>()
    }

    fn prepare(input: &PrepareInput<'_>, _: &Host<'_>) -> PluginResult<ControlLattice> {
        ControlLattice::new(input)
    }

    fn deform(
        lattice: &ControlLattice,
        input: &DeformInput<'_>,
        _: &mut (),
        out: &mut [[f32; 3]],
        host: &Host<'_>,
    ) -> PluginResult<()> {
        let moved = MovedPoints::new(lattice, input.handle_motions())?;
        let rest = input.samples.positions();
        if moved.is_empty() {
            out.copy_from_slice(rest);
            return Ok(());
        }
        host.parallel_blocks(out, BLOCK, |first, out| {
            moved.apply_all(&rest[first..first + out.len()], out);
        })
    }
}

impl Evaluate for LatticePlugin {
    fn evaluate(
        lattice: &ControlLattice,
        input: &DeformInput<'_>,
        points: &mut [[f64; 3]],
        host: &Host<'_>,
    ) -> PluginResult<()> {
        let moved = MovedPoints::new(lattice, input.handle_motions())?;
        for points in points.chunks_mut(BLOCK) {
            host.progress(0.0)?;
            points.iter_mut().for_each(|p| *p = moved.apply(DVec3::from(*p)).into());
        }
        Ok(())
    }
}

impl Handles for LatticePlugin {
    fn handles(input: &PrepareInput<'_>, _: &Host<'_>) -> PluginResult<Vec<HandleDesc>> {
        let lattice = ControlLattice::new(input)?;
        let handle = |index @ [i, j, k]: [usize; 3]| {
            HandleDesc::new(&format!("{i},{j},{k}"), lattice.control_point(index).into())
        };
        Ok(lattice.indices().map(handle).collect())
    }
}

impl IsIdentity for LatticePlugin {
    fn is_identity(input: &DeformInput<'_>) -> PluginResult<bool> {
        Ok(input.handle_motions().iter().all(|motion| *motion == Affine::IDENTITY))
    }
}

simod_plugin_api::export_plugin!(LatticePlugin, evaluate, handles, is_identity);

#[cfg(test)]
mod tests;
