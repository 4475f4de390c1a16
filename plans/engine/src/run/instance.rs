//! Which units there are of a stage, and what each covers.

use std::collections::BTreeSet;

use evermap_contract::Reach;

use crate::program::Scope;
use crate::run::RunSession;

/// What one unit of a stage covers.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub enum Instance {
    /// A session, by name.
    Session(String),
    /// A site, by name.
    Site(String),
    /// Everything.
    Map,
}

impl Instance {
    /// The instances of a scope, sorted by name.
    pub fn all<'s>(
        scope: Scope,
        sessions: impl IntoIterator<Item = &'s RunSession>,
    ) -> BTreeSet<Self> {
        let instance = |session: &RunSession| match scope {
            Scope::Session => Instance::Session(session.log.session.clone()),
            Scope::Site => Instance::Site(session.log.site.clone()),
            Scope::Map => Instance::Map,
        };
        sessions.into_iter().map(instance).collect()
    }

    /// What a recipe or a receipt covers: its session, else its site, else everything.
    pub fn of(session: Option<&String>, site: Option<&String>) -> Self {
        match (session, site) {
            (Some(session), _) => Instance::Session(session.clone()),
            (None, Some(site)) => Instance::Site(site.clone()),
            (None, None) => Instance::Map,
        }
    }

    /// The session and the site that it covers, as far as it is one.
    pub fn names(&self, sessions: &[RunSession]) -> (Option<String>, Option<String>) {
        match self {
            Instance::Session(name) => {
                let session = sessions.iter().find(|session| self.covers(session));
                (
                    Some(name.clone()),
                    session.map(|found| found.log.site.clone()),
                )
            }
            Instance::Site(site) => (None, Some(site.clone())),
            Instance::Map => (None, None),
        }
    }

    /// The sessions that belong with it, or with its site.
    pub fn reached<'s>(&self, reach: Reach, sessions: &'s [RunSession]) -> Vec<&'s RunSession> {
        let covering = match (reach, self.names(sessions).1) {
            (Reach::Site, Some(site)) => &Instance::Site(site),
            _ => self,
        };
        let reached = sessions.iter().filter(|session| covering.covers(session));
        reached.collect()
    }

    fn covers(&self, session: &RunSession) -> bool {
        match self {
            Instance::Session(name) => session.log.session == *name,
            Instance::Site(site) => session.log.site == *site,
            Instance::Map => true,
        }
    }
}

/// Which unit of a program.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct Place {
    /// Its stage.
    pub stage: String,
    /// What it covers.
    pub instance: Instance,
}

impl Place {
    /// What a person calls the unit.
    pub fn label(&self) -> String {
        match &self.instance {
            Instance::Session(name) | Instance::Site(name) => format!("{} of {name}", self.stage),
            Instance::Map => self.stage.clone(),
        }
    }
}
