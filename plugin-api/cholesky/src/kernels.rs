//! Kernels of a solution with the entries of a front, for three right-hand sides at once.
//!
//! Sums are the same, in the same order, however wide the processor's vectors are.

use glam::DVec3;
use std::ops::Range;

/// Numbers side by side: as many as the largest vectors of today's processors have.
pub type KernelLanes<T = f64> = [T; WIDTH];

/// The number of lanes.
pub const WIDTH: usize = 8;

/// Number type in which entries of a factor are kept.
pub trait Stored: Copy + Default + Send + Sync + std::fmt::Debug + Into<f64> {
    /// The number of this type that is nearest.
    fn nearest(number: f64) -> Self;
}

impl Stored for f64 {
    fn nearest(number: f64) -> Self {
        number
    }
}

/// Half as much to read, for solutions that are corrected afterwards, or only begin an iteration.
impl Stored for f32 {
    fn nearest(number: f64) -> Self {
        number as Self
    }
}

/// Three right-hand sides, one by one; after the last number, zeros.
pub type Sides = [Vec<KernelLanes>; 3];

/// Numbers as lanes.
pub fn lanes<T: Stored>(numbers: &[f64]) -> impl Iterator<Item = KernelLanes<T>> {
    numbers.chunks(WIDTH).map(|numbers| {
        let mut lanes = KernelLanes::default();
        lanes.iter_mut().zip(numbers).for_each(|(lane, number)| *lane = T::nearest(*number));
        lanes
    })
}

/// Makes sides zero.
#[inline(always)]
pub fn clear(sides: &mut Sides, lanes: usize) {
    for side in sides {
        side.clear();
        side.resize(lanes, KernelLanes::default());
    }
}

/// Makes sides of so many rows' values.
#[inline(always)]
pub fn gather(sides: &mut Sides, rows: usize, values: impl Iterator<Item = DVec3>) {
    clear(sides, rows.div_ceil(WIDTH));
    let [x, y, z] = sides.each_mut().map(|side| side.as_flattened_mut());
    for (((value, x), y), z) in values.zip(x).zip(y).zip(z) {
        (*x, *y, *z) = value.into();
    }
}

/// The value of a row.
#[inline(always)]
pub fn row_of(sides: &Sides, row: usize) -> DVec3 {
    let [x, y, z] = sides.each_ref().map(|side| side.as_flattened()[row]);
    DVec3::new(x, y, z)
}

#[inline(always)]
fn set(sides: &mut Sides, row: usize, value: DVec3) {
    sides.iter_mut().zip(value.to_array()).for_each(|(side, v)| side.as_flattened_mut()[row] = v);
}

/// A front's lower triangle.
#[derive(Clone, Copy)]
pub struct FrontTriangle<'a, T> {
    /// The columns of the triangle, each from the diagonal on.
    pub values: &'a [T],
}

impl<T: Stored> FrontTriangle<'_, T> {
    /// `L x = b`
    #[inline(always)]
    pub fn solve(self, x: &mut Sides, columns: usize) {
        let mut rest = self.values;
        for j in 0..columns {
            let (column, after) = rest.split_at(columns - j);
            rest = after;
            let value = row_of(x, j) / column[0].into();
            set(x, j, value);
            for (side, value) in x.iter_mut().zip(value.to_array()) {
                let side = &mut side.as_flattened_mut()[j + 1..columns];
                side.iter_mut().zip(&column[1..]).for_each(|(x, l)| *x -= (*l).into() * value);
            }
        }
    }

    /// `Lᵀ x = b - sums`; the sums mean nothing afterwards.
    #[inline(always)]
    pub fn solve_transposed(self, x: &mut [DVec3], sums: &mut Sides) {
        let columns = x.len();
        let mut rest = self.values;
        for j in (0..columns).rev() {
            let (before, column) = rest.split_at(rest.len() - (columns - j));
            rest = before;
            let mut value = x[j] - row_of(sums, j);
            for (c, side) in sums.iter().enumerate() {
                value[c] -= dot(&column[1..], &side.as_flattened()[j + 1..columns]);
            }
            value /= column[0].into();
            set(sums, j, value);
            x[j] = value;
        }
    }
}

/// A front's rows below the triangle, or some of them.
#[derive(Debug, Clone)]
pub struct Below<'a, T> {
    /// Column by column.
    values: &'a [KernelLanes<T>],
    /// Lanes from one column to the next.
    stride: usize,
    /// Range of each column's lanes.
    lanes: Range<usize>,
    columns: usize,
}

impl<'a, T: Stored> Below<'a, T> {
    /// All of a front's rows below the triangle.
    pub fn new(values: &'a [KernelLanes<T>], stride: usize, columns: usize) -> Self {
        Self { values, stride, lanes: 0..stride, columns }
    }

    /// Number of lanes of each column.
    pub fn height(&self) -> usize {
        self.lanes.len()
    }

    /// The rows, so many lanes at a time.
    pub fn blocks(&self, height: usize) -> impl Iterator<Item = Self> {
        self.lanes.clone().step_by(height).map(move |start| {
            let lanes = start..(start + height).min(self.lanes.end);
            Self { lanes, ..self.clone() }
        })
    }

    #[inline(always)]
    fn column(&self, j: usize) -> &'a [KernelLanes<T>] {
        &self.values[j * self.stride..][self.lanes.clone()]
    }

    /// Adds the product with what is known of the columns.
    #[inline(always)]
    pub fn times(&self, known: &Sides, sums: &mut Sides) {
        let height = self.height();
        for (known, sums) in known.iter().zip(sums) {
            let (known, sums) = (known.as_flattened(), &mut sums[..height]);
            let mut j = 0;
            // Four at once, so that sums are stored more rarely.
            while j + 4 <= self.columns {
                let [a, b, c, d] = [0, 1, 2, 3].map(|k| &self.column(j + k)[..height]);
                let by = [known[j], known[j + 1], known[j + 2], known[j + 3]];
                for i in 0..height {
                    let mut sum = sums[i];
                    add_multiple(&mut sum, &a[i], by[0]);
                    add_multiple(&mut sum, &b[i], by[1]);
                    add_multiple(&mut sum, &c[i], by[2]);
                    add_multiple(&mut sum, &d[i], by[3]);
                    sums[i] = sum;
                }
                j += 4;
            }
            for (j, &by) in known.iter().enumerate().take(self.columns).skip(j) {
                for (sum, a) in sums.iter_mut().zip(self.column(j)) {
                    add_multiple(sum, a, by);
                }
            }
        }
    }

    /// Adds the product of the transpose with what is known of the rows.
    #[inline(always)]
    pub fn transposed_times(&self, known: &Sides, sums: &mut Sides) {
        let height = self.height();
        let [x, y, z] = known.each_ref().map(|side| &side[..height]);
        // From the last column to the first, as fronts are gone through: memory is read in one direction.
        for j in (0..self.columns).rev() {
            let column = &self.column(j)[..height];
            let (mut a, mut b, mut c) =
                (KernelLanes::default(), KernelLanes::default(), KernelLanes::default());
            for i in 0..height {
                add_product(&mut a, &column[i], &x[i]);
                add_product(&mut b, &column[i], &y[i]);
                add_product(&mut c, &column[i], &z[i]);
            }
            let sum = DVec3::new(total(&a), total(&b), total(&c));
            set(sums, j, row_of(sums, j) + sum);
        }
    }
}

#[inline(always)]
fn add_multiple<T: Stored>(sum: &mut KernelLanes, a: &KernelLanes<T>, by: f64) {
    for n in 0..WIDTH {
        sum[n] += a[n].into() * by;
    }
}

#[inline(always)]
fn add_product<T: Stored>(sum: &mut KernelLanes, a: &KernelLanes<T>, b: &KernelLanes) {
    for n in 0..WIDTH {
        sum[n] += a[n].into() * b[n];
    }
}

/// A scalar product in one order.
#[inline(always)]
fn dot<T: Stored>(a: &[T], b: &[f64]) -> f64 {
    let ((a, a_rest), (b, b_rest)) = (a.as_chunks::<WIDTH>(), b.as_chunks::<WIDTH>());
    let mut sums = KernelLanes::default();
    for (a, b) in a.iter().zip(b) {
        add_product(&mut sums, a, b);
    }
    total(&sums) + a_rest.iter().zip(b_rest).map(|(a, b)| (*a).into() * b).sum::<f64>()
}

#[inline(always)]
fn total(lanes: &KernelLanes) -> f64 {
    let [a, b, c, d, e, f, g, h] = *lanes;
    ((a + b) + (c + d)) + ((e + f) + (g + h))
}
