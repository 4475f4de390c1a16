//! The order of steps, and the cycles that prevent one.

use std::collections::{BTreeSet, VecDeque};

use crate::fault::PlanFaults;
use crate::suggest::{printable, quoted};
use crate::written::WrittenStep;

/// An order in which every step comes after those it reads; among the steps that are ready,
/// the one written first. Without the steps of cycles and those that read them, after a fault for every cycle.
pub(super) fn order(
    steps: &[WrittenStep],
    reads: &[Vec<usize>],
    faults: &mut PlanFaults,
) -> Vec<usize> {
    let readers = reversed(reads);
    let mut missing: Vec<usize> = reads.iter().map(Vec::len).collect();
    let is_ready = |(index, missing): (usize, &usize)| (*missing == 0).then_some(index);
    let mut ready: BTreeSet<usize> = missing.iter().enumerate().filter_map(is_ready).collect();
    let mut order = Vec::with_capacity(steps.len());
    while let Some(step) = ready.pop_first() {
        order.push(step);
        for reader in readers.get(step).into_iter().flatten() {
            if let Some(missing) = missing.get_mut(*reader) {
                *missing -= 1;
                if *missing == 0 {
                    ready.insert(*reader);
                }
            }
        }
    }
    if order.len() < steps.len() {
        for cycle in cycles(reads) {
            report(steps, &cycle, faults);
        }
    }
    order
}

fn reversed(reads: &[Vec<usize>]) -> Vec<Vec<usize>> {
    let mut readers = vec![Vec::new(); reads.len()];
    for (reader, inputs) in reads.iter().enumerate() {
        for input in inputs {
            if let Some(readers) = readers.get_mut(*input) {
                readers.push(reader);
            }
        }
    }
    readers
}

/// Cycles so that every step on some cycle that shares no step with a reported one is named:
/// the shortest through each step in turn, skipping steps already named.
fn cycles(reads: &[Vec<usize>]) -> Vec<Vec<usize>> {
    let mut named = BTreeSet::new();
    let mut cycles = Vec::new();
    for start in 0..reads.len() {
        if named.contains(&start) {
            continue;
        }
        if let Some(cycle) = shortest_cycle(reads, start)
            && cycle.iter().all(|step| !named.contains(step))
        {
            named.extend(cycle.iter().copied());
            cycles.push(cycle);
        }
    }
    cycles
}

/// The shortest way from a step through what it reads back to itself, breadth first.
fn shortest_cycle(reads: &[Vec<usize>], start: usize) -> Option<Vec<usize>> {
    let mut from: Vec<Option<usize>> = vec![None; reads.len()];
    let mut queue = VecDeque::from([start]);
    while let Some(step) = queue.pop_front() {
        for next in reads.get(step).into_iter().flatten() {
            if *next == start {
                return Some(way(&from, start, step));
            }
            if let Some(unseen @ None) = from.get_mut(*next) {
                *unseen = Some(step);
                queue.push_back(*next);
            }
        }
    }
    None
}

fn way(from: &[Option<usize>], start: usize, end: usize) -> Vec<usize> {
    let mut way = vec![end];
    let mut step = end;
    while step != start {
        match from.get(step).copied().flatten() {
            Some(before) => step = before,
            None => break,
        }
        way.push(step);
    }
    way.reverse();
    way
}

fn report(steps: &[WrittenStep], cycle: &[usize], faults: &mut PlanFaults) {
    let step = |index: &usize| steps.get(*index);
    let Some(first) = cycle.first().and_then(step) else {
        return;
    };
    const MOST_SHOWN: usize = 20;
    let names = cycle
        .iter()
        .filter_map(step)
        .map(|step| quoted(&step.name.name));
    let mut path: Vec<String> = names.take(MOST_SHOWN).collect();
    if cycle.len() > MOST_SHOWN {
        path.push("…".to_owned());
    }
    path.push(quoted(&first.name.name));
    let message = format!("steps form a cycle: {}", path.join(" reads "));
    let last = cycle
        .get(1)
        .or(cycle.first())
        .and_then(step)
        .unwrap_or(first);
    let hint = format!(
        "to read the version of the map before, write `previous.{}`",
        printable(&last.name.name)
    );
    faults.error_with(first.name.location, message, hint);
}

/// The steps that `targets` need, themselves included.
pub(super) fn reachable(reads: &[Vec<usize>], targets: &[usize]) -> BTreeSet<usize> {
    let mut found: BTreeSet<usize> = targets.iter().copied().collect();
    let mut open: Vec<usize> = targets.to_vec();
    while let Some(step) = open.pop() {
        for input in reads.get(step).into_iter().flatten() {
            if found.insert(*input) {
                open.push(*input);
            }
        }
    }
    found
}
