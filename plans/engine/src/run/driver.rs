//! A run at work: ready units are begun, what they leave makes others ready.

use std::collections::BTreeMap;

use evermap_schemas::Fault;
use futures::StreamExt;
use futures::stream::SelectAll;

use crate::map::receipt::Receipt;
use crate::map::version::{Previous, StoredLayer, Version};
use crate::program::Stage;
use crate::run::pending::{Pending, Place};
use crate::run::previous::Held;
use crate::run::runner::Runner;
use crate::run::{Event, Run, RunResult};
use crate::unit::Unit;

/// A run under way, unit by unit.
struct Driver<'r, 'a> {
    run: &'r Run<'a>,
    previous: Previous,
    /// What was done once, in the version before.
    held: Held,
    units: Vec<Pending>,
    /// How many units each still waits for.
    waiting: Vec<usize>,
    /// The units that wait for each.
    dependents: BTreeMap<Place, Vec<usize>>,
    /// What was done, and whether it had been done before.
    receipts: BTreeMap<Place, (Receipt, bool)>,
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
        let once = |name: &str| self.program.stage(name).is_ok_and(|stage| stage.once);
        let mut driver = Driver::new(self, self.receipts_before(once).await?)?;
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
            sessions: self.sessions.clone(),
            layers: driver.layers()?,
            losses: driver.losses(),
        };
        let (version, published) = match &self.base {
            Some(base) if base.same_content(&version) => (base.clone(), false),
            _ => {
                version.publish(self.store).await?;
                (version, true)
            }
        };
        Ok(RunResult {
            version,
            published,
            units: driver.done(),
        })
    }
}

impl<'r, 'a> Driver<'r, 'a> {
    fn new(run: &'r Run<'a>, held: Held) -> Result<Self, Fault> {
        let units = run.units()?;
        let mut dependents: BTreeMap<Place, Vec<usize>> = BTreeMap::new();
        for (index, unit) in units.iter().enumerate() {
            for earlier in &unit.before {
                dependents.entry(earlier.clone()).or_default().push(index);
            }
        }
        Ok(Self {
            run,
            previous: run.previous()?,
            held,
            waiting: units.iter().map(|unit| unit.before.len()).collect(),
            dependents,
            receipts: BTreeMap::new(),
            units,
        })
    }

    async fn drive(
        &mut self,
        runner: &dyn Runner,
        observe: &mut (dyn FnMut(Event<'_>) + Send),
    ) -> Result<(), Fault> {
        let mut running = SelectAll::new();
        let mut ready: Vec<usize> = (0..self.units.len())
            .filter(|&index| self.waiting[index] == 0)
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
                for (index, _) in &fresh {
                    let label = &self.label(*index);
                    observe(Event::Started { label });
                }
                running.push(runner.start(fresh));
            }
            match running.next().await {
                None => break,
                Some((index, Ok(receipt))) => {
                    ready.extend(self.finish(index, receipt, false, observe))
                }
                Some((index, Err(fault))) => {
                    first_fault.get_or_insert_with(|| fault.at(self.label(index)));
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
            label: &self.label(index),
            receipt: &receipt,
            cached,
        });
        let place = &self.units[index].place;
        self.receipts.insert(place.clone(), (receipt, cached));
        let mut ready = Vec::new();
        for &later in self.dependents.get(place).into_iter().flatten() {
            self.waiting[later] -= 1;
            if self.waiting[later] == 0 {
                ready.push(later);
            }
        }
        ready
    }

    fn label(&self, index: usize) -> String {
        self.units[index].place.label()
    }

    fn unit(&self, index: usize) -> Result<Unit, Fault> {
        let artifact = |place: &Place| Ok(self.receipt(place)?.artifact.clone());
        let unit = &self.units[index];
        let before = self.held.get(&unit.place.label());
        unit.assemble(self.run, &self.previous, before, artifact)
    }

    fn receipt(&self, place: &Place) -> Result<&Receipt, Fault> {
        let missing = || Fault::bug(format!("{} was not run", place.label()));
        let (receipt, _) = self.receipts.get(place).ok_or_else(missing)?;
        Ok(receipt)
    }

    fn done(&self) -> Vec<(String, Receipt, bool)> {
        let done = |unit: &Pending| {
            let (receipt, cached) = self.receipts.get(&unit.place)?.clone();
            Some((unit.place.stage.clone(), receipt, cached))
        };
        self.units.iter().filter_map(done).collect()
    }

    fn layers(&self) -> Result<BTreeMap<String, StoredLayer>, Fault> {
        let mut layers: BTreeMap<String, StoredLayer> = BTreeMap::new();
        for unit in &self.units {
            let (stage, receipt) = (&unit.place.stage, self.receipt(&unit.place)?);
            let layer = layers.entry(stage.clone()).or_insert_with(|| StoredLayer {
                published: self.run.program.write.contains(stage),
                op: unit.stages.last().and_then(Stage::op).map(str::to_owned),
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
        for (receipt, _) in self.receipts.values() {
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
