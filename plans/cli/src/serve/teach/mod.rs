//! What people say of maps while they are served. Every act is on the disk, in its author's log, before it is answered;
//! what it teaches is there soon after.
//!
//! ```text
//!   DIR/MAP/SITE/SITE_AUTHOR.mcap      a log; its next parts are SITE_AUTHOR_2.mcap …
//! ```
//! A log ends when its author has said nothing for a while, when a version of the map has it, or with the server: a run
//! reads whole logs, and the next act begins the next part.

mod drawn;
mod lesson;
mod painting;
mod people;
mod taught_site;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Arc, MutexGuard, PoisonError};
use std::time::Duration;

use evermap_catalog::PERSON;
use evermap_catalog::painted::ImageKey;
use evermap_engine::erased::Erased;
use evermap_schemas::Fault;
use evermap_schemas::layers::PlacedLabel;
use rayon::{ThreadPool, ThreadPoolBuilder};
use tokio::sync::Mutex;

use crate::annotate::features::DrawnFeature;
use crate::annotate::mapped_image::PixelBox;
use crate::annotate::{is_blank, user};
use crate::serve::maps::{Opened, ServedMap};
use crate::serve::teach::lesson::{LearntKind, Lesson};
use crate::serve::teach::taught_site::TaughtSite;

pub use crate::serve::teach::drawn::PeopleOnImage;
pub use crate::serve::teach::painting::{Canvas, ImagePaint};
pub use crate::serve::teach::people::{People, PlacedQuestion};
pub use crate::serve::teach::taught_site::Saved;

/// A log ends when its author has said nothing for so long.
const SITTING: Duration = Duration::from_secs(60);

/// Where people teach, and what they have said so far.
pub struct Teaching {
    folder: PathBuf,
    /// Who speaks where nobody says a name.
    pub author: String,
    /// By the name of the map and the site.
    sites: Mutex<BTreeMap<(String, String), Arc<Site>>>,
    /// They search while people go on answering: all but one, so that an answer finds one that is free.
    threads: Arc<ThreadPool>,
}

/// A site that is taught.
pub struct Site {
    told: Mutex<TaughtSite>,
    learning: Mutex<()>,
    searching: Mutex<()>,
    threads: Arc<ThreadPool>,
    learnt: std::sync::Mutex<BTreeMap<String, Arc<LearntKind>>>,
}

/// The labels of a site.
pub struct Labels {
    /// The version that they are placed in.
    pub version: u64,
    /// Counts what was said.
    pub revision: u64,
    /// They, by name.
    pub labels: Vec<PlacedLabel>,
}

impl Teaching {
    /// Teaching into a folder, which is made where it is not there.
    ///
    /// # Errors
    /// A resource fault for a folder that cannot be made.
    pub fn new(folder: &Path) -> Result<Self, Fault> {
        made(folder)?;
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        let threads = ThreadPoolBuilder::new().num_threads((cores - 1).max(1));
        let threads = threads.build();
        let threads = threads.map_err(|error| Fault::resource(error.to_string()))?;
        Ok(Self {
            folder: folder.to_owned(),
            author: user(),
            sites: Mutex::default(),
            threads: Arc::new(threads),
        })
    }

    /// Who speaks: the user, where the server knows users, else who is named.
    pub fn author_of(&self, user: Option<String>, named: Option<String>) -> String {
        user.or(named).unwrap_or_else(|| self.author.clone())
    }

    /// A site of a map as it is now.
    ///
    /// # Errors
    /// A user fault for a site that there is not.
    pub async fn site(&self, map: &ServedMap, site: &str) -> Result<Arc<Site>, Fault> {
        let opened = map.newest().await?;
        let mut sites = self.sites.lock().await;
        let key = (map.name.clone(), site.to_owned());
        if let Some(known) = sites.get(&key) {
            let known = Arc::clone(known);
            drop(sites);
            known.at(opened).await?;
            return Ok(known);
        }
        let folder = self.folder.join(word(&map.name)?).join(word(site)?);
        let told = TaughtSite::read(opened, &map.address, site, folder).await?;
        let known = Arc::new(Site {
            told: Mutex::new(told),
            learning: Mutex::default(),
            searching: Mutex::default(),
            threads: Arc::clone(&self.threads),
            learnt: std::sync::Mutex::default(),
        });
        sites.insert(key, Arc::clone(&known));
        Ok(known)
    }

    /// Ends the logs of those who have said nothing for a while, for ever.
    pub async fn tidied(&self) {
        loop {
            tokio::time::sleep(SITTING / 4).await;
            let sites: Vec<Arc<Site>> = self.sites.lock().await.values().cloned().collect();
            for site in sites {
                site.told.lock().await.end(SITTING);
            }
        }
    }
}

impl Site {
    /// Places labels in a version of the map, if it was opened since.
    async fn at(&self, opened: Erased<Opened>) -> Result<(), Fault> {
        let mut told = self.told.lock().await;
        if told.opened.opening < opened.opening {
            told.end(Duration::ZERO);
            let (map, site) = (told.map.clone(), told.state.site.clone());
            let mut read = TaughtSite::read(opened, &map, &site, told.folder.clone()).await?;
            read.revision = told.revision + 1;
            read.last_ns = told.last_ns;
            *told = read;
        }
        Ok(())
    }

    /// The labels that there are.
    pub async fn labels(&self) -> Labels {
        let told = self.told.lock().await;
        Labels {
            version: told.state.version,
            revision: told.revision,
            labels: told.state.labels.rows().to_vec(),
        }
    }

    /// Says what features have drawn, and begins to learn from it.
    ///
    /// # Errors
    /// A user fault for features that make no sense, a resource fault where they cannot be written. Nothing is said then.
    pub async fn say(
        self: &Arc<Self>,
        author: &str,
        features: &[DrawnFeature],
    ) -> Result<Saved, Fault> {
        let author = word(author)?;
        let saved = {
            let mut told = self.told.lock().await;
            told.know_images(features).await?;
            tokio::task::block_in_place(|| told.say(author, features))?
        };
        // Of people the next run learns, from images.
        for kind in saved.kinds.clone() {
            if kind == PERSON {
                continue;
            }
            let site = Arc::clone(self);
            tokio::spawn(async move {
                if let Err(fault) = site.learn(&kind).await {
                    tracing::warn!("nothing was learnt of {kind}: {fault}");
                }
            });
        }
        Ok(saved)
    }

    /// Whom to ask about.
    pub async fn people(&self) -> People {
        self.told.lock().await.people()
    }

    /// Who was said to be in an image, and who was said to be none.
    pub async fn on_image(&self, canvas: &Canvas<'_>) -> PeopleOnImage {
        self.told.lock().await.on_image(canvas)
    }

    /// Says whom boxes on an image are around: people who were missed, or whom the map asks about. The next run learns from
    /// it.
    ///
    /// # Errors
    /// A user fault for boxes that make no sense there, a resource fault where they cannot be written. Nothing is said then.
    pub async fn draw(
        &self,
        author: &str,
        canvas: &Canvas<'_>,
        boxes: &[PixelBox],
    ) -> Result<Saved, Fault> {
        let author = word(author)?;
        let mut told = self.told.lock().await;
        let features = tokio::task::block_in_place(|| told.boxed(canvas, boxes))?;
        told.know_images(&features).await?;
        tokio::task::block_in_place(|| told.say(author, &features))
    }

    /// What lies on an image.
    pub async fn painted(&self, image: &ImageKey) -> ImagePaint {
        self.told.lock().await.painted(image)
    }

    /// Paints what features have drawn on an image.
    ///
    /// # Errors
    /// A user fault for features that cannot be painted there, a resource fault where they cannot be written. Nothing is
    /// said then.
    pub async fn paint(
        &self,
        author: &str,
        canvas: &Canvas<'_>,
        features: &[DrawnFeature],
    ) -> Result<Saved, Fault> {
        let author = word(author)?;
        let mut told = self.told.lock().await;
        tokio::task::block_in_place(|| told.paint(author, canvas, features))
    }

    /// What may be of a kind, as what was said up to a revision, or later, teaches; waits until it is learnt, and the image
    /// searched where that is asked for.
    ///
    /// # Errors
    /// As learning says.
    pub async fn learnt(
        self: &Arc<Self>,
        kind: &str,
        revision: u64,
        searched: bool,
    ) -> Result<Arc<LearntKind>, Fault> {
        let learnt = self.weighed(kind, revision).await?;
        if searched && !learnt.is_searched {
            self.search(kind).await;
        }
        Ok(self.known(kind).unwrap_or(learnt))
    }

    async fn weighed(
        self: &Arc<Self>,
        kind: &str,
        revision: u64,
    ) -> Result<Arc<LearntKind>, Fault> {
        match self.known(kind).filter(|known| known.revision >= revision) {
            Some(known) => Ok(known),
            None => self.learn(kind).await,
        }
    }

    fn known(&self, kind: &str) -> Option<Arc<LearntKind>> {
        self.all().get(kind).cloned()
    }

    fn all(&self) -> MutexGuard<'_, BTreeMap<String, Arc<LearntKind>>> {
        self.learnt.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Learns what all that was said of a kind teaches, unless somebody else has done so meanwhile. Where candidates are
    /// known they are weighed again at once, and others searched for later.
    async fn learn(self: &Arc<Self>, kind: &str) -> Result<Arc<LearntKind>, Fault> {
        let _turn = self.learning.lock().await;
        let lesson = self.lesson(kind).await;
        if lesson.labels.is_empty() {
            // Any word is a kind: what nobody has said anything of is not kept.
            self.all().remove(kind);
            return lesson.learn(None).map(Arc::new);
        }
        let known = self.known(kind);
        let new = |known: &Arc<LearntKind>| known.revision < lesson.revision;
        if let Some(known) = known.clone().filter(|known| !new(known)) {
            return Ok(known);
        }
        let candidates = known.and_then(|known| known.candidates.clone());
        let is_first = candidates.is_none();
        let work = tokio::task::spawn_blocking(move || lesson.learn(candidates));
        let learnt = work
            .await
            .map_err(|error| Fault::bug(error.to_string()))??;
        if !is_first {
            let site = Arc::clone(self);
            let kind = kind.to_owned();
            tokio::spawn(async move { site.search(&kind).await });
        }
        Ok(self.keep(kind, learnt))
    }

    fn keep(&self, kind: &str, learnt: LearntKind) -> Arc<LearntKind> {
        let learnt = Arc::new(learnt);
        self.all().insert(kind.to_owned(), Arc::clone(&learnt));
        learnt
    }

    /// Searches the image for what the latest model finds, one search after the other.
    async fn search(self: &Arc<Self>, kind: &str) {
        let _turn = self.searching.lock().await;
        let known = self.known(kind);
        if known.as_ref().is_some_and(|known| known.is_searched) {
            return;
        }
        let lesson = self.lesson(kind).await;
        let revision = lesson.revision;
        let threads = Arc::clone(&self.threads);
        let search = move || threads.install(|| lesson.search(known.as_deref()));
        let found = match tokio::task::spawn_blocking(search).await {
            Ok(Ok(found)) => found,
            Ok(Err(fault)) => return tracing::warn!("nothing was found of {kind}: {fault}"),
            Err(error) => return tracing::warn!("nothing was found of {kind}: {error}"),
        };
        let _turn = self.learning.lock().await;
        let lesson = self.lesson(kind).await;
        let found = match lesson.revision == revision {
            true => Ok(found),
            // More was said meanwhile.
            false => tokio::task::block_in_place(|| lesson.learn(found.candidates)),
        };
        if let Ok(found) = found {
            self.keep(kind, found);
        }
    }

    /// What there is to learn from.
    async fn lesson(&self, kind: &str) -> Lesson {
        let told = self.told.lock().await;
        let labels = told.state.labels.rows().iter();
        let labels = labels.filter(|label| label.kind == kind).cloned();
        Lesson {
            revision: told.revision,
            mosaic: Arc::clone(&told.mosaic),
            lanes: Arc::clone(&told.lanes),
            labels: labels.collect(),
        }
    }
}

/// A name, if it can be part of a file's.
fn word(name: &str) -> Result<&str, Fault> {
    let is_plain = |letter: char| letter.is_alphanumeric() || "-_.@+ ".contains(letter);
    let fits = !is_blank(name) && name.chars().count() <= 64 && !name.starts_with('.');
    match fits && name.chars().all(is_plain) {
        true => Ok(name),
        false => Err(Fault::user(format!(
            "expected a name of at most 64 letters, digits, spaces and - _ . @ +, found {name:?}"
        ))),
    }
}

/// Makes a folder where it is not there.
fn made(folder: &Path) -> Result<(), Fault> {
    let made = std::fs::create_dir_all(folder);
    made.map_err(|error| {
        Fault::resource(format!("cannot write to it: {error}")).at(folder.display())
    })
}
