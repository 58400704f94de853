//! Numbers of steps of the cactus' grid, in all its parts, for a number of vertices.

use std::f64::consts::FRAC_PI_2;

use super::form::CactusForm;

/// Height and radius of the rings between which the stem has evenly many; holes are between the third and
/// fourth, and between the fifth and sixth.
pub(super) const STEM: [[f64; 2]; 8] = [
    [0.0, 0.14],
    [0.06, 0.2],
    [0.645, 0.2],
    [0.955, 0.2],
    [1.06, 0.2],
    [1.34, 0.2],
    [1.78, 0.2],
    [1.923, 0.14],
];
/// Index in [`STEM`] of the ring at which each hole begins: the hole on the right (+x), and the one on the
/// left.
pub(super) const HOLES: [usize; 2] = [2, 4];
/// Length of an arm's curve up to the first ring that is out of the stem.
pub(super) const ROOT: f64 = 0.2;

/// Numbers of steps of the grid.
#[derive(Clone, Copy)]
pub(super) struct Counts {
    /// Steps on each of the four sides around the stem.
    pub side: u64,
    /// Steps between the rings of [`STEM`].
    pub stem: [u64; 7],
    /// Steps of each arm: out of the hole, along the tube, and to the cap.
    pub arms: [[u64; 3]; 2],
}

impl Counts {
    /// Lengths of the parts that are divided, in the order of [`rows`](Self::rows).
    pub fn lengths(form: &CactusForm) -> Vec<f64> {
        let of_stem = STEM.windows(2).map(|w| (w[1][0] - w[0][0]).hypot(w[1][1] - w[0][1]));
        // Arms have more columns for their width than the stem: so rows are wider apart.
        let of_arms = form.tubes[1..]
            .iter()
            .flat_map(|arm| [0.14, arm.length() - ROOT, 0.46 * arm.radius].map(|length| length / 1.3));
        of_stem.chain(of_arms).collect()
    }

    /// All numbers of rows.
    fn rows(&mut self) -> impl Iterator<Item = &mut u64> {
        self.stem.iter_mut().chain(self.arms.as_flattened_mut())
    }

    fn of_spacing(lengths: &[f64], spacing: f64) -> Self {
        let side = ((FRAC_PI_2 * STEM[1][1] / spacing).round() as u64).max(3);
        let mut counts = Self { side, stem: [0; 7], arms: [[0; 3]; 2] };
        counts
            .rows()
            .zip(lengths)
            .for_each(|(rows, length)| *rows = ((length / spacing).round() as u64).max(1));
        // Holes have two rows at least, so that arms' caps have vertices within.
        HOLES.into_iter().for_each(|hole| counts.stem[hole] = counts.stem[hole].max(2));
        counts
    }

    /// Counts for the most vertices that are no more than `vertices`.
    pub fn of_vertices(lengths: &[f64], vertices: u64) -> Self {
        // The coarsest one has less than any model.
        let (mut narrow, mut wide) = (1.0, 1.0);
        while Self::of_spacing(lengths, narrow).vertices() <= vertices {
            wide = narrow;
            narrow *= 0.5;
        }
        for _ in 0..50 {
            let middle = 0.5 * (narrow + wide);
            if Self::of_spacing(lengths, middle).vertices() <= vertices {
                wide = middle
            } else {
                narrow = middle
            }
        }
        let mut counts = Self::of_spacing(lengths, wide);
        // Rows are added where they are widest, as long as the number of vertices allows it.
        loop {
            let mut spacings: Vec<(usize, f64)> =
                counts.rows().zip(lengths).map(|(rows, length)| length / *rows as f64).enumerate().collect();
            spacings.sort_by(|a, b| b.1.total_cmp(&a.1));
            let more = spacings.into_iter().find_map(|(part, _)| {
                let mut more = counts;
                more.rows().skip(part).take(1).for_each(|rows| *rows += 1);
                (more.vertices() <= vertices).then_some(more)
            });
            match more {
                Some(more) => counts = more,
                None => return counts,
            }
        }
    }

    fn vertices(&self) -> u64 {
        let caps = 2 * (self.side - 1) * (self.side - 1);
        let stem = 4 * self.side * (self.stem.iter().sum::<u64>() + 1);
        // The cap of an arm has as many vertices as its hole lacks.
        let arm = |i: usize| self.around_arm(i) * self.arms[i].iter().sum::<u64>();
        caps + stem + arm(0) + arm(1)
    }

    pub fn around_arm(&self, arm: usize) -> u64 {
        2 * (self.side + self.stem[HOLES[arm]])
    }

    /// Rows of the stem between which an arm's hole is, and the column at which the hole begins.
    pub fn hole(&self, arm: usize) -> Hole {
        let before = |ring: usize| self.stem[..ring].iter().sum();
        Hole { low: before(HOLES[arm]), high: before(HOLES[arm] + 1), left: [0, 2][arm] * self.side }
    }
}

pub(super) struct Hole {
    pub low: u64,
    pub high: u64,
    pub left: u64,
}
