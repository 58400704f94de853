//! Sparse Cholesky factorisation of symmetric positive definite matrices: multifrontal, over a nested
//! dissection.
//!
//! I. Duff, J. Reid, *The Multifrontal Solution of Indefinite Sparse Symmetric Linear Systems*, TOMS 1983; J.
//! Liu, *The Multifrontal Method for Sparse Matrix Solution*, SIAM Review 1992: each part of the tree is a
//! small dense problem (a front), which passes on what it does to the unknowns after it. Subtrees are
//! factorised and solved side by side, always the same ones, so that results do not depend on the number of
//! threads; and one can stop at each front.

use crate::dissection::{EliminationTree, Pattern, Supernode};
use crate::front::{Front, Update, places};
use crate::kernels::Stored;
use crate::refusal::Refusal;
use crate::solve::FrontRun;
use crate::structure::Structure;
use glam::DVec3;
use simod_plugin_api::{Host, PluginResult};
use std::ops::Range;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Additions to the diagonal, relative to it, tried until rounding leaves the matrix positive definite.
const RIDGES: [f64; 5] = [0.0, 1e-14, 1e-12, 1e-10, 1e-8];

/// Up to so many unknowns, a pass takes less time on one thread than it takes to share it out.
const ALONE: usize = 8192;

/// One triangle of a symmetric matrix, by rows: columns up to the diagonal, ascending.
#[derive(Debug)]
pub struct Symmetric {
    starts: Vec<usize>,
    columns: Vec<u32>,
    values: Vec<f64>,
}

impl Default for Symmetric {
    fn default() -> Self {
        Self { starts: vec![0], columns: Vec::new(), values: Vec::new() }
    }
}

impl Symmetric {
    /// Adds a row; the last entry is the diagonal.
    pub fn push_row(&mut self, entries: impl IntoIterator<Item = (usize, f64)>) {
        for (column, value) in entries {
            self.columns.push(column as u32);
            self.values.push(value);
        }
        self.starts.push(self.columns.len());
    }

    fn len(&self) -> usize {
        self.starts.len() - 1
    }

    fn columns(&self, i: usize) -> &[u32] {
        &self.columns[self.starts[i]..self.starts[i + 1]]
    }

    fn row(&self, i: usize) -> impl Iterator<Item = (usize, f64)> {
        let range = self.starts[i]..self.starts[i + 1];
        self.columns[range.clone()].iter().map(|c| *c as usize).zip(self.values[range].iter().copied())
    }

    /// The matrix with its unknowns in another order: columns from the diagonal on, in no order.
    fn in_order(&self, order: &[u32]) -> Self {
        let mut place = vec![0; order.len()];
        order.iter().enumerate().for_each(|(k, i)| place[*i as usize] = k);
        let entries = || {
            (0..self.len()).flat_map(|i| self.row(i).map(move |(j, value)| (i, j, value))).map(
                |(i, j, value)| {
                    let (i, j) = (place[i], place[j]);
                    (i.min(j), i.max(j), value)
                },
            )
        };
        let mut starts = vec![0; order.len() + 1];
        entries().for_each(|(i, ..)| starts[i + 1] += 1);
        (0..order.len()).for_each(|i| starts[i + 1] += starts[i]);
        let mut next = starts.clone();
        let mut this =
            Self { starts, columns: vec![0; self.columns.len()], values: vec![0.0; self.values.len()] };
        for (i, j, value) in entries() {
            this.columns[next[i]] = j as u32;
            this.values[next[i]] = value;
            next[i] += 1;
        }
        this
    }
}

/// A factorised matrix. It is reckoned in double precision, and kept in that of `T`.
#[derive(Debug)]
pub struct Factor<T> {
    /// The unknowns as they are eliminated: those of the subtrees, then the others.
    order: Vec<u32>,
    /// Each subtree; in the end what parts them.
    runs: Vec<FrontRun<T>>,
}

impl<T: Stored> Factor<T> {
    /// Factorises. `at` are places of the unknowns: those that share an entry are near each other. Tells its
    /// progress as that from one fraction to the other.
    ///
    /// # Errors
    /// The matrix is not positive definite, or the factor is too large; or the host has stopped it.
    pub fn new(matrix: Symmetric, at: &[DVec3], told: Range<f64>, host: &Host<'_>) -> Result<Self, Refusal> {
        let tree = EliminationTree::new(&Pattern::new(&matrix.starts, &matrix.columns), at, host)?;
        let matrix = matrix.in_order(&tree.order);
        let structure = Structure::new(&tree, |i| matrix.columns(i), size_of::<T>(), host)?;
        for ridge in RIDGES {
            let (matrix, tree, structure, told) = (&matrix, &tree, &structure, &told);
            match (Elimination { matrix, ridge, tree, structure, told, host }).run() {
                Ok(runs) => return Ok(Self { order: tree.order.clone(), runs }),
                Err(Refusal::Indefinite) => {}
                Err(refusal) => return Err(refusal),
            }
        }
        Err(Refusal::Indefinite)
    }

    /// Replaces three right-hand sides by solutions, all in one pass over the factor: that is what takes the
    /// time.
    ///
    /// # Errors
    /// The host has stopped it.
    pub fn solve(&self, sides: &mut [DVec3], host: &Host<'_>) -> PluginResult<()> {
        let mut x: Vec<DVec3> = self.order.iter().map(|i| sides[*i as usize]).collect();
        let Some((top, subtrees)) = self.runs.split_last() else { return Ok(()) };
        let is_shared = x.len() > ALONE;
        let (mut below, above) = x.split_at_mut(top.columns.start);
        let mut tasks = Vec::with_capacity(subtrees.len());
        for run in subtrees {
            let (own, rest) = below.split_at_mut(run.columns.len());
            below = rest;
            tasks.push((run, own, vec![DVec3::ZERO; run.beyond.len()]));
        }
        share(&mut tasks, is_shared, host, |(run, own, beyond)| run.forward(own, beyond))?;
        for (run, _, beyond) in &tasks {
            run.beyond.iter().zip(beyond).for_each(|(row, d)| above[*row as usize] += *d);
        }
        top.forward_together(above, host)?;
        top.backward_together(above, host)?;
        share(&mut tasks, is_shared, host, |(run, own, beyond)| {
            run.beyond.iter().zip(beyond.iter_mut()).for_each(|(row, d)| *d = above[*row as usize]);
            run.backward(own, beyond);
        })?;
        self.order.iter().zip(x).for_each(|(i, x)| sides[*i as usize] = x);
        Ok(())
    }
}

/// Does tasks, shared out to threads or on this one alone.
fn share<T: Send>(
    tasks: &mut [T],
    is_shared: bool,
    host: &Host<'_>,
    work: impl Fn(&mut T) + Sync,
) -> PluginResult<()> {
    if is_shared {
        return host.parallel_blocks(tasks, 1, |_, tasks| tasks.iter_mut().for_each(&work));
    }
    tasks.iter_mut().for_each(work);
    Ok(())
}

/// A factorisation while it is done.
struct Elimination<'a> {
    /// The matrix, in the tree's order.
    matrix: &'a Symmetric,
    ridge: f64,
    tree: &'a EliminationTree,
    structure: &'a Structure,
    told: &'a Range<f64>,
    host: &'a Host<'a>,
}

/// A run of parts, and what becomes of them.
struct SubtreeTask<T> {
    parts: Range<usize>,
    run: FrontRun<T>,
    /// The update that the last part leaves.
    update: Option<Update>,
    result: Result<(), Refusal>,
}

impl Elimination<'_> {
    fn run<T: Stored>(&self) -> Result<Vec<FrontRun<T>>, Refusal> {
        let EliminationTree { parts, subtrees, .. } = self.tree;
        let mut tasks: Vec<SubtreeTask<T>> = subtrees.iter().map(|parts| self.task(parts.clone())).collect();
        let done = AtomicUsize::new(0);
        self.host.parallel_blocks(&mut tasks, 1, |_, tasks| {
            for task in tasks {
                task.result = self.subtree(task, &done);
            }
        })?;
        let mut updates: Vec<Option<Update>> = parts.iter().map(|_| None).collect();
        let mut runs = Vec::with_capacity(tasks.len() + 1);
        let top = self.task(subtrees.last().map_or(0, |s| s.end)..parts.len());
        for mut task in tasks {
            task.result?;
            if let Some(update) = task.update {
                task.run.end(&update.rows, top.run.columns.start);
                updates[task.parts.end - 1] = Some(update);
            }
            runs.push(task.run);
        }
        let mut run = top.run;
        for (k, part) in top.parts.clone().zip(&parts[top.parts]) {
            self.tell(
                0.5 + 0.5 * part.columns.start.saturating_sub(run.columns.start) as f64
                    / run.columns.len().max(1) as f64,
            )?;
            let children = part.children.iter().filter_map(|c| updates[*c].take()).collect();
            updates[k] = Some(self.eliminate((part, &self.structure.rows[k]), children, &mut run, true)?);
        }
        run.end(&[], run.columns.start);
        runs.push(run);
        Ok(runs)
    }

    fn task<T: Stored>(&self, parts: Range<usize>) -> SubtreeTask<T> {
        let own = &self.tree.parts[parts.clone()];
        let order = self.tree.order.len();
        let columns =
            own.first().map_or(order, |p| p.columns.start)..own.last().map_or(order, |p| p.columns.end);
        SubtreeTask { parts, run: FrontRun::new(columns), update: None, result: Ok(()) }
    }

    fn subtree<T: Stored>(&self, task: &mut SubtreeTask<T>, done: &AtomicUsize) -> Result<(), Refusal> {
        let parts = &self.tree.parts[task.parts.clone()];
        let mut updates: Vec<Option<Update>> = parts.iter().map(|_| None).collect();
        let rows = &self.structure.rows[task.parts.clone()];
        for (k, (part, rows)) in parts.iter().zip(rows).enumerate() {
            let before = done.fetch_add(part.columns.len(), Ordering::Relaxed);
            self.tell(0.5 * before as f64 / self.tree.order.len() as f64)?;
            let children =
                part.children.iter().filter_map(|c| updates[*c - task.parts.start].take()).collect();
            updates[k] = Some(self.eliminate((part, rows), children, &mut task.run, false)?);
        }
        task.update = updates.pop().flatten();
        Ok(())
    }

    fn tell(&self, fraction: f64) -> PluginResult<()> {
        self.host.progress(self.told.start + (self.told.end - self.told.start) * fraction)
    }

    /// Eliminates a part, given what its children pass on. `together`: on several threads.
    fn eliminate<T: Stored>(
        &self,
        (part, rows): (&Supernode, &[u32]),
        children: Vec<Update>,
        run: &mut FrontRun<T>,
        together: bool,
    ) -> Result<Update, Refusal> {
        let (start, end) = (part.columns.start, part.columns.end);
        let entries = |i: usize| self.matrix.row(i);
        let mut front = Front::new(part.columns.len(), rows.to_vec());
        for i in part.columns.clone() {
            for (j, value) in entries(i) {
                let value = if i == j { value * (1.0 + self.ridge) } else { value };
                let row = if j < end { j - start } else { front.row(j as u32) };
                *front.entry(row, i - start) += value;
            }
        }
        for child in children {
            let places = places(&child.rows, &part.columns, &front.rows);
            front.add(&child, &places, together.then_some(self.host))?;
        }
        if !front.factorise(together.then_some(self.host))? {
            return Err(Refusal::Indefinite);
        }
        Ok(run.push(part.columns.clone(), front))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A matrix with these pairs, well away from singular, and places of its unknowns.
    fn matrix(n: usize, pairs: impl Fn(usize) -> Vec<usize>) -> Symmetric {
        let mut degrees = vec![0.0; n];
        for i in 0..n {
            for j in pairs(i) {
                degrees[i] += 1.0;
                degrees[j] += 1.0;
            }
        }
        let mut matrix = Symmetric::default();
        for (i, degree) in degrees.iter().enumerate() {
            matrix.push_row(pairs(i).into_iter().map(|j| (j, -1.0)).chain([(i, degree + 0.1)]));
        }
        matrix
    }

    fn check(matrix: &dyn Fn() -> Symmetric, at: &[DVec3]) {
        let host = Host::new(&());
        let expected: Vec<DVec3> =
            (0..at.len()).map(|i| DVec3::new((i as f64).sin(), 1.0, i as f64 % 7.0)).collect();
        let mut sides = vec![DVec3::ZERO; at.len()];
        let given = matrix();
        for i in 0..at.len() {
            for (j, value) in given.row(i) {
                sides[i] += value * expected[j];
                if i != j {
                    sides[j] += value * expected[i];
                }
            }
        }
        let off =
            |found: &[DVec3]| found.iter().zip(&expected).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max);
        let mut double = sides.clone();
        Factor::<f64>::new(given, at, 0.0..1.0, &host).unwrap().solve(&mut double, &host).unwrap();
        assert!(off(&double) < 1e-10, "{} unknowns: {:.1e}", at.len(), off(&double));
        let mut single = sides;
        Factor::<f32>::new(matrix(), at, 0.0..1.0, &host).unwrap().solve(&mut single, &host).unwrap();
        assert!(off(&single) < 1e-3, "{} unknowns: {:.1e}", at.len(), off(&single));
    }

    #[test]
    fn solutions_solve() {
        // Of none, of one; a grid of many subtrees; one whose parts are torn apart; in one place all of it.
        let grid = |n: usize, torn: bool| {
            move |i: usize| -> Vec<usize> {
                let left = (!(i.is_multiple_of(n) || torn && i % n == n / 2)).then(|| i - 1);
                (i >= n).then(|| i - n).into_iter().chain(left).collect()
            }
        };
        let places = |n: usize| -> Vec<DVec3> {
            (0..n * n).map(|i| DVec3::new((i % n) as f64, (i / n) as f64, 0.3 * (i % n) as f64)).collect()
        };
        for n in [0, 1, 2, 5, 80] {
            for torn in [false, true] {
                check(&|| matrix(n * n, grid(n, torn)), &places(n));
            }
        }
        check(&|| matrix(400, grid(20, false)), &[DVec3::ONE; 400]);
        // All have to do with all: more than are eliminated at once.
        let line: Vec<DVec3> = (0..700).map(|i| DVec3::X * f64::from(i)).collect();
        check(&|| matrix(700, |i| (0..i).collect()), &line);
    }

    /// All in one place, and each unknown shares entries with others anywhere.
    #[test]
    fn what_cannot_be_held_is_refused_with_a_hint() {
        let host = Host::new(&());
        let n = 200_000_usize;
        let mut last = 1_u64;
        let mut random = |below: usize| {
            last = last.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (last >> 33) as usize % below
        };
        let mut given = Symmetric::default();
        for i in 0..n {
            let mut others: Vec<usize> = if i > 0 { (0..3).map(|_| random(i)).collect() } else { Vec::new() };
            others.sort_unstable();
            others.dedup();
            given.push_row(others.into_iter().map(|j| (j, -1.0)).chain([(i, n as f64)]));
        }
        let error = Factor::<f64>::new(given, &vec![DVec3::ONE; n], 0.0..1.0, &host).unwrap_err();
        assert!(matches!(error, Refusal::TooLarge), "{error:?}");
    }

    #[test]
    fn what_is_singular_is_refused_with_a_hint() {
        let host = Host::new(&());
        let mut singular = Symmetric::default();
        singular.push_row([(0, 1.0)]);
        singular.push_row([(0, -2.0), (1, 1.0)]);
        let error = Factor::<f64>::new(singular, &[DVec3::ZERO; 2], 0.0..1.0, &host).unwrap_err();
        assert!(matches!(error, Refusal::Indefinite), "{error:?}");
    }
}
