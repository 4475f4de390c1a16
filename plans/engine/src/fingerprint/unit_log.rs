//! The log of a session as a unit reads it: the one that the unit's recipe names, when it is opened and when it was read.

use std::sync::Arc;
use std::sync::atomic::AtomicU64;

use datafusion::execution::runtime_env::RuntimeEnv;
use evermap_datasets::fault::changed;
use evermap_datasets::{Dataset, LogPart, Manifest, Recordings};
use evermap_schemas::Fault;

use super::{Believe, FileState, Fingerprint, in_place, mapped, open, opened};
use crate::map::receipt::LogContent;
use crate::map::store::{Store, each};

/// A log that a unit reads. Of a file that has grown since its digest was taken there is as much as there was.
#[derive(Debug)]
pub struct UnitLog {
    /// The log.
    pub dataset: Dataset,
    /// Its digest.
    content: String,
    parts: Vec<Arc<LogPart>>,
    /// What its parts were like when they were opened.
    files: Vec<FileState>,
}

impl UnitLog {
    /// Opens the log of a session, where it was when its digest was taken. Where its files look otherwise (they are on
    /// another machine, were copied, touched or written on) they are read whole, to see whether it is the log.
    ///
    /// # Errors
    /// As [`open`], a user fault for a log that is gone, or a resource fault for another one in its place.
    pub async fn open(
        store: &Store,
        runtime: &RuntimeEnv,
        manifest: &Manifest,
        log: &LogContent,
    ) -> Result<Self, Fault> {
        let found = mapped(runtime, manifest).await?;
        let (dataset, known) = open(store, found, Believe::Content(&log.content)).await?;
        let whole = Self::of(dataset, &log.content);
        if known.contains_key(&log.session) {
            return Ok(whole);
        }
        if whole.has_its_content().await? {
            return whole.remembered(store).await;
        }
        for then in Fingerprint::of_content(store, &log.content).await? {
            let mut found = mapped(runtime, manifest).await?;
            if cut(&mut found, &then) {
                let begun = Self::of(found.open().await?, &log.content);
                if begun.has_its_content().await? {
                    return Ok(begun);
                }
            }
        }
        Err(another(&log.session))
    }

    fn of(dataset: Dataset, content: &str) -> Self {
        let parts = in_place(dataset.parts());
        Self {
            content: content.to_owned(),
            files: opened(&parts),
            parts,
            dataset,
        }
    }

    /// That what was read since it was opened is of the log that the recipe names.
    ///
    /// # Errors
    /// A resource fault where a file is another one by now, or as [`FileState::now`].
    pub async fn still(&self) -> Result<(), Fault> {
        let now = self.now().await?;
        for ((part, before), now) in self.parts.iter().zip(&self.files).zip(&now) {
            if !now.goes_on(before) {
                return Err(changed().at(&part.url));
            }
        }
        match now == self.files || self.has_its_content().await? {
            true => Ok(()),
            false => Err(changed().at(self.place())),
        }
    }

    /// What its parts are like now.
    async fn now(&self) -> Result<Vec<FileState>, Fault> {
        each(self.parts.iter().map(|part| FileState::now(part))).await
    }

    /// Reads it, to see whether it is the log.
    async fn has_its_content(&self) -> Result<bool, Fault> {
        for session in &self.dataset.sessions {
            let found = session.fingerprint(&AtomicU64::new(0)).await?;
            if found.to_hex().as_str() != self.content.as_str() {
                return Ok(false);
            }
        }
        Ok(!self.dataset.sessions.is_empty())
    }

    /// Remembers it, now that it was read, so that other units need not read it whole.
    async fn remembered(self, store: &Store) -> Result<Self, Fault> {
        if self.now().await? != self.files {
            return Err(changed().at(self.place()));
        }
        let indexes = self.parts.iter().map(|part| part.index_since()).collect();
        let files = self.files.clone();
        let fresh = Fingerprint::new(self.content.clone(), false, files, indexes)?;
        fresh.remember(store).await?;
        Ok(self)
    }

    /// Where it is, for people.
    fn place(&self) -> &str {
        self.parts.first().map_or("", |part| part.url.as_str())
    }
}

/// Gives files that have grown since the size that they had, and their index then. Whether there are any.
fn cut(found: &mut Recordings, then: &Fingerprint) -> bool {
    let mut grown = false;
    let files = found.sessions.iter_mut();
    for file in files.flat_map(|session| &mut session.files) {
        let now = FileState::of(file.store_url.as_str(), &file.meta);
        let mut known = then.files.iter().zip(&then.indexes);
        if let Some((before, index)) = known.find(|(before, _)| now.goes_on(before)) {
            grown |= before.size < now.size;
            file.meta.size = before.size;
            file.index = Some(index.clone());
        }
    }
    grown
}

/// That another log is where one was.
fn another(session: &str) -> Fault {
    Fault::resource(format!(
        "expected the log of session {session} as it was when its digest was taken, found another: the file changed"
    ))
    .next("run again with it among --sessions, when nothing writes to it")
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use std::path::{Path, PathBuf};

    use evermap_datasets::manifest::SessionFiles;
    use tempfile::TempDir;

    use super::super::{Contents, read};
    use super::*;

    /// A log without messages, whose header names a library of one letter.
    fn log(library: u8) -> Vec<u8> {
        let magic = b"\x89MCAP0\r\n";
        let header = [
            &b"\x01\x09\0\0\0\0\0\0\0\0\0\0\0\x01\0\0\0"[..],
            &[library][..],
        ]
        .concat();
        let data_end = b"\x0f\x04\0\0\0\0\0\0\0\0\0\0\0";
        let footer = [&b"\x02\x14\0\0\0\0\0\0\0"[..], &[0; 20][..]].concat();
        [
            &magic[..],
            &header[..],
            &data_end[..],
            &footer[..],
            &magic[..],
        ]
        .concat()
    }

    /// A map that is to have a session of one log.
    struct Mapped {
        _folder: TempDir,
        path: PathBuf,
        store: Store,
        manifest: Manifest,
        log: LogContent,
    }

    impl Mapped {
        /// As a run leaves it that has read the log.
        async fn new(bytes: &[u8]) -> Self {
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("a.mcap");
            std::fs::write(&path, bytes).unwrap();
            let store = Store::open(folder.path().join("map").to_str().unwrap(), true).unwrap();
            let manifest = Manifest {
                sessions: vec![SessionFiles {
                    name: "a".into(),
                    files: vec![path.to_str().unwrap().into()],
                    site: None,
                }],
                ..Manifest::default()
            };
            let dataset = Dataset::open(&RuntimeEnv::default(), &[], Some(&manifest))
                .await
                .unwrap();
            let nothing = Contents::new();
            let sessions = &dataset.sessions;
            let contents = read(&store, &nothing, sessions, Some(&mut |_: f64| ())).await;
            let log = LogContent {
                session: "a".into(),
                site: String::new(),
                content: contents.unwrap().remove(0),
                roles: String::new(),
            };
            Self {
                _folder: folder,
                path,
                store,
                manifest,
                log,
            }
        }

        async fn open(&self) -> Result<UnitLog, Fault> {
            let runtime = RuntimeEnv::default();
            UnitLog::open(&self.store, &runtime, &self.manifest, &self.log).await
        }
    }

    /// Another log in the place of one, which has its size, its times and even its file.
    fn replace(path: &Path, bytes: &[u8]) {
        let since = path.metadata().unwrap().modified().unwrap();
        std::fs::write(path, bytes).unwrap();
        let file = std::fs::File::options().append(true).open(path).unwrap();
        file.set_modified(since).unwrap();
    }

    /// A tick of the clock of file systems, so that the next change shows.
    fn tick() {
        std::thread::sleep(std::time::Duration::from_millis(30));
    }

    #[tokio::test]
    async fn another_log_in_the_place_of_one_is_not_opened_as_the_first() {
        let mapped = Mapped::new(&log(b'a')).await;
        assert!(mapped.open().await.is_ok());
        tick();
        replace(&mapped.path, &log(b'b'));
        let fault = mapped.open().await.unwrap_err();
        assert!(fault.message.contains("session a"), "{fault}");
        assert!(fault.message.contains("the file changed"), "{fault}");
    }

    #[tokio::test]
    async fn a_log_that_is_replaced_while_it_is_read_is_found_out() {
        let mapped = Mapped::new(&log(b'a')).await;
        let opened = mapped.open().await.unwrap();
        opened.still().await.unwrap();
        tick();
        replace(&mapped.path, &log(b'b'));
        let fault = opened.still().await.unwrap_err();
        assert!(
            fault.message.contains("changed while it was read"),
            "{fault}"
        );
        std::fs::remove_file(&mapped.path).unwrap();
        assert!(opened.still().await.is_err());
    }

    #[tokio::test]
    async fn a_log_that_was_copied_or_touched_is_read_again_once() {
        let mapped = Mapped::new(&log(b'a')).await;
        tick();
        let copy = mapped.path.with_extension("copy");
        std::fs::copy(&mapped.path, &copy).unwrap();
        std::fs::rename(&copy, &mapped.path).unwrap();
        let before = mapped.store.list(super::super::FOLDER).await.unwrap();
        let opened = mapped.open().await.unwrap();
        opened.still().await.unwrap();
        let after = mapped.store.list(super::super::FOLDER).await.unwrap();
        assert_eq!((before.len(), after.len()), (1, 2));
        mapped.open().await.unwrap();
        assert_eq!(
            mapped.store.list(super::super::FOLDER).await.unwrap(),
            after
        );
    }

    #[tokio::test]
    async fn of_a_log_that_grows_a_unit_reads_what_there_was() {
        use std::io::Write;
        let whole = log(b'a');
        let mapped = Mapped::new(&whole).await;
        tick();
        let grow = || {
            let mut file = std::fs::File::options()
                .append(true)
                .open(&mapped.path)
                .unwrap();
            file.write_all(b"what comes next").unwrap();
        };
        grow();
        let opened = mapped.open().await.unwrap();
        let part = &opened.dataset.parts()[0];
        assert_eq!(part.meta.size, whole.len() as u64);
        assert!(opened.dataset.losses.is_empty());
        grow();
        opened.still().await.unwrap();
        let mut other = log(b'b');
        other.resize(3 * whole.len(), 0);
        std::fs::write(&mapped.path, other).unwrap();
        assert!(opened.still().await.is_err());
    }
}
