//! `defaults` of a session manifest: parameters of a vehicle, laid over those of the plan before anything is checked.
//! What else it says is for who opens logs; here is where it stands.

use crate::fault::{Location, PlanFaults, Position, Source};
use crate::setting::found_or_added;
use crate::suggest::quoted;
use crate::vocabulary::{OperatorSpec, Vocabulary};
use crate::yaml::{self, Entry, Kind, Node, merge};

/// Lays a manifest's `defaults` over those of a plan. A step's own value holds. A manifest serves many plans: its
/// parameters are of some operator, not of a step of this plan.
pub(crate) fn lay(
    plan: &mut Node,
    manifest: &Source,
    vocabulary: &Vocabulary,
    faults: &mut PlanFaults,
) {
    if manifest.text.trim().is_empty() {
        return;
    }
    let Some(mut tree) = yaml::read(manifest, faults) else {
        return;
    };
    let Some(Entry {
        location, value, ..
    }) = tree.take("defaults")
    else {
        return;
    };
    let Kind::Mapping(given) = value.kind else {
        if value.kind != Kind::Null {
            value.mapping("`defaults`", faults);
        }
        return;
    };
    check(&given, vocabulary, faults);
    let defaults = found_or_added(plan, "defaults", location);
    match defaults.map(|entry| &mut entry.value.kind) {
        Some(Kind::Mapping(defaults)) => merge(defaults, given),
        Some(nothing @ Kind::Null) => *nothing = Kind::Mapping(given),
        // The plan is at fault, and is found to be when it is checked.
        _ => {}
    }
}

/// Where a manifest names a role, and where its topics are; `None` where it does not.
pub fn role_positions(manifest: &Source, role: &str) -> Option<[Position; 2]> {
    let tree = yaml::read(manifest, &mut PlanFaults::default())?;
    let entry = tree.get("roles")?.value.get(role)?;
    Some([entry.location, entry.value.location].map(Location::position))
}

/// Where an entry of a manifest is, by its path, such as `sessions[0].files[1]`; `None` where it is not there.
pub fn entry_position(manifest: &Source, path: &str) -> Option<Position> {
    let tree = yaml::read(manifest, &mut PlanFaults::default())?;
    let mut node = &tree;
    for part in path.split('.') {
        let item = part.strip_suffix(']').and_then(|part| part.split_once('['));
        let (key, item) = item.map_or((part, None), |(key, item)| (key, Some(item)));
        node = &node.get(key)?.value;
        if let Some(item) = item {
            let Kind::Sequence(items) = &node.kind else {
                return None;
            };
            node = items.get(item.parse::<usize>().ok()?)?;
        }
    }
    Some(node.location.position())
}

fn check(given: &[Entry], vocabulary: &Vocabulary, faults: &mut PlanFaults) {
    let operators = || vocabulary.operators.iter();
    let known = || operators().flat_map(OperatorSpec::parameter_names);
    for entry in given {
        if !known().any(|known| known == entry.key) {
            let name = quoted(&entry.key);
            let message = format!("`defaults` sets {name}, which is a parameter of no operator");
            faults.unknown(entry.location, message, &entry.key, known());
        }
    }
}
