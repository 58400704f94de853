//! The fewest nodes that part two halves of a set: a least vertex cover of the pairs between them.
//!
//! D. Kőnig, *Gráfok és mátrixok*, Matematikai és Fizikai Lapok 1931: it has as many nodes as the largest
//! matching has pairs, and follows from that: nodes of the first half from which no alternating path leads to
//! a node without a mate, and those of the second half that such paths reach.

/// Mate of a node that has none.
const NONE: u32 = u32::MAX;

/// Whether each node of either half is one of the fewest that all pairs have one of. `across` are the nodes
/// of the second half that a node of the first has to do with.
pub fn least_cover<I: Iterator<Item = usize>>(
    halves: [usize; 2],
    across: impl Fn(usize) -> I,
) -> [Vec<bool>; 2] {
    let mut mates = halves.map(|count| vec![NONE; count]);
    for one in 0..halves[0] {
        if let Some(other) = across(one).find(|other| mates[1][*other] == NONE) {
            (mates[0][one], mates[1][other]) = (other as u32, one as u32);
        }
    }
    // Nodes that searches in vain have reached, which no later one has to look at.
    let mut is_reached = halves.map(|count| vec![false; count]);
    let mut search =
        Search { before: vec![NONE; halves[1]], found: vec![NONE; halves[1]], to_visit: Vec::new() };
    for one in 0..halves[0] {
        if mates[0][one] == NONE && !search.augment(one, &mut mates, &is_reached[1], &across) {
            for visited in &search.to_visit {
                is_reached[0][*visited as usize] = true;
                across(*visited as usize).for_each(|other| is_reached[1][other] = true);
            }
        }
    }
    let [first, second] = is_reached;
    let first = first.into_iter().zip(&mates[0]).map(|(reached, mate)| !reached && *mate != NONE);
    [first.collect(), second]
}

/// Searches for paths along which pairs and other edges alternate.
struct Search {
    /// Node of the first half from which each node of the second was reached.
    before: Vec<u32>,
    /// The search that reached each node of the second half last.
    found: Vec<u32>,
    /// Nodes of the first half that the last search reached.
    to_visit: Vec<u32>,
}

impl Search {
    /// Matches a node that has no mate, if a path leads from it to another one; nodes that are `in_vain` are
    /// left out.
    fn augment<I: Iterator<Item = usize>>(
        &mut self,
        one: usize,
        mates: &mut [Vec<u32>; 2],
        in_vain: &[bool],
        across: impl Fn(usize) -> I,
    ) -> bool {
        self.to_visit.clear();
        self.to_visit.push(one as u32);
        let mut at = 0;
        while let Some(&node) = self.to_visit.get(at) {
            at += 1;
            for other in across(node as usize) {
                if in_vain[other] || self.found[other] == one as u32 {
                    continue;
                }
                (self.found[other], self.before[other]) = (one as u32, node);
                if mates[1][other] == NONE {
                    self.exchange(other, mates);
                    return true;
                }
                self.to_visit.push(mates[1][other]);
            }
        }
        false
    }

    /// Makes pairs of the path's other edges, from its last node back.
    fn exchange(&self, last: usize, mates: &mut [Vec<u32>; 2]) {
        let mut other = last as u32;
        while other != NONE {
            let one = self.before[other as usize];
            mates[1][other as usize] = one;
            other = std::mem::replace(&mut mates[0][one as usize], other);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn covers_are_the_least(pairs in proptest::collection::vec((0..6_usize, 0..7_usize), 0..20)) {
            let across = |one: usize| pairs.iter().filter(move |p| p.0 == one).map(|p| p.1);
            let [first, second] = least_cover([6, 7], across);
            prop_assert!(pairs.iter().all(|(a, b)| first[*a] || second[*b]));
            let size = first.iter().chain(&second).filter(|is_in| **is_in).count() as u32;
            // All sets of the first half's nodes, each with those that are then needed of the second.
            let least = (0..1_u32 << 6).map(|set| {
                let rest = pairs.iter().filter(|(a, _)| set >> a & 1 == 0);
                set.count_ones() + rest.fold(0_u32, |others, (_, b)| others | 1 << b).count_ones()
            });
            prop_assert_eq!(Some(size), least.min());
        }
    }
}
