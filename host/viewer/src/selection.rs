//! The selection of samples, and the samples next to each other by which it grows.

use serde::{Deserialize, Serialize};
use simod_core::sampled_model::SampledModel;

/// Neighbours of a sample that no triangle joins to others.
const RING: usize = 6;

/// Effect on the selection of the samples that are pointed at.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Combine {
    /// The pointed at samples are the selection.
    #[default]
    Replace,
    /// The pointed at samples join the selection.
    Add,
    /// The pointed at samples leave the selection.
    Subtract,
}

/// A set of samples.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Selection {
    marks: Vec<bool>,
    count: usize,
}

impl Selection {
    /// Empty selection of so many samples.
    pub fn none(samples: usize) -> Self {
        Self { marks: vec![false; samples], count: 0 }
    }

    /// Selection of the samples that are marked.
    pub fn from_marks(marks: Vec<bool>) -> Self {
        let count = marks.iter().filter(|m| **m).count();
        Self { marks, count }
    }

    /// Whether each sample is selected.
    pub fn marks(&self) -> &[bool] {
        &self.marks
    }

    /// Whether a sample is selected.
    pub fn contains(&self, sample: u32) -> bool {
        self.marks.get(sample as usize).copied().unwrap_or(false)
    }

    /// The number of samples that are selected.
    pub fn count(&self) -> usize {
        self.count
    }

    /// Whether no sample is selected.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// The samples that are selected, in ascending order.
    pub fn samples(&self) -> impl Iterator<Item = u32> {
        self.marks.iter().enumerate().filter(|(_, m)| **m).map(|(i, _)| i as u32)
    }

    /// Selection after other samples were pointed at.
    #[must_use]
    pub fn combined(&self, others: &Self, how: Combine) -> Self {
        let both = |(a, b): (&bool, &bool)| match how {
            Combine::Replace => *b,
            Combine::Add => *a || *b,
            Combine::Subtract => *a && !*b,
        };
        Self::from_marks(self.marks.iter().zip(&others.marks).map(both).collect())
    }

    /// All samples that are not selected.
    #[must_use]
    pub fn inverted(&self) -> Self {
        Self::from_marks(self.marks.iter().map(|m| !m).collect())
    }

    /// The selection with all samples next to a selected one.
    #[must_use]
    pub fn grown(&self, adjacency: &Adjacency) -> Self {
        self.changed(|i| self.marks[i] || adjacency.neighbours(i).iter().any(|j| self.contains(*j)))
    }

    /// The selection without the samples next to one that is not selected.
    #[must_use]
    pub fn shrunk(&self, adjacency: &Adjacency) -> Self {
        self.changed(|i| self.marks[i] && adjacency.neighbours(i).iter().all(|j| self.contains(*j)))
    }

    fn changed(&self, is_selected: impl Fn(usize) -> bool) -> Self {
        Self::from_marks((0..self.marks.len()).map(is_selected).collect())
    }

    /// The selection for another sampling of the same model: `former` says which sample of this sampling
    /// each sample of the other one is, if any, and `owners` to which known sample of the other sampling
    /// each belongs.
    #[must_use]
    pub fn carried(&self, former: &[Option<u32>], owners: &[u32]) -> Self {
        let of = |owner: &u32| former[*owner as usize].is_some_and(|i| self.contains(i));
        Self::from_marks(owners.iter().map(of).collect())
    }

    /// The selection as lengths of runs that are not selected and selected in turn, as a recording has it.
    pub fn runs(&self) -> Vec<u32> {
        let mut runs = vec![0];
        let mut selected = false;
        for mark in &self.marks {
            if *mark != selected {
                selected = *mark;
                runs.push(0);
            }
            if let Some(last) = runs.last_mut() {
                *last += 1;
            }
        }
        runs
    }

    /// Selection by runs, for so many samples; samples beyond the runs are not selected.
    pub fn from_runs(runs: &[u32], samples: usize) -> Self {
        let mut marks = Vec::with_capacity(samples);
        for (i, run) in runs.iter().enumerate() {
            let end = (marks.len() + *run as usize).min(samples);
            marks.resize(end, i % 2 == 1);
        }
        marks.resize(samples, false);
        Self::from_marks(marks)
    }
}

/// Samples next to each sample: those that triangles join to it, or else the nearest ones, in either
/// direction.
pub struct Adjacency {
    starts: Vec<u32>,
    lists: Vec<u32>,
}

impl Adjacency {
    /// The adjacency of a model's samples.
    pub fn of_model(sampled: &SampledModel) -> Self {
        let count = sampled.samples.len();
        let sides = |[a, b, c]: &[u32; 3]| [[*a, *b], [*b, *c], [*c, *a]];
        let mut pairs: Vec<[u32; 2]> = sampled.triangles.iter().flat_map(sides).collect();
        let mut joined = vec![false; count];
        pairs.iter().flatten().for_each(|i| joined[*i as usize] = true);
        if joined.contains(&false) {
            let neighbours = sampled.samples.neighbours();
            for i in (0..count).filter(|i| !joined[*i]) {
                let near = &neighbours.nearest_to(i)[..RING.min(neighbours.k())];
                pairs.extend(near.iter().map(|j| [i as u32, *j]));
            }
        }
        Self::of_pairs(count, &pairs)
    }

    fn of_pairs(count: usize, pairs: &[[u32; 2]]) -> Self {
        let both = pairs.iter().flat_map(|[a, b]| [[*a, *b], [*b, *a]]);
        let mut all: Vec<[u32; 2]> = both.filter(|[a, b]| a != b).collect();
        all.sort_unstable();
        all.dedup();
        let mut starts = vec![0; count + 1];
        all.iter().for_each(|[a, _]| starts[*a as usize + 1] += 1);
        (0..count).for_each(|i| starts[i + 1] += starts[i]);
        Self { starts, lists: all.into_iter().map(|[_, b]| b).collect() }
    }

    /// The samples next to one, in ascending order.
    pub fn neighbours(&self, i: usize) -> &[u32] {
        &self.lists[self.starts[i] as usize..self.starts[i + 1] as usize]
    }

    /// Number of samples.
    pub fn len(&self) -> usize {
        self.starts.len() - 1
    }

    /// Whether there are no samples.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// All samples that can be reached from one.
    pub fn connected(&self, from: u32) -> Selection {
        let mut marks = vec![false; self.len()];
        let mut open = Vec::new();
        if let Some(mark) = marks.get_mut(from as usize) {
            *mark = true;
            open.push(from);
        }
        while let Some(next) = open.pop() {
            for j in self.neighbours(next as usize) {
                if !std::mem::replace(&mut marks[*j as usize], true) {
                    open.push(*j);
                }
            }
        }
        Selection::from_marks(marks)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Two rows of samples that do not touch.
    fn rows() -> Adjacency {
        let pairs: Vec<[u32; 2]> = (0..9).chain(10..19).map(|i| [i, i + 1]).collect();
        Adjacency::of_pairs(20, &pairs)
    }

    #[test]
    fn parts_are_connected() {
        let rows = rows();
        let samples: Vec<u32> = rows.connected(13).samples().collect();
        assert_eq!(samples, (10..20).collect::<Vec<_>>());
        assert!(rows.connected(99).is_empty());
    }

    #[test]
    fn grown_and_shrunk_by_one() {
        let some = Selection::from_marks((0..20).map(|i| (3..6).contains(&i)).collect());
        assert_eq!(some.grown(&rows()).samples().collect::<Vec<_>>(), [2, 3, 4, 5, 6]);
        assert_eq!(some.shrunk(&rows()).samples().collect::<Vec<_>>(), [4]);
    }

    proptest! {
        #[test]
        fn what_was_grown_and_shrunk_holds_what_it_was(marks in prop::collection::vec(any::<bool>(), 20)) {
            let (rows, some) = (rows(), Selection::from_marks(marks));
            let back = some.grown(&rows).shrunk(&rows);
            prop_assert!(some.samples().all(|i| back.contains(i)));
            prop_assert_eq!(some.inverted().grown(&rows).inverted(), some.shrunk(&rows));
            prop_assert_eq!(&Selection::from_runs(&some.runs(), 20), &some);
        }

        #[test]
        fn combinations_are_those_of_sets(
            a in prop::collection::vec(any::<bool>(), 20), b in prop::collection::vec(any::<bool>(), 20),
        ) {
            let (a, b) = (Selection::from_marks(a), Selection::from_marks(b));
            for i in 0..20 {
                prop_assert_eq!(a.combined(&b, Combine::Add).contains(i), a.contains(i) || b.contains(i));
                prop_assert_eq!(a.combined(&b, Combine::Subtract).contains(i), a.contains(i) && !b.contains(i));
                prop_assert_eq!(a.combined(&b, Combine::Replace).contains(i), b.contains(i));
            }
        }
    }
}
