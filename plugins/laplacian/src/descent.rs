//! Earlier steps of a descent, by which the next one is chosen (J. Nocedal, S. Wright, *Numerical
//! Optimization*, §7.2).

use glam::DVec3;
use simod_cholesky::Factor;
use simod_plugin_api::{Host, PluginResult};
use std::collections::VecDeque;

/// Nodes at once on one thread.
const TOGETHER: usize = 1 << 14;
/// Steps that are remembered.
const REMEMBERED: usize = 6;

/// Steps of a descent so far, which approximate the energy's second derivative.
#[derive(Debug, Default)]
pub struct Past {
    /// Steps, changes of the gradient, and one over their products.
    pairs: VecDeque<(Vec<DVec3>, Vec<DVec3>, f64)>,
}

impl Past {
    /// Whether there are no earlier steps.
    pub fn is_empty(&self) -> bool {
        self.pairs.is_empty()
    }

    /// The step that would lead to the least energy, as far as is known (algorithm 7.4).
    pub fn step(
        &self,
        gradient: &[DVec3],
        factor: &Factor<f32>,
        host: &Host<'_>,
    ) -> PluginResult<Vec<DVec3>> {
        let mut q: Vec<DVec3> = gradient.iter().map(|g| -*g).collect();
        let mut shares = Vec::with_capacity(self.pairs.len());
        for (s, y, inverse) in self.pairs.iter().rev() {
            let share = inverse * dot(s, &q, host)?;
            add_multiple(&mut q, -share, y, host)?;
            shares.push(share);
        }
        factor.solve(&mut q, host)?;
        for ((s, y, inverse), share) in self.pairs.iter().zip(shares.into_iter().rev()) {
            let other = inverse * dot(y, &q, host)?;
            add_multiple(&mut q, share - other, s, host)?;
        }
        Ok(q)
    }

    /// Remembers a part of a step, and the gradients before and after it.
    pub fn push(
        &mut self,
        step: &[DVec3],
        part: f64,
        before: &[DVec3],
        after: &[DVec3],
        host: &Host<'_>,
    ) -> PluginResult<()> {
        let s: Vec<DVec3> = step.iter().map(|s| part * *s).collect();
        let y: Vec<DVec3> = after.iter().zip(before).map(|(a, b)| *a - *b).collect();
        let product = dot(&s, &y, host)?;
        // The second derivative is not always positive, and what is to be used has to be.
        if product <= 1e-12 * (dot(&s, &s, host)? * dot(&y, &y, host)?).sqrt() {
            return Ok(());
        }
        if self.pairs.len() == REMEMBERED {
            self.pairs.pop_front();
        }
        self.pairs.push_back((s, y, 1.0 / product));
        Ok(())
    }
}

/// Adds a multiple of vectors to others.
fn add_multiple(to: &mut [DVec3], factor: f64, vectors: &[DVec3], host: &Host<'_>) -> PluginResult<()> {
    host.parallel_blocks(to, TOGETHER, |first, to| {
        to.iter_mut().zip(&vectors[first..]).for_each(|(to, v)| *to += factor * *v);
    })
}

/// The scalar product, whose parts are summed up in one order.
pub fn dot(a: &[DVec3], b: &[DVec3], host: &Host<'_>) -> PluginResult<f64> {
    let mut parts = vec![0.0; a.len().div_ceil(TOGETHER)];
    host.parallel_blocks(&mut parts, 1, |first, parts| {
        for (k, part) in (first..).zip(parts) {
            let all = a[k * TOGETHER..].iter().zip(&b[k * TOGETHER..]).take(TOGETHER);
            *part = all.map(|(a, b)| a.dot(*b)).sum::<f64>();
        }
    })?;
    Ok(parts.iter().sum())
}
