//! From what a person asks for to a run: plan text, sessions and a map, checked together.

mod given;
mod host;
mod manifest;
mod vehicle;

use std::collections::{BTreeMap, BTreeSet};

use datafusion::execution::runtime_env::RuntimeEnv;
use evermap_contract::Registry;
use evermap_datasets::manifest::Vehicle;
use evermap_datasets::{Dataset, Manifest, Reason, Recordings};
use evermap_language::{Body, Plan, PlanFaults, Source};
use evermap_schemas::Fault;

use self::given::{coming, joining, overwritten};
pub use self::host::vocabulary;
use self::host::{Surroundings, by_path};
pub use self::manifest::located;
use self::manifest::{beside, seen_from_plan};
use self::vehicle::Vehicles;
pub use crate::fingerprint::OnProgress;
use crate::fingerprint::{self, Believe};
use crate::map::make;
use crate::map::store::Store;
use crate::map::version::{MappedSession, Previous, Version};
use crate::preflight::players::Players;
use crate::preflight::{Lacks, Needs, Unplayed, idle, unknown};
use crate::program::Program;
use crate::program::compile::{all_faults, compile};
use crate::run::Run;
use crate::sql::{Limits, context};

/// What keeps a plan from running: its own faults, or something else.
#[derive(Debug)]
pub enum Refusal {
    /// The plan's faults, all of them, with positions.
    Plan(Box<PlanFaults>),
    /// Anything else.
    Fault(Fault),
}

impl From<Fault> for Refusal {
    fn from(fault: Fault) -> Self {
        Self::Fault(fault)
    }
}

impl From<PlanFaults> for Refusal {
    fn from(faults: PlanFaults) -> Self {
        Self::Plan(Box::new(faults))
    }
}

/// A plan's text, where others are found, and what overrides it.
#[derive(Debug, Clone)]
pub struct PlanText {
    /// The YAML.
    pub source: Source,
    /// Finds the plan that another extends, as [`evermap_language::Host::plan`] does.
    pub find: fn(&str, &str) -> Result<Source, String>,
    /// `step.param=value` options.
    pub settings: Vec<String>,
    /// The session manifest, whose `defaults` hold for the plan; where there is none, the one that the plan names.
    pub manifest: Option<Source>,
}

/// Parses a plan and checks what its text alone shows.
///
/// # Errors
/// All its faults.
pub fn parse(plan: &PlanText, registry: &Registry) -> Result<Plan, PlanFaults> {
    let host = Surroundings { plan, registry };
    evermap_language::parse(&plan.source, &plan.settings, &vocabulary(registry), &host)
}

/// As [`parse`], for a plan that is shown: what plans that it extends name by a path of theirs is named by a path of its
/// own, and files that were read by their paths, so that the text is that of the same plan.
///
/// # Errors
/// All its faults.
pub fn composed(plan: &PlanText, registry: &Registry) -> Result<Plan, PlanFaults> {
    let mut composed = parse(plan, registry)?;
    let own = &plan.source.origin;
    composed.sessions = composed.sessions.map(|named| seen_from_plan(named, own));
    for step in &mut composed.steps {
        if let Body::Op { params, .. } = &mut step.body {
            by_path(params);
        }
    }
    Ok(composed)
}

/// That a plan's text shows no faults; those that only compiling shows, of what is sound in the text, are told with them.
///
/// # Errors
/// All its faults, if its text shows one.
pub async fn check_text(plan: &PlanText, registry: &Registry) -> Result<(), Refusal> {
    let (host, vocabulary) = (Surroundings { plan, registry }, vocabulary(registry));
    let (source, settings) = (&plan.source, &plan.settings);
    let (sound, faults) = evermap_language::read(source, settings, &vocabulary, &host);
    if faults.error_count() == 0 {
        return Ok(());
    }
    let Some(sound) = sound else {
        return Err(faults.settle().into());
    };
    let context = context(Limits::default())?;
    let no_logs = Dataset::open(&context.runtime_env(), &[], None).await?;
    no_logs.register(&context)?;
    Err(all_faults(&sound, registry, &context, faults).await.into())
}

/// The vehicle that a plan's steps are told, and logs are to be read for; `None` where they are told none, and a manifest
/// alone may say it.
///
/// # Errors
/// All faults of the plan.
pub fn vehicle_of(plan: &PlanText, registry: &Registry) -> Result<Option<Vehicle>, Refusal> {
    let parsed = parse(plan, registry)?;
    Ok(Vehicles::of_plan(&parsed).first().cloned())
}

/// Parses and compiles a plan, on the tables of these sessions; none are needed unless the plan reads topics.
///
/// # Errors
/// All its faults; a user fault where its steps are told vehicles that differ, and rows of these sessions depend on it.
pub async fn check(
    plan: &PlanText,
    registry: &Registry,
    dataset: &Dataset,
) -> Result<(Plan, Program), Refusal> {
    let parsed = parse(plan, registry)?;
    Vehicles::of_plan(&parsed).agree(dataset)?;
    let program = compiled(&parsed, registry, dataset).await?;
    Ok((parsed, program))
}

/// The program of a plan on the tables of these sessions.
async fn compiled(plan: &Plan, registry: &Registry, dataset: &Dataset) -> Result<Program, Refusal> {
    let context = context(Limits::default())?;
    dataset.register(&context)?;
    Ok(compile(plan, registry, &context).await?)
}

/// A session whose name another log has had so far.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Replaced {
    /// Its name.
    pub session: String,
    /// Where the log is that the map was made from.
    pub before: String,
    /// Where the log is that was given.
    pub now: String,
}

/// A run, ready to be explained or executed.
pub struct Prepared {
    /// The program.
    pub program: Program,
    /// All sessions of the coming version, sorted by name: those of the version before, and the new ones.
    pub sessions: Vec<MappedSession>,
    /// The version before.
    pub base: Option<Version>,
    /// The map.
    pub store: Store,
    /// What the plan reads of the version before, though that version does not have it.
    pub missing: Vec<String>,
    /// Whether that is all that it reads of it, so that every session is new.
    pub begins_anew: bool,
    /// Choices that the user might want to make differently, sessions that are the same recording, and those that do not say
    /// what their vehicle is like, in sentences.
    pub notes: Vec<String>,
    /// What a manifest names and nothing has, in sentences.
    pub unknown: Vec<String>,
    /// Roles that the plan reads and that no session plays.
    pub unplayed: Unplayed,
    /// The logs that were given, opened.
    pub logs: Dataset,
    /// Names of the sessions that were given.
    pub given: Vec<String>,
    /// Sessions of which the plan makes nothing, and what they lack.
    pub idle: Vec<(String, Lacks)>,
    /// Sessions that take the place of another log of the same name, at another place.
    pub replaced: Vec<Replaced>,
    /// Sessions whose log holds another recording than the version before was made from, in sentences.
    pub overwritten: Vec<String>,
    /// Files among those given that cannot be read, with a reason each: they take no part.
    pub unreadable: BTreeMap<String, u64>,
}

impl Prepared {
    /// Checks a plan against the sessions and the map that it is to run on. The sessions given join those that the map has;
    /// one of the same name takes its place.
    ///
    /// Without `told` nothing is written. With it, as of what is then run, logs that are not known are read last, when nothing
    /// else speaks against the run. The map's folder is made before, and each log is remembered as soon as it is read, so
    /// that neither the run's units nor, where it is killed meanwhile, the next run need read it. `told` hears how far that is.
    ///
    /// # Errors
    /// All faults of the plan, or what is wrong with a session or the map; that the plan makes nothing of any session. Where
    /// logs are remembered, a user fault where the map's folder cannot be made, a resource fault when its store does not take
    /// what is remembered.
    pub async fn new(
        plan: &PlanText,
        registry: &Registry,
        map: &str,
        sessions: &[String],
        manifest: Option<&Manifest>,
        told: Option<OnProgress<'_>>,
    ) -> Result<Self, Refusal> {
        let mut parsed = parse(plan, registry)?;
        let read;
        let mut written = plan.manifest.clone();
        let manifest = match (manifest, &parsed.sessions) {
            (None, Some(named)) => {
                let path = beside(&named.origin, &named.path);
                read = Manifest::load(&path)?;
                written = Some(Source {
                    origin: path.display().to_string(),
                    text: Manifest::text(&path)?,
                });
                let plan = PlanText {
                    manifest: written.clone(),
                    ..plan.clone()
                };
                parsed = parse(&plan, registry)?;
                Some(&read)
            }
            (manifest, _) => manifest,
        };
        let store = Store::open(map, true)?;
        let base = Version::latest(&store).await?;
        let vehicles = Vehicles::of_plan(&parsed);
        // Topics are checked on the logs at hand; a map's earlier logs may be gone, their artifacts are not.
        let placed = |fault| located(fault, written.as_ref());
        let found = Recordings::find(&RuntimeEnv::default(), sessions, manifest).await;
        let mut found = found.map_err(placed)?;
        if let Some(vehicle) = vehicles.first() {
            found = found.of_vehicle(vehicle.clone());
        }
        let opened = fingerprint::open(&store, found, Believe::Rested).await;
        let (given, remembered) = opened.map_err(placed)?;
        vehicles.agree(&given)?;
        let program = compiled(&parsed, registry, &given).await?;
        let mut by_name = mapped_sessions(base.as_ref());
        let joining = joining(&given.sessions, manifest, &by_name);
        let players = Players::of(&given, coming(&joining, &by_name));
        let sites = players.sites();
        let needs = Needs::of_program(&program, registry, &sites);
        let mut unknown_names = unknown::topics(&given);
        unknown_names.extend(unknown::origins(&program, &sites));
        // A name that is misspelt may be why.
        let idle = idle(&needs, &given, &players).map_err(|fault| Fault {
            message: [
                std::slice::from_ref(&fault.message),
                unknown_names.as_slice(),
            ]
            .concat()
            .join("; "),
            ..fault
        })?;
        let unplayed = needs.unplayed(&program, &players.all());
        // What is refused reads no log and begins no map.
        if told.is_some() {
            make(&store)?;
        }
        let digests = fingerprint::read(&store, &remembered, &given.sessions, told).await?;
        let mut replaced = Vec::new();
        for (session, content) in joining.into_iter().zip(digests) {
            replaced.extend(session.join(content, &mut by_name)?);
        }
        let sessions: Vec<_> = by_name.into_values().collect();
        let before = base.as_ref();
        let missing = before.map_or_else(Vec::new, |base| Previous::missing(&program, base));
        let begins_anew = before.is_some_and(|base| Previous::begins_anew(&program, base));
        let mut notes = given.notes.clone();
        notes.extend(repeated(&given, &sessions));
        notes.extend(needs.untold(&given, &players, &idle));
        Ok(Self {
            notes,
            unknown: unknown_names,
            unplayed,
            unreadable: unreadable(&given),
            idle,
            replaced,
            overwritten: overwritten(before, &sessions),
            given: given
                .sessions
                .iter()
                .map(|session| session.name.to_string())
                .collect(),
            logs: given,
            program,
            sessions,
            base,
            store,
            missing,
            begins_anew,
        })
    }

    /// That nothing which was published since `before` was prepared takes the place of what was given then: a session of
    /// the same name, of another log.
    ///
    /// # Errors
    /// A user fault that names the session.
    pub fn agrees_with(&self, before: &Self) -> Result<(), Fault> {
        let (now, then) = (contents(self.base.as_ref()), contents(before.base.as_ref()));
        for name in &before.given {
            let given = MappedSession::named(&before.sessions, name);
            let given = given.map(|session| session.log.content.as_str());
            let now = now.get(name.as_str()).copied();
            if now != then.get(name.as_str()).copied() && now != given {
                return Err(Fault::user(format!(
                    "another run mapped another log as session {name} while this one was at work"
                ))
                .next("run again if this one's is to take its place"));
            }
        }
        Ok(())
    }

    /// The run.
    pub fn run<'a>(&'a self, registry: &'a Registry, limits: Limits) -> Run<'a> {
        Run {
            program: &self.program,
            registry,
            store: &self.store,
            sessions: &self.sessions,
            base: self.base.as_ref(),
            limits,
        }
    }
}

/// Files that no session has, as they cannot be read.
fn unreadable(given: &Dataset) -> BTreeMap<String, u64> {
    let entries = given.losses.entries().into_iter();
    entries
        .filter(|entry| entry.reason == Reason::Unreadable)
        .map(|entry| {
            (
                format!("{}: {}", entry.file, entry.reason),
                entry.loss.count,
            )
        })
        .collect()
}

/// That sessions are the same recording, of which one at least is given: a copy, or a link, under another name.
fn repeated(given: &Dataset, sessions: &[MappedSession]) -> Vec<String> {
    let names: BTreeSet<&str> = given.sessions.iter().map(|s| &*s.name).collect();
    let mut first = BTreeMap::<&str, &str>::new();
    let mut notes = Vec::new();
    // Those that are new are told, beside what was there before them.
    let (new, known): (Vec<_>, Vec<_>) = sessions
        .iter()
        .map(|session| &session.log)
        .partition(|log| names.contains(log.session.as_str()));
    for log in known {
        first.entry(&log.content).or_insert(&log.session);
    }
    for log in new {
        let (name, one) = (
            &log.session,
            *first.entry(&log.content).or_insert(&log.session),
        );
        if one != name {
            notes.push(format!(
                "session {name} is the same recording as session {one}, and counts as another drive"
            ));
        }
    }
    notes
}

/// The contents of the logs of a version, by session.
fn contents(version: Option<&Version>) -> BTreeMap<&str, &str> {
    let sessions = version.iter().flat_map(|version| &version.sessions);
    sessions
        .map(|session| (session.log.session.as_str(), session.log.content.as_str()))
        .collect()
}

fn mapped_sessions(base: Option<&Version>) -> BTreeMap<String, MappedSession> {
    let sessions = base.into_iter().flat_map(|base| base.sessions.clone());
    sessions
        .map(|session| (session.log.session.clone(), session))
        .collect()
}
