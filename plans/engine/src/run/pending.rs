//! The units of a run: what each waits for, and how it is put together when that is done.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;
use std::sync::Arc;

use evermap_language::Input;
use evermap_schemas::Fault;

use crate::map::receipt::{Artifact, Extent, LayerRows, Receipt, Recipe};
use crate::map::version::{MappedSession, Previous};
use crate::program::Stage;
use crate::run::Run;
use crate::unit::Unit;

/// Which unit of a program.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct UnitId {
    /// Its stage.
    pub stage: String,
    /// What it covers.
    pub extent: Extent,
}

impl UnitId {
    /// The units of a stage on these sessions, sorted.
    fn all<'s>(
        stage: &Stage,
        sessions: impl IntoIterator<Item = &'s MappedSession>,
    ) -> BTreeSet<Self> {
        let id = |session: &MappedSession| Self {
            stage: stage.name.clone(),
            extent: Extent::of(stage.scope, &session.log),
        };
        sessions.into_iter().map(id).collect()
    }

    /// What a person calls it.
    pub fn label(&self) -> String {
        self.extent.label(&self.stage)
    }
}

/// A unit that cannot begin before others are done, as its recipe names the contents of what they make. There may be
/// hundreds of thousands, and a unit of a site reads those of all its sessions: others are known by their numbers.
pub struct Pending {
    /// Which unit it is.
    pub id: UnitId,
    /// The stage and those that run inside it, in order.
    pub stages: Arc<[Stage]>,
    /// The units whose rows it reads, ascending, by the table that they are read as.
    tables: Box<[(Input, Box<[usize]>)]>,
    /// The sessions of the run whose logs it reads, ascending.
    logs: Box<[usize]>,
}

impl Run<'_> {
    /// All units, each after those that it waits for.
    ///
    /// # Errors
    /// A bug fault for a program that names a stage that there is not.
    pub fn units(&self) -> Result<Vec<Pending>, Fault> {
        let mut planning = Planning {
            run: self,
            previous: self.previous()?,
            of_site: of_sites(self.sessions),
            units: Vec::new(),
            of_stage: BTreeMap::new(),
        };
        for stage in self.program.stages.iter().filter(|stage| stage.stored) {
            planning.add(stage)?;
        }
        Ok(planning.units)
    }
}

/// Units of a run so far. None looks at all sessions, or units, for its own.
struct Planning<'r, 'a> {
    run: &'r Run<'a>,
    previous: Previous,
    /// The sessions of a site, by number.
    of_site: BTreeMap<&'r str, Vec<usize>>,
    units: Vec<Pending>,
    /// Where the units of a stage are, sorted.
    of_stage: BTreeMap<&'r str, Range<usize>>,
}

fn of_sites(sessions: &[MappedSession]) -> BTreeMap<&str, Vec<usize>> {
    let mut of_site: BTreeMap<&str, Vec<usize>> = BTreeMap::new();
    for (number, session) in sessions.iter().enumerate() {
        of_site.entry(&session.log.site).or_default().push(number);
    }
    of_site
}

impl<'r> Planning<'r, '_> {
    /// Adds the units of a stage.
    fn add(&mut self, stage: &'r Stage) -> Result<(), Fault> {
        let stages: Arc<[Stage]> = self.run.program.fragment(&stage.name).into();
        let start = self.units.len();
        for id in UnitId::all(stage, self.run.sessions) {
            let unit = self.unit(id, Arc::clone(&stages))?;
            self.units.push(unit);
        }
        self.of_stage.insert(&stage.name, start..self.units.len());
        Ok(())
    }

    fn unit(&self, id: UnitId, stages: Arc<[Stage]>) -> Result<Pending, Fault> {
        let mut tables: BTreeMap<&Input, BTreeSet<usize>> = BTreeMap::new();
        let mut logs = BTreeSet::new();
        for read in stages.iter().flat_map(|stage| &stage.reads) {
            let mut sessions = self.within(&id.extent.reached(read.reach));
            if matches!(read.table, Input::Source(_)) || read.pixels.is_some() {
                logs.extend(&sessions);
            }
            let name = match &read.table {
                Input::Step(name) => name,
                Input::New(name) => {
                    sessions.retain(|number| self.previous.is_new(self.name(*number)));
                    name
                }
                Input::Source(_) | Input::Previous(_) => continue,
            };
            let made = self.run.program.stage(name)?;
            if made.stored {
                let units = self.numbers(made, &sessions)?;
                tables.entry(&read.table).or_default().extend(units);
            }
        }
        let tables = tables.into_iter();
        let tables = tables.map(|(table, units)| (table.clone(), units.into_iter().collect()));
        Ok(Pending {
            tables: tables.collect(),
            logs: logs.into_iter().collect(),
            id,
            stages,
        })
    }

    /// The sessions that an extent covers, ascending.
    fn within(&self, extent: &Extent) -> Vec<usize> {
        let sessions = self.run.sessions;
        match (&extent.session, &extent.site) {
            (Some(name), _) => MappedSession::place(sessions, name)
                .filter(|number| extent.covers(&sessions[*number].log))
                .into_iter()
                .collect(),
            (None, Some(site)) => self.of_site.get(site.as_str()).cloned().unwrap_or_default(),
            (None, None) => (0..sessions.len()).collect(),
        }
    }

    /// The units of a stage on these sessions.
    fn numbers(&self, stage: &Stage, sessions: &[usize]) -> Result<Vec<usize>, Fault> {
        let later = || Fault::bug(format!("{} comes after what reads it", stage.name));
        let range = self.of_stage.get(stage.name.as_str()).ok_or_else(later)?;
        let (start, units) = (range.start, &self.units[range.clone()]);
        let number = |session: &usize| {
            let extent = Extent::of(stage.scope, &self.run.sessions[*session].log);
            let place = units.binary_search_by(|unit| unit.id.extent.cmp(&extent));
            place.map(|place| start + place).map_err(|_| later())
        };
        sessions.iter().map(number).collect()
    }

    fn name(&self, session: usize) -> &str {
        &self.run.sessions[session].log.session
    }
}

impl Pending {
    /// Whether what was done once stays as it was then.
    pub fn is_done_once(&self) -> bool {
        self.stages.last().is_some_and(|stage| stage.once)
    }

    /// The units whose rows it reads.
    pub fn before(&self) -> BTreeSet<usize> {
        let units = self.tables.iter().flat_map(|(_, units)| units);
        units.copied().collect()
    }

    /// The unit, which reads what `artifact` says that the units before it left. `before` is the receipt of the unit of
    /// the same name in the version before: what is done once is done as it was then.
    ///
    /// # Errors
    /// What `artifact` says.
    pub fn assemble(
        &self,
        run: &Run<'_>,
        previous: &Previous,
        before: Option<&Receipt>,
        artifact: impl Fn(usize) -> Result<Artifact, Fault>,
    ) -> Result<Unit, Fault> {
        let extent = self.id.extent.clone();
        let site = extent.site.as_ref();
        let layers = previous.concerning(run.program, &self.stages, site);
        let mut recipe = Recipe::new(Arc::clone(&self.stages), extent);
        for (table, units) in &self.tables {
            let artifacts = units
                .iter()
                .map(|unit| artifact(*unit))
                .collect::<Result<_, _>>()?;
            if let Input::New(name) = table {
                let op = run.program.stage(name)?.op().map(str::to_owned);
                let artifacts = Artifact::with_rows(artifacts);
                recipe.new.insert(name.clone(), LayerRows { op, artifacts });
            } else {
                let artifacts = Artifact::with_rows_or_columns(artifacts, &recipe.extent);
                recipe.tables.insert(table.written(), artifacts);
            }
        }
        if !layers.is_empty() {
            recipe.replaced.clone_from(&previous.replaced);
        }
        recipe.previous = layers;
        let logs = self.logs.iter().map(|session| &run.sessions[*session]);
        recipe.logs = logs.clone().map(|session| session.log.clone()).collect();
        if self.is_done_once()
            && let Some(before) = before
        {
            recipe = recipe.as_of(&before.recipe, !previous.replaced.is_empty());
        }
        Ok(Unit {
            store: run.store.url().to_string(),
            recipe,
            logs: logs.map(|session| session.manifest.clone()).collect(),
            limits: run.limits,
            lease: String::new(),
        })
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use datafusion::execution::runtime_env::RuntimeEnv;
    use evermap_contract::{Entry, Operator, Port, Registry, Work};
    use evermap_datasets::{Dataset, Manifest};
    use evermap_language::Source;
    use evermap_schemas::roles::{Frame, LabelClass};
    use schemars::JsonSchema;
    use serde::{Deserialize, Serialize};

    use super::*;
    use crate::map::receipt::LogContent;
    use crate::map::store::Store;
    use crate::prepare::{PlanText, check};
    use crate::sql::Limits;

    #[derive(Default, Clone, Serialize, Deserialize, JsonSchema)]
    struct Params {}

    /// Reads frames of a session beside the classes of its site.
    struct Labels;
    impl Operator for Labels {
        const NAME: &'static str = "labels";
        const VERSION: u32 = 1;
        const PAGE: &'static str = "";
        type Params = Params;
        type Output = LabelClass;
        fn work() -> Work<Params> {
            Work::each_row(
                Port::session::<Frame>("frames"),
                vec![Port::site::<LabelClass>("classes")],
                |_, _| Ok(()),
                |_, _: Frame| Ok(None::<LabelClass>),
            )
        }
    }

    fn session(name: &str, site: &str) -> MappedSession {
        MappedSession {
            log: LogContent {
                session: name.into(),
                site: site.into(),
                content: name.into(),
                roles: String::new(),
            },
            manifest: Manifest::default(),
            times: None,
        }
    }

    #[tokio::test]
    async fn a_side_of_the_site_that_logs_feed_reads_those_of_all_its_sessions() {
        let text = "plan: p\nsteps:\n  labels: { op: labels, in: { classes: label_classes } }\nwrite: [labels]";
        let plan = PlanText {
            source: Source {
                origin: "p.yaml".into(),
                text: text.into(),
            },
            find: |name, _| Err(format!("no plan {name}")),
            settings: Vec::new(),
            manifest: None,
        };
        let registry = Registry::new([Entry::of::<Labels>()]);
        let logs = Dataset::open(&RuntimeEnv::default(), &[], None).await;
        let (_, program) = check(&plan, &registry, &logs.unwrap()).await.unwrap();
        let folder = tempfile::tempdir().unwrap();
        let run = Run {
            program: &program,
            registry: &registry,
            store: &Store::open(folder.path().to_str().unwrap(), true).unwrap(),
            sessions: &[session("a", "s"), session("b", "s"), session("c", "t")],
            base: None,
            limits: Limits::one_partition(),
        };
        let no_rows = |unit| Err(Fault::bug(format!("unit {unit}")));
        let read: Vec<(String, Vec<String>)> = run
            .units()
            .unwrap()
            .iter()
            .map(|unit| {
                let unit = unit
                    .assemble(&run, &Previous::default(), None, no_rows)
                    .unwrap();
                let logs = unit.recipe.logs.iter();
                (unit.label(), logs.map(|log| log.session.clone()).collect())
            })
            .collect();
        let expected = [
            ("labels of a", vec!["a", "b"]),
            ("labels of b", vec!["a", "b"]),
            ("labels of c", vec!["c"]),
        ];
        let expected = expected.map(|(unit, logs)| {
            let logs: Vec<String> = logs.into_iter().map(str::to_owned).collect();
            (unit.to_owned(), logs)
        });
        assert_eq!(read, expected);
    }
}
