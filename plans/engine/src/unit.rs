//! A work unit: one stage for one session, one site, or the whole map.
//!
//! A unit is self-contained. It says what to read, by digest and by URL, and runs the same in this process, in
//! another, or on another machine; what it leaves behind is one artifact under its content's digest, and a receipt
//! under its recipe's.

use std::collections::BTreeMap;
use std::time::Instant;

use evermap_contract::Registry;
use evermap_datasets::Manifest;
use evermap_schemas::Fault;
use serde::{Deserialize, Serialize};

use crate::artifact;
use crate::build::Builder;
use crate::program::Stage;
use crate::sql::Limits;
use crate::store::{Store, digest};

/// Raised when artifacts of the same recipe would come out differently for reasons no operator's version tells.
const FORMAT: u32 = 1;

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
        let text = serde_json::to_vec(self).map_err(|error| Fault::bug(error.to_string()))?;
        Ok(digest(&text))
    }
}

/// A layer of the version before, as a unit reads it.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct PreviousLayer {
    /// The operator that makes the layer in this plan: gives the columns where there is no version before.
    pub op: Option<String>,
    /// The rows; none where there is no version before.
    pub artifacts: Vec<Artifact>,
    /// Sessions whose rows are left out: their logs have been replaced.
    #[serde(default)]
    pub without: Vec<String>,
}

/// A unit of work.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Unit {
    /// URL of the map store.
    pub store: String,
    /// What the result depends on.
    pub recipe: Recipe,
    /// The rows of the stored stages that are read.
    pub tables: BTreeMap<String, Vec<Artifact>>,
    /// The layers of the version before that are read.
    pub previous: BTreeMap<String, PreviousLayer>,
    /// The logs that are read, as manifests of one session each.
    pub logs: Vec<Manifest>,
    /// Bytes it may hold, partitions it may use.
    pub memory_bytes: usize,
    /// Partitions that its plan is cut into.
    pub partitions: usize,
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

    /// The receipt of a recipe that was done before, if its rows are still there.
    ///
    /// # Errors
    /// A resource fault when the store does not answer.
    pub async fn find(store: &Store, digest: &str) -> Result<Option<Self>, Fault> {
        let Some(receipt) = store.read_json::<Self>(&Self::name(digest)).await? else {
            return Ok(None);
        };
        Ok(if store.exists(&receipt.artifact.name()).await? {
            Some(receipt)
        } else {
            None
        })
    }
}

impl Unit {
    /// The stage that it makes.
    ///
    /// # Errors
    /// A bug fault for a unit without stages.
    pub fn stage(&self) -> Result<&Stage, Fault> {
        self.recipe
            .stages
            .last()
            .ok_or_else(|| Fault::bug("a unit without stages"))
    }

    /// What a person calls it: the stage and the session or site.
    pub fn label(&self) -> String {
        let stage = self
            .recipe
            .stages
            .last()
            .map_or("", |stage| stage.name.as_str());
        match self.recipe.session.as_ref().or(self.recipe.site.as_ref()) {
            Some(of) => format!("{stage} of {of}"),
            None => stage.to_owned(),
        }
    }

    /// Does the work: reads, runs, writes the artifact, then the receipt. Done twice, it leaves the same.
    ///
    /// # Errors
    /// Whatever stops it; nothing is left behind but, perhaps, a file in `tmp/`.
    pub async fn run(&self, registry: &Registry) -> Result<Receipt, Fault> {
        let (started, clock) = (chrono::Utc::now(), Instant::now());
        let store = Store::open(&self.store, false)?;
        let limits = Limits {
            memory_bytes: self.memory_bytes,
            partitions: self.partitions,
        };
        let builder = Builder::new(self, &store, registry, limits).await?;
        let plan = builder.plan().await?;
        let span = tracing::info_span!("unit", label = %self.label());
        let written =
            tracing::Instrument::instrument(artifact::write(&store, plan, &builder), span).await?;
        let receipt = Receipt {
            digest: self.recipe.digest()?,
            recipe: self.recipe.clone(),
            artifact: Artifact {
                session: self.recipe.session.clone(),
                site: self.recipe.site.clone(),
                ..written
            },
            skipped: builder.skipped(),
            log_losses: builder.log_losses(),
            started: started.timestamp_nanos_opt().unwrap_or_default(),
            seconds: clock.elapsed().as_secs_f64(),
        };
        store
            .write_json(&Receipt::name(&receipt.digest), &receipt)
            .await?;
        Ok(receipt)
    }
}
