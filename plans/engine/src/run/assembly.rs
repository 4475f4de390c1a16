//! A unit, put together when all that it reads is known.

use std::collections::BTreeMap;

use evermap_schemas::Fault;

use crate::map::receipt::{Artifact, Recipe};
use crate::map::version::Previous;
use crate::program::Stage;
use crate::run::instance::{Instance, Needs};
use crate::run::{Run, RunSession};
use crate::unit::Unit;

/// The unit of `stage` for `instance`, which reads what `artifact` says that the units before it left.
///
/// # Errors
/// What `artifact` says, or a bug fault for a stage that there is not.
pub fn assemble(
    run: &Run<'_>,
    previous: &Previous,
    stage: &Stage,
    instance: &Instance,
    needs: &Needs,
    artifact: impl Fn(&(String, Instance)) -> Result<Artifact, Fault>,
) -> Result<Unit, Fault> {
    let (session, site) = instance.names(&run.sessions);
    let mut recipe = Recipe::new(run.program.fragment(&stage.name)?, session, site);
    let mut tables = BTreeMap::new();
    for (name, places) in &needs.tables {
        let artifacts = places
            .iter()
            .map(|place| artifact(&(name.clone(), place.clone())));
        let artifacts = artifacts.collect::<Result<Vec<_>, _>>()?;
        recipe.tables.insert(name.clone(), contents(&artifacts));
        tables.insert(name.clone(), artifacts);
    }
    let previous = previous.concerning(run.program, &recipe.stages, instance, &run.sessions);
    for (name, layer) in &previous {
        recipe
            .previous
            .insert(name.clone(), contents(&layer.artifacts));
        recipe.replaced.clone_from(&layer.without);
    }
    let logs: Vec<&RunSession> = run
        .sessions
        .iter()
        .filter(|session| needs.logs.contains(&session.log.session))
        .collect();
    recipe.logs = logs.iter().map(|session| session.log.clone()).collect();
    let logs = logs
        .iter()
        .map(|session| session.manifest.clone())
        .collect();
    Ok(Unit {
        store: run.store.url().to_string(),
        recipe,
        tables,
        previous,
        logs,
        memory_bytes: run.limits.memory_bytes,
        partitions: run.limits.partitions,
    })
}

fn contents(artifacts: &[Artifact]) -> Vec<String> {
    artifacts
        .iter()
        .map(|artifact| artifact.content.clone())
        .collect()
}
