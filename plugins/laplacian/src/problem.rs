//! Equations of the free samples: the samples that are to be found, and those next to them that hold them.

use crate::constraints::{SampleTarget, Soft};
use crate::elements::SurfaceTriangle;
use crate::operators::Operators;
use glam::DVec3;
use simod_cholesky::{Factor, Refusal, Stored, Symmetric};
use simod_plugin_api::{ErrorCode, Host, PluginError, PluginResult};
use std::ops::Range;

/// Rows at once on one thread.
const TOGETHER: usize = 2048;

/// Constraint of a sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Constraint {
    /// A node that is to be found.
    Free,
    /// A node that a region holds.
    Held(SampleTarget),
    /// A sample that is connected to none that is held or drawn.
    Loose,
}

/// The free samples and those around them, numbered anew: *nodes*. Samples that are held far from any free
/// one are not among them.
#[derive(Debug)]
pub struct Problem {
    /// The sample that each node is: the free ones first, then the held ones that share an element with
    /// those, then the held ones that share one with these.
    pub samples: Vec<u32>,
    /// Positions of the nodes at rest.
    pub rest: Vec<DVec3>,
    /// Number of free nodes.
    pub free: usize,
    /// Number of nodes that are free or next to free ones: the rows of the operators that are complete.
    pub rows: usize,
    /// Region of each held node, from `free` on.
    pub held: Vec<SampleTarget>,
    /// The draws at free nodes.
    pub soft: Vec<Soft>,
    /// Laplacian and areas.
    pub operators: Operators,
}

impl Problem {
    /// Picks the nodes. `kinds` and `rest` are of all samples; draws at samples that are not free are left
    /// out.
    pub fn new(
        rest: &[DVec3],
        elements: &[SurfaceTriangle],
        kinds: &[Constraint],
        soft: &[Soft],
        host: &Host<'_>,
    ) -> PluginResult<Self> {
        const FAR: u8 = u8::MAX;
        let mut ring: Vec<u8> = kinds.iter().map(|k| if *k == Constraint::Free { 0 } else { FAR }).collect();
        for distance in 1..=2 {
            for e in elements {
                let nearest = e.corners.iter().map(|c| ring[*c as usize]).min().unwrap_or(FAR);
                if nearest == distance - 1 {
                    for c in e.corners {
                        ring[c as usize] = ring[c as usize].min(distance);
                    }
                }
            }
        }
        let of =
            |wanted: u8| ring.iter().enumerate().filter(move |(_, r)| **r == wanted).map(|(i, _)| i as u32);
        let samples: Vec<u32> = (0..3).flat_map(of).collect();
        let mut node = vec![u32::MAX; rest.len()];
        samples.iter().enumerate().for_each(|(k, i)| node[*i as usize] = k as u32);
        let (free, rows) = (of(0).count(), of(0).count() + of(1).count());

        let is_near = |e: &&SurfaceTriangle| e.corners.iter().any(|c| ring[*c as usize] <= 1);
        let elements: Vec<SurfaceTriangle> = elements
            .iter()
            .filter(is_near)
            .map(|e| SurfaceTriangle { corners: e.corners.map(|c| node[c as usize]), ..*e })
            .collect();
        let at: Vec<DVec3> = samples.iter().map(|i| rest[*i as usize]).collect();
        let operators = Operators::new(&at, &elements, host)?;
        let held = samples[free..].iter().map(|i| match kinds[*i as usize] {
            Constraint::Held(target) => target,
            // Nothing loose shares an element with what is free.
            Constraint::Free | Constraint::Loose => SampleTarget::Fixed,
        });
        let soft = soft.iter().filter(|s| kinds[s.node as usize] == Constraint::Free);
        Ok(Self {
            held: held.collect(),
            soft: soft.map(|s| Soft { node: node[s.node as usize], ..*s }).collect(),
            samples,
            rest: at,
            free,
            rows,
            operators,
        })
    }

    /// The number of nodes.
    pub fn len(&self) -> usize {
        self.rest.len()
    }

    /// Region that holds a node, if any.
    pub fn target(&self, node: usize) -> Option<SampleTarget> {
        node.checked_sub(self.free).map(|k| self.held[k])
    }

    /// Displacements of all nodes: of the held ones by their regions, of the free ones zero so far.
    pub fn held_displacements(&self, displacement: impl Fn(SampleTarget, DVec3) -> DVec3) -> Vec<DVec3> {
        let held = self.held.iter().zip(&self.rest[self.free..]).map(|(t, p)| displacement(*t, *p));
        std::iter::repeat_n(DVec3::ZERO, self.free).chain(held).collect()
    }

    /// The draws' springs, given how stiff one is where its strength is 1 and so is the area: one or more for
    /// each node that has any.
    pub fn springs(&self, stiffness: f64) -> Vec<Soft> {
        let spring = |s: &Soft| {
            let area = self.operators.areas[s.node as usize];
            Soft { strength: stiffness * area * s.strength, ..*s }
        };
        self.soft.iter().map(spring).collect()
    }

    /// The Laplacian among the free nodes.
    pub fn laplacian(&self) -> impl Fn(usize) -> Vec<(usize, f64)> + Sync {
        |i| self.operators.laplacian(i).filter(|(j, _)| *j <= i).collect()
    }

    /// Bi-Laplacian `L M⁻¹ L` among the free nodes, without the entries beyond the diagonal.
    pub fn bilaplacian(&self) -> impl Fn(usize) -> Vec<(usize, f64)> + Sync {
        |i| {
            let mut row: Vec<(usize, f64)> = Vec::new();
            for (k, a) in self.operators.laplacian(i) {
                let a = a / self.operators.areas[k];
                row.extend(self.operators.laplacian(k).filter(|(j, _)| *j <= i).map(|(j, b)| (j, a * b)));
            }
            // Stable: sums are taken in one order.
            row.sort_by_key(|e| e.0);
            row.dedup_by(|b, a| {
                let same = a.0 == b.0;
                if same {
                    a.1 += b.1;
                }
                same
            });
            row
        }
    }

    /// Factorises a matrix of the free nodes, given by the rows of its lower triangle, with springs; `told`
    /// is the range of the progress.
    pub fn factor<T: Stored>(
        &self,
        row: impl Fn(usize) -> Vec<(usize, f64)> + Sync,
        springs: &[Soft],
        told: Range<f64>,
        host: &Host<'_>,
    ) -> PluginResult<Factor<T>> {
        let mut rows: Vec<Vec<(usize, f64)>> = vec![Vec::new(); self.free];
        host.parallel_blocks(&mut rows, TOGETHER, |first, rows| {
            rows.iter_mut().enumerate().for_each(|(i, r)| *r = row(first + i));
        })?;
        for spring in springs {
            let row = &mut rows[spring.node as usize];
            if let Some(diagonal) = row.last_mut() {
                diagonal.1 += spring.strength;
            }
        }
        let mut matrix = Symmetric::default();
        rows.into_iter().for_each(|row| matrix.push_row(row));
        Factor::new(matrix, &self.rest[..self.free], told, host).map_err(refused)
    }
}

/// Error of equations that have no factor.
fn refused(refusal: Refusal) -> PluginError {
    match refusal {
        Refusal::Indefinite => {
            let what = "nothing tells where some part of the surface goes";
            PluginError::new(ErrorCode::NOT_CONVERGED, what)
                .hint("add a fixed region, or sample the model anew")
        }
        Refusal::TooLarge => out_of_memory(),
        Refusal::Stopped(error) => error,
    }
}

/// Error of equations that need more memory than there is.
pub fn out_of_memory() -> PluginError {
    PluginError::new(ErrorCode::INVALID_INPUT, "there is not enough memory for the surface's equations")
        .hint("take fewer samples, or repair the model: where many triangles join samples in one place, equations grow")
}
