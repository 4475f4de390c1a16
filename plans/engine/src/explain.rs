//! What a run would do, and why, before it is run.

use std::collections::{BTreeMap, BTreeSet};

use evermap_schemas::Fault;
use serde::Serialize;

use crate::needs::{Instance, instances, needs};
use crate::program::{Stage, Task};
use crate::run::Run;
use crate::unit::{Receipt, Recipe};

/// What would become of one unit.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct UnitForecast {
    /// Its stage.
    pub step: String,
    /// What a person calls it.
    pub label: String,
    /// Whether it would be computed.
    pub recompute: bool,
    /// Why.
    pub reason: String,
}

impl Run<'_> {
    /// Forecasts every unit, against the version before. A unit whose inputs would be recomputed is forecast as
    /// recomputed too, though it is skipped when they come out unchanged.
    ///
    /// # Errors
    /// As [`Run::execute`], as far as it is not about running.
    pub async fn explain(&self) -> Result<Vec<UnitForecast>, Fault> {
        let before = self.receipts_before().await?;
        let mut forecasts: BTreeMap<(String, Instance), UnitForecast> = BTreeMap::new();
        let mut order = Vec::new();
        for stage in self.program.stages.iter().filter(|stage| stage.stored) {
            for instance in instances(stage.scope, &self.sessions) {
                let place = (stage.name.clone(), instance.clone());
                let reason =
                    self.reason(stage, &instance, before.get(&place), &before, &forecasts)?;
                let forecast = UnitForecast {
                    step: stage.name.clone(),
                    label: instance.label(&stage.name),
                    recompute: reason.is_some(),
                    reason: reason.unwrap_or_else(|| "unchanged".to_owned()),
                };
                forecasts.insert(place.clone(), forecast);
                order.push(place);
            }
        }
        Ok(order
            .iter()
            .filter_map(|place| forecasts.remove(place))
            .collect())
    }

    /// The receipts of the version before, by stage and instance.
    async fn receipts_before(&self) -> Result<BTreeMap<(String, Instance), Receipt>, Fault> {
        let mut receipts = BTreeMap::new();
        for (name, layer) in self.base.iter().flat_map(|base| &base.layers) {
            for digest in &layer.recipes {
                if let Some(receipt) = Receipt::find(self.store, digest).await? {
                    let instance = match (&receipt.recipe.session, &receipt.recipe.site) {
                        (Some(session), _) => Instance::Session(session.clone()),
                        (None, Some(site)) => Instance::Site(site.clone()),
                        (None, None) => Instance::Map,
                    };
                    receipts.insert((name.clone(), instance), receipt);
                }
            }
        }
        Ok(receipts)
    }

    fn reason(
        &self,
        stage: &Stage,
        instance: &Instance,
        held: Option<&Receipt>,
        before: &BTreeMap<(String, Instance), Receipt>,
        forecasts: &BTreeMap<(String, Instance), UnitForecast>,
    ) -> Result<Option<String>, Fault> {
        let Some(held) = held else {
            return Ok(Some(new_reason(instance, before)));
        };
        if let Some(change) = stage_change(&held.recipe, &self.program.fragment(&stage.name)?) {
            return Ok(Some(change));
        }
        let needs = needs(self.program, self.registry, stage, instance, &self.sessions)?;
        let logs: BTreeSet<_> = held
            .recipe
            .logs
            .iter()
            .map(|log| (&log.session, &log.content, &log.roles, &log.site))
            .collect();
        for session in self
            .sessions
            .iter()
            .filter(|session| needs.logs.contains(&session.log.session))
        {
            let log = &session.log;
            if !logs.contains(&(&log.session, &log.content, &log.roles, &log.site)) {
                return Ok(Some(format!(
                    "the log of {} is new or has changed",
                    log.session
                )));
            }
        }
        let inputs: Vec<_> = needs.places().collect();
        let changed = inputs.iter().find(|place| {
            forecasts
                .get(place)
                .is_some_and(|forecast| forecast.recompute)
        });
        if let Some((name, input)) = changed {
            return Ok(Some(format!("{} is recomputed", input.label(name))));
        }
        for name in needs.tables.keys() {
            let count = inputs.iter().filter(|(input, _)| input == name).count();
            if held.recipe.tables.get(name).map_or(0, Vec::len) != count {
                return Ok(Some(format!("{name} is made of other units")));
            }
        }
        Ok(self.previous_change(held))
    }

    fn previous_change(&self, held: &Receipt) -> Option<String> {
        let base = self.base.as_ref()?;
        held.recipe.previous.iter().find_map(|(name, contents)| {
            let now = base.layers.get(name).map(|layer| {
                layer
                    .artifacts
                    .iter()
                    .map(|artifact| artifact.content.clone())
                    .collect::<BTreeSet<_>>()
            });
            let then: BTreeSet<_> = contents.iter().cloned().collect();
            (!then.is_subset(&now.unwrap_or_default()))
                .then(|| format!("previous.{name} has changed"))
        })
    }
}

fn new_reason(instance: &Instance, before: &BTreeMap<(String, Instance), Receipt>) -> String {
    match instance {
        _ if before.is_empty() => "nothing was computed before".to_owned(),
        Instance::Session(name) if !before.keys().any(|(_, held)| held == instance) => {
            format!("session {name} is new")
        }
        Instance::Site(name) if !before.keys().any(|(_, held)| held == instance) => {
            format!("site {name} is new")
        }
        _ => "the step is new".to_owned(),
    }
}

/// How the stages differ from those that a unit was made with, in the words of the plan.
fn stage_change(held: &Recipe, now: &[Stage]) -> Option<String> {
    for stage in now {
        let Some(then) = held.stages.iter().find(|then| then.name == stage.name) else {
            return Some(format!("{} runs inside it now", stage.name));
        };
        if then.task != stage.task {
            return Some(task_change(&then.task, &stage.task, &stage.name));
        }
    }
    (held.stages != now).then(|| "the plan is wired differently".to_owned())
}

fn task_change(then: &Task, now: &Task, name: &str) -> String {
    match (then, now) {
        (Task::Sql { query: a, .. }, Task::Sql { query: b, .. }) if a != b => {
            format!("the query of {name} has changed")
        }
        (Task::Op { op: a, .. }, Task::Op { op: b, .. }) if a != b => {
            format!("{name} was {a}, is {b}")
        }
        (Task::Op { version: a, .. }, Task::Op { version: b, .. }) if a != b => {
            format!("the operator of {name} was version {a}, is {b}")
        }
        (Task::Op { params: a, .. }, Task::Op { params: b, .. }) if a != b => {
            let changed = b
                .as_object()
                .into_iter()
                .flatten()
                .find(|(key, value)| a.get(key.as_str()) != Some(value));
            changed.map_or_else(
                || format!("the parameters of {name} have changed"),
                |(key, value)| {
                    let was = a
                        .get(key)
                        .map_or_else(|| "unset".to_owned(), ToString::to_string);
                    format!("{name}.{key} was {was}, is {value}")
                },
            )
        }
        _ => format!("{name} reads other tables"),
    }
}
