//! From what a person names to sessions whose files are found, before any of them is read.

use std::collections::{BTreeMap, HashSet};

use datafusion::execution::runtime_env::RuntimeEnv;
use evermap_schemas::Fault;
use evermap_schemas::roles::{self, Role};
use object_store::ObjectStoreExt;
use object_store::path::Path;

use crate::manifest::{Manifest, SessionFiles, Vehicle};
use crate::session::{DEFAULT_SITE, stem};
use crate::stores::{LogFile, resolve};
use crate::yaml::{LONGEST, from_yaml};

/// Sessions whose files are found, and how they are to be opened.
#[derive(Debug)]
pub struct Recordings {
    /// The sessions.
    pub sessions: Vec<Recording>,
    /// The roles that their topics may play: a table each.
    pub roles: &'static [Role],
    /// Topics by role, where they are not inferred.
    pub(crate) topics: BTreeMap<String, Vec<String>>,
    /// The vehicle.
    pub(crate) vehicle: Vehicle,
}

/// The files of one session.
#[derive(Debug)]
pub struct Recording {
    /// Name of the session.
    pub name: String,
    /// Site of the session.
    pub site: String,
    /// The files, in any order.
    pub files: Vec<LogFile>,
}

impl Recordings {
    /// Finds the files that `paths` name (files, folders, globs, URLs) and the sessions of the manifest.
    ///
    /// One file is one session, named after the file's stem. Files that a rosbag2 `metadata.yaml` beside them lists
    /// together are one session, named after their folder. The manifest says what else is one recording.
    ///
    /// # Errors
    /// A user fault when nothing is found or two sessions have one name.
    pub async fn find(
        runtime: &RuntimeEnv,
        paths: &[String],
        manifest: Option<&Manifest>,
    ) -> Result<Self, Fault> {
        let nothing = Manifest::default();
        let manifest = manifest.unwrap_or(&nothing);
        let site = manifest.site.as_deref().unwrap_or(DEFAULT_SITE);
        let mut sessions = Vec::new();
        for SessionFiles {
            name,
            files,
            site: own,
        } in &manifest.sessions
        {
            sessions.push(Recording {
                name: name.clone(),
                site: own.as_deref().unwrap_or(site).to_owned(),
                files: find_all(runtime, files).await?,
            });
        }
        let listed = grouped(find_all(runtime, paths).await?).await;
        sessions.extend(listed.into_iter().map(|(name, files)| Recording {
            name,
            site: site.to_owned(),
            files,
        }));
        check_names(&sessions)?;
        Ok(Self {
            sessions,
            roles: roles::ALL,
            topics: manifest.roles.clone(),
            vehicle: manifest.vehicle(),
        })
    }

    /// The same, to be read for a vehicle in place of the manifest's.
    #[must_use]
    pub fn of_vehicle(self, vehicle: Vehicle) -> Self {
        Self { vehicle, ..self }
    }
}

async fn find_all(runtime: &RuntimeEnv, names: &[String]) -> Result<Vec<LogFile>, Fault> {
    let mut files = Vec::new();
    for name in names {
        files.extend(resolve(runtime, name).await?);
    }
    Ok(files)
}

/// Groups files into sessions, by name: those that lie in one folder and are listed together by its rosbag2
/// `metadata.yaml` are one, every other file is its own. A file that is named twice counts once.
async fn grouped(files: Vec<LogFile>) -> Vec<(String, Vec<LogFile>)> {
    let mut folders = BTreeMap::<(String, String), Vec<LogFile>>::new();
    let mut seen = HashSet::new();
    for file in files {
        let folder = file.folder();
        if seen.insert((folder.clone(), file.meta.location.clone())) {
            folders.entry(folder).or_default().push(file);
        }
    }
    let mut groups = Vec::new();
    for ((_, folder), files) in folders {
        let listed = match files.len() {
            0 | 1 => Vec::new(),
            _ => rosbag2_files(&files[0], &folder).await,
        };
        let place = |file: &LogFile| listed.iter().position(|name| name == file.name());
        let (mut parts, mut single): (Vec<_>, Vec<_>) =
            files.into_iter().partition(|file| place(file).is_some());
        if parts.len() > 1 {
            parts.sort_by_key(place);
            let name = folder.rsplit('/').next().unwrap_or_default();
            groups.push((name.to_owned(), parts));
        } else {
            single.extend(parts);
        }
        let alone = |file: LogFile| (stem(file.name()).to_owned(), vec![file]);
        groups.extend(single.into_iter().map(alone));
    }
    groups
}

/// File names that a folder's `metadata.yaml` lists, in order; none where there is no such file, or it is not
/// rosbag2's.
async fn rosbag2_files(sibling: &LogFile, folder: &str) -> Vec<String> {
    let path = format!("{folder}/metadata.yaml");
    let Ok(path) = Path::parse(path.trim_start_matches('/')) else {
        return Vec::new();
    };
    let Ok(object) = sibling.store.get(&path).await else {
        return Vec::new();
    };
    if object.meta.size > LONGEST as u64 {
        return Vec::new();
    }
    let bytes = object.bytes().await.unwrap_or_default();
    let text = String::from_utf8_lossy(&bytes);
    let metadata: serde_yaml_ng::Value =
        from_yaml(&text, "metadata of a rosbag2").unwrap_or_default();
    let files = &metadata["rosbag2_bagfile_information"]["relative_file_paths"];
    let names = files.as_sequence().into_iter().flatten();
    let name = |value: &serde_yaml_ng::Value| {
        let path = value.as_str()?;
        Some(path.rsplit('/').next().unwrap_or(path).to_owned())
    };
    names.filter_map(name).collect()
}

fn check_names(recordings: &[Recording]) -> Result<(), Fault> {
    let mut seen = BTreeMap::<&str, &Recording>::new();
    for recording in recordings {
        if let Some(other) = seen.insert(&recording.name, recording) {
            let place = |recording: &Recording| match recording.files.first() {
                Some(file) => file.url(),
                None => "the manifest".to_owned(),
            };
            return Err(Fault::user(format!(
                "expected one session of each name, found two named {}: {} and {}",
                recording.name,
                place(other),
                place(recording)
            ))
            .next("name them in a session manifest, or rename a file"));
        }
    }
    Ok(())
}
