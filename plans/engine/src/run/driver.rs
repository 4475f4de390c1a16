//! A run at work: ready units are begun, what they leave makes others ready.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Mutex;

use evermap_schemas::Fault;
use futures::StreamExt;
use futures::stream::SelectAll;

use crate::locked::locked;
use crate::map::damage::Damage;
use crate::map::lease::Lease;
use crate::map::receipt::{RECEIPTS, Receipt};
use crate::map::sound::Sound;
use crate::map::store::{ARTIFACTS, each};
use crate::map::version::{Previous, StoredLayer};
use crate::program::Stage;
use crate::run::done::{Done, KnownNodes};
use crate::run::mend::{Makers, Mending};
use crate::run::pending::Pending;
use crate::run::previous_units::PreviousUnits;
use crate::run::runner::{Report, Runner};
use crate::run::skip_reasons::SkipReasons;
use crate::run::{Event, Run};
use crate::unit::Unit;

/// Units that are looked for at once, whether they were done before.
const LOOKED_FOR: usize = 256;

/// A run under way, unit by unit.
pub struct Driver<'r, 'a> {
    run: &'r Run<'a>,
    lease: &'r Lease,
    /// What `previous` means in it.
    pub previous: Previous,
    /// The units of the version before.
    held: PreviousUnits<'r>,
    /// Which artifacts are what was written.
    pub sound: Sound<'r>,
    units: Vec<Pending>,
    /// How many units each still waits for.
    waiting: Vec<usize>,
    /// The units that wait for each.
    dependents: Vec<Vec<usize>>,
    /// Those that are done.
    done: Vec<Option<Done>>,
    /// What the nodes of their plans are called.
    nodes: KnownNodes,
    /// Receipts that were taken away, as their rows are damaged.
    damaged: Mutex<Makers>,
}

impl<'r, 'a> Driver<'r, 'a> {
    /// A run of which nothing has been looked at yet.
    ///
    /// # Errors
    /// As [`Run::units`] and [`Run::previous`].
    pub fn new(run: &'r Run<'a>, lease: &'r Lease, sound: Sound<'r>) -> Result<Self, Fault> {
        let units = run.units()?;
        let mut dependents = vec![Vec::new(); units.len()];
        let mut waiting = Vec::with_capacity(units.len());
        for (index, unit) in units.iter().enumerate() {
            let before = unit.before();
            waiting.push(before.len());
            for earlier in before {
                dependents[earlier].push(index);
            }
        }
        Ok(Self {
            run,
            lease,
            previous: run.previous()?,
            held: run.held(),
            sound,
            waiting,
            dependents,
            done: units.iter().map(|_| None).collect(),
            nodes: KnownNodes::new(),
            damaged: Mutex::default(),
            units,
        })
    }

    /// How many units there are.
    pub fn units(&self) -> usize {
        self.units.len()
    }

    /// Runs all units that were not done before.
    ///
    /// # Errors
    /// The first unit's fault, after the units that were under way have ended.
    pub async fn drive(
        &mut self,
        runner: &dyn Runner,
        observe: &mut (dyn FnMut(Event<'_>) + Send),
    ) -> Result<(), Fault> {
        let (room, mut at_work) = (runner.room(), 0);
        let mut running = SelectAll::new();
        let is_ready = |index: &usize| self.waiting[*index] == 0;
        let mut ready: BTreeSet<usize> = (0..self.units.len()).filter(is_ready).collect();
        let mut first_fault: Option<Fault> = None;
        loop {
            // Many at once, as a store of objects answers late.
            if at_work <= room / 2 && first_fault.is_none() {
                let fresh = self.fresh(&mut ready, room - at_work, observe).await?;
                self.mend_previous(&fresh, runner).await?;
                for (index, _) in &fresh {
                    let label = &self.label(*index);
                    observe(Event::Started { label });
                }
                if !fresh.is_empty() {
                    at_work += fresh.len();
                    running.push(runner.start(fresh));
                }
            }
            match running.next().await {
                None => break,
                Some((index, Report::Advanced(share))) => {
                    let label = &self.label(index);
                    observe(Event::Advanced { label, share });
                }
                Some((index, Report::Ended(ended))) => {
                    at_work -= 1;
                    match ended {
                        Ok(receipt) => ready.extend(self.finish(index, *receipt, false, observe)),
                        Err(fault) => {
                            first_fault.get_or_insert_with(|| fault.at(self.label(index)));
                        }
                    }
                }
            }
        }
        first_fault.map_or(Ok(()), Err)
    }

    /// The first of the units that are ready and were not done before, at most so many. Those that were are done now, which may
    /// make others ready.
    async fn fresh(
        &mut self,
        ready: &mut BTreeSet<usize>,
        room: usize,
        observe: &mut (dyn FnMut(Event<'_>) + Send),
    ) -> Result<Vec<(usize, Unit)>, Fault> {
        let mut fresh = Vec::new();
        while fresh.len() < room && !ready.is_empty() {
            let most = LOOKED_FOR.min(room - fresh.len());
            let units: Vec<usize> = (0..most).map_while(|_| ready.pop_first()).collect();
            for (index, unit, receipt) in self.done_before(&units).await? {
                match receipt {
                    Some(receipt) => ready.extend(self.finish(index, receipt, true, observe)),
                    None => fresh.push((index, unit)),
                }
            }
        }
        fresh.sort_by_key(|(index, _)| *index);
        Ok(fresh)
    }

    /// These units, each with its receipt where it was done before and its rows are what was written then.
    async fn done_before(
        &self,
        units: &[usize],
    ) -> Result<Vec<(usize, Unit, Option<Receipt>)>, Fault> {
        each(units.iter().map(|index| self.found_before(*index))).await
    }

    async fn found_before(&self, index: usize) -> Result<(usize, Unit, Option<Receipt>), Fault> {
        let unit = self.unit(index).await?;
        let digest = unit.recipe.digest()?;
        let known = (&self.sound, &self.held);
        let found = self.run.found(known, &self.units[index], &digest);
        let receipt = match found.await? {
            Some((receipt, Some(damage))) => {
                tracing::warn!("{damage}; {} is made anew", self.label(index));
                // Nobody else is to take it for done.
                self.run.store.remove(&Receipt::name(&digest)).await?;
                locked(&self.damaged).insert(damage.file, receipt);
                None
            }
            found => found.map(|(receipt, _)| receipt),
        };
        Ok((index, unit, receipt))
    }

    /// Makes anew what these units read of the version before, where it is not what was written then.
    async fn mend_previous(
        &self,
        units: &[(usize, Unit)],
        runner: &dyn Runner,
    ) -> Result<(), Fault> {
        let layers = units
            .iter()
            .flat_map(|(_, unit)| unit.recipe.previous.values());
        let artifacts = layers.flat_map(|layer| &layer.artifacts);
        let damaged = self.sound.damages(artifacts).await?;
        let makers = locked(&self.damaged).clone();
        let mending = Mending {
            run: self.run,
            lease: self.lease,
            sound: &self.sound,
            runner,
        };
        mending.mend(damaged, makers).await
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
        self.done[index] = Some(Done::of(receipt, cached, &mut self.nodes));
        let mut ready = std::mem::take(&mut self.dependents[index]);
        ready.retain(|&later| {
            self.waiting[later] -= 1;
            self.waiting[later] == 0
        });
        ready
    }

    fn label(&self, index: usize) -> String {
        self.units[index].id.label()
    }

    async fn unit(&self, index: usize) -> Result<Unit, Fault> {
        let artifact = |earlier| Ok(self.end(earlier)?.artifact.clone());
        let unit = &self.units[index];
        let before = self.held.once(unit).await?;
        let unit = unit.assemble(self.run, &self.previous, before.as_ref(), artifact)?;
        Ok(Unit {
            lease: self.lease.name().to_owned(),
            ..unit
        })
    }

    fn end(&self, index: usize) -> Result<&Done, Fault> {
        let missing = || Fault::bug(format!("{} was not run", self.label(index)));
        self.done[index].as_ref().ok_or_else(missing)
    }

    /// What of the units that are done is no longer there, as far as sizes tell. Receipts that have vanished are written
    /// again.
    ///
    /// # Errors
    /// A resource fault when the store does not answer.
    pub async fn gone(&self) -> Result<Vec<Damage>, Fault> {
        let there = self.listed(RECEIPTS).await?;
        let vanished = |done: &Done| !there.contains_key(&Receipt::name(&done.digest));
        let vanished = self.ends().filter(|(_, done)| vanished(done));
        let again = each(vanished.map(|(index, done)| self.write_again(index, done))).await?;
        let sizes = self.listed(ARTIFACTS).await?;
        let gone = self.ends().filter_map(|(_, done)| {
            let size = sizes.get(&done.artifact.name()).copied();
            done.artifact.size_differs(size)
        });
        Ok(again.into_iter().flatten().chain(gone).collect())
    }

    /// The names in a folder of the map, with their sizes.
    async fn listed(&self, folder: &str) -> Result<BTreeMap<String, u64>, Fault> {
        Ok(self.run.store.list(folder).await?.into_iter().collect())
    }

    /// Writes a receipt again, whose recipe follows from what the unit read. Where that is not what it was, it is gone.
    async fn write_again(&self, index: usize, done: &Done) -> Result<Option<Damage>, Fault> {
        let recipe = self.unit(index).await?.recipe;
        if recipe.digest()? == done.digest {
            done.receipt(recipe).write(self.run.store).await?;
            return Ok(None);
        }
        Ok(Some(Damage {
            file: Receipt::name(&done.digest),
            expected: format!("the receipt of {}", self.label(index)),
            found: None,
        }))
    }

    /// The units that are done.
    fn ends(&self) -> impl Iterator<Item = (usize, &Done)> {
        let ends = self.done.iter().enumerate();
        ends.filter_map(|(index, done)| Some((index, done.as_ref()?)))
    }

    /// Every unit that is done, with its stage.
    pub fn done(self) -> Vec<(String, Done)> {
        let units = self.units.into_iter().zip(self.done);
        let done = units.filter_map(|(unit, done)| Some((unit.id.stage, done?)));
        done.collect()
    }

    /// The layers of the version that comes of it.
    ///
    /// # Errors
    /// A bug fault for a unit that was not run.
    pub fn layers(&self) -> Result<BTreeMap<String, StoredLayer>, Fault> {
        let mut layers: BTreeMap<String, StoredLayer> = BTreeMap::new();
        for (index, unit) in self.units.iter().enumerate() {
            let (stage, done) = (&unit.id.stage, self.end(index)?);
            let layer = layers.entry(stage.clone()).or_insert_with(|| StoredLayer {
                published: self.run.program.write.contains(stage),
                op: unit.stages.last().and_then(Stage::op).map(str::to_owned),
                ..StoredLayer::default()
            });
            layer.artifacts.push(done.artifact.clone());
            layer.recipes.push(done.digest.clone());
        }
        Ok(layers)
    }

    /// What was skipped or lost: operators' counts as [`SkipReasons`] has them, a log's counted once however many units
    /// read it.
    pub fn losses(&self) -> BTreeMap<String, u64> {
        let mut told = SkipReasons::default();
        for (index, done) in self.ends() {
            told.add(&self.units[index].id, &done.skipped);
        }
        let mut losses = told.lines();
        for (reason, count) in self.ends().flat_map(|(_, done)| &done.log_losses) {
            let held = losses.entry(reason.clone()).or_default();
            *held = (*held).max(*count);
        }
        losses
    }
}
