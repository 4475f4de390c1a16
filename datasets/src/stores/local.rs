//! Files on a disk that a path or a pattern names.

use std::collections::BTreeSet;
use std::path::{Path as FilePath, PathBuf};
use std::sync::Arc;

use datafusion::execution::object_store::ObjectStoreUrl;
use datafusion::execution::runtime_env::RuntimeEnv;
use evermap_schemas::Fault;
use object_store::path::Path;
use object_store::{ObjectMeta, ObjectStore, ObjectStoreExt};

use super::{LogFile, WHAT_TO_GIVE, is_mcap, logs_among, special};
use crate::escapes::escaped;
use crate::fault::store_fault;

/// The files that a path or a pattern names, or a folder has.
///
/// # Errors
/// A user fault for a pattern that is none. What is wrong with a file is a fault where it is the only one; among others it
/// is what the file is refused for.
pub(super) async fn files(runtime: &RuntimeEnv, name: &str) -> Result<Vec<LogFile>, Fault> {
    let url = ObjectStoreUrl::local_filesystem();
    let store = runtime
        .object_store(&url)
        .map_err(|error| Fault::resource(error.to_string()))?;
    let mut files = Vec::new();
    let paths = paths(name)?;
    let is_among_others = paths.len() > 1;
    for path in paths {
        let file = match found(&store, &path).await {
            Ok(meta) => LogFile::new(&store, &url, meta),
            Err(fault) if is_among_others => LogFile {
                refused: Some(fault),
                ..LogFile::new(&store, &url, nothing_at(&path))
            },
            Err(fault) => return Err(fault),
        };
        files.push(file);
    }
    Ok(files)
}

/// Where a file is and what its store says of it.
async fn found(store: &Arc<dyn ObjectStore>, path: &FilePath) -> Result<ObjectMeta, Fault> {
    check_file(path)?;
    let location = location(path)?;
    let meta = store.head(&location).await;
    meta.map_err(|error| store_fault(&error).at(shown(path)))
}

fn location(path: &FilePath) -> Result<Path, Fault> {
    let plain = plain_path(path).map_err(|error| Fault::user(error.to_string()).at(shown(path)))?;
    Path::from_absolute_path(&plain).map_err(|_| {
        Fault::user("expected names in UTF-8 without control characters, found another one")
            .next("rename it")
            .at(shown(&plain))
    })
}

/// A path for people: one that is no text of a line is written with escapes.
fn shown(path: &FilePath) -> String {
    match path.to_str() {
        Some(text) if !text.contains(char::is_control) => text.to_owned(),
        _ => escaped(path.as_os_str().as_encoded_bytes()),
    }
}

/// What is said of a file that cannot be read, at its place as it is shown.
fn nothing_at(path: &FilePath) -> ObjectMeta {
    let as_shown = || {
        let absolute = std::path::absolute(path);
        let text = shown(absolute.as_deref().unwrap_or(path));
        Path::parse(&text).unwrap_or_else(|_| Path::from(text))
    };
    ObjectMeta {
        location: location(path).unwrap_or_else(|_| as_shown()),
        last_modified: Default::default(),
        size: 0,
        e_tag: None,
        version: None,
    }
}

/// Refuses what is not there, and what is no file: reading a pipe would wait for ever, and a device has no end.
fn check_file(path: &FilePath) -> Result<(), Fault> {
    let found = std::fs::metadata(path).map_err(|error| {
        match error.kind() {
            std::io::ErrorKind::NotFound => {
                Fault::user("expected a file, found nothing").next(WHAT_TO_GIVE)
            }
            _ => Fault::resource(format!("cannot read the file: {error}")),
        }
        .at(shown(path))
    })?;
    if found.is_file() || found.is_dir() {
        return Ok(());
    }
    let kind = special(found.file_type());
    Err(Fault::user(format!("expected a file, found {kind}"))
        .next("record it to a file first")
        .at(shown(path)))
}

/// The absolute path without `..`; a link to a file keeps its own name.
fn plain_path(path: &FilePath) -> std::io::Result<PathBuf> {
    let path = std::path::absolute(path)?;
    match (path.parent(), path.file_name()) {
        (Some(folder), Some(name)) if folder.exists() => Ok(folder.canonicalize()?.join(name)),
        _ => path.canonicalize(),
    }
}

fn paths(name: &str) -> Result<Vec<PathBuf>, Fault> {
    let path = FilePath::new(name);
    if path.is_dir() {
        return folder_paths(path);
    }
    if path.exists() || !name.contains(['*', '?', '[']) {
        return Ok(vec![path.to_owned()]);
    }
    let matches = glob::glob(name)
        .map_err(|error| Fault::user(format!("the pattern {name}: {error}")))?
        .collect::<Result<Vec<_>, _>>()
        .map_err(|error| Fault::resource(error.to_string()))?;
    let PassedOver { ends, on_the_way } = passed_over(name);
    let mut files = Vec::new();
    for path in matches.into_iter().chain(ends) {
        match path.is_dir() {
            true => files.extend(folder_paths(&path)?.into_iter().filter(|p| is_mcap(p))),
            false => files.push(path),
        }
    }
    let mut files = logs_among(files, PathBuf::as_path);
    files.extend(on_the_way);
    Ok(files)
}

/// What a pattern would fit if its name were UTF-8.
#[derive(Default)]
struct PassedOver {
    /// What the whole pattern fits.
    ends: BTreeSet<PathBuf>,
    /// Folders that a part of it fits; what is in them is not looked for.
    on_the_way: BTreeSet<PathBuf>,
}

/// What [`glob::glob`] passes over, as it compares names that are UTF-8 alone.
fn passed_over(pattern: &str) -> PassedOver {
    let mut found = PassedOver::default();
    let mut end = 0;
    for part in pattern.split_inclusive('/') {
        let start = end;
        end += part.len();
        let part = part.trim_end_matches('/');
        if part == "**" || !part.contains(['*', '?', '[']) {
            continue;
        }
        let Ok(wanted) = glob::Pattern::new(part) else {
            continue;
        };
        for folder in folders(&pattern[..start]) {
            let fitting = other_names(&folder, &wanted);
            match end == pattern.len() {
                true => found.ends.extend(fitting),
                false => found
                    .on_the_way
                    .extend(fitting.filter(|path| path.is_dir())),
            }
        }
    }
    found
}

/// The folders that the beginning of a pattern fits.
fn folders(mut beginning: &str) -> Vec<PathBuf> {
    let mut found = Vec::new();
    loop {
        match beginning {
            "" => found.push(PathBuf::from(".")),
            _ => found.extend(glob::glob(beginning).into_iter().flatten().flatten()),
        }
        // Any number of folders may be none.
        match beginning.strip_suffix("**/") {
            Some(shorter) => beginning = shorter,
            None => return found,
        }
    }
}

/// What a folder has by names that are not UTF-8 and, as they are shown, fit.
fn other_names(folder: &FilePath, wanted: &glob::Pattern) -> impl Iterator<Item = PathBuf> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let fits = move |path: &PathBuf| {
        let name = path.file_name().filter(|name| name.to_str().is_none());
        name.is_some_and(|name| wanted.matches(&name.to_string_lossy()))
    };
    entries.map(|entry| entry.path()).filter(fits)
}

/// The MCAP files of a folder; where there are none, its bags, so that they are refused with what to do.
fn folder_paths(folder: &FilePath) -> Result<Vec<PathBuf>, Fault> {
    let entries = std::fs::read_dir(folder)
        .and_then(|entries| {
            entries
                .map(|e| Ok(e?.path()))
                .collect::<Result<Vec<_>, _>>()
        })
        .map_err(|error| Fault::resource(error.to_string()).at(shown(folder)))?;
    let with = |extensions: &[&str]| -> Vec<PathBuf> {
        let fits = |path: &&PathBuf| {
            let extension = path.extension().and_then(|e| e.to_str());
            !path.is_dir() && extension.is_some_and(|found| extensions.contains(&found))
        };
        entries.iter().filter(fits).cloned().collect()
    };
    let logs = with(&["mcap"]);
    Ok(if logs.is_empty() {
        with(&["bag", "db3"])
    } else {
        logs
    })
}
