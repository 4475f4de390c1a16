//! Where logs are: local paths, globs, and any URL that `object_store` reads.

use std::io::Read;
use std::path::Path as FilePath;
use std::sync::Arc;

use datafusion::execution::object_store::ObjectStoreUrl;
use datafusion::execution::runtime_env::RuntimeEnv;
use evermap_schemas::Fault;
use futures::TryStreamExt;
use object_store::path::Path;
use object_store::{ObjectMeta, ObjectStore, ObjectStoreExt};
use url::{Position, Url};

use crate::address::url_of;
use crate::fault::store_fault;
use crate::log::index::LogIndex;

mod local;

/// A log's file that was named, or found.
#[derive(Debug, Clone)]
pub struct LogFile {
    /// Store that holds it.
    pub store: Arc<dyn ObjectStore>,
    /// The store's name in DataFusion's registry.
    pub store_url: ObjectStoreUrl,
    /// Path, size and times in the store.
    pub meta: ObjectMeta,
    /// Its index, where that is known from elsewhere. It is believed if it fits the file's size and makes sense; else
    /// it is read from the file.
    pub index: Option<LogIndex>,
    /// Why it cannot be a log, where that shows from outside: it is told when it is opened.
    pub refused: Option<Fault>,
}

impl LogFile {
    fn new(store: &Arc<dyn ObjectStore>, store_url: &ObjectStoreUrl, meta: ObjectMeta) -> Self {
        Self {
            store: store.clone(),
            store_url: store_url.clone(),
            meta,
            index: None,
            refused: None,
        }
    }

    pub(crate) fn name(&self) -> &str {
        self.meta.location.filename().unwrap_or_default()
    }

    /// Store and folder, to tell which files lie side by side.
    pub(crate) fn folder(&self) -> (String, String) {
        let path = self.meta.location.as_ref();
        let folder = path.rsplit_once('/').map_or("", |(folder, _)| folder);
        (self.store_url.as_str().to_owned(), folder.to_owned())
    }

    /// Where it is, for people.
    pub(crate) fn url(&self) -> String {
        match self.store_url.as_str() {
            "file:///" => format!("/{}", self.meta.location),
            url => format!("{}/{}", url.trim_end_matches('/'), self.meta.location),
        }
    }
}

/// The files that a path, glob or URL names, in natural order (`x_2` before `x_10`). A folder stands for the MCAP
/// files in it.
pub(crate) async fn resolve(runtime: &RuntimeEnv, name: &str) -> Result<Vec<LogFile>, Fault> {
    let mut found = match url_of(name)? {
        Some(url) if url.scheme() == "file" => {
            let path = url.to_file_path().map_err(|()| {
                Fault::user(format!("expected the URL of a local file, found {name}"))
            })?;
            local::files(runtime, &path.to_string_lossy()).await?
        }
        Some(url) => remote(runtime, &url).await?,
        None => local::files(runtime, name).await?,
    };
    if found.is_empty() {
        return Err(
            Fault::user(format!("expected MCAP files, found none at {name}")).next(WHAT_TO_GIVE),
        );
    }
    found.sort_by_key(|file| natural_key(file.meta.location.as_ref()));
    Ok(found)
}

/// Text with its numbers as numbers.
pub(crate) fn natural_key(text: &str) -> Vec<(String, u64)> {
    let mut key = Vec::new();
    let mut rest = text;
    while !rest.is_empty() {
        let digits = rest
            .find(|c: char| c.is_ascii_digit())
            .unwrap_or(rest.len());
        let (word, tail) = rest.split_at(digits);
        let end = tail
            .find(|c: char| !c.is_ascii_digit())
            .unwrap_or(tail.len());
        let (number, tail) = tail.split_at(end);
        key.push((word.to_owned(), number.parse().unwrap_or(u64::MAX)));
        rest = tail;
    }
    key.push((text.to_owned(), 0));
    key
}

/// What names logs.
const WHAT_TO_GIVE: &str = "give a file, a folder, a glob in quotes, or a URL";

fn is_mcap(path: &FilePath) -> bool {
    path.extension()
        .is_some_and(|extension| extension.eq_ignore_ascii_case("mcap"))
}

/// What stands at a path in the place of a file: a folder, what has no end or waits for ever for one (a pipe, a socket, a device), or
/// a link that leads nowhere. `None` for a file.
///
/// # Errors
/// What the file system says; `NotFound` where there is nothing.
pub fn no_file(path: &FilePath) -> std::io::Result<Option<&'static str>> {
    let kind = match std::fs::metadata(path) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
            path.symlink_metadata()?;
            return Ok(Some("a link that leads nowhere"));
        }
        found => found?.file_type(),
    };
    Ok(match () {
        () if kind.is_file() => None,
        () if kind.is_dir() => Some("a folder"),
        () => Some(special(kind)),
    })
}

/// What a person wrote is not as large: plans, manifests, labels of other programs.
const LARGEST_TEXT: u64 = 256 << 20;

/// What some editors begin a text with: it is no part of it.
const BYTE_ORDER_MARK: &str = "\u{feff}";

/// A text without the byte order mark that it may begin with.
pub fn without_mark(text: &str) -> &str {
    text.strip_prefix(BYTE_ORDER_MARK).unwrap_or(text)
}

/// A file that a person wrote, whole, without a byte order mark.
///
/// # Errors
/// What keeps it from being read; that it is a pipe or a device, which might never end, or too large.
pub fn read_bytes(path: &FilePath) -> std::io::Result<Vec<u8>> {
    let mut bytes = read_at_most(path, LARGEST_TEXT)?;
    if bytes.starts_with(BYTE_ORDER_MARK.as_bytes()) {
        bytes.drain(..BYTE_ORDER_MARK.len());
    }
    Ok(bytes)
}

/// A file that a person names, whole, of at most so many bytes.
///
/// # Errors
/// As [`read_bytes`].
pub fn read_at_most(path: &FilePath, largest: u64) -> std::io::Result<Vec<u8>> {
    let found = std::fs::metadata(path).map_err(|error| match error.kind() {
        kind @ std::io::ErrorKind::NotFound => std::io::Error::new(kind, "nothing"),
        _ => error,
    })?;
    if !found.is_file() && !found.is_dir() {
        let kind = special(found.file_type());
        return Err(std::io::Error::other(format!("{kind}, and no file")));
    }
    let mut bytes = Vec::new();
    let mut file = std::fs::File::open(path)?.take(largest + 1);
    if file.read_to_end(&mut bytes)? as u64 > largest {
        let most = largest >> 20;
        return Err(std::io::Error::other(format!(
            "a file of more than {most} MiB"
        )));
    }
    Ok(bytes)
}

/// The same as text.
///
/// # Errors
/// As [`read_bytes`], or where it is none.
pub fn read_text(path: &FilePath) -> std::io::Result<String> {
    let no_text = |_| std::io::Error::other("bytes that are no UTF-8");
    String::from_utf8(read_bytes(path)?).map_err(no_text)
}

#[cfg(unix)]
fn special(kind: std::fs::FileType) -> &'static str {
    use std::os::unix::fs::FileTypeExt;
    match () {
        () if kind.is_fifo() => "a named pipe",
        () if kind.is_socket() => "a socket",
        () => "a device",
    }
}

#[cfg(not(unix))]
fn special(_: std::fs::FileType) -> &'static str {
    "something else"
}

/// What a pattern found: the MCAP files alone, where there are any among others.
fn logs_among<T>(mut found: Vec<T>, path: impl Fn(&T) -> &FilePath) -> Vec<T> {
    if found.iter().any(|file| is_mcap(path(file))) {
        found.retain(|file| is_mcap(path(file)));
    }
    found
}

async fn remote(runtime: &RuntimeEnv, url: &Url) -> Result<Vec<LogFile>, Fault> {
    let store_url = ObjectStoreUrl::parse(&url[..Position::BeforePath])
        .map_err(|error| Fault::user(error.to_string()).at(url))?;
    let (store, path) = open_store(runtime, url, &store_url)?;
    let found = match path.as_ref().contains(['*', '?', '[']) {
        true => matching(store.as_ref(), &path).await,
        false => at(store.as_ref(), &path).await,
    };
    let found = found.map_err(|fault| fault.at(url))?.into_iter();
    let file = |meta| LogFile::new(&store, &store_url, meta);
    Ok(found.map(file).collect())
}

/// The object of this name, or else the MCAP files of the folder.
async fn at(store: &dyn ObjectStore, path: &Path) -> Result<Vec<ObjectMeta>, Fault> {
    let refused = match store.head(path).await {
        Ok(meta) => return Ok(vec![meta]),
        Err(object_store::Error::NotFound { .. }) => None,
        Err(error) => Some(store_fault(&error)),
    };
    // Who may not look at an object may still list a folder.
    let listed = store.list_with_delimiter(Some(path)).await;
    let mut logs = match (listed, &refused) {
        (Ok(listed), _) => listed.objects,
        (Err(_), Some(_)) => Vec::new(),
        (Err(error), None) => return Err(store_fault(&error)),
    };
    logs.retain(|meta| is_mcap(FilePath::new::<str>(meta.location.as_ref())));
    match refused.filter(|_| logs.is_empty()) {
        Some(fault) => Err(fault),
        None => Ok(logs),
    }
}

/// The objects that a pattern fits, or the one that is called so.
async fn matching(store: &dyn ObjectStore, path: &Path) -> Result<Vec<ObjectMeta>, Fault> {
    let text: &str = path.as_ref();
    let pattern = glob::Pattern::new(text)
        .map_err(|error| Fault::user(format!("the pattern {text}: {error}")))?;
    let fixed = text.split(['*', '?', '[']).next().unwrap_or_default();
    let prefix = fixed.rsplit_once('/').map_or("", |(folder, _)| folder);
    let prefix = Path::parse(prefix).map_err(|error| Fault::user(error.to_string()))?;
    let listed = store.list(Some(&prefix)).try_collect().await;
    let listed: Vec<ObjectMeta> = listed.map_err(|error| store_fault(&error))?;
    if let Some(named) = listed.iter().find(|meta| meta.location == *path) {
        return Ok(vec![named.clone()]);
    }
    let options = glob::MatchOptions {
        require_literal_separator: true,
        ..glob::MatchOptions::new()
    };
    let fits = |meta: &ObjectMeta| pattern.matches_with(meta.location.as_ref(), options);
    let fitting: Vec<ObjectMeta> = listed.into_iter().filter(fits).collect();
    Ok(logs_among(fitting, |meta: &ObjectMeta| {
        FilePath::new::<str>(meta.location.as_ref())
    }))
}

/// The store of a URL: one that is registered already, else a new one with the environment's credentials, which is
/// then registered.
fn open_store(
    runtime: &RuntimeEnv,
    url: &Url,
    store_url: &ObjectStoreUrl,
) -> Result<(Arc<dyn ObjectStore>, Path), Fault> {
    let wrong = |error: object_store::Error| Fault::user(error.to_string()).at(url);
    if let Ok(store) = runtime.object_store(store_url) {
        let path = Path::from_url_path(url.path()).map_err(|e| wrong(e.into()))?;
        return Ok((store, path));
    }
    let options = std::env::vars().map(|(key, value)| (key.to_lowercase(), value));
    let (store, path) = object_store::parse_url_opts(url, options).map_err(wrong)?;
    let store: Arc<dyn ObjectStore> = Arc::from(store);
    runtime.register_object_store(store_url.as_ref(), store.clone());
    Ok((store, path))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_that_is_not_there_is_nothing() {
        let path = FilePath::new("/no/such/labels.json");
        let told = read_text(path).map_err(|error| (error.kind(), error.to_string()));
        let said = (std::io::ErrorKind::NotFound, "nothing".to_owned());
        assert_eq!(told, Err(said));
    }

    #[test]
    #[allow(clippy::unwrap_used)]
    fn a_byte_order_mark_is_no_part_of_a_text() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("labels.json");
        for (written, read) in [("\u{feff}{}", "{}"), ("{\u{feff}}", "{\u{feff}}"), ("", "")] {
            std::fs::write(&path, written).unwrap();
            assert_eq!(read_text(&path).unwrap(), read);
            assert_eq!(read_bytes(&path).unwrap(), read.as_bytes());
            assert_eq!(without_mark(written), read);
        }
    }

    #[test]
    fn endings_in_capitals_are_endings() {
        let is_log = |name: &str| is_mcap(FilePath::new(name));
        assert!(is_log("/a/drive.mcap") && is_log("/a/drive2.MCAP"));
        assert!(!is_log("/a/mcap") && !is_log("/a/drive.mcap.part"));
    }

    #[test]
    fn numbers_sort_as_numbers() {
        let mut names = ["x_10.mcap", "x_2.mcap", "x_1.mcap", "a.mcap"];
        names.sort_by_key(|name| natural_key(name));
        assert_eq!(names, ["a.mcap", "x_1.mcap", "x_2.mcap", "x_10.mcap"]);
    }
}
