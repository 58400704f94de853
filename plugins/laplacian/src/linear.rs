//! Displacements as smooth as can be, with one system of equations.
//!
//! M. Botsch, L. Kobbelt, *An Intuitive Framework for Real-Time Freeform Modeling*, SIGGRAPH 2004: the least
//! integral of `|Δd|²` for the displacements of the regions. Handles move affinely, so that all displacements
//! are combinations of four solutions per handle, found beforehand.

use crate::constraints::{OwnMotions, SampleTarget, Soft};
use crate::problem::{Problem, out_of_memory};
use glam::DVec3;
use simod_cholesky::Factor;
use simod_plugin_api::{Host, PluginResult};
use std::ops::Range;

/// Functions per handle: 1, and the coordinates relative to its middle.
const PER_HANDLE: usize = 4;
/// Handles for which solutions are tabulated. More would need more memory than the factorisation, and their
/// displacements are solved for anew each time.
const MOST_TABULATED: usize = 12;
/// Products of the Laplacian's entries that are summed up, at most. A surface has some fifty per sample; a
/// sample that thousands of others share triangles with has millions.
const MOST_ENTRIES: usize = 1 << 27;
/// Nodes at once on one thread.
const TOGETHER: usize = 4096;

/// The bi-Laplacian on a problem.
#[derive(Debug)]
pub struct BiLaplacian {
    /// The nodes.
    pub problem: Problem,
    springs: Vec<Soft>,
    factor: Factor<f64>,
}

/// Bi-Laplacian with the displacements that each handle makes by itself.
#[derive(Debug)]
pub struct Smoothest {
    /// The equations.
    pub equations: BiLaplacian,
    table: Option<HandleDisplacements>,
}

/// The displacements of the free nodes for each function of each handle.
#[derive(Debug)]
struct HandleDisplacements {
    /// Middle and size of each handle.
    frames: Vec<(DVec3, f64)>,
    /// Displacements node by node.
    values: Vec<f32>,
}

impl BiLaplacian {
    /// Factorises the bi-Laplacian. `stiffness` is that of a draw, per area; `told` is the range of the
    /// progress.
    pub fn new(problem: Problem, stiffness: f64, told: Range<f64>, host: &Host<'_>) -> PluginResult<Self> {
        let entries = |i: usize| problem.operators.laplacian(i).map(|(k, _)| problem.operators.entries(k));
        if (0..problem.free).flat_map(entries).sum::<usize>() > MOST_ENTRIES {
            return Err(out_of_memory());
        }
        let springs = problem.springs(stiffness);
        let factor = problem.factor(problem.bilaplacian(), &springs, told, host)?;
        Ok(Self { problem, springs, factor })
    }

    /// Displacements whose Laplacians are nearest to given ones; those of held nodes, and the goals of draws,
    /// are as `target` says.
    pub fn respond(
        &self,
        laplacian: impl Fn(usize) -> DVec3 + Sync,
        target: impl Fn(SampleTarget, DVec3) -> DVec3,
        host: &Host<'_>,
    ) -> PluginResult<Vec<DVec3>> {
        let Problem { free, rows, rest, operators, .. } = &self.problem;
        let mut displacements = self.problem.held_displacements(&target);
        // Rest of the Laplacians after the held nodes' part, per area.
        let mut lacking = vec![DVec3::ZERO; *rows];
        host.parallel_blocks(&mut lacking, TOGETHER, |first, out| {
            for (i, sum) in (first..).zip(out) {
                let held = operators.laplacian(i).filter(|(j, _)| j >= free);
                let held: DVec3 = held.map(|(j, l)| l * displacements[j]).sum();
                *sum = (laplacian(i) - held) / operators.areas[i];
            }
        })?;
        let mut sums = vec![DVec3::ZERO; *free];
        host.parallel_blocks(&mut sums, TOGETHER, |first, out| {
            for (i, sum) in (first..).zip(out) {
                *sum = operators.laplacian(i).map(|(j, l)| l * lacking[j]).sum();
            }
        })?;
        for spring in &self.springs {
            let node = spring.node as usize;
            sums[node] += spring.strength * target(spring.target, rest[node]);
        }
        self.factor.solve(&mut sums, host)?;
        displacements[..*free].copy_from_slice(&sums);
        Ok(displacements)
    }
}

impl Smoothest {
    /// Solves for the displacements that the handles make. `frames` are the handles' middles and sizes.
    pub fn new(equations: BiLaplacian, frames: Vec<(DVec3, f64)>, host: &Host<'_>) -> PluginResult<Self> {
        let is_worth = frames.len() <= MOST_TABULATED;
        let table = if is_worth { Some(HandleDisplacements::new(&equations, frames, host)?) } else { None };
        Ok(Self { equations, table })
    }

    /// The displacements of all nodes that the regions' ask for.
    pub fn displacements(&self, motion: &OwnMotions, host: &Host<'_>) -> PluginResult<Vec<DVec3>> {
        let problem = &self.equations.problem;
        let target = |target, at| motion.displacement(target, at);
        let Some(table) = &self.table else {
            return self.equations.respond(|_| DVec3::ZERO, target, host);
        };
        let mut coefficients = Vec::with_capacity(PER_HANDLE * table.frames.len());
        for (h, &(middle, size)) in table.frames.iter().enumerate() {
            let map = motion.of_handle(h);
            coefficients.push(map.transform_point3(middle));
            coefficients
                .extend([map.matrix3.x_axis, map.matrix3.y_axis, map.matrix3.z_axis].map(|c| c * size));
        }
        let mut displacements = problem.held_displacements(target);
        let functions = coefficients.len();
        host.parallel_blocks(&mut displacements[..problem.free], TOGETHER, |first, out| {
            let rows = table.values[first * functions..].chunks_exact(functions);
            for (d, row) in out.iter_mut().zip(rows) {
                *d = row.iter().zip(&coefficients).map(|(v, k)| f64::from(*v) * *k).sum();
            }
        })?;
        Ok(displacements)
    }
}

impl HandleDisplacements {
    fn new(equations: &BiLaplacian, frames: Vec<(DVec3, f64)>, host: &Host<'_>) -> PluginResult<Self> {
        let functions = PER_HANDLE * frames.len();
        let mut values = vec![0.0; equations.problem.free * functions];
        for (h, &(middle, size)) in frames.iter().enumerate() {
            host.progress(0.9 + 0.1 * h as f64 / frames.len() as f64)?;
            let is_own = |target: SampleTarget| target == SampleTarget::Handle(h as u32);
            let one = |target, _| if is_own(target) { DVec3::X } else { DVec3::ZERO };
            let relative =
                |target, at: DVec3| if is_own(target) { (at - middle) / size } else { DVec3::ZERO };
            let one = equations.respond(|_| DVec3::ZERO, one, host)?;
            let relative = equations.respond(|_| DVec3::ZERO, relative, host)?;
            for (i, row) in values.chunks_exact_mut(functions).enumerate() {
                let values = [one[i].x, relative[i].x, relative[i].y, relative[i].z];
                row[PER_HANDLE * h..][..PER_HANDLE].copy_from_slice(&values.map(|x| x as f32));
            }
        }
        Ok(Self { frames, values })
    }
}
