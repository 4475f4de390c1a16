//! A set of sessions, opened: the entry point of the engine and the command line.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use arrow::datatypes::SchemaRef;
use datafusion::catalog::TableProvider;
use datafusion::common::TableReference;
use datafusion::execution::runtime_env::RuntimeEnv;
use datafusion::prelude::SessionContext;
use evermap_schemas::Fault;
use futures::{StreamExt, TryStreamExt};
use object_store::ObjectStoreExt;
use object_store::path::Path;

use crate::listing;
use crate::log::window::store_fault;
use crate::losses::LossLedger;
use crate::manifest::{Manifest, ManifestRoles, Roles, TopicInfo};
use crate::roles;
use crate::scan::{FaultyTable, LogTable, McapTable};
use crate::session::{DEFAULT_SITE, LogPart, Session, stem};
use crate::stores::{Found, resolve};

/// Files whose indexes are read at the same time.
const OPEN_AT_ONCE: usize = 8;

/// Sessions with their indexes read, and the ledger of what could not be read.
#[derive(Debug, Clone)]
pub struct Dataset {
    /// Sessions, ordered by name.
    pub sessions: Vec<Session>,
    /// What was lost so far; it grows while tables are scanned.
    pub losses: LossLedger,
    /// Choices that the user might want to make differently, in sentences.
    pub notes: Vec<String>,
}

/// Files of one session, before they are opened.
struct Group {
    name: String,
    site: Option<String>,
    files: Vec<Found>,
}

impl Dataset {
    /// Opens the files that `paths` name (files, folders, globs, URLs) and the sessions of the manifest, and reads
    /// their indexes.
    ///
    /// One file is one session, named after the file's stem. Files that a rosbag2 `metadata.yaml` beside them lists
    /// together are one session, named after their folder. The manifest says what else is one recording.
    ///
    /// # Errors
    /// A user fault when nothing is found or two sessions have one name; a data fault when a file is no MCAP file.
    /// A damaged file is no error: see [`Dataset::losses`].
    pub async fn open(
        runtime: &RuntimeEnv,
        paths: &[String],
        manifest: Option<&Manifest>,
    ) -> Result<Self, Fault> {
        let nothing = Manifest::default();
        let manifest = manifest.unwrap_or(&nothing);
        let mut groups = Vec::new();
        for session in &manifest.sessions {
            let mut files = Vec::new();
            for name in &session.files {
                files.extend(resolve(runtime, name).await?);
            }
            groups.push(Group {
                name: session.name.clone(),
                site: session.site.clone(),
                files,
            });
        }
        let mut files = Vec::new();
        for name in paths {
            files.extend(resolve(runtime, name).await?);
        }
        groups.extend(recordings(files).await?);
        check_names(&groups)?;
        let losses = LossLedger::new();
        let site = manifest.site.as_deref().unwrap_or(DEFAULT_SITE);
        let opened = futures::stream::iter(groups)
            .map(|group| open_session(group, site, &manifest.roles, &losses))
            .buffered(OPEN_AT_ONCE)
            .try_collect::<Vec<_>>()
            .await?;
        let mut sessions = Vec::new();
        let mut notes = Vec::new();
        for (session, said) in opened {
            notes.extend(
                said.iter()
                    .map(|note| format!("session {}: {note}", session.name)),
            );
            sessions.push(session);
        }
        sessions.sort_by(|a, b| a.name.cmp(&b.name));
        check_roles(&manifest.roles, &sessions)?;
        Ok(Self {
            sessions,
            losses,
            notes,
        })
    }

    /// The same dataset with only one of its sessions; losses go to the same ledger.
    ///
    /// # Errors
    /// A user fault when there is no such session.
    pub fn session(&self, name: &str) -> Result<Self, Fault> {
        let session = self.sessions.iter().find(|session| &*session.name == name);
        let session = session.ok_or_else(|| {
            let known: Vec<&str> = self.sessions.iter().map(|s| &*s.name).collect();
            Fault::user(format!(
                "expected one of the sessions {}, found {name}",
                known.join(", ")
            ))
        })?;
        Ok(Self {
            sessions: vec![session.clone()],
            losses: self.losses.clone(),
            notes: Vec::new(),
        })
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

    /// The schema of a topic's table.
    ///
    /// # Errors
    /// As [`crate::scan::topic_schema`].
    pub fn topic_schema(&self, topic: &str) -> Result<SchemaRef, Fault> {
        crate::scan::topic_schema(topic, &self.parts())
    }

    /// Every table of the dataset, by name: each topic, `messages`, `channels`, `sessions`, `attachments`,
    /// `metadata`, and the roles `frames`, `depth_frames`, `label_frames`, `odometry`, `calibration`, `transforms`,
    /// `label_classes`.
    ///
    /// A topic that cannot be decoded is a table that says so when it is scanned.
    ///
    /// # Errors
    /// A fault of ours.
    pub fn tables(&self) -> Result<BTreeMap<String, Arc<dyn TableProvider>>, Fault> {
        let parts = self.parts();
        let mut tables = BTreeMap::<String, Arc<dyn TableProvider>>::new();
        for topic in self.topics() {
            let table = LogTable::Topic(topic.as_str().into());
            let provider: Arc<dyn TableProvider> =
                match McapTable::new(table, &parts, self.losses.clone()) {
                    Ok(table) => Arc::new(table),
                    Err(fault) => Arc::new(FaultyTable::new(fault)),
                };
            tables.insert(topic, provider);
        }
        for table in [
            LogTable::Messages,
            LogTable::Attachments,
            LogTable::Metadata,
        ] {
            let name = table.name().to_owned();
            let provider = McapTable::new(table, &parts, self.losses.clone())?;
            tables.insert(name, Arc::new(provider));
        }
        tables.insert("sessions".to_owned(), listing::sessions(&self.sessions)?);
        tables.insert("channels".to_owned(), listing::channels(&self.sessions)?);
        for (name, table) in roles::tables(self)? {
            tables.insert(name.to_owned(), table);
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
                .map_err(|error| crate::scan::fault_of(&error).at(format!("table {name}")))?;
        }
        Ok(())
    }

    /// Registers the object stores that the files are in.
    pub fn register_stores(&self, runtime: &RuntimeEnv) {
        for part in self.sessions.iter().flat_map(|session| &session.parts) {
            runtime.register_object_store(part.store_url.as_ref(), part.store.clone());
        }
    }

    /// The digest of a session's bytes: BLAKE3 over the contents of its files in order, each preceded by its length.
    ///
    /// # Errors
    /// A user fault when there is no such session, a resource fault when a file cannot be read.
    pub async fn fingerprint(&self, session: &str) -> Result<blake3::Hash, Fault> {
        let mut hasher = blake3::Hasher::new();
        for part in &self.session(session)?.sessions[0].parts {
            hasher.update(&part.meta.size.to_le_bytes());
            let object = part.store.get(&part.meta.location).await;
            let object = object.map_err(|error| store_fault(&error).at(&part.url))?;
            let mut stream = object.into_stream();
            while let Some(bytes) = stream.next().await {
                let bytes = bytes.map_err(|error| store_fault(&error).at(&part.url))?;
                hasher.update(&bytes);
            }
        }
        Ok(hasher.finalize())
    }
}

async fn open_session(
    group: Group,
    site: &str,
    manifest: &ManifestRoles,
    losses: &LossLedger,
) -> Result<(Session, Vec<String>), Fault> {
    let name: Arc<str> = group.name.into();
    let site: Arc<str> = group.site.as_deref().unwrap_or(site).into();
    let mut parts = futures::stream::iter(group.files)
        .map(|file| LogPart::open(file.store, file.url, file.meta, losses))
        .buffered(OPEN_AT_ONCE)
        .try_collect::<Vec<_>>()
        .await?;
    parts.sort_by_key(|part| part.index.time_range().map_or(i64::MAX, |(start, _)| start));
    for (number, part) in parts.iter_mut().enumerate() {
        part.session = name.clone();
        part.site = site.clone();
        part.part = number as u32;
    }
    let mut topics = BTreeMap::<String, TopicInfo>::new();
    for part in &parts {
        for channel in part.index.channels.values() {
            let info = topics.entry(channel.topic.clone()).or_default();
            info.messages += part.index.channel_messages(channel.id).unwrap_or(0);
            if let Some(schema) = &channel.schema {
                info.schema.clone_from(&schema.name);
            }
        }
    }
    let (roles, notes) = Roles::resolve(manifest, &topics)?;
    let parts = parts.into_iter().map(Arc::new).collect();
    let session = Session {
        name,
        site,
        parts,
        roles,
    };
    Ok((session, notes))
}

/// Groups files into recordings: those that lie in one folder and are listed together by its rosbag2 `metadata.yaml`
/// are one, every other file is its own.
async fn recordings(files: Vec<Found>) -> Result<Vec<Group>, Fault> {
    let mut folders = BTreeMap::<(String, String), Vec<Found>>::new();
    for file in files {
        let siblings = folders.entry(file.folder()).or_default();
        if siblings
            .iter()
            .all(|other| other.meta.location != file.meta.location)
        {
            siblings.push(file);
        }
    }
    let mut groups = Vec::new();
    for ((_, folder), files) in folders {
        let listed = match files.len() {
            0 | 1 => Vec::new(),
            _ => rosbag2_files(&files[0], &folder).await,
        };
        let place = |file: &Found| listed.iter().position(|name| name == file.name());
        let (mut parts, single): (Vec<_>, Vec<_>) =
            files.into_iter().partition(|file| place(file).is_some());
        parts.sort_by_key(|file| place(file));
        let name = folder.rsplit('/').next().unwrap_or_default().to_owned();
        match parts.len() {
            0 => {}
            1 => groups.extend(parts.into_iter().map(single_group)),
            _ => groups.push(Group {
                name,
                site: None,
                files: parts,
            }),
        }
        groups.extend(single.into_iter().map(single_group));
    }
    Ok(groups)
}

fn single_group(file: Found) -> Group {
    Group {
        name: stem(file.name()).to_owned(),
        site: None,
        files: vec![file],
    }
}

/// File names that a folder's `metadata.yaml` lists, in order; none where there is no such file, or it is not
/// rosbag2's.
async fn rosbag2_files(sibling: &Found, folder: &str) -> Vec<String> {
    let path = format!("{folder}/metadata.yaml");
    let Ok(path) = Path::parse(path.trim_start_matches('/')) else {
        return Vec::new();
    };
    let Ok(object) = sibling.store.get(&path).await else {
        return Vec::new();
    };
    let bytes = object.bytes().await.unwrap_or_default();
    let metadata: serde_yaml_ng::Value = serde_yaml_ng::from_slice(&bytes).unwrap_or_default();
    let files = &metadata["rosbag2_bagfile_information"]["relative_file_paths"];
    let names = files.as_sequence().into_iter().flatten();
    let name = |value: &serde_yaml_ng::Value| {
        let path = value.as_str()?;
        Some(path.rsplit('/').next().unwrap_or(path).to_owned())
    };
    names.filter_map(name).collect()
}

fn check_names(groups: &[Group]) -> Result<(), Fault> {
    let mut seen = BTreeMap::<&str, &Group>::new();
    for group in groups {
        if let Some(other) = seen.insert(&group.name, group) {
            let place = |group: &Group| match group.files.first() {
                Some(file) => file.meta.location.to_string(),
                None => "the manifest".to_owned(),
            };
            return Err(Fault::user(format!(
                "expected one session of each name, found two named {}: {} and {}",
                group.name,
                place(other),
                place(group)
            ))
            .next("name them in a session manifest, or rename a file"));
        }
    }
    Ok(())
}

/// A pattern of the manifest that no session has a topic for is a mistake.
fn check_roles(manifest: &ManifestRoles, sessions: &[Session]) -> Result<(), Fault> {
    let given = [
        ("frames", manifest.frames.is_some()),
        ("depth_frames", manifest.depth_frames.is_some()),
        ("label_frames", manifest.label_frames.is_some()),
        ("odometry", manifest.odometry.is_some()),
        ("calibration", manifest.calibration.is_some()),
        ("transforms", manifest.transforms.is_some()),
    ];
    for (role, given) in given {
        let found = sessions
            .iter()
            .any(|session| !session.roles.topics(role).is_empty());
        if given && !found {
            let topics: BTreeSet<String> = sessions.iter().flat_map(Session::topics).collect();
            let topics: Vec<String> = topics.into_iter().collect();
            return Err(Fault::user(format!(
                "expected a topic for the role {role}, found none that fits among {}",
                topics.join(", ")
            ))
            .at(format!("roles.{role}")));
        }
    }
    Ok(())
}
