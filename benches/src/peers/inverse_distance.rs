//! Inverse distance weighting: D. Shepard, *A two-dimensional interpolation function for irregularly-spaced
//! data*, ACM National Conference 1968.

use std::num::NonZeroUsize;

use glam::DVec3;

use super::{Cloud, Field};

const NEIGHBOURS: NonZeroUsize = NonZeroUsize::new(8).expect("more than 0");

pub struct InverseDistance(pub Cloud);

impl Field for InverseDistance {
    fn displacement(&self, p: DVec3) -> DVec3 {
        let (mut sum, mut weights) = (DVec3::ZERO, 0.0);
        for sample in self.0.nearest(p, NEIGHBOURS) {
            let square = sample.position.distance_squared(p);
            if square == 0.0 {
                return sample.displacement;
            }
            sum += sample.displacement / square;
            weights += 1.0 / square;
        }
        sum / weights
    }
}
