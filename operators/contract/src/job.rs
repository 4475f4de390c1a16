//! An operator at work on the tables of a unit: what both engines drive.
//!
//! ```text
//!  sides ──► Job (prepared, once) ──┬──► Worker ◄── rows of a partition ──► rows
//!                                   └──► Worker ◄── rows of a partition ──► rows
//! ```
//! A worker cuts what it is given by site and by key, so that a kernel sees rows of one site only.

use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};

use arrow::array::RecordBatch;
use evermap_schemas::{Bytes, Fault, Layer, LayerRow, rows};
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::fold::StateRow;
use crate::kernel::{Folding, GroupOpener, Kernel, Mapper, Prepare, Rows};
use crate::sides::{runs_of_equal, same_group, site_of};
use crate::{Emit, Entry, Key, Port, Shape, Sides};

/// Which part of an operator's work is done.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Phase {
    /// All of it: Map and Group.
    Run,
    /// A fold's rows to states.
    Lift,
    /// A fold's states to rows.
    Merge,
}

/// What drives a phase, and how its rows must come.
#[derive(Debug, Clone)]
pub struct Driving {
    /// The port; `states` for a merge.
    pub port: Port,
    /// Columns whose equal values must come together; none where any split will do.
    pub group: &'static [&'static str],
    /// Columns that the rows are ordered by.
    pub sorting: Vec<&'static str>,
}

/// The states of one key.
const STATES: Key = Key {
    columns: &["site", "key"],
    order: &[],
};

impl Entry {
    /// What drives a phase.
    pub fn driving(&self, phase: Phase) -> Driving {
        let (port, key) = match (phase, self.shape) {
            (Phase::Merge, _) => (Port::site::<StateRow>("states"), Some(STATES)),
            (_, Shape::Group(key)) => (self.ports[0].clone(), Some(key)),
            _ => (self.ports[0].clone(), None),
        };
        Driving {
            group: key.map_or(&[], |key| key.columns),
            sorting: key.map_or_else(Vec::new, |key| key.sorting(&port.layer)),
            port,
        }
    }

    /// The other ports of a phase.
    pub fn sides(&self, phase: Phase) -> &[Port] {
        match phase {
            Phase::Merge => &[],
            Phase::Run | Phase::Lift => &self.ports[1..],
        }
    }

    /// The layer whose rows a phase yields.
    pub fn yields(&self, phase: Phase) -> Layer {
        match phase {
            Phase::Lift => StateRow::layer(),
            Phase::Run | Phase::Merge => self.output.clone(),
        }
    }
}

/// An operator with parameters and sides, ready for the rows of one unit. Partitions share it.
pub struct Job {
    work: Work,
    idle: bool,
}

enum Work {
    Map(BySite<Mapper>),
    Group(Groups),
    Lift(BySite<Box<dyn Folding>>),
    Merge(Box<dyn Folding>),
}

impl Job {
    /// Prepares for each site that the sides tell of. This may take long and use all threads of the current pool.
    ///
    /// # Errors
    /// A user fault for parameters that make no sense, a data fault for such sides.
    pub fn new(entry: &Entry, params: &Value, phase: Phase, sides: Sides) -> Result<Self, Fault> {
        let ports = entry.sides(phase);
        let idle = sides.lacks(ports);
        let work = match (entry.kernel(params)?, phase) {
            (Kernel::Map(prepare), _) => Work::Map(BySite::new(&prepare, ports, &sides)?),
            (Kernel::Group(open), _) => Work::Group(Groups {
                open,
                columns: entry.driving(phase).group,
                ports: ports.to_vec(),
                sides: Mutex::new(sides),
            }),
            (Kernel::Fold(prepare), Phase::Merge) => Work::Merge(prepare(&Sides::default())?),
            (Kernel::Fold(prepare), _) => Work::Lift(BySite::new(&prepare, ports, &sides)?),
        };
        Ok(Self { work, idle })
    }

    /// Whether a table that is needed is empty: nothing comes of any driving rows, so that they need not be read.
    pub fn is_idle(&self) -> bool {
        self.idle
    }

    /// A worker for one partition of the driving rows.
    pub fn worker(&self) -> Box<dyn Worker + '_> {
        match &self.work {
            Work::Map(mappers) => Box::new(MapWorker(mappers)),
            Work::Group(groups) => Box::new(GroupWorker { groups, open: None }),
            Work::Lift(folds) => Box::new(LiftWorker {
                folds,
                lifters: BTreeMap::new(),
            }),
            Work::Merge(fold) => Box::new(MergeWorker {
                fold: fold.as_ref(),
                open: None,
            }),
        }
    }
}

/// Takes the rows of one partition, in the order that [`Driving`] says.
pub trait Worker: Send {
    /// Takes the next rows.
    ///
    /// # Errors
    /// Only what makes the whole run senseless; bad rows are skipped and counted.
    fn push(&mut self, rows: &RecordBatch, emit: &mut Emit<'_>) -> Result<(), Fault>;

    /// Rows that it has taken, but works on when all of their key are there.
    fn held(&self) -> usize {
        0
    }

    /// There are no more rows.
    ///
    /// # Errors
    /// As [`Worker::push`].
    fn close(&mut self, emit: &mut Emit<'_>) -> Result<(), Fault>;
}

/// What was prepared for each site of the sides, and for sites that they do not tell of; nothing where a table that is
/// needed has no rows of it.
struct BySite<T> {
    sites: BTreeMap<String, Option<T>>,
    unknown: Option<T>,
}

impl<T> BySite<T> {
    fn new(prepare: &Prepare<T>, ports: &[Port], sides: &Sides) -> Result<Self, Fault> {
        let prepared = |sides: &Sides| {
            let there = !sides.lacks(ports);
            there.then(|| prepare(sides)).transpose()
        };
        let sites = sides.by_site()?.into_iter();
        Ok(Self {
            sites: sites
                .map(|(site, sides)| Ok((site, prepared(&sides)?)))
                .collect::<Result<_, Fault>>()?,
            unknown: prepared(&sides.everywhere())?,
        })
    }

    fn of(&self, site: &str) -> Option<&T> {
        self.sites.get(site).unwrap_or(&self.unknown).as_ref()
    }
}

struct MapWorker<'j>(&'j BySite<Mapper>);

impl Worker for MapWorker<'_> {
    fn push(&mut self, rows: &RecordBatch, emit: &mut Emit<'_>) -> Result<(), Fault> {
        for run in runs_of_equal(rows, &["site"])? {
            if let Some(mapper) = self.0.of(site_of(&run).unwrap_or_default()) {
                mapper(&run, emit)?;
            }
        }
        Ok(())
    }

    fn close(&mut self, _: &mut Emit<'_>) -> Result<(), Fault> {
        Ok(())
    }
}

struct Groups {
    open: GroupOpener,
    columns: &'static [&'static str],
    ports: Vec<Port>,
    /// What no group has taken with it.
    sides: Mutex<Sides>,
}

impl Groups {
    /// Begins with the group of these rows, unless a table that is needed has none of it.
    fn begin(&self, run: &RecordBatch) -> Result<Option<Box<dyn Rows>>, Fault> {
        let mut sides = self.sides.lock().unwrap_or_else(PoisonError::into_inner);
        let own = sides.leave(&self.ports, run, self.columns)?;
        drop(sides);
        let there = !own.lacks(&self.ports);
        there.then(|| (self.open)(own)).transpose()
    }
}

struct GroupWorker<'j> {
    groups: &'j Groups,
    /// The first row of the key at hand, and its group where there is something to do.
    open: Option<(RecordBatch, Option<Box<dyn Rows>>)>,
}

impl Worker for GroupWorker<'_> {
    fn push(&mut self, rows: &RecordBatch, emit: &mut Emit<'_>) -> Result<(), Fault> {
        let columns = self.groups.columns;
        for run in runs_of_equal(rows, columns)? {
            let goes_on = |(first, _): &(RecordBatch, _)| same_group(first, &run, columns);
            if !self.open.as_ref().is_some_and(goes_on) {
                self.close(emit)?;
                self.open = Some((run.slice(0, 1), self.groups.begin(&run)?));
            }
            if let Some((_, Some(group))) = &mut self.open {
                group.push(&run, emit)?;
            }
        }
        Ok(())
    }

    fn held(&self) -> usize {
        match &self.open {
            Some((_, Some(group))) => group.held(),
            _ => 0,
        }
    }

    fn close(&mut self, emit: &mut Emit<'_>) -> Result<(), Fault> {
        match self.open.take() {
            Some((_, Some(group))) => group.close(emit),
            _ => Ok(()),
        }
    }
}

struct LiftWorker<'j> {
    folds: &'j BySite<Box<dyn Folding>>,
    lifters: BTreeMap<String, Box<dyn Rows + 'j>>,
}

impl Worker for LiftWorker<'_> {
    fn push(&mut self, rows: &RecordBatch, emit: &mut Emit<'_>) -> Result<(), Fault> {
        for run in runs_of_equal(rows, &["site"])? {
            let site = site_of(&run).unwrap_or_default();
            if let Some(fold) = self.folds.of(site) {
                let begin = || fold.lifter(site);
                let lifter = self.lifters.entry(site.to_owned()).or_insert_with(begin);
                lifter.push(&run, emit)?;
            }
        }
        Ok(())
    }

    fn close(&mut self, emit: &mut Emit<'_>) -> Result<(), Fault> {
        std::mem::take(&mut self.lifters)
            .into_values()
            .try_for_each(|lifter| lifter.close(emit))
    }
}

struct MergeWorker<'j> {
    fold: &'j dyn Folding,
    /// The key at hand, and its states so far.
    open: Option<(String, Bytes, Vec<Bytes>)>,
}

impl Worker for MergeWorker<'_> {
    fn push(&mut self, batch: &RecordBatch, emit: &mut Emit<'_>) -> Result<(), Fault> {
        for StateRow { site, key, state } in rows(batch)? {
            match &mut self.open {
                Some((open_site, open_key, states)) if *open_site == site && *open_key == key => {
                    states.push(state);
                }
                _ => {
                    self.close(emit)?;
                    self.open = Some((site, key, vec![state]));
                }
            }
        }
        Ok(())
    }

    fn held(&self) -> usize {
        self.open.as_ref().map_or(0, |(_, _, states)| states.len())
    }

    fn close(&mut self, emit: &mut Emit<'_>) -> Result<(), Fault> {
        match self.open.take() {
            Some((site, key, states)) => self.fold.finish(&site, &key, states, emit),
            None => Ok(()),
        }
    }
}
