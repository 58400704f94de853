//! The neighbours of as many samples as the processor fits at once, gathered number by number.

use glam::Vec3;
use pulp::Simd;

use super::double_lanes::{DoubleLanes, MOST_LANES, Triple};

/// Most neighbours of a sample in a fit.
pub const MOST_NEIGHBOURS: usize = 28;

/// The neighbours of several samples, place by place in their lists, as ways from the samples.
///
/// They are gathered before any is loaded: a vector that is loaded right behind its numbers, which are stored
/// one by one, has to wait for these.
pub struct Neighbours {
    /// Samples around which nothing moves, themselves included.
    pub is_still: [bool; MOST_LANES],
    /// One over the radius of the kernel; 1 where that is nothing, and nobody is gathered.
    pub scale: [f64; MOST_LANES],
    /// Places of the longest list.
    pub longest: usize,
    pub places: [Place; MOST_NEIGHBOURS],
}

/// The neighbours of several samples that come at one place in their lists.
#[derive(Clone, Copy)]
pub struct Place {
    /// 1, or 0 where a list is over.
    pub is_there: [f64; MOST_LANES],
    pub way: [[f64; MOST_LANES]; 3],
    /// The same after the deformation.
    pub moved: [[f64; MOST_LANES]; 3],
}

impl Place {
    const NOBODY: Self =
        Self { is_there: [0.0; MOST_LANES], way: [[0.0; MOST_LANES]; 3], moved: [[0.0; MOST_LANES]; 3] };
}

impl Default for Neighbours {
    fn default() -> Self {
        Self {
            is_still: [true; MOST_LANES],
            scale: [1.0; MOST_LANES],
            longest: 0,
            places: [Place::NOBODY; MOST_NEIGHBOURS],
        }
    }
}

impl Neighbours {
    /// Gathers the neighbours of as many samples as there are lanes: those that are `around` each, at most
    /// [`MOST_NEIGHBOURS`], and the radius of the kernel over them. Positions at rest, and deformed.
    #[inline(always)]
    pub fn gather<'a, S: Simd>(
        &mut self,
        positions: &[Vec3],
        deformed: &[Vec3],
        packet: &[usize; MOST_LANES],
        around: impl Fn(usize) -> (&'a [u32], f32),
    ) {
        let mut lists = [&[][..]; MOST_LANES];
        (self.is_still, self.scale, self.longest) = ([true; MOST_LANES], [1.0; MOST_LANES], 0);
        for lane in 0..S::F64_LANES {
            let (near, radius) = around(packet[lane]);
            let is_still = |i: usize| positions[i] == deformed[i];
            self.is_still[lane] = is_still(packet[lane]) && near.iter().all(|j| is_still(*j as usize));
            // Of neighbours that all lie at one place, nothing can be told.
            if radius > 0.0 {
                self.scale[lane] = 1.0 / f64::from(radius);
                (lists[lane], self.longest) = (near, near.len().max(self.longest));
            }
        }
        for lane in 0..S::F64_LANES {
            let (i, list) = (packet[lane], lists[lane]);
            let (q, image) = (positions[i], deformed[i].as_dvec3());
            for (place, j) in self.places.iter_mut().zip(list) {
                let way = (positions[*j as usize] - q).as_dvec3();
                let moved = deformed[*j as usize].as_dvec3() - image;
                place.is_there[lane] = 1.0;
                for axis in 0..3 {
                    (place.way[axis][lane], place.moved[axis][lane]) = (way[axis], moved[axis]);
                }
            }
            for place in &mut self.places[list.len()..self.longest] {
                place.is_there[lane] = 0.0;
                for axis in 0..3 {
                    (place.way[axis][lane], place.moved[axis][lane]) = (0.0, 0.0);
                }
            }
        }
    }
}

/// Three lists of numbers, one for each sample.
#[inline(always)]
pub fn triple<S: Simd>(simd: S, numbers: &[[f64; MOST_LANES]; 3]) -> Triple<S> {
    let [x, y, z] = numbers;
    [DoubleLanes::load(simd, x), DoubleLanes::load(simd, y), DoubleLanes::load(simd, z)]
}
