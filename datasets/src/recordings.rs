//! From what a person names to sessions whose files are found, before any of them is read.

use std::collections::{BTreeMap, HashSet};

use datafusion::execution::runtime_env::RuntimeEnv;
use evermap_schemas::Fault;
use evermap_schemas::roles::{self, Role};
use object_store::ObjectStoreExt;
use object_store::path::Path;

use crate::manifest::{Bits, Manifest, SessionFiles, Vehicle, of_file, of_name};
use crate::session::stem;
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
    /// Bits of samples of raw images, by topic.
    pub(crate) bits: Bits,
    /// The vehicle.
    pub(crate) vehicle: Vehicle,
}

/// The files of one session.
#[derive(Debug)]
pub struct Recording {
    /// Name of the session.
    pub name: String,
    /// Site of the session: the session's own name where nobody says one, as odometry frames of sessions differ.
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
    /// A user fault when nothing is found or two sessions have one name; one of the manifest has its entry as its place
    /// ([`crate::manifest::faulty_session`]).
    pub async fn find(
        runtime: &RuntimeEnv,
        paths: &[String],
        manifest: Option<&Manifest>,
    ) -> Result<Self, Fault> {
        let nothing = Manifest::default();
        let manifest = manifest.unwrap_or(&nothing);
        let recording = |name: String, own: Option<&str>, files| Recording {
            site: own.or(manifest.site.as_deref()).unwrap_or(&name).to_owned(),
            name,
            files,
        };
        let mut sessions = Vec::new();
        for (index, session) in manifest.sessions.iter().enumerate() {
            let SessionFiles {
                name,
                files,
                site: own,
            } = session;
            let files = find_all(runtime, files).await;
            let files = files.map_err(|(fault, file)| of_file(fault, index, file))?;
            sessions.push(recording(name.clone(), own.as_deref(), files));
        }
        let listed = find_all(runtime, paths).await.map_err(|(fault, _)| fault)?;
        let listed = grouped(listed).await;
        let listed = listed.into_iter();
        sessions.extend(listed.map(|(name, files)| recording(name, None, files)));
        check_names(&sessions, manifest.sessions.len())?;
        Ok(Self {
            sessions,
            roles: roles::ALL,
            topics: manifest.roles.clone(),
            bits: manifest.bits.clone(),
            vehicle: manifest.vehicle(),
        })
    }

    /// The same, to be read for a vehicle in place of the manifest's.
    #[must_use]
    pub fn of_vehicle(self, vehicle: Vehicle) -> Self {
        Self { vehicle, ..self }
    }
}

/// The files that these name; a fault comes with the index of the name that is at fault.
async fn find_all(runtime: &RuntimeEnv, names: &[String]) -> Result<Vec<LogFile>, (Fault, usize)> {
    let mut files = Vec::new();
    for (index, name) in names.iter().enumerate() {
        let found = resolve(runtime, name).await;
        files.extend(found.map_err(|fault| (fault, index))?);
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

/// That no two sessions have one name; the first so many are those of the manifest.
fn check_names(recordings: &[Recording], written: usize) -> Result<(), Fault> {
    let mut seen = BTreeMap::<&str, usize>::new();
    for (index, recording) in recordings.iter().enumerate() {
        let Some(other) = seen.insert(&recording.name, index) else {
            continue;
        };
        let place = |index: usize| match recordings[index].files.first() {
            Some(file) => file.url(),
            None => "the manifest".to_owned(),
        };
        let fault = Fault::user(format!(
            "expected one session of each name, found two named {}: {} and {}",
            recording.name,
            place(other),
            place(index)
        ));
        return Err(if index < written {
            of_name(fault.next("give one of them another name"), index)
        } else if other < written {
            let next = "give it another name in the manifest, or name its file there alone";
            of_name(fault.next(next), other)
        } else {
            fault.next("name them in a session manifest, or rename a file")
        });
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::manifest::{faulty_session, unwritten};

    /// What is wrong with sessions: where in the manifest, where else, and what to do next.
    async fn fault(sessions: &[(&str, &[&str])], paths: &[&str]) -> [String; 3] {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &&str| folder.path().join(name).to_string_lossy().into_owned();
        for name in ["a.mcap", "b.mcap", "c.mcap"] {
            std::fs::write(at(&name), "").unwrap();
        }
        let session = |(name, files): &(&str, &[&str])| SessionFiles {
            name: (*name).to_owned(),
            files: files.iter().map(at).collect(),
            site: None,
        };
        let manifest = Manifest {
            sessions: sessions.iter().map(session).collect(),
            ..Manifest::default()
        };
        let paths: Vec<String> = paths.iter().map(at).collect();
        let found = Recordings::find(&RuntimeEnv::default(), &paths, Some(&manifest)).await;
        let fault = found.unwrap_err();
        let (entry, _) = faulty_session(&fault).unwrap_or_default();
        let entry = entry.to_owned();
        let fault = unwritten(fault);
        let folder = format!("{}/", folder.path().display());
        [entry, fault.place.replace(&folder, ""), fault.next]
    }

    #[tokio::test]
    async fn a_session_of_which_nobody_says_a_site_is_a_site_of_its_own() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name).to_string_lossy().into_owned();
        for name in ["a.mcap", "b.mcap", "c.mcap"] {
            std::fs::write(at(name), "").unwrap();
        }
        let session = |name: &str, file: &str, site: Option<&str>| SessionFiles {
            name: name.to_owned(),
            files: vec![at(file)],
            site: site.map(str::to_owned),
        };
        let sites = async |site: Option<&str>| {
            let manifest = Manifest {
                site: site.map(str::to_owned),
                sessions: vec![
                    session("one", "a.mcap", Some("street")),
                    session("two", "b.mcap", None),
                ],
                ..Manifest::default()
            };
            let runtime = RuntimeEnv::default();
            let found = Recordings::find(&runtime, &[at("c.mcap")], Some(&manifest)).await;
            let sessions = found.unwrap().sessions.into_iter();
            let sites = sessions.map(|session| session.site);
            sites.collect::<Vec<_>>()
        };
        assert_eq!(sites(None).await, ["street", "two", "c"]);
        assert_eq!(
            sites(Some("default")).await,
            ["street", "default", "default"]
        );
    }

    #[tokio::test]
    async fn what_a_manifest_says_wrong_of_sessions_has_its_place_there() {
        let give = "give a file, a folder, a glob in quotes, or a URL";
        let first: (&str, &[&str]) = ("one", &["a.mcap"]);
        let found = fault(&[first, ("two", &["b.mcap", "no.mcap"])], &[]).await;
        assert_eq!(found, ["sessions[1].files[1]", "no.mcap", give]);
        let found = fault(&[("one", &["n*.mcap"])], &["a.mcap"]).await;
        assert_eq!(found, ["sessions[0].files[0]", "", give]);
        let found = fault(&[first, ("one", &["b.mcap"])], &[]).await;
        let another = "give one of them another name";
        assert_eq!(found, ["sessions[1].name", "", another]);
        let found = fault(&[first, ("b", &["a.mcap"])], &["b.mcap"]).await;
        assert_eq!(found[0], "sessions[1].name");
        let found = fault(&[first], &["no.mcap"]).await;
        assert_eq!(found, ["", "no.mcap", give]);
    }
}
