//! What a run would do, and why, before it is run.

use std::collections::BTreeSet;

use evermap_schemas::{Fault, record};
use serde_json::Value;

use crate::map::damage::Damage;
use crate::map::receipt::{Artifact, Extent, LogContent, OTHER_FORMAT, RECEIPTS, Receipt, Recipe};
use crate::map::sound::Sound;
use crate::map::store::each;
use crate::map::version::Previous;
use crate::program::{Stage, Task};
use crate::run::Run;
use crate::run::pending::Pending;
use crate::run::previous_units::PreviousUnits;

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
        let receipts = self.store.list(RECEIPTS).await?.into_iter();
        let units = self.units()?;
        let mut known = Forecaster {
            run: self,
            previous: self.previous()?,
            sound: Sound::load(self.store).await?,
            held: self.held(),
            receipts: receipts
                .filter(|(_, bytes)| *bytes > 0)
                .map(|(name, _)| name)
                .collect(),
            units: &units,
            artifacts: Vec::new(),
        };
        let mut forecasts = Vec::new();
        // Those of a stage do not wait for each other.
        for units in units.chunk_by(|one, next| one.id.stage == next.id.stage) {
            let fates = each(units.iter().map(|unit| known.fate(unit))).await?;
            for (unit, fate) in units.iter().zip(fates) {
                forecasts.push(UnitForecast {
                    step: unit.id.stage.clone(),
                    unit: unit.id.label(),
                    recompute: fate.kept.is_none(),
                    why: fate.why,
                });
                known.artifacts.push(fate.kept);
            }
        }
        Ok(forecasts)
    }
}

/// What would become of a unit, and why.
struct Fate {
    /// The rows that it has already; `None` where it would be computed.
    kept: Option<Artifact>,
    why: String,
}

impl Fate {
    fn recomputed(why: String) -> Self {
        Self { kept: None, why }
    }
}

/// What is known without running anything: the artifacts of the units that were done before.
struct Forecaster<'r, 'a> {
    run: &'r Run<'a>,
    previous: Previous,
    sound: Sound<'r>,
    held: PreviousUnits<'r>,
    /// The names of the receipts that are there: those of tens of thousands of units are listed faster than read.
    receipts: BTreeSet<String>,
    units: &'r [Pending],
    /// Of the units so far those that need not be computed.
    artifacts: Vec<Option<Artifact>>,
}

impl Forecaster<'_, '_> {
    async fn fate(&self, unit: &Pending) -> Result<Fate, Fault> {
        let mut inputs = unit.before().into_iter();
        if let Some(open) = inputs.find(|input| self.artifacts[*input].is_none()) {
            let change = match self.held.receipt(&unit.id).await? {
                None => Some(new_reason(&unit.id.extent, &self.held)),
                Some(before) => stage_change(&before.recipe, &unit.stages),
            };
            let follows = || format!("{} is recomputed", self.units[open].id.label());
            return Ok(Fate::recomputed(change.unwrap_or_else(follows)));
        }
        let once = self.held.once(unit).await?;
        let assembled = unit.assemble(self.run, &self.previous, once.as_ref(), |input| {
            let label = || self.units[input].id.label();
            let found = self.artifacts[input].clone();
            found.ok_or_else(|| Fault::bug(format!("{} is not known", label())))
        });
        let recipe = assembled?.recipe;
        let digest = recipe.digest()?;
        if let Some((artifact, damage, why)) = self.done(unit, &digest).await? {
            return Ok(match damage {
                Some(damage) => Fate::recomputed(damage.to_string()),
                None => Fate {
                    kept: Some(artifact),
                    why: why.to_owned(),
                },
            });
        }
        Ok(Fate::recomputed(
            match self.held.receipt(&unit.id).await? {
                None => new_reason(&unit.id.extent, &self.held),
                Some(before) => recipe_change(&before.recipe, &recipe),
            },
        ))
    }

    /// The rows that a recipe has made, what is wrong with them, and when they were made.
    async fn done(
        &self,
        unit: &Pending,
        digest: &str,
    ) -> Result<Option<(Artifact, Option<Damage>, &'static str)>, Fault> {
        if !self.receipts.contains(&Receipt::name(digest)) {
            return Ok(None);
        }
        if let Some(artifact) = self.held.artifact(&unit.id, digest) {
            let damage = self.sound.damage(artifact).await?;
            return Ok(Some((artifact.clone(), damage, "unchanged")));
        }
        let known = (&self.sound, &self.held);
        let found = self.run.found(known, unit, digest).await?;
        Ok(found.map(|(receipt, damage)| (receipt.artifact, damage, "done before")))
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

fn new_reason(extent: &Extent, before: &PreviousUnits<'_>) -> String {
    let mut extents = before.extents();
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
    if !held.is_of_today() {
        return Some(OTHER_FORMAT.to_owned());
    }
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
    (held.stages[..] != *now).then(|| "the plan is wired differently".to_owned())
}

fn task_change(then: &Task, now: &Task, name: &str) -> String {
    match (then, now) {
        (Task::Sql { query: a, .. }, Task::Sql { query: b, .. }) if a != b => {
            format!("the query of {name} has changed")
        }
        (Task::Sql { notes: a, .. }, Task::Sql { notes: b, .. }) if a != b => {
            format!("what {name} reads has other units or frames")
        }
        (Task::Op { op: a, .. }, Task::Op { op: b, .. }) if a != b => {
            format!("{name} was {a}, is {b}")
        }
        (Task::Op { version: a, .. }, Task::Op { version: b, .. }) if a != b => {
            format!("the operator of {name} was version {a}, is {b}")
        }
        (Task::Op { params: a, .. }, Task::Op { params: b, .. }) if a != b => {
            parameter_change(name, a, b)
        }
        (Task::Python(a), Task::Python(b)) if a.environment != b.environment => format!(
            "the Python that {name} runs in, or a package there, was {}, is {}",
            a.environment, b.environment
        ),
        (Task::Python(a), Task::Python(b)) if a.function.params != b.function.params => {
            let (a, b) = (a.function.params.clone(), b.function.params.clone());
            parameter_change(name, &Value::Object(a), &Value::Object(b))
        }
        (Task::Python(a), Task::Python(b)) if a.function.code != b.function.code => {
            format!("the code of {name} in {} has changed", b.function.file)
        }
        _ => format!("{name} is another task"),
    }
}

fn parameter_change(name: &str, then: &Value, now: &Value) -> String {
    let mut entries = now.as_object().into_iter().flatten();
    let changed = entries.find(|(key, value)| then.get(key.as_str()) != Some(value));
    let Some((key, value)) = changed else {
        return format!("the parameters of {name} have changed");
    };
    let was = then
        .get(key)
        .map_or_else(|| "unset".to_owned(), ToString::to_string);
    let is = value.to_string();
    match was.len().max(is.len()) > LONGEST_VALUE {
        true => format!("{name}.{key} has changed"),
        false => format!("{name}.{key} was {was}, is {is}"),
    }
}

/// Longer values of parameters, such as images, are nothing to read (bytes).
const LONGEST_VALUE: usize = 400;
