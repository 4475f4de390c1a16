//! `--set step.param=value`: parameters from the command line, laid over the tree before
//! anything is checked, so that they are checked like written ones. `--set NAME`: a preset.

use crate::fault::{Location, PlanFaults};
use crate::preset::Presets;
use crate::suggest::quoted;
use crate::written::Context;
use crate::yaml::{self, Entry, Kind, Node};

/// Applies the settings in order; a later one wins. Deeper parameters are `step.camera.fx=3`.
/// The value is YAML: `0.2`, `true`, `[1, 2]`, `'text'`. Faults name the option.
pub(crate) fn set(
    root: &mut Node,
    settings: &[String],
    context: &Context<'_>,
    faults: &mut PlanFaults,
) {
    let presets = Presets::take(root, faults);
    presets.check_others(settings, root, context, faults);
    for (index, setting) in settings.iter().enumerate() {
        let location = Location::Setting(index);
        if is_name(setting) {
            presets.lay(setting, root, location, faults);
            continue;
        }
        let Some((path, value)) = parsed(setting, location, faults) else {
            continue;
        };
        let [step, parameter @ ..] = path.as_slice() else {
            continue;
        };
        if let Some(parameters) = parameters_of(root, step, location, faults) {
            assign(parameters, parameter, value, location, faults);
        }
    }
}

/// Whether a setting names a preset.
fn is_name(setting: &str) -> bool {
    let is_letter = |c: char| c.is_alphanumeric() || c == '_' || c == '-';
    !setting.is_empty() && setting.chars().all(is_letter)
}

/// The path and the value of a setting, everything placed at the setting.
fn parsed<'s>(
    setting: &'s str,
    location: Location,
    faults: &mut PlanFaults,
) -> Option<(Vec<&'s str>, Node)> {
    let (path, text) = setting.split_once('=').unwrap_or((setting, ""));
    let path: Vec<&str> = path.trim().split('.').collect();
    let complete = path.len() >= 2 && path.iter().all(|part| !part.is_empty());
    if !complete || !setting.contains('=') {
        faults.error_with(
            location,
            "this sets nothing",
            "write `step.parameter=value`, or the name of a preset",
        );
        return None;
    }
    if path.len() > yaml::DEEPEST {
        faults.error(location, "this names a parameter nested too deep");
        return None;
    }
    if text.trim().is_empty() {
        return Some((path, nothing(location)));
    }
    Some((path, yaml::read_from(location, text, faults)?))
}

fn nothing(location: Location) -> Node {
    Node {
        location,
        kind: Kind::Null,
    }
}

/// The mapping under `with` of a step, made if absent. `None` if there is no such step or
/// the plan is not in a shape to say; the latter is found when the plan is checked.
pub(crate) fn parameters_of<'n>(
    root: &'n mut Node,
    step: &str,
    location: Location,
    faults: &mut PlanFaults,
) -> Option<&'n mut Node> {
    let steps = root.get_mut("steps")?.value.entries_mut()?;
    let Some(index) = steps.iter().position(|entry| entry.key == step) else {
        let message = format!("there is no step {}", quoted(step));
        let known = steps.iter().map(|entry| entry.key.as_str());
        faults.unknown(location, message, step, known);
        return None;
    };
    let body = &mut steps.get_mut(index)?.value;
    if is_query(body, step, location, faults) {
        return None;
    }
    Some(&mut found_or_added(body, "with", location)?.value)
}

/// Whether a step is a query, to which nobody can give parameters; that is recorded.
pub(crate) fn is_query(
    body: &Node,
    step: &str,
    location: Location,
    faults: &mut PlanFaults,
) -> bool {
    let is_query = body.get("sql").is_some();
    if is_query {
        let message = format!("step {} is a query, which has no parameters", quoted(step));
        faults.error(location, message);
    }
    is_query
}

/// The entry of a key, added if absent; `None` if the node is no mapping.
pub(crate) fn found_or_added<'n>(
    node: &'n mut Node,
    key: &str,
    location: Location,
) -> Option<&'n mut Entry> {
    let entries = node.entries_mut()?;
    let index = entries.iter().position(|entry| entry.key == key);
    let index = index.unwrap_or_else(|| {
        entries.push(Entry {
            key: key.to_owned(),
            location,
            value: nothing(location),
        });
        entries.len() - 1
    });
    entries.get_mut(index)
}

fn assign(
    parameters: &mut Node,
    path: &[&str],
    value: Node,
    location: Location,
    faults: &mut PlanFaults,
) {
    let mut node = parameters;
    for key in path {
        if node.kind == Kind::Null {
            node.kind = Kind::Mapping(Vec::new());
        }
        let Some(entry) = found_or_added(node, key, location) else {
            let message = format!("{} is not in a mapping", quoted(key));
            faults.error(location, message);
            return;
        };
        entry.location = location;
        node = &mut entry.value;
    }
    *node = value;
}
