//! Groups of steps: steps that follow each other and have the same word as their group. Steps do the same in
//! a group as out of it; a group is switched, moved and named as one.

use super::entry::Entry;
use std::ops::Range;
use std::sync::Arc;

/// Places of the steps of the group that a step is in; none where it is in no group.
pub fn group_at(steps: &[Entry], at: usize) -> Option<Range<usize>> {
    let name = steps.get(at)?.step.group.as_ref()?;
    let is_in = |entry: &&Entry| entry.step.group.as_ref() == Some(name);
    let before = steps[..at].iter().rev().take_while(is_in).count();
    let from = steps[at..].iter().take_while(is_in).count();
    Some(at - before..at + from)
}

/// A name that no group has: the given one, or that with a number.
pub fn free_name(steps: &[Entry], name: &str) -> String {
    let is_free = |name: &String| steps.iter().all(|entry| entry.step.group.as_ref() != Some(name));
    let numbered = (2..).map(|i| format!("{name} {i}"));
    std::iter::once(name.to_owned()).chain(numbered).find(is_free).unwrap_or_default()
}

/// Steps are of a group from now on, or of none.
pub(super) fn set(entries: &mut [Entry], name: Option<&String>) {
    for entry in entries.iter_mut().filter(|entry| entry.step.group.as_ref() != name) {
        Arc::make_mut(&mut entry.step).group = name.cloned();
    }
}

/// Parts a group from which steps were taken out: the steps behind them become a group of their own.
pub(super) fn part(steps: &mut [Entry], taken: Range<usize>) {
    let (before, behind) = (taken.start.checked_sub(1), taken.end);
    let Some(Range { end, .. }) = group_at(steps, behind) else { return };
    let is_same = before.is_some_and(|before| steps[before].step.group == steps[behind].step.group);
    if is_same && steps[taken.start].step.group != steps[behind].step.group {
        let name = steps[behind].step.group.as_ref().map(|name| free_name(steps, name));
        set(&mut steps[behind..end], name.as_ref());
    }
}

/// Place for a step: the place itself, or the one behind the group which it is within.
pub(super) fn gap_at(steps: &[Entry], at: usize) -> usize {
    group_at(steps, at).filter(|group| group.start < at).map_or(at, |group| group.end)
}

/// Settles the group of a step that has come to a place: it joins the group that it has come into; it stays
/// in its own where it is beside that; and elsewhere it is in none.
pub(super) fn settle(steps: &mut [Entry], at: usize) {
    let of = |place: Option<usize>| steps.get(place?)?.step.group.clone();
    let (before, own, behind) = (of(at.checked_sub(1)), of(Some(at)), of(Some(at + 1)));
    let group = if before == behind {
        before
    } else {
        own.filter(|own| [&before, &behind].into_iter().flatten().any(|group| group == own))
    };
    set(&mut steps[at..=at], group.as_ref());
}

/// Settles the groups of new steps that have come to some places: they join the group that they have come
/// into; elsewhere they keep their own, by names that are free.
pub(super) fn settle_new(steps: &mut [Entry], new: Range<usize>) {
    let of = |place: Option<usize>| steps.get(place?)?.step.group.clone();
    let (before, behind) = (of(new.start.checked_sub(1)), of(Some(new.end)));
    if before.is_some() && before == behind {
        return set(&mut steps[new], before.as_ref());
    }
    let others: Vec<Entry> = steps[..new.start].iter().chain(&steps[new.end..]).cloned().collect();
    let mut at = new.start;
    while at < new.end {
        let Some(name) = steps[at].step.group.clone() else {
            at += 1;
            continue;
        };
        let end = group_at(&steps[..new.end], at).map_or(at + 1, |group| group.end);
        set(&mut steps[at..end], Some(&free_name(&others, &name)));
        at = end;
    }
}
