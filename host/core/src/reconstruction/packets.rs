//! The neighbours of as many samples as the processor fits at once, gathered number by number.

#![expect(
    clippy::needless_range_loop,
    reason = "vectors are compiled for the processor only where they are inlined"
)]

use glam::Vec3;
use pulp::Simd;

use crate::double_lanes::{DoubleLanes, MOST_LANES, Triple};

/// Largest number of neighbours of a sample in a fit.
pub const MOST_NEIGHBOURS: usize = 28;

/// The neighbours of several samples, place by place in their lists, as ways from the samples.
///
/// All neighbours are gathered before any is loaded: a vector that is loaded right behind its numbers, which
/// are stored one by one, has to wait for these.
pub struct Neighbours {
    /// Samples around which nothing moves, themselves included.
    pub is_still: [bool; MOST_LANES],
    /// One over the radius of the kernel; 1 where the radius is zero, and no neighbours are gathered.
    pub scale: [f64; MOST_LANES],
    /// Places of the longest list.
    pub longest: usize,
    pub places: [NeighbourPacket; MOST_NEIGHBOURS],
    /// The neighbours' positions at rest and deformed, of which the ways are made.
    positions: [[[f32; MOST_LANES]; 6]; MOST_NEIGHBOURS],
}

/// The neighbours of several samples that come at one place in their lists.
#[derive(Clone, Copy)]
pub struct NeighbourPacket {
    /// 1, or 0 where a list is over.
    pub is_there: [f64; MOST_LANES],
    pub way: [[f64; MOST_LANES]; 3],
    /// The way after the deformation.
    pub moved: [[f64; MOST_LANES]; 3],
}

impl NeighbourPacket {
    const NOBODY: Self =
        Self { is_there: [0.0; MOST_LANES], way: [[0.0; MOST_LANES]; 3], moved: [[0.0; MOST_LANES]; 3] };
}

impl Default for Neighbours {
    fn default() -> Self {
        Self {
            is_still: [true; MOST_LANES],
            scale: [1.0; MOST_LANES],
            longest: 0,
            places: [NeighbourPacket::NOBODY; MOST_NEIGHBOURS],
            positions: [[[0.0; MOST_LANES]; 6]; MOST_NEIGHBOURS],
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
            // Neighbours that all lie at one place tell nothing.
            if radius > 0.0 {
                self.scale[lane] = 1.0 / f64::from(radius);
                (lists[lane], self.longest) = (near, near.len().max(self.longest));
            }
        }
        let mut own = [[0.0; MOST_LANES]; 6];
        for lane in 0..S::F64_LANES {
            let (i, list) = (packet[lane], lists[lane]);
            set(&mut own, lane, positions[i], deformed[i]);
            for (place, j) in self.positions.iter_mut().zip(list) {
                set(place, lane, positions[*j as usize], deformed[*j as usize]);
            }
            // The places behind a list's end get the sample itself, to which there is no way.
            for place in &mut self.positions[list.len()..self.longest] {
                set(place, lane, positions[i], deformed[i]);
            }
        }
        for at in 0..self.longest {
            let (place, positions) = (&mut self.places[at], &self.positions[at]);
            for lane in 0..S::F64_LANES {
                place.is_there[lane] = if at < lists[lane].len() { 1.0 } else { 0.0 };
            }
            for axis in 0..3 {
                for lane in 0..S::F64_LANES {
                    place.way[axis][lane] = f64::from(positions[axis][lane] - own[axis][lane]);
                    place.moved[axis][lane] =
                        f64::from(positions[3 + axis][lane]) - f64::from(own[3 + axis][lane]);
                }
            }
        }
    }
}

/// Sets positions at rest and deformed.
#[inline(always)]
fn set(numbers: &mut [[f32; MOST_LANES]; 6], lane: usize, rest: Vec3, deformed: Vec3) {
    for axis in 0..3 {
        (numbers[axis][lane], numbers[3 + axis][lane]) = (rest[axis], deformed[axis]);
    }
}

/// Three lists of numbers, one for each sample.
#[inline(always)]
pub fn triple<S: Simd>(simd: S, numbers: &[[f64; MOST_LANES]; 3]) -> Triple<S> {
    let [x, y, z] = numbers;
    [DoubleLanes::load(simd, x), DoubleLanes::load(simd, y), DoubleLanes::load(simd, z)]
}
