//! `presets`: parameters of steps that a plan gives one name, such as `preview`; `--set NAME` lays them over the steps.

use crate::fault::{Location, PlanFaults};
use crate::setting::{is_query, parameters_of};
use crate::suggest::quoted;
use crate::written::{Context, check_alone};
use crate::yaml::{Entry, Kind, Node, merge};

/// The presets of a plan, taken out of its tree.
pub(crate) struct Presets(Vec<Entry>);

impl Presets {
    /// Takes them, and checks that their steps are there. Those of an extended plan may be of a step that was dropped.
    pub(crate) fn take(root: &mut Node, faults: &mut PlanFaults) -> Self {
        let Some(presets) = root.take("presets") else {
            return Self(Vec::new());
        };
        let presets = presets.value.mapping("`presets`", faults);
        let presets = presets.map_or_else(Vec::new, <[Entry]>::to_vec);
        let steps = root
            .get_mut("steps")
            .and_then(|steps| steps.value.entries_mut());
        let steps: Vec<String> = steps
            .into_iter()
            .flatten()
            .map(|step| step.key.clone())
            .collect();
        for preset in &presets {
            let what = format!("preset {}", quoted(&preset.key));
            let named = preset.value.mapping(&what, faults).unwrap_or_default();
            for step in named.iter().filter(|step| step.is_own()) {
                let name = quoted(&step.key);
                step.value
                    .mapping(&format!("step {name} of {what}"), faults);
                if !steps.contains(&step.key) {
                    let message = format!("{what} names {name}, which is not a step");
                    let known = steps.iter().map(String::as_str);
                    faults.unknown(step.location, message, &step.key, known);
                }
            }
        }
        Self(presets)
    }

    /// Checks the parameters of presets that are not chosen: those of one that is are checked where it is laid.
    pub(crate) fn check_others(
        &self,
        chosen: &[String],
        root: &Node,
        context: &Context<'_>,
        faults: &mut PlanFaults,
    ) {
        let others = self.0.iter().filter(|preset| !chosen.contains(&preset.key));
        for preset in others {
            if let Kind::Mapping(steps) = &preset.value.kind {
                let steps = steps.iter();
                steps.for_each(|step| check_parameters(step, root, context, faults));
            }
        }
    }

    /// Lays the preset of this name over the steps of a plan.
    pub(crate) fn lay(
        &self,
        name: &str,
        root: &mut Node,
        location: Location,
        faults: &mut PlanFaults,
    ) {
        let Some(preset) = self.0.iter().find(|preset| preset.key == name) else {
            let known = self.0.iter().map(|preset| preset.key.as_str());
            let message = format!(
                "{} is neither `step.parameter=value` nor a preset of this plan",
                quoted(name)
            );
            faults.unknown(location, message, name, known);
            return;
        };
        let Kind::Mapping(steps) = &preset.value.kind else {
            return;
        };
        for step in steps {
            let is_there = |root: &mut Node| {
                let steps = root.get_mut("steps")?.value.entries_mut()?;
                steps.iter().find(|known| known.key == step.key).map(drop)
            };
            if is_there(root).is_none() {
                continue;
            }
            let Kind::Mapping(values) = &step.value.kind else {
                continue;
            };
            let Some(parameters) = parameters_of(root, &step.key, step.location, faults) else {
                continue;
            };
            match &mut parameters.kind {
                Kind::Mapping(entries) => merge(entries, values.clone()),
                nothing => *nothing = Kind::Mapping(values.clone()),
            }
        }
    }
}

/// Checks what a preset gives to a step. What an extended plan gives may be of a step that is another one by now.
fn check_parameters(given: &Entry, root: &Node, context: &Context<'_>, faults: &mut PlanFaults) {
    let steps = root.get("steps");
    let step = steps.and_then(|steps| steps.value.get(&given.key));
    let (Some(step), Kind::Mapping(values)) = (step, &given.value.kind) else {
        return;
    };
    let own: Vec<&Entry> = values.iter().filter(|value| value.is_own()).collect();
    if own.is_empty() || is_query(&step.value, &given.key, given.location, faults) {
        return;
    }
    if let Some(op) = step.value.get("op")
        && let Kind::Text(name) = &op.value.kind
        && let Some(spec) = context.vocabulary.operator(name)
    {
        check_alone(spec, &own, context.host, faults);
    }
}

/// Levels that stand between the presets of a plan and their parameters: preset, step.
pub(crate) const LEVELS: usize = 2;

/// Puts entries in a mapping; those with the same key are overlaid in turn, so many levels down.
pub(crate) fn overlay(entries: &mut Vec<Entry>, changes: Vec<Entry>, levels: usize) {
    for change in changes {
        let Some(entry) = entries.iter_mut().find(|entry| entry.key == change.key) else {
            entries.push(change);
            continue;
        };
        match (levels, &mut entry.value.kind, change.value.kind) {
            (1.., Kind::Mapping(entries), Kind::Mapping(changes)) => {
                overlay(entries, changes, levels - 1);
            }
            (_, _, kind) => {
                let location = change.value.location;
                entry.value = Node { location, kind };
            }
        }
    }
}
