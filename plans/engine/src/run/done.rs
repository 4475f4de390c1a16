//! What a run keeps of a unit that is done.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use crate::map::receipt::{Artifact, Receipt, Recipe};
use crate::unit::work::NodeWork;

/// A unit that is done: its receipt without the recipe, which may name the rows of thousands of others.
#[derive(Debug, Clone)]
pub struct Done {
    /// Digest of the recipe.
    pub digest: String,
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
    /// What the nodes of its plan did.
    pub nodes: Nodes,
    /// Whether it had been done before.
    pub cached: bool,
}

impl Done {
    /// What is kept of a receipt.
    pub fn of(receipt: Receipt, cached: bool, known: &mut KnownNodes) -> Self {
        Self {
            digest: receipt.digest,
            artifact: receipt.artifact,
            skipped: receipt.skipped,
            log_losses: receipt.log_losses,
            started: receipt.started,
            seconds: receipt.seconds,
            nodes: Nodes::of(receipt.nodes, known),
            cached,
        }
    }

    /// The receipt, given its recipe again.
    pub fn receipt(&self, recipe: Recipe) -> Receipt {
        Receipt {
            digest: self.digest.clone(),
            recipe,
            artifact: self.artifact.clone(),
            skipped: self.skipped.clone(),
            log_losses: self.log_losses.clone(),
            started: self.started,
            seconds: self.seconds,
            nodes: self.nodes.work(),
        }
    }
}

/// What a node is called, and what it is about.
type Node = (String, Option<String>);

/// The nodes of plans so far.
pub type KnownNodes = BTreeSet<Arc<[Node]>>;

/// What the nodes of a plan did. What they are called is kept once for all plans that are alike, as those of a step are.
#[derive(Debug, Clone)]
pub struct Nodes {
    called: Arc<[Node]>,
    /// Rows, bytes and seconds of each.
    did: Box<[(u64, u64, f64)]>,
}

impl Nodes {
    fn of(nodes: Vec<NodeWork>, known: &mut KnownNodes) -> Self {
        let nodes = nodes.into_iter();
        let nodes = nodes.map(|node| {
            let did = (node.rows, node.bytes, node.seconds);
            ((node.node, node.of), did)
        });
        let (called, did): (Vec<Node>, Vec<_>) = nodes.unzip();
        let called = known.get(called.as_slice()).cloned().unwrap_or_else(|| {
            let called: Arc<[Node]> = called.into();
            known.insert(Arc::clone(&called));
            called
        });
        let did = did.into();
        Self { called, did }
    }

    /// As receipts have it.
    pub fn work(&self) -> Vec<NodeWork> {
        let nodes = self.called.iter().zip(&self.did);
        let nodes = nodes.map(|((node, of), (rows, bytes, seconds))| NodeWork {
            node: node.clone(),
            of: of.clone(),
            rows: *rows,
            bytes: *bytes,
            seconds: *seconds,
        });
        nodes.collect()
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[test]
    fn what_nodes_are_called_is_kept_once() {
        let plan = |rows: u64| {
            let scan = NodeWork {
                node: "DataSourceExec".to_owned(),
                of: Some("odometry".to_owned()),
                rows,
                bytes: 7,
                seconds: 0.1,
            };
            vec![NodeWork::writing(rows, 3, Duration::ZERO), scan]
        };
        let mut known = KnownNodes::new();
        let kept: Vec<Nodes> = (0..100)
            .map(|rows| Nodes::of(plan(rows), &mut known))
            .collect();
        let none = Nodes::of(Vec::new(), &mut known);
        assert_eq!((known.len(), none.work()), (2, Vec::new()));
        assert_eq!(kept[42].work(), plan(42));
        assert!(Arc::ptr_eq(&kept[0].called, &kept[99].called));
    }
}
