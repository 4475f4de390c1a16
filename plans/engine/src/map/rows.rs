//! What a map says of itself, as rows.

use evermap_schemas::record;

use crate::unit::work::NodeWork;

/// The folder of a map that has a file of [`RunRow`]s for each run that computed or published something, until `gc` has
/// forgotten the version that it ended at.
pub const RUNS: &str = "runs";

record! {
    /// How one unit of one run went.
    #[layer("runs", key(version, run, step, site, session))]
    pub struct RunRow {
        /// Version that the run ended at.
        version: u64,
        /// Name of the run; runs of one version are told apart by it.
        run: String,
        /// Step that the unit belongs to.
        step: String,
        /// Session that the unit covered; null where it covered more.
        session: Option<String>,
        /// Site that the unit covered; null where it covered the map.
        site: Option<String>,
        /// Whether the work had been done before.
        cached: bool,
        /// Rows that came out.
        rows: u64,
        /// Bytes that came out.
        bytes: u64 ["B"],
        /// How long it took, when it was done.
        seconds: f64 ["s"],
        /// When it was done.
        started: evermap_schemas::Stamp ["ns"],
        /// Inputs that the unit skipped or lost; other units may have counted the same ones.
        lost: u64,
        /// Digest of what the work depends on.
        recipe: String,
        /// Digest of what came out.
        content: String,
        /// What the nodes of its plan did, when the work was done; null where an older evermap did it.
        nodes: Option<Vec<NodeWork>>,
    }
}

record! {
    /// One file of one layer of one version.
    #[layer("layer_files", key(layer, file))]
    pub struct LayerFile {
        /// Name of the layer.
        layer: String,
        /// The Parquet file: a path on this machine, or a URL.
        file: String,
        /// Its rows.
        rows: u64,
        /// Its size.
        bytes: u64 ["B"],
    }
}

record! {
    /// One layer of one version.
    #[layer("layers", key(layer))]
    pub struct LayerInfo {
        /// Layer name.
        layer: String,
        /// Rows in it.
        rows: u64,
        /// Bytes in it.
        bytes: u64 ["B"],
        /// Files that hold it.
        artifacts: u32,
        /// Operator that made it; null for a query.
        operator: Option<String>,
        /// One digest for all its rows.
        digest: String,
    }
}

record! {
    /// One version of a map.
    #[layer("versions", key(version))]
    pub struct VersionInfo {
        /// Counted from 1.
        version: u64,
        /// When it was published, RFC 3339.
        published: String,
        /// Plan that made it.
        plan: String,
        /// Sessions that it is made from.
        sessions: Vec<String>,
        /// Layers in it.
        layers: u32,
        /// Inputs that were skipped or lost on the way, those that several steps counted once.
        lost: u64,
    }
}
