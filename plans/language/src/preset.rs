//! `presets`: parameters of steps that a plan gives one name, such as `preview`; `--set NAME` lays them over the steps.

use crate::fault::{Place, PlanFaults};
use crate::setting::parameters_of;
use crate::suggest::quoted;
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
                    faults.unknown(step.place, message, &step.key, known);
                }
            }
        }
        Self(presets)
    }

    /// Lays the preset of this name over the steps of a plan.
    pub(crate) fn lay(&self, name: &str, root: &mut Node, place: Place, faults: &mut PlanFaults) {
        let Some(preset) = self.0.iter().find(|preset| preset.key == name) else {
            let known = self.0.iter().map(|preset| preset.key.as_str());
            let message = format!(
                "{} is neither `step.parameter=value` nor a preset of this plan",
                quoted(name)
            );
            faults.unknown(place, message, name, known);
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
            let Some(parameters) = parameters_of(root, &step.key, step.place, faults) else {
                continue;
            };
            match &mut parameters.kind {
                Kind::Mapping(entries) => merge(entries, values.clone()),
                nothing => *nothing = Kind::Mapping(values.clone()),
            }
        }
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
                let place = change.value.place;
                entry.value = Node { place, kind };
            }
        }
    }
}
