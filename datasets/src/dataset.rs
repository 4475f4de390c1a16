//! A set of sessions, opened: the entry point of the engine and the command line.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use datafusion::catalog::TableProvider;
use datafusion::common::TableReference;
use datafusion::execution::runtime_env::RuntimeEnv;
use datafusion::prelude::SessionContext;
use evermap_schemas::roles::{CameraMount, Role, Topic};
use evermap_schemas::{Fault, Kind};
use futures::{FutureExt, StreamExt, TryStreamExt};

use crate::fault::OrFault;
use crate::losses::{Loss, LossLedger, Reason};
use crate::manifest::{BITS, Bits, Manifest, ROLES, Roles, TopicBits, Vehicle, of_role};
use crate::recordings::{Recording, Recordings};
use crate::roles::vehicle::OfVehicle;
use crate::roles::{delays, robots, vehicle};
use crate::scan::{LazyTable, LogTable, McapTable, MessagesTable, RecordTable, TopicTable};
use crate::session::{LogPart, Session};
use crate::{listing, roles};

/// Files whose indexes are read at the same time.
const OPEN_AT_ONCE: usize = 8;

/// Sessions with their indexes read, and the ledger of what could not be read.
#[derive(Debug, Clone, Default)]
pub struct Dataset {
    /// Sessions, ordered by name.
    pub sessions: Vec<Session>,
    /// What was lost so far; it grows while tables are scanned.
    pub losses: LossLedger,
    /// Choices that the user might want to make differently, in sentences.
    pub notes: Vec<String>,
    /// Topics, or patterns of them, that a manifest says something of and that no session has, with the key first
    /// (`roles.frames`, `bits`); a role is played by others of its topics.
    pub unknown_topics: Vec<(String, String)>,
    roles: &'static [Role],
}

impl Dataset {
    /// Opens the files that `paths` name and the sessions of the manifest: see [`Recordings::find`].
    ///
    /// # Errors
    /// As [`Recordings::find`] and [`Recordings::open`].
    pub async fn open(
        runtime: &RuntimeEnv,
        paths: &[String],
        manifest: Option<&Manifest>,
    ) -> Result<Self, Fault> {
        let found = Recordings::find(runtime, paths, manifest).await?;
        found.open().await
    }

    /// All files of all sessions.
    pub fn parts(&self) -> Vec<Arc<LogPart>> {
        let parts = self.sessions.iter().flat_map(|session| &session.parts);
        parts.cloned().collect()
    }

    /// Topics of all sessions, ascending.
    pub fn topics(&self) -> BTreeSet<String> {
        self.sessions.iter().flat_map(Session::topics).collect()
    }

    /// Names of the tables that every dataset has, beside one for each topic: roles, and what a log says of itself.
    pub fn table_names() -> Vec<&'static str> {
        let roles = evermap_schemas::roles::ALL.iter().map(|role| role.name);
        let whole = ["messages", "attachments", "metadata"];
        roles.chain(whole).chain(listing::NAMES).collect()
    }

    /// The same, of one of its sessions.
    #[must_use]
    pub fn of_session(&self, session: &Session) -> Self {
        Self {
            sessions: vec![session.clone()],
            losses: self.losses.clone(),
            notes: self.notes.clone(),
            unknown_topics: self.unknown_topics.clone(),
            roles: self.roles,
        }
    }

    /// Where the cameras of its sessions are mounted by their first calibrations, by name; those that are not at the frame of
    /// their name.
    ///
    /// # Errors
    /// A data fault for calibrations that cannot be decoded, a resource fault for a file that cannot be read.
    pub async fn camera_mounts(&self) -> Result<BTreeMap<String, CameraMount>, Fault> {
        let mut mounts = BTreeMap::new();
        for session in &self.sessions {
            mounts.extend(roles::camera_mounts(session).await?);
        }
        Ok(mounts)
    }

    /// How long after their stamps the first messages of each topic of a role were logged, at the median (ns). None of a topic
    /// whose messages have no stamps, or cannot be read.
    pub async fn delays(session: &Session, role: &str) -> Vec<(String, i64)> {
        delays::of(session, role).await
    }

    /// The roles that a session plays with transforms which move no vehicle, so that nothing comes of them, and why, with what
    /// a manifest may say.
    pub async fn unmoved(&self, session: &Session) -> Vec<(&'static str, String)> {
        let mut unmoved = Vec::new();
        for role in self.roles {
            let why = robots::unmoved(role, session).await;
            unmoved.extend(why.map(|why| (role.name, why)));
        }
        unmoved
    }

    /// Topics that are called as one of [`Dataset::table_names`] is, and so are not among [`Dataset::tables`].
    pub fn hidden_topics(&self) -> BTreeSet<String> {
        let names = Self::table_names();
        let mut topics = self.topics();
        topics.retain(|topic| names.contains(&topic.as_str()));
        topics
    }

    /// The table of each topic, by name, whatever it is called.
    ///
    /// A topic that cannot be decoded is a table that says so when it is scanned.
    pub fn topic_tables(&self) -> BTreeMap<String, Arc<dyn TableProvider>> {
        let mut tables = BTreeMap::<String, Arc<dyn TableProvider>>::new();
        let shared: Arc<[Arc<LogPart>]> = self.parts().into();
        for topic in self.topics() {
            let (name, parts) = (topic.clone(), shared.clone());
            let table = LazyTable::new(move || {
                let table = TopicTable::new(&name, &parts)?;
                Ok(Arc::new(McapTable::new(Arc::new(table), &parts)))
            });
            tables.insert(topic, Arc::new(table));
        }
        tables
    }

    /// Every table of the dataset, by name: each topic, and those of [`Dataset::table_names`], which go before topics of
    /// their names.
    ///
    /// # Errors
    /// A fault of ours.
    pub fn tables(&self) -> Result<BTreeMap<String, Arc<dyn TableProvider>>, Fault> {
        let (parts, mut tables) = (self.parts(), self.topic_tables());
        let whole: [Arc<dyn LogTable>; 3] = [
            Arc::new(MessagesTable),
            Arc::new(RecordTable::attachments()),
            Arc::new(RecordTable::metadata()),
        ];
        for table in whole {
            let name = table.name().to_owned();
            tables.insert(name, Arc::new(McapTable::new(table, &parts)));
        }
        for (name, table) in listing::tables(&self.sessions) {
            tables.insert(name.to_owned(), table);
        }
        for role in self.roles {
            tables.insert(role.name.to_owned(), roles::table(role, &self.sessions)?);
        }
        Ok(tables)
    }

    /// Registers every table, and the object stores that the files are in.
    ///
    /// # Errors
    /// As [`Dataset::tables`], or when the context refuses a name.
    pub fn register(&self, context: &SessionContext) -> Result<(), Fault> {
        self.register_stores(&context.runtime_env());
        for (name, table) in self.tables()? {
            let reference = TableReference::bare(name.as_str());
            context
                .deregister_table(reference.clone())
                .and_then(|_| context.register_table(reference, table))
                .or_fault()
                .map_err(|fault| fault.at(format!("table {name}")))?;
        }
        Ok(())
    }

    /// Registers the object stores that the files are in.
    pub fn register_stores(&self, runtime: &RuntimeEnv) {
        for part in self.parts() {
            runtime.register_object_store(part.store_url.as_ref(), part.store.clone());
        }
    }
}

impl Recordings {
    /// Reads the indexes that are not known yet.
    ///
    /// # Errors
    /// A user fault when the manifest names a role that there is not or that nothing plays; a data fault when no file
    /// is an MCAP file. A damaged file is no error, nor one among others that cannot be read: see [`Dataset::losses`].
    pub async fn open(self) -> Result<Dataset, Fault> {
        let (roles, topics) = (self.roles, &self.topics);
        let said = ManifestTopics {
            topics,
            bits: &self.bits,
            vehicle: &self.vehicle,
        };
        check_roles(roles, topics)?;
        let losses = LossLedger::new();
        let alone = self.sessions.iter().map(|s| s.files.len()).sum::<usize>() <= 1;
        let mut opened = futures::stream::iter(self.sessions)
            .map(|recording| open_session(recording, roles, said, &losses))
            .buffered(OPEN_AT_ONCE)
            .try_collect::<Vec<_>>()
            .await?;
        let mut unreadable = None;
        for (_, _, faults) in &mut opened {
            unreadable = unreadable.or(faults.pop());
        }
        let nothing = opened.iter().all(|(session, ..)| session.parts.is_empty());
        if let Some(fault) = unreadable.filter(|_| alone || nothing) {
            return Err(fault);
        }
        opened.retain(|(session, ..)| !session.parts.is_empty());
        let notes = opened.iter().flat_map(|(session, said, _)| {
            said.iter()
                .map(move |note| format!("session {}: {note}", session.name))
        });
        let notes = notes.collect();
        opened.sort_by(|(a, ..), (b, ..)| a.name.cmp(&b.name));
        let sessions: Vec<Session> = opened.into_iter().map(|(session, ..)| session).collect();
        check_topics(topics, &sessions)?;
        Ok(Dataset {
            unknown_topics: unknown_topics(said, &sessions),
            sessions,
            losses,
            notes,
            roles,
        })
    }
}

/// What a manifest says of the topics of all sessions.
#[derive(Clone, Copy)]
struct ManifestTopics<'m> {
    /// By role.
    topics: &'m BTreeMap<String, Vec<String>>,
    bits: &'m Bits,
    vehicle: &'m Vehicle,
}

/// A session of those of its files that can be read, what was chosen for the person, and why files cannot be read.
type Opened = (Session, Vec<String>, Vec<Fault>);

async fn open_session(
    recording: Recording,
    roles: &[Role],
    said: ManifestTopics<'_>,
    losses: &LossLedger,
) -> Result<Opened, Fault> {
    let given = said.topics;
    let (name, site): (Arc<str>, Arc<str>) = (recording.name.into(), recording.site.into());
    let mut opened = futures::stream::iter(recording.files)
        .map(|file| {
            let (url, size) = (file.url(), file.meta.size);
            let part = LogPart::open(file, name.clone(), site.clone(), losses);
            part.map(move |part| (part, url, size))
        })
        .buffered(OPEN_AT_ONCE);
    let (mut parts, mut faults) = (Vec::new(), Vec::new());
    while let Some((part, url, size)) = opened.next().await {
        match part {
            Ok(part) => parts.push(part),
            Err(fault) if fault.kind == Kind::Bug => return Err(fault),
            Err(fault) => {
                let losses = losses.of_file(url);
                let said = fault.to_string();
                losses.note(Reason::Unreadable, 0, Loss::one(size), said);
                faults.push(fault);
            }
        }
    }
    drop(opened);
    parts.sort_by_key(|part| part.index.time_range().map_or(i64::MAX, |(start, _)| start));
    for (number, part) in parts.iter_mut().enumerate() {
        part.part = number as u32;
    }
    let mut parts: Vec<Arc<LogPart>> = parts.into_iter().map(Arc::new).collect();
    // They were collected in the place of the parts themselves, which takes some kilobytes.
    parts.shrink_to_fit();
    let topics = topics_of(&parts);
    let mut resolved = Roles::named(roles, given, &topics)?;
    let of_vehicle = OfVehicle::of(roles, &parts, &topics, &resolved, said.vehicle).await;
    let mut notes = resolved.infer(roles, |role| of_vehicle.choices(role));
    notes.extend(of_vehicle.note().map(str::to_owned));
    let own = of_vehicle.topics();
    let mut session = Session {
        name,
        site,
        parts,
        roles: resolved,
        bits: TopicBits::new(),
        vehicle: said.vehicle.clone(),
    };
    for role in roles {
        let is_given = given.contains_key(role.name);
        if !is_given && let Some((choices, note)) = robots::instead(role, &session, &own).await? {
            session.roles.give(role, choices);
            notes.push(note);
        }
        if is_given {
            of_vehicle.check(role, session.roles.topics(role.name))?;
        }
        vehicle::check(role, &session, &topics, is_given).await?;
    }
    let pictures = roles.iter().filter(|role| has_pictures(role));
    let pictures = pictures.flat_map(|role| session.roles.topics(role.name));
    session.bits = said.bits.of_topics(pictures)?;
    if !of_vehicle.matters() && !robots::matter(roles, &session) {
        session.vehicle = Vehicle::default();
    }
    Ok((session, notes, faults))
}

fn has_pictures(role: &Role) -> bool {
    role.messages().is_some_and(|messages| messages.pictures)
}

/// The topics of a session, by name.
fn topics_of(parts: &[Arc<LogPart>]) -> Vec<Topic> {
    let mut topics = BTreeMap::<&str, (&str, u64, bool)>::new();
    for part in parts {
        for channel in part.index.channels.values() {
            let (schema, messages, untyped) = topics.entry(&channel.topic).or_default();
            *untyped |= part.index.is_untyped(channel);
            // Where nobody knows, there may be some.
            let said = part.index.channel_messages(channel.id).unwrap_or(1);
            *messages = messages.saturating_add(said);
            if let Some(found) = part.index.schema_of(channel) {
                *schema = &found.name;
            }
        }
    }
    topics
        .into_iter()
        .map(|(name, (schema, messages, untyped))| Topic {
            untyped,
            ..Topic::new(name, schema, messages)
        })
        .collect()
}

fn check_roles(roles: &[Role], given: &BTreeMap<String, Vec<String>>) -> Result<(), Fault> {
    let names: Vec<&str> = roles
        .iter()
        .filter(|role| role.messages().is_some())
        .map(|role| role.name)
        .collect();
    match given.keys().find(|role| !names.contains(&role.as_str())) {
        Some(role) => {
            let names = names.join(", ");
            let fault = format!("expected one of the roles {names}, found {role}");
            Err(of_role(Fault::user(fault), role))
        }
        None => Ok(()),
    }
}

/// A pattern of the manifest that no session has a topic for is a mistake.
fn check_topics(given: &BTreeMap<String, Vec<String>>, sessions: &[Session]) -> Result<(), Fault> {
    let played = |role: &String| sessions.iter().any(|s| !s.roles.topics(role).is_empty());
    let Some((role, patterns)) = given.iter().find(|(role, _)| !played(role)) else {
        return Ok(());
    };
    let topics: BTreeSet<String> = sessions.iter().flat_map(Session::topics).collect();
    let topics: Vec<String> = topics.into_iter().collect();
    let fault = Fault::user(format!(
        "expected a topic for the role {role} that fits {}, found none among {}",
        patterns.join(" or "),
        topics.join(", ")
    ));
    Err(of_role(fault, role))
}

/// The patterns of the manifest, by key, that no session has a topic for.
fn unknown_topics(said: ManifestTopics<'_>, sessions: &[Session]) -> Vec<(String, String)> {
    let topics: BTreeSet<String> = sessions.iter().flat_map(Session::topics).collect();
    let is_known = |pattern: &str| {
        let pattern = glob::Pattern::new(pattern);
        pattern.is_ok_and(|pattern| topics.iter().any(|topic| pattern.matches(topic)))
    };
    let of_roles = said.topics.iter().flat_map(|(role, patterns)| {
        let key = format!("{ROLES}{role}");
        patterns.iter().map(move |pattern| (key.clone(), pattern))
    });
    let of_bits = said.bits.patterns();
    let of_bits = of_bits.map(|pattern| (BITS.to_owned(), pattern));
    let unknown = of_roles
        .chain(of_bits)
        .filter(|(_, pattern)| !topics.is_empty() && !is_known(pattern));
    unknown
        .map(|(key, pattern)| (key, pattern.clone()))
        .collect()
}
