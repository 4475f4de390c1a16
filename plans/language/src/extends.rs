//! Plans that build on plans: the tree of a plan, laid over the tree of the one that it extends.
//!
//! This is done before anything is checked, so that a composed plan is checked like one that
//! was written whole, and every fault points to the file that it is in.

use crate::Host;
use crate::fault::{PlanFaults, Source};
use crate::preset;
use crate::suggest::{listed, one_line, quoted};
use crate::written::BODY_KEYS;
use crate::yaml::{self, Entry, Kind, Node, merge};

/// A chain of plans may be this long.
const LONGEST_CHAIN: usize = 16;

/// The tree of a plan, composed with all that it extends.
pub(crate) fn read(source: &Source, host: &dyn Host, faults: &mut PlanFaults) -> Option<Node> {
    composed(source, host, &mut Vec::new(), faults)
}

/// `chain` has the origins of the plans that extend this one.
fn composed(
    source: &Source,
    host: &dyn Host,
    chain: &mut Vec<String>,
    faults: &mut PlanFaults,
) -> Option<Node> {
    let mut plan = yaml::read(source, faults)?;
    let Some(extends) = plan.take("extends") else {
        if let Some(drop) = plan.take("drop") {
            let message = "`drop` is for steps of a plan that this one `extends`";
            faults.error(drop.location, message);
        }
        return Some(plan);
    };
    let name = extends.value.text("`extends`", faults)?;
    let location = extends.value.location;
    let base = match host.plan(name, &source.origin) {
        Ok(base) => base,
        Err(error) => {
            faults.error(location, one_line(&error));
            return None;
        }
    };
    chain.push(source.origin.clone());
    if chain.contains(&base.origin) || chain.len() >= LONGEST_CHAIN {
        let names = chain.iter().chain([&base.origin]);
        let path: Vec<String> = names.map(|origin| quoted(origin)).collect();
        let message = format!("plans extend each other: {}", path.join(" extends "));
        faults.error(location, message);
        return None;
    }
    let base = composed(&base, host, chain, faults)?;
    Some(laid_over(base, plan, name, faults))
}

/// The plan `base`, called `name`, with what `plan` changes of it.
fn laid_over(mut base: Node, mut plan: Node, name: &str, faults: &mut PlanFaults) -> Node {
    // What a plan is called and how it is tested is its own.
    base.take("plan");
    base.take("tests");
    if let Some(drop) = plan.take("drop") {
        drop_steps(&drop.value, &mut base, name, faults);
    }
    let Kind::Mapping(changes) = plan.kind else {
        return base;
    };
    if let Some(entries) = base.entries_mut() {
        for change in changes {
            match entries.iter_mut().find(|entry| entry.key == change.key) {
                Some(entry) => lay_entry(entry, change, name, faults),
                None => entries.push(change),
            }
        }
        base.location = plan.location;
    }
    base
}

/// Takes steps out of a plan, and out of what it writes.
fn drop_steps(drop: &Node, base: &mut Node, name: &str, faults: &mut PlanFaults) {
    let items = drop.sequence("`drop`", faults).unwrap_or_default();
    let mut dropped = Vec::new();
    if let Some(steps) = base.get_mut("steps").and_then(|e| e.value.entries_mut()) {
        for item in items {
            let Some(step) = item.text("an item of `drop`", faults) else {
                continue;
            };
            let known = steps.iter().map(|entry| entry.key.as_str());
            if !known.clone().any(|known| known == step) {
                let message = format!("`drop` names {}, no step of {}", quoted(step), quoted(name));
                faults.unknown(item.location, message, step, known);
            }
            dropped.push(step);
        }
        steps.retain(|entry| !dropped.contains(&entry.key.as_str()));
    }
    if let Some(Kind::Sequence(items)) = base.get_mut("write").map(|e| &mut e.value.kind) {
        items.retain(|item| !matches!(&item.kind, Kind::Text(t) if dropped.contains(&t.as_str())));
    }
}

fn lay_entry(entry: &mut Entry, change: Entry, name: &str, faults: &mut PlanFaults) {
    let key = entry.key.as_str();
    match (key, &mut entry.value.kind, change.value.kind) {
        ("steps", Kind::Mapping(steps), Kind::Mapping(changes)) => {
            lay_steps(steps, changes, name, faults);
        }
        ("defaults", Kind::Mapping(defaults), Kind::Mapping(changes)) => merge(defaults, changes),
        ("presets", Kind::Mapping(presets), Kind::Mapping(changes)) => {
            preset::overlay(presets, changes, preset::LEVELS);
        }
        ("write", Kind::Sequence(items), Kind::Sequence(added)) => {
            for item in added {
                if items.iter().all(|written| written.kind != item.kind) {
                    items.push(item);
                }
            }
        }
        // The plan below is at fault, and is found to be when the composed plan is checked.
        ("steps" | "defaults" | "presets", _, Kind::Mapping(_))
        | ("write", _, Kind::Sequence(_)) => {}
        (_, _, kind) => {
            let location = change.value.location;
            entry.value = Node { location, kind };
        }
    }
}

fn lay_steps(steps: &mut Vec<Entry>, changes: Vec<Entry>, name: &str, faults: &mut PlanFaults) {
    for change in changes {
        let is_whole = BODY_KEYS.iter().any(|key| change.value.get(key).is_some());
        let is_part = !is_whole && matches!(change.value.kind, Kind::Mapping(_));
        match steps.iter_mut().find(|step| step.key == change.key) {
            Some(step) if is_part => change_step(&mut step.value, change.value),
            Some(step) => *step = change,
            None if is_part => {
                let (step, base) = (quoted(&change.key), quoted(name));
                let message = format!(
                    "step {step} has none of {}, and there is none in {base} to change",
                    listed(BODY_KEYS)
                );
                let known = steps.iter().map(|step| step.key.as_str());
                faults.unknown(change.location, message, &change.key, known);
            }
            None => steps.push(change),
        }
    }
}

/// Changes the ports and parameters that are given, and leaves the others.
fn change_step(step: &mut Node, change: Node) {
    let (Some(entries), Kind::Mapping(changes)) = (step.entries_mut(), change.kind) else {
        return;
    };
    for change in changes {
        let Some(entry) = entries.iter_mut().find(|entry| entry.key == change.key) else {
            entries.push(change);
            continue;
        };
        match (&mut entry.value.kind, change.value.kind) {
            (Kind::Mapping(entries), Kind::Mapping(changes)) => merge(entries, changes),
            (_, Kind::Null) => {}
            (_, kind) => {
                let location = change.value.location;
                entry.value = Node { location, kind };
            }
        }
    }
}
