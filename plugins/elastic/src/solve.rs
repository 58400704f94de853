//! Rest of the body: the state of least energy, found by Newton's steps with conjugate gradients. Where the
//! energy is not convex, steps tend to those of projective dynamics (T. Liu, S. Bouaziz, L. Kavan,
//! *Quasi-Newton methods for real-time simulation of hyperelastic materials*, ACM TOG 36, 2017), in which the
//! material is a Laplacian.

use crate::body::{Body, BodyGradients, Load};
use crate::contact::{ContactSurface, Touch};
use crate::held::Goals;
use crate::lattice::CellPoint;
use glam::DVec3;
use simod_plugin_api::{Host, PluginResult};

/// Conjugate gradients for one step, at most.
const MOST_GRADIENTS: usize = 600;
/// Budget of products of the second derivatives for a lattice: the first divided by the number of cells,
/// within the two bounds.
const WORK: usize = 600_000;
const FEWEST_PRODUCTS: usize = 30;
const MOST_PRODUCTS: usize = 1500;
/// Part of its shear modulus by which the material is taken for stiffer where the energy is not convex, times
/// three each time that it is not enough, up to the second.
const STIFFER: f64 = 0.1;
const STIFFEST: f64 = 2.0;
/// Gain of a step, as a part of the energy, below which a body that touches itself is at rest, too: points in
/// contact slide from one to the next, which goes on for long and shows nowhere.
const SLIDING: f64 = 1e-4;
/// Halvings of a step, at most.
const HALVINGS: usize = 14;

/// Loads under which a body is to be brought to rest.
pub struct LoadCase<'a> {
    /// The places of the regions.
    pub goals: &'a Goals,
    /// The force on a unit of the body.
    pub weight: DVec3,
    /// Contact with itself, where samples lie.
    pub contact: Option<(&'a ContactSurface, &'a [Option<CellPoint>])>,
}

/// The criteria by which a body is at rest.
#[derive(Debug, Clone, Copy)]
pub struct RestCriteria {
    /// Largest move of a corner in a whole step.
    pub still: f64,
    /// Most steps.
    pub steps: usize,
    /// Part of the forces that conjugate gradients leave.
    pub left: f64,
    /// Most conjugate gradients for one step.
    pub gradients: usize,
    /// Most products of the second derivatives.
    pub products: usize,
}

/// Number of products of the second derivatives that are spent on a lattice.
pub fn worth(body: &Body) -> usize {
    (WORK / body.lattice.cells.len().max(1)).clamp(FEWEST_PRODUCTS, MOST_PRODUCTS)
}

impl RestCriteria {
    /// Criteria for a place on the way.
    pub fn roughly(still: f64, products: usize) -> Self {
        Self { still, steps: 3, left: 0.1, gradients: 60, products }
    }

    /// The criteria for a draft.
    pub fn quickly() -> Self {
        Self { still: 1e-3, steps: 2, left: 0.2, gradients: 12, products: 24 }
    }

    /// Criteria for the end of the way.
    pub fn wholly(still: f64, products: usize) -> Self {
        Self { still, steps: 100, left: 1e-2, gradients: MOST_GRADIENTS, products }
    }
}

/// Effort that is left: the products that Newton's steps may still take, and the part by which the next one
/// takes the material for stiffer at first.
struct NewtonEffort {
    products: usize,
    stiffer: f64,
}

impl NewtonEffort {
    /// Newton's step from where the gradients and forces are. The material is taken for stiffer until
    /// conjugate gradients find no direction along which the energy is not convex.
    fn step(
        &mut self,
        body: &Body,
        gradients: &BodyGradients,
        (touches, forces): (&[Touch], &[DVec3]),
        until: RestCriteria,
        host: &Host<'_>,
    ) -> PluginResult<Vec<DVec3>> {
        loop {
            let most = until.gradients.min(self.products.max(1));
            let (products, stiffer) = (&mut self.products, self.stiffer);
            let change = |by: &[DVec3]| {
                *products = products.saturating_sub(1);
                body.change(gradients, (touches, stiffer), by, host)
            };
            let residual: Vec<DVec3> = forces.iter().map(|f| -*f).collect();
            let inverse = body.inverse(touches);
            let precondition = |r: &[DVec3], z: &mut Vec<DVec3>| body.precondition(&inverse, r, z);
            let (step, is_convex) = solve(residual, (until.left, most), precondition, change)?;
            if is_convex || self.stiffer >= STIFFEST {
                self.stiffer = if self.stiffer < STIFFER { 0.0 } else { 0.3 * self.stiffer };
                return Ok(step);
            }
            self.stiffer = (3.0 * self.stiffer).max(STIFFER);
        }
    }
}

/// Brings corners to rest; returns whether they are.
pub fn settle(
    body: &Body,
    x: &mut Vec<DVec3>,
    task: &LoadCase<'_>,
    until: RestCriteria,
    host: &Host<'_>,
) -> PluginResult<bool> {
    let mut gradients = body.gradients(x, host)?;
    let mut effort = NewtonEffort { products: until.products, stiffer: 0.0 };
    for _ in 0..until.steps {
        let touches: Vec<Touch> = match task.contact {
            Some((surface, places)) => surface.touches(body, places, x, host)?,
            None => Vec::new(),
        };
        let load = Load { goals: task.goals, weight: task.weight, touches: &touches };
        let (energy, forces) = body.energy(x, &gradients, &load, host)?;
        let step = effort.step(body, &gradients, (&touches, &forces), until, host)?;
        if effort.products == 0 {
            return Ok(false);
        }
        let farthest = step.iter().map(|d| d.length()).fold(0.0, f64::max);
        let steepness: f64 = step.iter().zip(&forces).map(|(d, f)| d.dot(*f)).sum();
        if !touches.is_empty() && -steepness <= SLIDING * energy {
            return Ok(true);
        }
        // Also where there is nothing more than rounding to be gained, or a number is none.
        if !(farthest > 0.0 && steepness < 0.0) {
            return Ok(farthest == 0.0 || farthest <= until.still);
        }
        let longest = task.contact.map_or(f64::INFINITY, |(surface, _)| surface.step());
        let mut part = (longest / farthest).min(1.0);
        let mut is_better = false;
        for _ in 0..HALVINGS {
            let there: Vec<DVec3> = x.iter().zip(&step).map(|(x, d)| *x + part * *d).collect();
            let deformed = body.gradients(&there, host)?;
            let (new, _) = body.energy(&there, &deformed, &load, host)?;
            if new <= energy + 1e-4 * part * steepness {
                (*x, gradients, is_better) = (there, deformed, true);
                break;
            }
            part *= 0.5;
        }
        if !is_better || part * farthest <= until.still {
            // A step that is shorter by halving alone is no rest.
            return Ok(farthest <= until.still || !is_better && farthest <= 10.0 * until.still);
        }
    }
    Ok(false)
}

/// Solves by conjugate gradients until a part `left` of the residual is left, or for `most` of them; also
/// tells whether the energy is convex along all of them.
fn solve(
    mut residual: Vec<DVec3>,
    (left, most): (f64, usize),
    precondition: impl Fn(&[DVec3], &mut Vec<DVec3>),
    mut change: impl FnMut(&[DVec3]) -> PluginResult<Vec<DVec3>>,
) -> PluginResult<(Vec<DVec3>, bool)> {
    let dot = |a: &[DVec3], b: &[DVec3]| a.iter().zip(b).map(|(a, b)| a.dot(*b)).sum::<f64>();
    let mut solution = vec![DVec3::ZERO; residual.len()];
    let mut z = Vec::new();
    precondition(&residual, &mut z);
    let mut along = z.clone();
    let mut size = dot(&residual, &z);
    let enough = left * left * size;
    for n in 0..most {
        if size <= enough || !size.is_finite() || size <= 0.0 {
            break;
        }
        let changed = change(&along)?;
        let curvature = dot(&along, &changed);
        if curvature <= 0.0 || !curvature.is_finite() {
            return Ok((if n == 0 { along } else { solution }, false));
        }
        let part = size / curvature;
        for ((s, r), (d, c)) in solution.iter_mut().zip(&mut residual).zip(along.iter().zip(&changed)) {
            *s += part * *d;
            *r -= part * *c;
        }
        precondition(&residual, &mut z);
        let next = dot(&residual, &z);
        let keep = next / size;
        size = next;
        along.iter_mut().zip(&z).for_each(|(d, z)| *d = *z + keep * *d);
    }
    Ok((solution, true))
}

/// Part by which each corner goes along with each of some targets: 1 where it holds, 0 where others do, even
/// between. The targets are solved for three at a time.
pub fn shares(body: &Body, targets: &[u32], host: &Host<'_>) -> PluginResult<Vec<Vec<f64>>> {
    let inverse = body.inverse(&[]);
    let mut all = Vec::new();
    for targets in targets.chunks(3) {
        let draws: Vec<Vec<f64>> = targets.iter().map(|t| body.draws(*t)).collect();
        let of = |i: usize, n: usize| draws.get(n).map_or(0.0, |d| d[i]);
        let forces = (0..body.lattice.rest.len()).map(|i| DVec3::new(of(i, 0), of(i, 1), of(i, 2))).collect();
        let (found, _) = solve(
            forces,
            (1e-4, MOST_GRADIENTS),
            |r, z| body.precondition(&inverse, r, z),
            |by| body.even(by, host),
        )?;
        all.extend((0..targets.len()).map(|n| found.iter().map(|s| s[n]).collect()));
    }
    Ok(all)
}
