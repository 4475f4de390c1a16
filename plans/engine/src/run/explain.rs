//! What a run would do, and why, before it is run.

use std::collections::BTreeMap;

use evermap_schemas::{Fault, record};

use crate::map::receipt::{Artifact, Extent, LogContent, Recipe};
use crate::map::sound::Sound;
use crate::map::version::Previous;
use crate::program::{Stage, Task};
use crate::run::Run;
use crate::run::pending::{Pending, Place};
use crate::run::previous::Held;

record! {
    /// What would become of one unit.
    #[layer("forecasts", key(step, unit))]
    pub struct UnitForecast {
        /// Step that it belongs to.
        step: String,
        /// The unit.
        unit: String,
        /// Whether it would be computed.
        recompute: bool,
        /// Why, or why not.
        why: String,
    }
}

impl Run<'_> {
    /// Forecasts every unit, against the version before. A unit whose inputs would be recomputed is forecast as
    /// recomputed too, though it is skipped when they come out unchanged.
    ///
    /// # Errors
    /// As [`Run::execute`], as far as it is not about running.
    pub async fn explain(&self) -> Result<Vec<UnitForecast>, Fault> {
        let held = self.receipts_before(|_| true).await?;
        let mut known = Known {
            run: self,
            previous: self.previous()?,
            sound: Sound::load(self.store).await?,
            artifacts: BTreeMap::new(),
        };
        let mut forecasts = Vec::new();
        for unit in self.units()? {
            let reason = known.reason(&unit, &held).await?;
            forecasts.push(UnitForecast {
                unit: unit.place.label(),
                step: unit.place.stage,
                recompute: reason.is_err(),
                why: reason.unwrap_or_else(|why| why),
            });
        }
        Ok(forecasts)
    }
}

/// What is known without running anything: the artifacts of the units that were done before.
struct Known<'r, 'a> {
    run: &'r Run<'a>,
    previous: Previous,
    sound: Sound<'r>,
    artifacts: BTreeMap<Place, Artifact>,
}

impl Known<'_, '_> {
    /// Why a unit would not be computed, or, as the error, why it would.
    async fn reason(
        &mut self,
        unit: &Pending,
        held: &Held,
    ) -> Result<Result<String, String>, Fault> {
        let before = held.get(&unit.place.label());
        let mut inputs = unit.before.iter();
        if let Some(open) = inputs.find(|input| !self.artifacts.contains_key(input)) {
            let change = match before {
                None => Some(new_reason(&unit.place.extent, held)),
                Some(before) => stage_change(&before.recipe, &unit.stages),
            };
            return Ok(Err(
                change.unwrap_or_else(|| format!("{} is recomputed", open.label()))
            ));
        }
        let recipe = unit.assemble(self.run, &self.previous, before, |input| {
            let found = self.artifacts.get(input).cloned();
            found.ok_or_else(|| Fault::bug(format!("{} is not known", input.label())))
        });
        let recipe = recipe?.recipe;
        let digest = recipe.digest()?;
        match self.sound.receipt(&digest).await? {
            Some((_, Some(damage))) => return Ok(Err(damage.to_string())),
            Some((receipt, None)) => {
                self.artifacts.insert(unit.place.clone(), receipt.artifact);
                let same = before.is_some_and(|before| before.digest == digest);
                return Ok(Ok(if same { "unchanged" } else { "done before" }.to_owned()));
            }
            None => {}
        }
        Ok(Err(match before {
            None => new_reason(&unit.place.extent, held),
            Some(before) => recipe_change(&before.recipe, &recipe),
        }))
    }
}

/// How what a unit reads differs from what it read.
fn recipe_change(then: &Recipe, now: &Recipe) -> String {
    if let Some(change) = stage_change(then, &now.stages) {
        return change;
    }
    if let Some(log) = now.logs.iter().find(|log| !then.logs.contains(log)) {
        let same = |other: &&LogContent| other.session == log.session;
        return match then.logs.iter().find(same) {
            None => format!("session {} is new", log.session),
            Some(other) if other.content != log.content => {
                format!("the log of {} has changed", log.session)
            }
            Some(other) if other.site != log.site => {
                format!(
                    "{} was of site {}, is of {}",
                    log.session, other.site, log.site
                )
            }
            Some(_) => format!("other topics of {} play the roles", log.session),
        };
    }
    for (name, contents) in &now.tables {
        match then.tables.get(name) {
            Some(then) if then == contents => {}
            Some(then) if then.len() == contents.len() => return format!("{name} has changed"),
            _ => return format!("{name} is made of other units"),
        }
    }
    for (name, contents) in &now.new {
        if then.new.get(name) != Some(contents) {
            return format!("new.{name} has changed");
        }
    }
    for (name, contents) in &now.previous {
        if then.previous.get(name) != Some(contents) {
            return format!("previous.{name} has changed");
        }
    }
    if then.replaced != now.replaced {
        return "the log of a session of the version before was replaced".to_owned();
    }
    "its rows are gone from the map".to_owned()
}

fn new_reason(extent: &Extent, before: &Held) -> String {
    let mut extents = before.values().map(|receipt| &receipt.recipe.extent);
    let new = match extent {
        _ if before.is_empty() => return "nothing was computed before".to_owned(),
        Extent {
            session: Some(name),
            ..
        } if extents.all(|of| of.session != extent.session) => {
            format!("session {name}")
        }
        Extent {
            session: None,
            site: Some(name),
        } if extents.all(|of| of.site != extent.site) => {
            format!("site {name}")
        }
        _ => "the step".to_owned(),
    };
    format!("{new} is new")
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
        if then.reads != stage.reads {
            return Some(format!("{} reads other tables", stage.name));
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
        _ => format!("{name} is another task"),
    }
}
