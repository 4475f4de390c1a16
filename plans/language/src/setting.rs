//! `--set step.param=value`: parameters from the command line, laid over the tree before
//! anything is checked, so that they are checked like written ones.

use crate::fault::{Faults, Place};
use crate::suggest::quoted;
use crate::yaml::{self, Entry, Kind, Node};

/// Applies the settings in order; a later one wins. Deeper parameters are `step.camera.fx=3`.
/// The value is YAML: `0.2`, `true`, `[1, 2]`, `'text'`. Faults name the option.
pub fn set(root: &mut Node, settings: &[String], faults: &mut Faults) {
    for (index, setting) in settings.iter().enumerate() {
        let place = Place::Setting(index);
        let Some((path, value)) = parsed(setting, place, faults) else {
            continue;
        };
        let [step, parameter @ ..] = path.as_slice() else {
            continue;
        };
        if let Some(parameters) = parameters_of(root, step, place, faults) {
            assign(parameters, parameter, value, place, faults);
        }
    }
}

/// The path and the value of a setting, everything placed at the setting.
fn parsed<'s>(setting: &'s str, place: Place, faults: &mut Faults) -> Option<(Vec<&'s str>, Node)> {
    let (path, text) = setting.split_once('=').unwrap_or((setting, ""));
    let path: Vec<&str> = path.trim().split('.').collect();
    let complete = path.len() >= 2 && path.iter().all(|part| !part.is_empty());
    if !complete || !setting.contains('=') {
        faults.error_with(place, "this sets nothing", "write `step.parameter=value`");
        return None;
    }
    if path.len() > yaml::DEEPEST {
        faults.error(place, "this names a parameter nested too deep");
        return None;
    }
    if text.trim().is_empty() {
        let kind = Kind::Null;
        return Some((path, Node { place, kind }));
    }
    let mut within = Faults::new("", text);
    let value = yaml::read(text, &mut within);
    for fault in within.iter() {
        faults.error(place, format!("its value: {}", fault.message));
    }
    let mut value = value.filter(|_| within.is_empty())?;
    move_to(&mut value, place);
    Some((path, value))
}

/// Places a tree, at most [`yaml::DEEPEST`] deep, at the setting.
fn move_to(node: &mut Node, place: Place) {
    node.place = place;
    match &mut node.kind {
        Kind::Sequence(items) => items.iter_mut().for_each(|item| move_to(item, place)),
        Kind::Mapping(entries) => {
            for entry in entries {
                entry.place = place;
                move_to(&mut entry.value, place);
            }
        }
        Kind::Null | Kind::Bool(_) | Kind::Integer(_) | Kind::Float(_) | Kind::Text(_) => {}
    }
}

/// The mapping under `with` of a step, made if absent. `None` if there is no such step or
/// the plan is not in a shape to say; the latter is found when the plan is checked.
fn parameters_of<'n>(
    root: &'n mut Node,
    step: &str,
    place: Place,
    faults: &mut Faults,
) -> Option<&'n mut Node> {
    let steps = entries_of(value_of(root, "steps")?)?;
    let Some(index) = steps.iter().position(|entry| entry.key == step) else {
        let message = format!("there is no step {}", quoted(step));
        faults.unknown(
            place,
            message,
            step,
            steps.iter().map(|entry| entry.key.as_str()),
        );
        return None;
    };
    let body = entries_of(&mut steps.get_mut(index)?.value)?;
    if body.iter().any(|entry| entry.key == "sql") {
        let message = format!("step {} is a query, which has no parameters", quoted(step));
        faults.error(place, message);
        return None;
    }
    Some(&mut found_or_added(body, "with", place)?.value)
}

fn entries_of(node: &mut Node) -> Option<&mut Vec<Entry>> {
    match &mut node.kind {
        Kind::Mapping(entries) => Some(entries),
        _ => None,
    }
}

fn value_of<'n>(node: &'n mut Node, key: &str) -> Option<&'n mut Node> {
    let entry = entries_of(node)?
        .iter_mut()
        .find(|entry| entry.key == key)?;
    Some(&mut entry.value)
}

fn found_or_added<'n>(
    entries: &'n mut Vec<Entry>,
    key: &str,
    place: Place,
) -> Option<&'n mut Entry> {
    let index = entries.iter().position(|entry| entry.key == key);
    let index = index.unwrap_or_else(|| {
        entries.push(Entry {
            key: key.to_owned(),
            place,
            value: Node {
                place,
                kind: Kind::Null,
            },
        });
        entries.len() - 1
    });
    entries.get_mut(index)
}

fn assign(parameters: &mut Node, path: &[&str], value: Node, place: Place, faults: &mut Faults) {
    let mut node = parameters;
    for key in path {
        if node.kind == Kind::Null {
            node.kind = Kind::Mapping(Vec::new());
        }
        let Some(entries) = entries_of(node) else {
            let message = format!("{} is not in a mapping", quoted(key));
            faults.error(place, message);
            return;
        };
        let Some(entry) = found_or_added(entries, key, place) else {
            return;
        };
        entry.place = place;
        node = &mut entry.value;
    }
    *node = value;
}
