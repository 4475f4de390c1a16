//! What `previous` means in a run: the layers of the version before, and which of their rows still hold.
//!
//! A run that does what the latest version was made by, on the same logs, is the same run: `previous` then means what
//! it meant in that run, and not its own result. Otherwise no map would ever come to rest (decision 6).

use std::collections::{BTreeMap, BTreeSet};

use evermap_schemas::Fault;

use crate::map::receipt::Artifact;
use crate::map::version::{MappedSession, Previous, Version};
use crate::program::{Program, Stage, Table};
use crate::run::RunSession;
use crate::run::instance::Instance;
use crate::unit::PreviousLayer;

impl Previous {
    /// What `previous` means for a program on these sessions, when the map is at `base`.
    ///
    /// # Errors
    /// As [`Program::digest`].
    pub fn of(
        program: &Program,
        sessions: &[RunSession],
        base: Option<&Version>,
    ) -> Result<Self, Fault> {
        let Some(base) = base else {
            return Ok(Self::default());
        };
        if base.program == program.digest()? && same_logs(base, sessions) {
            return Ok(base.previous.clone());
        }
        let layers = names(&program.stages).into_iter().filter_map(|name| {
            let held = base.layers.get(name)?;
            Some((name.clone(), held.artifacts.clone()))
        });
        Ok(Self {
            version: base.version,
            layers: layers.collect(),
            replaced: replaced(base, sessions),
        })
    }

    /// The layers that these stages read, as far as they concern the instance.
    pub fn concerning(
        &self,
        program: &Program,
        stages: &[Stage],
        instance: &Instance,
        sessions: &[RunSession],
    ) -> BTreeMap<String, PreviousLayer> {
        let site = instance.names(sessions).1;
        let concerns = |artifact: &&Artifact| {
            let here = site.is_none() || artifact.site.is_none() || artifact.site == site;
            let holds = artifact
                .session
                .as_ref()
                .is_none_or(|session| !self.replaced.contains(session));
            here && holds
        };
        let layer = |name: &String| {
            let held = self.layers.get(name).map_or(&[][..], Vec::as_slice);
            PreviousLayer {
                op: program
                    .stage(name)
                    .ok()
                    .and_then(Stage::op)
                    .map(str::to_owned),
                artifacts: held.iter().filter(concerns).cloned().collect(),
                without: self.replaced.clone(),
            }
        };
        names(stages)
            .into_iter()
            .map(|name| (name.clone(), layer(name)))
            .collect()
    }

    /// Layers that the program reads of the version before, which that version does not have.
    pub fn missing<'p>(&self, program: &'p Program) -> Vec<&'p String> {
        let mut missing = names(&program.stages);
        missing.retain(|name| !self.layers.contains_key(*name));
        missing.into_iter().collect()
    }
}

/// Names of the layers that stages read of the version before.
fn names(stages: &[Stage]) -> BTreeSet<&String> {
    stages
        .iter()
        .flat_map(|stage| stage.task.inputs())
        .filter_map(|table| match table {
            Table::Previous(name) => Some(name),
            _ => None,
        })
        .collect()
}

/// Whether a version is made of just these logs, wherever they lie.
fn same_logs(base: &Version, sessions: &[RunSession]) -> bool {
    let held = base.sessions.iter().map(|session| &session.log);
    held.eq(sessions.iter().map(|session| &session.log))
}

fn replaced(base: &Version, sessions: &[RunSession]) -> Vec<String> {
    let other = |held: &&MappedSession| sessions.iter().all(|session| session.log != held.log);
    base.sessions
        .iter()
        .filter(other)
        .map(|held| held.log.session.clone())
        .collect()
}
