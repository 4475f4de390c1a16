//! What the steps of a plan need of logs, and what logs bring: told before anything runs.
//!
//! A step is *fed* where everything that it must read is there: roles that a session plays, and steps that are fed. A
//! query is fed by one of its tables, as an outer join or a union may be content with that. What a plan reads of the
//! version before, topics by name and roles of metadata are there or not as they please. A query that hands
//! what a vehicle is like (its cameras, where they sit) to other steps makes nothing of a session by itself.

mod nothing;
pub mod players;
pub mod unknown;
mod untold;

use std::collections::{BTreeMap, BTreeSet};

use evermap_contract::Registry;
use evermap_datasets::Dataset;
use evermap_language::{Body, Input, Plan, Step};
use evermap_schemas::{Fault, roles};

use self::players::{Player, Players};
use crate::program::{LIFT, Program, Role, Scope, Stage, Task};

/// A step, as far as it matters here.
struct Need {
    step: String,
    /// What it cannot do without.
    inputs: Vec<Input>,
    /// What it would use.
    optional: Vec<Input>,
    is_query: bool,
    /// Whether it works on one session at a time.
    of_session: bool,
}

/// What a plan and its steps need.
pub struct Needs {
    /// The steps, each after all it reads.
    steps: Vec<Need>,
    /// What the plan says that it needs of a session.
    whole: Lacks,
}

/// Names of roles.
pub type Roles = BTreeSet<String>;

/// Roles that a plan reads and that no session plays, each with the first step that reads it.
pub struct Unplayed {
    /// Steps need them: what is made of them is empty.
    needed: Lacks,
    /// Steps would use them, but do without.
    of_use: Lacks,
}

impl Unplayed {
    /// What a person is told of them.
    pub fn notes(&self) -> Vec<String> {
        let notes = [
            (&self.needed, ": what the plan makes of it is empty"),
            (&self.of_use, ", which the plan would use"),
        ];
        let due = notes.into_iter().filter(|(roles, _)| !roles.is_empty());
        let note =
            |(roles, why): (&Lacks, &str)| format!("note: no session has {}{why}", in_words(roles));
        due.map(note).collect()
    }

    /// What a person is told of the layers of a run that have no rows, where a step needs what no session has.
    pub fn note_of_empty(&self, layers: &[&str]) -> Option<String> {
        let is_due = !self.needed.is_empty() && !layers.is_empty();
        is_due.then(|| format!("note: layers without rows: {}", layers.join(", ")))
    }
}

/// Roles that are missing, each with the first step that cannot do without.
pub type Lacks = BTreeMap<String, String>;

impl Needs {
    /// The needs of a compiled plan, for sessions of these sites. No GNSS fixes where it is told where one of the sites
    /// lies.
    pub fn of_program(program: &Program, registry: &Registry, sites: &BTreeSet<&str>) -> Self {
        let need = |stage: &Stage| {
            let op = stage.op().unwrap_or_default();
            let reads = stage.reads.iter().map(|read| {
                let optional = match &read.role {
                    Role::Side(port) => is_optional(registry, op, port),
                    Role::Driving | Role::Query => false,
                };
                (read.table.clone(), optional)
            });
            let is_query = matches!(stage.task, Task::Sql { .. });
            Need::of(&stage.name, reads, is_query, stage.scope == Scope::Session)
        };
        let reads = |stage: &Stage, role: &str| {
            let mut reads = stage.reads.iter();
            reads.any(|read| is_source(&read.table, role))
        };
        let reader = |role: &String| {
            let stage = program.stages.iter().find(|stage| reads(stage, role))?;
            Some((role.clone(), step_of(&stage.name)))
        };
        let is_surveyed = !unknown::surveyed(program).is_disjoint(sites);
        let fixes = roles::gnss_fixes::ROLE.name;
        let needed = program.needs.iter();
        let needed = needed.filter(|role| !is_surveyed || role.as_str() != fixes);
        Self {
            steps: program.stages.iter().map(need).collect(),
            whole: needed.filter_map(reader).collect(),
        }
    }

    /// The needs of a plan for a session that is alone.
    pub fn of_plan(plan: &Plan, registry: &Registry) -> Self {
        let need = |step: &Step| {
            let reads = step.inputs.iter().map(|(port, input)| {
                let optional = match &step.body {
                    Body::Op { op, .. } => is_optional(registry, op, port),
                    Body::Sql { .. } | Body::Python(_) => false,
                };
                (input.clone(), optional)
            });
            let is_query = matches!(step.body, Body::Sql { .. });
            Need::of(&step.name, reads, is_query, true)
        };
        let reader = |role: &String| {
            let reads = |step: &&Step| step.inputs.iter().any(|(_, input)| is_source(input, role));
            let step = plan.steps.iter().find(reads)?;
            Some((role.clone(), step.name.clone()))
        };
        Self {
            steps: plan.steps.iter().map(need).collect(),
            whole: plan.needs.iter().filter_map(reader).collect(),
        }
    }

    /// What a session lacks of all that the plan says it needs, where its site has these shared roles.
    fn short_of(&self, plays: &Roles, site: &Roles) -> Lacks {
        let mut short = self.whole.clone();
        short.retain(|role, _| !plays.contains(role) && !site.contains(role));
        short
    }

    /// Whether a step reads a role.
    fn reads(&self, role: &str) -> bool {
        self.sources().contains(role)
    }

    /// The tables of sessions that steps read.
    fn sources(&self) -> BTreeSet<&str> {
        let tables = self.steps.iter().flat_map(Need::tables);
        let names = tables.filter_map(|table| match table {
            Input::Source(name) => Some(name.as_str()),
            _ => None,
        });
        names.collect()
    }

    /// The first step that cannot do without a role.
    fn needing(&self, role: &str) -> Option<String> {
        let needs = |need: &&Need| need.inputs.iter().any(|input| is_source(input, role));
        let first = self.steps.iter().find(needs);
        first.map(|need| step_of(&need.step))
    }

    /// The roles that are not among those played, and of whose steps nothing comes therefore.
    pub fn without(&self, played: &Roles) -> Vec<&'static str> {
        let names = roles::ALL.iter().map(|role| role.name);
        let unplayed = names.filter(|name| is_role(name) && !played.contains(*name));
        unplayed
            .filter(|name| self.needing(name).is_some())
            .collect()
    }

    /// The roles that the program reads and that are not among those that sessions play.
    pub fn unplayed(&self, program: &Program, played: &Roles) -> Unplayed {
        let (mut needed, mut of_use) = (Lacks::new(), Lacks::new());
        for stage in &program.stages {
            for read in &stage.reads {
                let Input::Source(name) = &read.table else {
                    continue;
                };
                if !is_role(name) || played.contains(name) {
                    continue;
                }
                let (lacks, step) = match self.needing(name) {
                    Some(step) => (&mut needed, step),
                    None => (&mut of_use, step_of(&stage.name)),
                };
                lacks.entry(name.clone()).or_insert(step);
            }
        }
        Unplayed { needed, of_use }
    }

    /// What a session that plays some roles lacks, beside sessions that together play `all`, where its site has some
    /// shared roles; `None` where a step makes something of it, and it has all of what the plan says it needs, or is no
    /// drive of which the plan reads anything. How a vehicle is built is played beside anything, what is shared by whoever
    /// has it to give: neither says that a session is a drive.
    pub fn lacks(&self, plays: &Roles, all: &Roles, site: &Roles) -> Option<Lacks> {
        let short = self.short_of(plays, site);
        let mut roles = plays.iter();
        let is_drive = roles.any(|role| is_of_drive(role) && self.reads(role));
        match is_drive && !short.is_empty() {
            true => Some(short),
            false => self.unfed(plays, all),
        }
    }

    /// What a session lacks that is alone; `None` where a step makes something of it, and it plays all of what the plan says
    /// it needs.
    pub fn lacks_alone(&self, plays: &Roles) -> Option<Lacks> {
        let short = self.short_of(plays, &Roles::new());
        match short.is_empty() {
            true => self.unfed(plays, plays),
            false => Some(short),
        }
    }

    /// What no step can be fed without, of all that reads something of a session; `None` where a step makes something of it,
    /// or nothing that the plan reads tells sessions apart.
    fn unfed(&self, plays: &Roles, all: &Roles) -> Option<Lacks> {
        let read = self.sources();
        if !read.is_empty() && !read.iter().any(|name| is_role(name)) {
            return None;
        }
        let (mut own, mut any) = (BTreeMap::new(), BTreeMap::new());
        let (mut of_its_own, mut of_any) = (Lacks::new(), Lacks::new());
        let mut handed_on = BTreeSet::new();
        for need in &self.steps {
            let together = need.lacks(all, &any);
            let lacks = match need.of_session {
                true => need.lacks(plays, &own),
                false => together.clone(),
            };
            let reads = need.reads_of(plays, &handed_on);
            match &lacks {
                None if reads && self.is_handed_on(need) => {
                    handed_on.insert(need.step.as_str());
                }
                None if reads => return None,
                Some(found) if reads => merge(&mut of_its_own, found),
                Some(found) => merge(&mut of_any, found),
                None => {}
            }
            own.insert(need.step.as_str(), lacks);
            any.insert(need.step.as_str(), together);
        }
        Some(match of_its_own.is_empty() {
            true => of_any,
            false => of_its_own,
        })
    }

    /// Whether a query of what a vehicle is like is there for other steps.
    fn is_handed_on(&self, query: &Need) -> bool {
        let is_of_logs = |input: &Input| matches!(input, Input::Source(name) if is_lasting(name));
        let is_it = |input: &Input| matches!(input, Input::Step(name) if *name == query.step);
        let mut others = self.steps.iter().flat_map(|need| &need.inputs);
        query.is_query && query.inputs.iter().all(is_of_logs) && others.any(is_it)
    }
}

impl Need {
    /// A step, and what it reads, each with whether it does without.
    fn of(
        step: &str,
        reads: impl Iterator<Item = (Input, bool)>,
        is_query: bool,
        of_session: bool,
    ) -> Self {
        let (optional, inputs): (Vec<_>, Vec<_>) = reads.partition(|(_, optional)| *optional);
        let tables = |reads: Vec<(Input, bool)>| reads.into_iter().map(|(table, _)| table);
        Self {
            step: step.to_owned(),
            inputs: tables(inputs).collect(),
            optional: tables(optional).collect(),
            is_query,
            of_session,
        }
    }

    /// All that it reads.
    fn tables(&self) -> impl Iterator<Item = &Input> {
        self.inputs.iter().chain(&self.optional)
    }

    /// What it lacks where these roles are played; `None` where it is fed.
    fn lacks(&self, plays: &Roles, missing: &BTreeMap<&str, Option<Lacks>>) -> Option<Lacks> {
        let step = || step_of(&self.step);
        let mut lacks: Vec<Lacks> = Vec::new();
        let mut known = 0;
        for input in &self.inputs {
            match input {
                Input::Source(name) if is_role(name) => {
                    known += 1;
                    if !plays.contains(name) {
                        lacks.push(Lacks::from([(name.clone(), step())]));
                    }
                }
                Input::Step(name) => {
                    known += 1;
                    lacks.extend(missing.get(name.as_str()).cloned().flatten());
                }
                Input::Source(_) | Input::Previous(_) | Input::New(_) => {}
            }
        }
        let fed = match self.is_query {
            true => known == 0 || lacks.len() < known,
            false => lacks.is_empty(),
        };
        let all = lacks.iter().fold(Lacks::new(), |mut all, found| {
            merge(&mut all, found);
            all
        });
        (!fed).then_some(all)
    }

    /// Whether it reads a role that is played, a topic by its name or what any log has, itself or as it is handed on.
    fn reads_of(&self, plays: &Roles, handed_on: &BTreeSet<&str>) -> bool {
        self.inputs.iter().any(|input| match input {
            Input::Source(name) => plays.contains(name) || is_of_any_log(name),
            Input::Step(name) => handed_on.contains(name.as_str()),
            Input::Previous(_) | Input::New(_) => false,
        })
    }
}

/// The step that a stage is of.
fn step_of(stage: &str) -> String {
    stage.trim_end_matches(LIFT).to_owned()
}

fn is_source(input: &Input, role: &str) -> bool {
    matches!(input, Input::Source(name) if name == role)
}

fn merge(all: &mut Lacks, found: &Lacks) {
    for (role, step) in found {
        all.entry(role.clone()).or_insert_with(|| step.clone());
    }
}

/// Whether a table is a role that messages play.
fn is_role(name: &str) -> bool {
    messages(name).is_some()
}

/// Whether a table is no role, but a topic or what every log says of itself (`messages`, `channels` …).
fn is_of_any_log(name: &str) -> bool {
    roles::ALL.iter().all(|role| role.name != name)
}

/// Whether a role says what a vehicle is like.
fn is_lasting(name: &str) -> bool {
    messages(name).is_some_and(|messages| messages.lasting)
}

/// Whether one session plays a role for all of its site.
fn is_shared(name: &str) -> bool {
    messages(name).is_some_and(|messages| messages.shared)
}

/// Whether a role is what only a drive has to say, of itself.
fn is_of_drive(name: &str) -> bool {
    is_role(name) && !is_lasting(name) && !is_shared(name)
}

fn messages(name: &str) -> Option<&'static roles::Messages> {
    let role = roles::ALL.iter().find(|role| role.name == name);
    role.and_then(|role| role.messages())
}

fn is_optional(registry: &Registry, op: &str, port: &str) -> bool {
    let entry = registry.get(op).ok();
    entry.is_some_and(|entry| entry.port(port).is_some_and(|port| port.optional))
}

/// The sessions given of which a plan makes nothing, beside all that there are.
///
/// # Errors
/// A user fault when that is all of them, or when no session has all that the plan says it needs.
pub fn idle(
    needs: &Needs,
    given: &Dataset,
    players: &Players,
) -> Result<Vec<(String, Lacks)>, Fault> {
    let (all, shared, none) = (players.all(), players.shared(), Roles::new());
    let site = |player: &Player| shared.get(player.site.as_str()).unwrap_or(&none);
    let short = |player: &Player| needs.short_of(&player.plays, site(player));
    let is_met = players.each().any(|player| short(player).is_empty());
    let lacks = |player: &Player| match is_met {
        true => needs.lacks(&player.plays, &all, site(player)),
        false => Some(short(player)),
    };
    let sessions = given.sessions.iter();
    let idle = sessions.filter_map(|session| {
        let player = players.named(&session.name)?;
        Some((session, lacks(player)?))
    });
    let idle: Vec<_> = idle.collect();
    match idle.as_slice() {
        [(session, lacks), ..] if idle.len() == given.sessions.len() => {
            Err(nothing::to_make(needs, session, lacks, idle.len() - 1))
        }
        _ => Ok(idle
            .into_iter()
            .map(|(session, lacks)| (session.name.to_string(), lacks))
            .collect()),
    }
}

/// Some words, of which there may be many.
fn few(mut words: Vec<String>) -> String {
    const FEW: usize = 8;
    let left = words.len().saturating_sub(FEW);
    if left > 0 {
        words.truncate(FEW);
        words.push(format!("{left} more"));
    }
    words.join(", ")
}

/// What is lacking, for people: `odometry (step keyframes)`.
pub fn in_words(lacks: &Lacks) -> String {
    let words = lacks
        .iter()
        .map(|(role, step)| format!("{role} (step {step})"));
    words.collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests;
