//! Free-form deformation: a lattice of control points about the model, or a part of it, bends the space inside.
//!
//! T. W. Sederberg, S. R. Parry, *Free-form deformation of solid geometric models*, SIGGRAPH 1986, with the basis of
//! Bernstein's polynomials; J. Griessmair, W. Purgathofer, *Deformation of solids with trivariate B-splines*,
//! Eurographics 1989. The control points are handles. Nothing is prepared but the lattice's place.

mod basis;
mod frame;
mod moved;

use basis::{Basis, Beyond, MOST};
use frame::Frame;
use glam::DVec3;
use moved::Moved;
use simod_plugin_api::{
    Affine, DeformInput, Deformer, Descriptor, Evaluate, HandleDesc, Handles, Host, IsIdentity, ParamDesc,
    PluginError, PluginResult, PrepareInput, Unit,
};

/// Samples that are deformed at once on one thread.
const BLOCK: usize = 4096;

/// The plugin.
struct LatticePlugin;

/// A lattice at rest.
pub struct Lattice {
    frame: Frame,
    bases: [Basis; 3],
}

impl Lattice {
    fn new(input: &PrepareInput<'_>) -> PluginResult<Self> {
        let params = input.params();
        let beyond = match params.choice("outside")? {
            "smooth" => Beyond::Smooth { reach: params.float("reach")? },
            "clamped" => Beyond::Clamped,
            other => return Err(PluginError::parameter("outside", &format!("is unknown: {other}"))),
        };
        let basis = match params.choice("basis")? {
            "b-spline" => Basis::b_spline,
            "bernstein" => Basis::bernstein,
            other => return Err(PluginError::parameter("basis", &format!("is unknown: {other}"))),
        };
        let along = |id: &str| match usize::try_from(params.int(id)?) {
            Ok(count) if (2..=MOST).contains(&count) => Ok(basis(count, beyond)),
            _ => Err(PluginError::parameter(id, &format!("is not from 2 to {MOST}"))),
        };
        let bases = [along("resolution-x")?, along("resolution-y")?, along("resolution-z")?];
        Ok(Self { frame: Frame::new(params, &input.bounds, input.samples.positions())?, bases })
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

    /// Where a control point is at rest.
    fn control_point(&self, index: [usize; 3]) -> DVec3 {
        self.frame.point(std::array::from_fn(|axis| self.bases[axis].place_of(index[axis])))
    }
}

impl Deformer for LatticePlugin {
    type State = Lattice;
    type Scratch = ();

    fn descriptor() -> Descriptor {
        let bases = [("b-spline", "Cubic B-splines (local)"), ("bernstein", "Bernstein (global)")];
        let outsides = [("smooth", "Smooth, fading"), ("clamped", "As the nearest face")];
        let resolution = |id, name| {
            ParamDesc::int(id, name, 4)
                .hard(2.0, MOST as f64)
                .soft(2.0, 10.0)
                .hint("Control points along this axis of the box")
                .group("Lattice")
                .invalidates_preparation()
        };
        let size = |id, name| {
            ParamDesc::float(id, name, 0.0)
                .unit(Unit::DIAGONAL)
                .hard(0.0, 100.0)
                .soft(0.0, 1.0)
                .hint("Of the box along this axis of its own; 0 for what the whole model needs")
                .group("Box")
                .invalidates_preparation()
        };
        Descriptor::new("lattice", "Lattice", env!("CARGO_PKG_VERSION"))
            .summary("Bends space by the control points of a lattice about the model, or a part of it")
            .citation(
                "T. W. Sederberg, S. R. Parry, Free-form deformation of solid geometric models, SIGGRAPH 1986; \
                 J. Griessmair, W. Purgathofer, Deformation of solids with trivariate B-splines, Eurographics 1989",
            )
            .param(resolution("resolution-x", "Resolution x"))
            .param(resolution("resolution-y", "Resolution y"))
            .param(resolution("resolution-z", "Resolution z"))
            .param(
                ParamDesc::choice("basis", "Basis", "b-spline", &bases)
                    .hint("How far control points reach: some cells of the lattice, or all of it")
                    .group("Lattice")
                    .invalidates_preparation(),
            )
            .param(
                ParamDesc::point("center", "Centre", [0.5; 3])
                    .unit(Unit::MODEL_LENGTH)
                    .hint("Of the box")
                    .group("Box")
                    .invalidates_preparation(),
            )
            .param(size("size-x", "Size x"))
            .param(size("size-y", "Size y"))
            .param(size("size-z", "Size z"))
            .param(
                ParamDesc::direction("axis", "Axis", [0.0, 1.0, 0.0])
                    .hint("About which the box is turned")
                    .group("Box")
                    .invalidates_preparation(),
            )
            .param(
                ParamDesc::float("angle", "Angle", 0.0)
                    .unit(Unit::DEGREES)
                    .soft(-180.0, 180.0)
                    .hint("By which the box is turned")
                    .group("Box")
                    .invalidates_preparation(),
            )
            .param(
                ParamDesc::choice("outside", "Outside", "smooth", &outsides)
                    .hint("What is beyond a face goes on as inside and fades to rest, or follows the nearest point of the box")
                    .group("Outside")
                    .invalidates_preparation(),
            )
            .param(
                ParamDesc::float("reach", "Reach", 0.25)
                    .unit(Unit::RATIO)
                    .hard(0.01, 10.0)
                    .soft(0.05, 1.0)
                    .hint("Over which part of the box' size a smooth deformation fades outside")
                    .group("Outside")
                    .invalidates_preparation(),
            )
    }

    fn prepare(input: &PrepareInput<'_>, _: &Host<'_>) -> PluginResult<Lattice> {
        Lattice::new(input)
    }

    fn deform(
        lattice: &Lattice,
        input: &DeformInput<'_>,
        _: &mut (),
        out: &mut [[f32; 3]],
        host: &Host<'_>,
    ) -> PluginResult<()> {
        let moved = Moved::new(lattice, input.handle_motions())?;
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
        lattice: &Lattice,
        input: &DeformInput<'_>,
        points: &mut [[f64; 3]],
        host: &Host<'_>,
    ) -> PluginResult<()> {
        let moved = Moved::new(lattice, input.handle_motions())?;
        for points in points.chunks_mut(BLOCK) {
            host.progress(0.0)?;
            points.iter_mut().for_each(|p| *p = moved.apply(DVec3::from(*p)).into());
        }
        Ok(())
    }
}

impl Handles for LatticePlugin {
    fn handles(input: &PrepareInput<'_>, _: &Host<'_>) -> PluginResult<Vec<HandleDesc>> {
        let lattice = Lattice::new(input)?;
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
