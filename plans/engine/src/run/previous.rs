//! What `previous` means in a run: the layers of the version before, and which of their rows still hold.
//!
//! A run that does what the latest version was made by, on the same logs, is the same run: `previous` then means what
//! it meant in that run, and not its own result. Otherwise no map would ever come to rest (decision 6).

use std::collections::{BTreeMap, BTreeSet};

use evermap_language::Input;
use evermap_schemas::Fault;

use crate::map::receipt::{Artifact, Extent, LayerRows, LogContent};
use crate::map::version::{MappedSession, Previous, Version};
use crate::program::{Program, Stage};

impl Previous {
    /// What `previous` means for a program on these sessions, when the map is at `base`.
    ///
    /// # Errors
    /// As [`Program::digest`].
    pub fn of(
        program: &Program,
        sessions: &[MappedSession],
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
        let begins_anew = Self::begins_anew(program, base);
        let had = |log: &LogContent| !begins_anew && holds(sessions, log);
        Ok(Self {
            version: base.version,
            layers: layers.collect(),
            replaced: sessions_of(base, |log| !holds(sessions, log)),
            sessions: sessions_of(base, had),
        })
    }

    /// Whether a version has none of the layers that a program reads of the version before: another plan made it, and its
    /// sessions are new to this one.
    pub fn begins_anew(program: &Program, base: &Version) -> bool {
        let read = names(&program.stages);
        !read.is_empty() && Self::missing(program, base).len() == read.len()
    }

    /// The layers that these stages read, as far as they concern a site; everything where none is given.
    pub fn concerning(
        &self,
        program: &Program,
        stages: &[Stage],
        site: Option<&String>,
    ) -> BTreeMap<String, LayerRows> {
        let concerns = |artifact: &&Artifact| {
            let Extent { session, site: of } = &artifact.extent;
            let here = site.is_none() || of.is_none() || of.as_ref() == site;
            let replaced = |session| self.replaced.contains(session);
            here && !session.as_ref().is_some_and(replaced)
        };
        let layer = |name: &String| {
            let held = self.layers.get(name).map_or(&[][..], Vec::as_slice);
            let made = program.stage(name).ok();
            LayerRows {
                op: made.and_then(Stage::op).map(str::to_owned),
                artifacts: Artifact::with_rows(held.iter().filter(concerns).cloned().collect()),
            }
        };
        let names = names(stages).into_iter();
        names.map(|name| (name.clone(), layer(name))).collect()
    }

    /// Whether the version before did not have a session, had another log of it, or has nothing of any.
    pub fn is_new(&self, session: &str) -> bool {
        !self.sessions.iter().any(|held| held == session)
    }

    /// Layers that a program reads of the version before, which that version does not have.
    pub fn missing(program: &Program, base: &Version) -> Vec<String> {
        let mut missing = names(&program.stages);
        missing.retain(|name| !base.layers.contains_key(*name));
        missing.into_iter().cloned().collect()
    }
}

/// Names of the layers that stages read of the version before.
fn names(stages: &[Stage]) -> BTreeSet<&String> {
    let reads = stages.iter().flat_map(|stage| &stage.reads);
    reads
        .filter_map(|read| match &read.table {
            Input::Previous(name) => Some(name),
            _ => None,
        })
        .collect()
}

/// Whether a version is made of just these logs, wherever they lie.
fn same_logs(base: &Version, sessions: &[MappedSession]) -> bool {
    let held = base.sessions.iter().map(|session| &session.log);
    held.eq(sessions.iter().map(|session| &session.log))
}

fn holds(sessions: &[MappedSession], log: &LogContent) -> bool {
    MappedSession::named(sessions, &log.session).is_some_and(|session| session.log == *log)
}

fn sessions_of(base: &Version, wanted: impl Fn(&LogContent) -> bool) -> Vec<String> {
    let logs = base.sessions.iter().map(|held| &held.log);
    let wanted = logs.filter(|log| wanted(log));
    wanted.map(|log| log.session.clone()).collect()
}
