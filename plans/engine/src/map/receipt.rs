//! What a unit leaves behind: rows under their digest, and a receipt under the digest of what they depend on.

use std::collections::BTreeMap;

use evermap_schemas::{Fault, Kind};
use serde::{Deserialize, Serialize};

use crate::digest::digest_of;
use crate::map::store::Store;
use crate::program::Stage;

/// Raised when artifacts of the same recipe would come out differently for reasons no operator's version tells.
const FORMAT: u32 = 2;

/// Rows that are kept: a Parquet file named by its content.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Artifact {
    /// BLAKE3 of the file.
    pub content: String,
    /// Rows in it.
    pub rows: u64,
    /// Bytes of it.
    pub bytes: u64,
    /// The session that it covers; null where it covers more.
    pub session: Option<String>,
    /// The site that it covers; null where it covers the map.
    pub site: Option<String>,
}

impl Artifact {
    /// Its name in the map store.
    pub fn name(&self) -> String {
        format!("artifacts/{}.parquet", self.content)
    }
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
    pub stages: Vec<Stage>,
    /// Contents of the stored stages that are read.
    pub tables: BTreeMap<String, Vec<String>>,
    /// Contents of the layers of the version before that are read.
    pub previous: BTreeMap<String, Vec<String>>,
    /// Sessions whose rows of the version before are not read, as their logs have been replaced.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub replaced: Vec<String>,
    /// Logs that are read.
    pub logs: Vec<LogContent>,
    /// The session that is covered.
    pub session: Option<String>,
    /// The site that is covered.
    pub site: Option<String>,
}

impl Recipe {
    /// An empty recipe for these stages.
    pub fn new(stages: Vec<Stage>, session: Option<String>, site: Option<String>) -> Self {
        let (tables, previous) = (BTreeMap::new(), BTreeMap::new());
        Self {
            format: FORMAT,
            stages,
            tables,
            previous,
            replaced: Vec::new(),
            logs: Vec::new(),
            session,
            site,
        }
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
    /// How long it took.
    pub seconds: f64,
}

impl Receipt {
    /// Its name in the map store.
    pub fn name(digest: &str) -> String {
        format!("receipts/{digest}.json")
    }

    /// The receipt of a recipe that was done before, if it reads and its rows are still there.
    ///
    /// # Errors
    /// A resource fault when the store does not answer.
    pub async fn find(store: &Store, digest: &str) -> Result<Option<Self>, Fault> {
        let receipt = match store.read_json::<Self>(&Self::name(digest)).await {
            Ok(Some(receipt)) => receipt,
            Err(fault) if fault.kind != Kind::Data => return Err(fault),
            Ok(None) | Err(_) => return Ok(None),
        };
        let there = store.exists(&receipt.artifact.name()).await?;
        Ok(there.then_some(receipt))
    }
}
