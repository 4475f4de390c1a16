//! What a unit has to wait for, and which logs it reads.

use std::collections::{BTreeMap, BTreeSet};

use evermap_contract::Registry;
use evermap_schemas::Fault;

use crate::nodes::operator::Phase;
use crate::program::{Program, Scope, Stage, Table, Task};
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
    /// What a person calls the unit.
    pub fn label(&self, stage: &str) -> String {
        match self {
            Instance::Session(name) | Instance::Site(name) => format!("{stage} of {name}"),
            Instance::Map => stage.to_owned(),
        }
    }

    /// The session and the site that it covers, as far as it is one.
    pub fn names(&self, sessions: &[RunSession]) -> (Option<String>, Option<String>) {
        match self {
            Instance::Session(name) => {
                let site = sessions
                    .iter()
                    .find(|session| session.log.session == *name)
                    .map(|found| found.log.site.clone());
                (Some(name.clone()), site)
            }
            Instance::Site(site) => (None, Some(site.clone())),
            Instance::Map => (None, None),
        }
    }

    fn covers(&self, session: &RunSession) -> bool {
        match self {
            Instance::Session(name) => session.log.session == *name,
            Instance::Site(site) => session.log.site == *site,
            Instance::Map => true,
        }
    }
}

/// The instances of a scope, sorted by name.
pub fn instances(scope: Scope, sessions: &[RunSession]) -> Vec<Instance> {
    let names: BTreeSet<Instance> = match scope {
        Scope::Session => sessions
            .iter()
            .map(|session| Instance::Session(session.log.session.clone()))
            .collect(),
        Scope::Site => sessions
            .iter()
            .map(|session| Instance::Site(session.log.site.clone()))
            .collect(),
        Scope::Map => BTreeSet::from([Instance::Map]),
    };
    names.into_iter().collect()
}

/// What a unit reads.
#[derive(Debug, Clone, Default)]
pub struct Needs {
    /// Stored stages, with the instances of each.
    pub tables: BTreeMap<String, BTreeSet<Instance>>,
    /// Sessions whose logs are read.
    pub logs: BTreeSet<String>,
}

impl Needs {
    /// Every unit that has to be done before.
    pub fn places(&self) -> impl Iterator<Item = (String, Instance)> + '_ {
        self.tables.iter().flat_map(|(name, instances)| {
            instances
                .iter()
                .map(|instance| (name.clone(), instance.clone()))
        })
    }
}

/// What the unit of `stage` for `instance` reads.
///
/// # Errors
/// A bug fault for a program that names a stage or an operator that there is not.
pub fn needs(
    program: &Program,
    registry: &Registry,
    stage: &Stage,
    instance: &Instance,
    sessions: &[RunSession],
) -> Result<Needs, Fault> {
    let mut needs = Needs::default();
    for inner in program.fragment(&stage.name)? {
        for (table, whole) in reads(&inner, registry)? {
            match table {
                Table::Previous(_) => {}
                Table::Log(_) => {
                    let covered = sessions.iter().filter(|session| instance.covers(session));
                    needs
                        .logs
                        .extend(covered.map(|session| session.log.session.clone()));
                }
                Table::Stage(name) => {
                    let input = program.stage(&name)?;
                    if input.stored {
                        let wanted = wanted(input.scope, instance, whole, sessions);
                        needs.tables.entry(name).or_default().extend(wanted);
                    }
                }
            }
        }
        if pixels(&inner, registry) {
            let covered = sessions.iter().filter(|session| instance.covers(session));
            needs
                .logs
                .extend(covered.map(|session| session.log.session.clone()));
        }
    }
    Ok(needs)
}

/// The tables of a stage, and whether all of the site is read of each, however little the unit covers.
fn reads(stage: &Stage, registry: &Registry) -> Result<Vec<(Table, bool)>, Fault> {
    Ok(match &stage.task {
        Task::Sql { inputs, .. } => inputs.iter().map(|table| (table.clone(), false)).collect(),
        Task::Op {
            phase: Phase::Merge,
            inputs,
            ..
        } => inputs
            .values()
            .map(|table| (table.clone(), false))
            .collect(),
        Task::Op { op, inputs, .. } => {
            let entry = registry.get(op)?;
            let whole = |port: &str| {
                entry
                    .port(port)
                    .is_some_and(|port| !port.grain.is_per_session())
            };
            inputs
                .iter()
                .map(|(port, table)| (table.clone(), whole(port)))
                .collect()
        }
    })
}

/// Whether the stage asks for images, which come from logs though no table of the logs is named.
fn pixels(stage: &Stage, registry: &Registry) -> bool {
    match &stage.task {
        Task::Op { op, phase, .. } if *phase != Phase::Merge => {
            registry.get(op).is_ok_and(|entry| {
                entry
                    .ports
                    .first()
                    .is_some_and(|port| port.pixels.is_some())
            })
        }
        _ => false,
    }
}

fn wanted(
    scope: Scope,
    instance: &Instance,
    whole: bool,
    sessions: &[RunSession],
) -> Vec<Instance> {
    let covering = match (whole, instance.names(sessions).1) {
        (true, Some(site)) => Instance::Site(site),
        _ => instance.clone(),
    };
    let covered: Vec<RunSession> = sessions
        .iter()
        .filter(|session| covering.covers(session))
        .cloned()
        .collect();
    instances(scope, &covered)
}
