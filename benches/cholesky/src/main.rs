//! Sparse Cholesky factorisation and solution: ours beside faer's, on the squared Laplacian of a closed
//! surface, as the bi-Laplacian plugin has it. Seconds, medians of five runs in turn.
//!
//!     cargo run --release --manifest-path benches/cholesky/Cargo.toml [UNKNOWNS ...]

use faer::linalg::solvers::Solve;
use faer::sparse::linalg::solvers::{Llt, SymbolicLlt};
use faer::sparse::{SparseColMat, Triplet};
use faer::{Mat, Par, Side};
use glam::DVec3;
use rayon::prelude::*;
use simod_cholesky::{Factor, Symmetric};
use simod_plugin_api::{Host, HostCalls, LogLevel};
use std::f64::consts::TAU;
use std::time::Instant;

/// A host that is never in the way.
struct Threads;

impl HostCalls for Threads {
    fn progress(&self, _: f64) -> bool {
        true
    }

    fn parallel_for(&self, count: usize, body: &(dyn Fn(usize) + Sync)) -> bool {
        (0..count).into_par_iter().for_each(body);
        true
    }

    fn log(&self, _: LogLevel, _: &str) {}
}

/// The rows of the lower triangle of the squared Laplacian of a torus of triangles, a little of the identity
/// added, and the places of its nodes.
fn matrix(side: usize) -> (Vec<Vec<(usize, f64)>>, Vec<DVec3>) {
    let n = side * side;
    let node = |i: usize, j: usize| (i % side) * side + j % side;
    let around = |k: usize| {
        let (i, j) = (k / side + side, k % side + side);
        [(0, 1), (1, 0), (1, 1), (0, -1), (-1, 0), (-1, -1)]
            .map(|(a, b): (isize, isize)| node(i.wrapping_add_signed(a), j.wrapping_add_signed(b)))
    };
    let rows = (0..n).map(|k| {
        // L² of L = 6 - neighbours.
        let mut row = std::collections::BTreeMap::from([(k, 36.0 + 1e-3)]);
        for a in around(k) {
            *row.entry(a).or_default() -= 12.0;
            for b in around(a) {
                *row.entry(b).or_default() += 1.0;
            }
        }
        row.into_iter().take_while(|(j, _)| *j <= k).collect()
    });
    let place = |k: usize| {
        let [u, v] = [k / side, k % side].map(|x| TAU * x as f64 / side as f64);
        DVec3::new((2.0 + v.cos()) * u.cos(), (2.0 + v.cos()) * u.sin(), v.sin())
    };
    (rows.collect(), (0..n).map(place).collect())
}

fn seconds<T>(work: impl FnOnce() -> T) -> (f64, T) {
    let since = Instant::now();
    let made = work();
    (since.elapsed().as_secs_f64(), made)
}

fn median(mut all: Vec<f64>) -> f64 {
    all.sort_by(f64::total_cmp);
    all[all.len() / 2]
}

fn main() {
    let threads = rayon::current_num_threads();
    let given: Vec<usize> = std::env::args().skip(1).filter_map(|n| n.parse().ok()).collect();
    let sizes = if given.is_empty() { vec![20_000, 100_000, 200_000] } else { given };
    faer::set_global_parallelism(Par::rayon(threads));
    println!("{threads} threads");
    println!("| unknowns | ours: factor | solve three | faer: factor | solve three | largest difference |");
    println!("|---:|---:|---:|---:|---:|---:|");
    for size in sizes {
        let side = (size as f64).sqrt().round() as usize;
        let (rows, places) = matrix(side);
        let n = rows.len();
        let sides: Vec<DVec3> = places.iter().map(|p| (3.0 * *p).map(f64::sin)).collect();
        let host = Host::new(&Threads);
        let entries: Vec<Triplet<usize, usize, f64>> =
            (0..n).flat_map(|i| rows[i].iter().map(move |(j, value)| Triplet::new(i, *j, *value))).collect();
        let lower = SparseColMat::try_new_from_triplets(n, n, &entries).expect("a sparse matrix");
        let right = Mat::from_fn(n, 3, |i, k| sides[i][k]);
        let mut times: [Vec<f64>; 4] = Default::default();
        let mut apart = 0.0;
        for _ in 0..5 {
            let mut ours = Symmetric::default();
            rows.iter().for_each(|row| ours.push_row(row.iter().copied()));
            let (t, factor) = seconds(|| Factor::<f64>::new(ours, &places, 0.0..1.0, &host));
            times[0].push(t);
            let factor = factor.expect("a positive definite matrix");
            let mut x = sides.clone();
            let (t, solved) = seconds(|| factor.solve(&mut x, &host));
            times[1].push(t);
            solved.expect("a solution");
            let (t, theirs) = seconds(|| {
                let symbolic = SymbolicLlt::try_new(lower.symbolic(), Side::Lower).expect("an order");
                Llt::try_new_with_symbolic(symbolic, lower.as_ref(), Side::Lower).expect("a factor")
            });
            times[2].push(t);
            let (t, y) = seconds(|| theirs.solve(&right));
            times[3].push(t);
            let largest = x.iter().map(|x| x.abs().max_element()).fold(0.0, f64::max);
            let off =
                (0..n).flat_map(|i| (0..3).map(move |k| (i, k))).map(|(i, k)| (x[i][k] - y[(i, k)]).abs());
            apart = off.fold(0.0, f64::max) / largest;
        }
        let [a, b, c, d] = times.map(median);
        println!("| {n} | {a:.3} | {b:.4} | {c:.3} | {d:.4} | {apart:.1e} |");
    }
}
