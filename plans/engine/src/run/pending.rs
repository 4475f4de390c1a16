//! The units of a run: what each waits for, and how it is put together when that is done.

use std::collections::{BTreeMap, BTreeSet};
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

/// A unit that cannot begin before others are done, as its recipe names the contents of what they make.
pub struct Pending {
    /// Which unit it is.
    pub id: UnitId,
    /// The stage and those that run inside it, in order.
    pub stages: Arc<[Stage]>,
    /// The units whose rows it reads.
    pub before: BTreeSet<UnitId>,
    /// The same, by the table that they are read as.
    tables: BTreeMap<Input, BTreeSet<UnitId>>,
    /// The sessions whose logs it reads.
    logs: BTreeSet<String>,
}

impl Run<'_> {
    /// All units, each after those that it waits for.
    ///
    /// # Errors
    /// A bug fault for a program that names a stage that there is not.
    pub fn units(&self) -> Result<Vec<Pending>, Fault> {
        let previous = self.previous()?;
        let sessions = Sessions::of(&self.sessions);
        let stored = self.program.stages.iter().filter(|stage| stage.stored);
        let units = stored.flat_map(|stage| {
            let stages: Arc<[Stage]> = self.program.fragment(&stage.name).into();
            let ids = UnitId::all(stage, &self.sessions).into_iter();
            ids.map(move |id| (id, Arc::clone(&stages)))
        });
        units
            .map(|(id, stages)| Pending::new(self, &sessions, &previous, id, stages))
            .collect()
    }
}

/// The sessions of a run, by what units cover: none looks at all of them for its own.
struct Sessions<'r> {
    sorted: &'r [MappedSession],
    of_site: BTreeMap<&'r str, Vec<&'r MappedSession>>,
}

impl<'r> Sessions<'r> {
    fn of(sorted: &'r [MappedSession]) -> Self {
        let mut of_site: BTreeMap<&str, Vec<_>> = BTreeMap::new();
        for session in sorted {
            let site = of_site.entry(&session.log.site);
            site.or_default().push(session);
        }
        Self { sorted, of_site }
    }

    /// Those that an extent covers, sorted by name.
    fn within(&self, extent: &Extent) -> Vec<&'r MappedSession> {
        match (&extent.session, &extent.site) {
            (Some(name), _) => MappedSession::named(self.sorted, name)
                .filter(|session| extent.covers(&session.log))
                .into_iter()
                .collect(),
            (None, Some(site)) => self.of_site.get(site.as_str()).cloned().unwrap_or_default(),
            (None, None) => self.sorted.iter().collect(),
        }
    }
}

impl Pending {
    /// Whether what was done once stays as it was then.
    pub fn is_done_once(&self) -> bool {
        self.stages.last().is_some_and(|stage| stage.once)
    }

    fn new(
        run: &Run<'_>,
        sessions: &Sessions<'_>,
        previous: &Previous,
        id: UnitId,
        stages: Arc<[Stage]>,
    ) -> Result<Self, Fault> {
        let mut tables: BTreeMap<Input, BTreeSet<UnitId>> = BTreeMap::new();
        let mut logs = BTreeSet::new();
        for read in stages.iter().flat_map(|stage| &stage.reads) {
            let reached = id.extent.reached(read.reach);
            let sessions = sessions.within(&reached).into_iter();
            if matches!(read.table, Input::Source(_)) || read.pixels.is_some() {
                logs.extend(sessions.clone().map(|session| session.log.session.clone()));
            }
            let ids = match &read.table {
                Input::Step(name) => {
                    let made = run.program.stage(name)?;
                    if !made.stored {
                        continue;
                    }
                    UnitId::all(made, sessions)
                }
                Input::New(name) => {
                    let new = sessions.filter(|session| previous.is_new(&session.log.session));
                    UnitId::all(run.program.stage(name)?, new)
                }
                Input::Source(_) | Input::Previous(_) => continue,
            };
            tables.entry(read.table.clone()).or_default().extend(ids);
        }
        Ok(Self {
            id,
            stages,
            before: tables.values().flatten().cloned().collect(),
            tables,
            logs,
        })
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
        artifact: impl Fn(&UnitId) -> Result<Artifact, Fault>,
    ) -> Result<Unit, Fault> {
        let extent = self.id.extent.clone();
        let site = extent.site.as_ref();
        let layers = previous.concerning(run.program, &self.stages, site);
        let mut recipe = Recipe::new(Arc::clone(&self.stages), extent);
        for (table, ids) in &self.tables {
            let artifacts = ids.iter().map(&artifact).collect::<Result<_, _>>()?;
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
        let logs = self.logs.iter();
        let logs = logs.filter_map(|name| MappedSession::named(&run.sessions, name));
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
            sessions: vec![session("a", "s"), session("b", "s"), session("c", "t")],
            base: None,
            limits: Limits::one_partition(),
        };
        let no_rows = |id: &UnitId| Err(Fault::bug(id.label()));
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
