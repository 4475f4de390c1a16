//! What a unit leaves behind: rows under their digest, and a receipt under the digest of what they depend on.

use std::collections::BTreeMap;
use std::sync::Arc;

use evermap_contract::Reach;
use evermap_schemas::{Fault, Kind};
use serde::{Deserialize, Serialize};

use crate::digest::digest_of;
use crate::map::sealed;
use crate::map::store::{ARTIFACTS, Store};
use crate::program::{Scope, Stage};
use crate::unit::work::NodeWork;

/// Raised when artifacts of the same recipe would come out differently for reasons no operator's version tells.
const FORMAT: u32 = 11;

/// Why something is not what would come out today.
pub const OTHER_FORMAT: &str = "it was made by an evermap whose files have another format";

/// The folder of a map that has receipts.
pub const RECEIPTS: &str = "receipts";

/// What rows are of and what a unit covers: a session, a site, or the map.
#[derive(Debug, Clone, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Extent {
    /// The session; null where it is more than one.
    pub session: Option<String>,
    /// The site; null where it is the map.
    pub site: Option<String>,
}

impl Extent {
    /// As much as a scope says of where a log belongs.
    pub fn of(scope: Scope, log: &LogContent) -> Self {
        Self {
            session: (scope == Scope::Session).then(|| log.session.clone()),
            site: (scope != Scope::Map).then(|| log.site.clone()),
        }
    }

    /// What is read for it.
    pub fn reached(&self, reach: Reach) -> Self {
        let session = self.session.clone();
        Self {
            session: session.filter(|_| reach == Reach::Session),
            site: self.site.clone(),
        }
    }

    /// Whether a log belongs to it.
    pub fn covers(&self, log: &LogContent) -> bool {
        let within = |own: &Option<String>, of| own.as_ref().is_none_or(|own| own == of);
        within(&self.session, &log.session) && within(&self.site, &log.site)
    }

    /// What a person calls the unit of a stage that covers it.
    pub fn label(&self, stage: &str) -> String {
        match self.session.as_ref().or(self.site.as_ref()) {
            Some(of) => format!("{stage} of {of}"),
            None => stage.to_owned(),
        }
    }
}

/// Rows that are kept: a Parquet file named by its content.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Artifact {
    /// BLAKE3 of the file.
    pub content: String,
    /// Rows in it.
    pub rows: u64,
    /// Bytes of it.
    pub bytes: u64,
    /// What they are of.
    #[serde(flatten)]
    pub extent: Extent,
}

impl Artifact {
    /// Its name in the map store.
    pub fn name(&self) -> String {
        Self::name_of(&self.content)
    }

    /// The name of the rows with this content.
    pub fn name_of(content: &str) -> String {
        format!("{ARTIFACTS}/{content}.parquet")
    }

    /// Those that have rows. What has none says nothing to who reads it, so a session that brings no rows of a layer
    /// changes no recipe of what reads the layer.
    pub fn with_rows(mut artifacts: Vec<Self>) -> Vec<Self> {
        artifacts.retain(|artifact| artifact.rows > 0);
        artifacts
    }

    /// Those that have rows; where none has, one without rows, which has the columns, as if it were of `extent`.
    pub fn with_rows_or_columns(artifacts: Vec<Self>, extent: &Extent) -> Vec<Self> {
        let columns = artifacts.first().map(|first| Self {
            extent: extent.clone(),
            ..first.clone()
        });
        let filled = Self::with_rows(artifacts);
        if filled.is_empty() {
            return columns.into_iter().collect();
        }
        filled
    }
}

/// A layer of the version before, or of new sessions, as far as a unit reads it.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct LayerRows {
    /// The operator that makes the layer in this plan: gives the columns where there are no rows.
    pub op: Option<String>,
    /// The rows; none where there is no version before, or no new session.
    pub artifacts: Vec<Artifact>,
}

/// A session's log, as a recipe names it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct LogContent {
    /// Session.
    pub session: String,
    /// Site that it belongs to.
    pub site: String,
    /// BLAKE3 of the files.
    pub content: String,
    /// Digest of how topics are mapped to roles.
    pub roles: String,
}

/// Everything that a unit's result depends on, and nothing else: equal recipes have equal results.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Recipe {
    /// Format of artifacts.
    pub format: u32,
    /// The stages: operators with versions and parameters, queries.
    pub stages: Arc<[Stage]>,
    /// The rows of the stored stages that are read.
    pub tables: BTreeMap<String, Vec<Artifact>>,
    /// The layers of the version before that are read.
    pub previous: BTreeMap<String, LayerRows>,
    /// The layers that are read of sessions alone which the version before did not have.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub new: BTreeMap<String, LayerRows>,
    /// Sessions whose rows of the version before are not read, as their logs have been replaced.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub replaced: Vec<String>,
    /// Logs that are read.
    pub logs: Vec<LogContent>,
    /// What is covered.
    #[serde(flatten)]
    pub extent: Extent,
}

impl Recipe {
    /// An empty recipe for these stages.
    pub fn new(stages: Arc<[Stage]>, extent: Extent) -> Self {
        Self {
            format: FORMAT,
            stages,
            tables: BTreeMap::new(),
            previous: BTreeMap::new(),
            new: BTreeMap::new(),
            replaced: Vec::new(),
            logs: Vec::new(),
            extent,
        }
    }

    /// The other recipe, if it differs only in what the version before was, and in what was new then where nothing is
    /// now; else this one. `gone`: whether a session of the version before is not what it was, so that what reads new
    /// ones alone must do without it.
    pub fn as_of(self, then: &Self, gone: bool) -> Self {
        let mut new = self.new.values();
        let is_due = !new.all(|layer| layer.artifacts.is_empty()) || gone && !self.new.is_empty();
        if is_due {
            return self;
        }
        let with_then = Self {
            previous: then.previous.clone(),
            replaced: then.replaced.clone(),
            new: then.new.clone(),
            ..self.clone()
        };
        if with_then == *then { with_then } else { self }
    }

    /// All stored rows that are read.
    pub fn artifacts(&self) -> impl Iterator<Item = &Artifact> {
        let layers = self.previous.values().chain(self.new.values());
        let layers = layers.flat_map(|layer| &layer.artifacts);
        self.tables.values().flatten().chain(layers)
    }

    /// Whether artifacts are written today as they were when it was noted.
    pub fn is_of_today(&self) -> bool {
        self.format == FORMAT
    }

    /// The recipe's digest.
    ///
    /// # Errors
    /// A bug fault when it does not serialise.
    pub fn digest(&self) -> Result<String, Fault> {
        digest_of(self)
    }
}

/// What a unit did.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Receipt {
    /// Digest of the recipe.
    pub digest: String,
    /// The recipe, so that a later run can say what has changed.
    pub recipe: Recipe,
    /// The rows.
    pub artifact: Artifact,
    /// What operators skipped, and why.
    pub skipped: BTreeMap<String, u64>,
    /// What the logs had lost, by file and reason.
    pub log_losses: BTreeMap<String, u64>,
    /// When it began; nanoseconds since the epoch, UTC.
    pub started: i64,
    /// How long it took, without what it took to make it last.
    pub seconds: f64,
    /// What the nodes of its plan did; none in receipts that are older than this.
    #[serde(default)]
    pub nodes: Vec<NodeWork>,
}

impl Receipt {
    /// Its name in the map store.
    pub fn name(digest: &str) -> String {
        format!("{RECEIPTS}/{digest}.json")
    }

    /// The digest of the recipe whose receipt has this name.
    pub fn digest_of(name: &str) -> Option<&str> {
        let file = name.strip_prefix(RECEIPTS)?.strip_prefix('/')?;
        file.strip_suffix(".json")
    }

    /// Puts it into the map store.
    ///
    /// # Errors
    /// A resource fault when the store does not take it.
    pub async fn write(&self, store: &Store) -> Result<(), Fault> {
        store
            .write(&Self::name(&self.digest), sealed::bytes(self)?)
            .await
    }

    /// The receipt of a recipe that was done before. One that does not read, as a crash may leave it, or is not as it was
    /// written, is none: it is told, and the work is done again.
    ///
    /// # Errors
    /// A resource fault when the store does not answer.
    pub async fn read(store: &Store, digest: &str) -> Result<Option<Self>, Fault> {
        let name = Self::name(digest);
        match sealed::read::<Self>(store, &name).await {
            Ok(Some(receipt)) if receipt.digest != digest => {
                tracing::warn!("{name} is ignored: it is the receipt of {}", receipt.digest);
                Ok(None)
            }
            Err(fault) if fault.kind == Kind::Data => {
                tracing::warn!("{name} is ignored: {fault}");
                Ok(None)
            }
            found => found,
        }
    }

    /// As [`Receipt::read`], if the rows are still there, as far as their size tells.
    ///
    /// # Errors
    /// A resource fault when the store does not answer.
    pub async fn find(store: &Store, digest: &str) -> Result<Option<Self>, Fault> {
        let Some(receipt) = Self::read(store, digest).await? else {
            return Ok(None);
        };
        let damage = receipt.artifact.size_damage(store).await?;
        Ok(damage.is_none().then_some(receipt))
    }
}
