//! Earlier steps of a descent, by which the next one is chosen (J. Nocedal, S. Wright, *Numerical
//! Optimization*, §7.2).

use glam::DVec3;
use simod_cholesky::Factor;
use simod_plugin_api::{Host, PluginResult};
use std::collections::VecDeque;

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
            let share = inverse * dot(s, &q);
            q.iter_mut().zip(y).for_each(|(q, y)| *q -= share * *y);
            shares.push(share);
        }
        factor.solve(&mut q, host)?;
        for ((s, y, inverse), share) in self.pairs.iter().zip(shares.into_iter().rev()) {
            let other = inverse * dot(y, &q);
            q.iter_mut().zip(s).for_each(|(q, s)| *q += (share - other) * *s);
        }
        Ok(q)
    }

    /// Remembers a part of a step, and the gradients before and after it.
    pub fn push(&mut self, step: &[DVec3], part: f64, before: &[DVec3], after: &[DVec3]) {
        let s: Vec<DVec3> = step.iter().map(|s| part * *s).collect();
        let y: Vec<DVec3> = after.iter().zip(before).map(|(a, b)| *a - *b).collect();
        let product = dot(&s, &y);
        // The second derivative is not always positive, and what is to be used has to be.
        if product <= 1e-12 * (dot(&s, &s) * dot(&y, &y)).sqrt() {
            return;
        }
        if self.pairs.len() == REMEMBERED {
            self.pairs.pop_front();
        }
        self.pairs.push_back((s, y, 1.0 / product));
    }
}

fn dot(a: &[DVec3], b: &[DVec3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a.dot(*b)).sum()
}
