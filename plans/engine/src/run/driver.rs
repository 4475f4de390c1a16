//! A run at work: ready units are begun, what they leave makes others ready.

use std::collections::{BTreeMap, BTreeSet};

use evermap_schemas::Fault;
use futures::StreamExt;
use futures::stream::SelectAll;

use crate::map::receipt::{Artifact, Receipt};
use crate::map::version::{MappedSession, Previous, StoredLayer, Version};
use crate::program::Stage;
use crate::run::assembly::assemble;
use crate::run::instance::{Instance, Needs, instances, needs};
use crate::run::runner::Runner;
use crate::run::{Event, Run, RunResult, RunSession};
use crate::unit::Unit;

/// A unit before its recipe is known.
struct Pending {
    stage: usize,
    instance: Instance,
    needs: Needs,
    waiting: usize,
}

struct Driver<'r, 'a> {
    run: &'r Run<'a>,
    previous: Previous,
    units: Vec<Pending>,
    by_place: BTreeMap<(String, Instance), usize>,
    dependents: Vec<Vec<usize>>,
    receipts: Vec<Option<(Receipt, bool)>>,
    labels: Vec<String>,
}

impl Run<'_> {
    /// Runs everything, then publishes.
    ///
    /// # Errors
    /// The first unit's fault, after the units that were under way have ended; what was done stays done.
    pub async fn execute(
        &self,
        runner: &dyn Runner,
        observe: &mut (dyn FnMut(Event<'_>) + Send),
    ) -> Result<RunResult, Fault> {
        if self.sessions.is_empty() {
            return Err(Fault::user("no sessions to map").next("give some with --sessions FILES"));
        }
        let mut driver = Driver::new(self)?;
        observe(Event::Planned {
            units: driver.units.len(),
        });
        driver.drive(runner, observe).await?;
        self.publish(&driver).await
    }

    /// What `previous` means in this run.
    ///
    /// # Errors
    /// As [`Previous::of`].
    pub fn previous(&self) -> Result<Previous, Fault> {
        Previous::of(self.program, &self.sessions, self.base.as_ref())
    }

    async fn publish(&self, driver: &Driver<'_, '_>) -> Result<RunResult, Fault> {
        let parent = self.base.as_ref().map_or(0, |base| base.version);
        let version = Version {
            version: parent + 1,
            parent,
            program: self.program.digest()?,
            previous: driver.previous.clone(),
            plan: self.program.plan.clone(),
            evermap: env!("CARGO_PKG_VERSION").to_owned(),
            published: chrono::Utc::now().to_rfc3339(),
            sessions: self.sessions.iter().map(mapped).collect::<Result<_, _>>()?,
            layers: driver.layers()?,
            losses: driver.losses(),
        };
        let units = driver.done();
        match &self.base {
            Some(base) if base.same_content(&version) => Ok(RunResult {
                version: base.clone(),
                published: false,
                units,
            }),
            _ => {
                version.publish(self.store).await?;
                Ok(RunResult {
                    version,
                    published: true,
                    units,
                })
            }
        }
    }
}

fn mapped(session: &RunSession) -> Result<MappedSession, Fault> {
    let manifest =
        serde_json::to_value(&session.manifest).map_err(|error| Fault::bug(error.to_string()))?;
    Ok(MappedSession {
        log: session.log.clone(),
        manifest,
    })
}

impl<'r, 'a> Driver<'r, 'a> {
    fn new(run: &'r Run<'a>) -> Result<Self, Fault> {
        let mut units = Vec::new();
        let mut by_place = BTreeMap::new();
        let mut labels = Vec::new();
        for (stage_index, stage) in run
            .program
            .stages
            .iter()
            .enumerate()
            .filter(|(_, stage)| stage.stored)
        {
            for instance in instances(stage.scope, &run.sessions) {
                let needs = needs(run.program, run.registry, stage, &instance, &run.sessions)?;
                labels.push(instance.label(&stage.name));
                by_place.insert((stage.name.clone(), instance.clone()), units.len());
                units.push(Pending {
                    stage: stage_index,
                    instance,
                    needs,
                    waiting: 0,
                });
            }
        }
        let mut dependents = vec![Vec::new(); units.len()];
        for (index, unit) in units.iter_mut().enumerate() {
            let unit: &mut Pending = unit;
            let places = unit.needs.places();
            let before: BTreeSet<usize> = places
                .filter_map(|place| by_place.get(&place).copied())
                .collect();
            unit.waiting = before.len();
            before
                .into_iter()
                .for_each(|earlier: usize| dependents[earlier].push(index));
        }
        let receipts = vec![None; units.len()];
        Ok(Self {
            run,
            previous: run.previous()?,
            units,
            by_place,
            dependents,
            receipts,
            labels,
        })
    }

    async fn drive(
        &mut self,
        runner: &dyn Runner,
        observe: &mut (dyn FnMut(Event<'_>) + Send),
    ) -> Result<(), Fault> {
        let mut running = SelectAll::new();
        let mut ready: Vec<usize> = (0..self.units.len())
            .filter(|&index| self.units[index].waiting == 0)
            .collect();
        let mut first_fault: Option<Fault> = None;
        loop {
            let mut fresh = Vec::new();
            while let Some(index) = ready.pop() {
                let unit = self.unit(index)?;
                match Receipt::find(self.run.store, &unit.recipe.digest()?).await? {
                    Some(receipt) => ready.extend(self.finish(index, receipt, true, observe)),
                    None => fresh.push((index, unit)),
                }
            }
            fresh.sort_by_key(|(index, _)| *index);
            if !fresh.is_empty() && first_fault.is_none() {
                fresh.iter().for_each(|(index, _)| {
                    observe(Event::Started {
                        label: &self.labels[*index],
                    })
                });
                running.push(runner.start(fresh));
            }
            match running.next().await {
                None => break,
                Some((index, Ok(receipt))) => {
                    ready.extend(self.finish(index, receipt, false, observe))
                }
                Some((index, Err(fault))) => {
                    first_fault.get_or_insert_with(|| fault.at(&self.labels[index]));
                }
            }
        }
        first_fault.map_or(Ok(()), Err)
    }

    /// Notes a unit's receipt; the units that waited only for it are ready now.
    fn finish(
        &mut self,
        index: usize,
        receipt: Receipt,
        cached: bool,
        observe: &mut (dyn FnMut(Event<'_>) + Send),
    ) -> Vec<usize> {
        observe(Event::Done {
            label: &self.labels[index],
            receipt: &receipt,
            cached,
        });
        self.receipts[index] = Some((receipt, cached));
        let mut ready = Vec::new();
        for &later in &self.dependents[index] {
            self.units[later].waiting -= 1;
            if self.units[later].waiting == 0 {
                ready.push(later);
            }
        }
        ready
    }

    fn artifact(&self, place: &(String, Instance)) -> Result<Artifact, Fault> {
        self.by_place
            .get(place)
            .and_then(|&index| self.receipts[index].as_ref())
            .map(|(receipt, _)| receipt.artifact.clone())
            .ok_or_else(|| Fault::bug(format!("a unit began before {}", place.1.label(&place.0))))
    }

    fn unit(&self, index: usize) -> Result<Unit, Fault> {
        let pending = &self.units[index];
        let stage = &self.run.program.stages[pending.stage];
        let artifact = |place: &(String, Instance)| self.artifact(place);
        let (instance, needs) = (&pending.instance, &pending.needs);
        assemble(self.run, &self.previous, stage, instance, needs, artifact)
    }

    fn done(&self) -> Vec<(String, Receipt, bool)> {
        let units = self.units.iter().zip(&self.receipts);
        let stage = |unit: &Pending| self.run.program.stages[unit.stage].name.clone();
        units
            .filter_map(|(unit, receipt)| {
                receipt
                    .clone()
                    .map(|(receipt, cached)| (stage(unit), receipt, cached))
            })
            .collect()
    }

    fn layers(&self) -> Result<BTreeMap<String, StoredLayer>, Fault> {
        let mut layers: BTreeMap<String, StoredLayer> = BTreeMap::new();
        for (unit, receipt) in self.units.iter().zip(&self.receipts) {
            let stage: &Stage = &self.run.program.stages[unit.stage];
            let (receipt, _) = receipt
                .as_ref()
                .ok_or_else(|| Fault::bug(format!("{} was not run", stage.name)))?;
            let layer = layers
                .entry(stage.name.clone())
                .or_insert_with(|| StoredLayer {
                    published: self.run.program.write.contains(&stage.name),
                    op: stage.op().map(str::to_owned),
                    ..StoredLayer::default()
                });
            layer.artifacts.push(receipt.artifact.clone());
            layer.recipes.push(receipt.digest.clone());
        }
        Ok(layers)
    }

    /// What was skipped or lost: operators' counts summed, a log's counted once however many units read it.
    fn losses(&self) -> BTreeMap<String, u64> {
        let mut losses: BTreeMap<String, u64> = BTreeMap::new();
        for (receipt, _) in self.receipts.iter().flatten() {
            for (reason, count) in &receipt.skipped {
                *losses.entry(reason.clone()).or_default() += count;
            }
            for (reason, count) in &receipt.log_losses {
                let held = losses.entry(reason.clone()).or_default();
                *held = (*held).max(*count);
            }
        }
        losses
    }
}
