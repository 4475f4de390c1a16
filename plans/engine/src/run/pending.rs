//! The units of a run: what each waits for, and how it is put together when that is done.

use std::collections::{BTreeMap, BTreeSet};

use evermap_language::Input;
use evermap_schemas::Fault;

use crate::map::receipt::{Artifact, Recipe};
use crate::map::version::Previous;
use crate::program::Stage;
use crate::run::instance::{Instance, Place};
use crate::run::{Run, RunSession};
use crate::unit::Unit;

/// A unit that cannot begin before others are done, as its recipe names the contents of what they make.
pub struct Pending {
    /// Which unit it is.
    pub place: Place,
    /// The stage and those that run inside it, in order.
    pub stages: Vec<Stage>,
    /// The units whose rows it reads.
    pub before: BTreeSet<Place>,
    /// The sessions whose logs it reads.
    logs: BTreeSet<String>,
}

impl Run<'_> {
    /// All units, each after those that it waits for.
    ///
    /// # Errors
    /// A bug fault for a program that names a stage that there is not.
    pub fn units(&self) -> Result<Vec<Pending>, Fault> {
        let stored = self.program.stages.iter().filter(|stage| stage.stored);
        let unit = |(stage, instance): (&Stage, Instance)| Pending::new(self, stage, instance);
        stored
            .flat_map(|stage| {
                let instances = Instance::all(stage.scope, &self.sessions);
                instances.into_iter().map(move |instance| (stage, instance))
            })
            .map(unit)
            .collect()
    }
}

impl Pending {
    fn new(run: &Run<'_>, stage: &Stage, instance: Instance) -> Result<Self, Fault> {
        let stages = run.program.fragment(&stage.name);
        let (mut before, mut logs) = (BTreeSet::new(), BTreeSet::new());
        for read in stages.iter().flat_map(|stage| &stage.reads) {
            let sessions = instance.reached(read.reach, &run.sessions);
            if matches!(read.table, Input::Source(_)) || !read.pixels.is_empty() {
                let names = sessions.iter().map(|session| session.log.session.clone());
                logs.extend(names);
            }
            if let Input::Step(name) = &read.table {
                let made = run.program.stage(name)?;
                if made.stored {
                    let instances = Instance::all(made.scope, sessions);
                    before.extend(instances.into_iter().map(|instance| Place {
                        stage: name.clone(),
                        instance,
                    }));
                }
            }
        }
        let place = Place {
            stage: stage.name.clone(),
            instance,
        };
        Ok(Self {
            place,
            stages,
            before,
            logs,
        })
    }

    /// The unit, which reads what `artifact` says that the units before it left.
    ///
    /// # Errors
    /// What `artifact` says.
    pub fn assemble(
        &self,
        run: &Run<'_>,
        previous: &Previous,
        artifact: impl Fn(&Place) -> Result<Artifact, Fault>,
    ) -> Result<Unit, Fault> {
        let (session, site) = self.place.instance.names(&run.sessions);
        let previous = previous.concerning(run.program, &self.stages, site.as_ref());
        let mut recipe = Recipe::new(self.stages.clone(), session, site);
        let mut tables: BTreeMap<String, Vec<Artifact>> = BTreeMap::new();
        for place in &self.before {
            let rows = tables.entry(place.stage.clone()).or_default();
            rows.push(artifact(place)?);
        }
        for (name, artifacts) in &tables {
            recipe.tables.insert(name.clone(), contents(artifacts));
        }
        for (name, layer) in &previous {
            let contents = contents(&layer.artifacts);
            recipe.previous.insert(name.clone(), contents);
            recipe.replaced.clone_from(&layer.without);
        }
        let read = |session: &&RunSession| self.logs.contains(&session.log.session);
        let logs = run.sessions.iter().filter(read);
        recipe.logs = logs.clone().map(|session| session.log.clone()).collect();
        Ok(Unit {
            store: run.store.url().to_string(),
            recipe,
            tables,
            previous,
            logs: logs.map(|session| session.manifest.clone()).collect(),
            limits: run.limits,
        })
    }
}

fn contents(artifacts: &[Artifact]) -> Vec<String> {
    let contents = artifacts.iter().map(|artifact| artifact.content.clone());
    contents.collect()
}
