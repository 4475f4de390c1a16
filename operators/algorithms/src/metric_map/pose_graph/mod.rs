//! Odometry and loops relaxed into consistent poses.
//!
//! A [`Graph`] has poses and [`Edge`]s that say how one pose was measured from another. Relaxation
//! finds the poses `x` that minimise
//!
//! ```text
//! ½ Σ ρ( rᵀ Ω r ),   r = Log( measured⁻¹ · from⁻¹ · to )
//! ```
//!
//! with every pose moved as [`crate::geometry::lie`] says. This is what GTSAM
//! minimises, so that costs can be compared digit by digit.
//!
//! | file | what it knows |
//! |---|---|
//! | [`motion`] | residual and Jacobians |
//! | [`chordal`] | a start from all edges |
//! | [`relaxation`] | the graph as a [`crate::solving::least_squares::Problem`] |
//! | [`certificate`] | whether other poses could cost less |
//! | [`robust`] | false loops, by graduated non-convexity |
//! | [`consensus`] | where a drive lies in a map, from loops of which many may be false |
//! | [`drives`] | odometry, loops and fixes of many drives joined into one map |
//! | [`g2o`] | written in the text format of the field |

mod anchors;
pub mod certificate;
pub mod chordal;
mod chords;
pub mod consensus;
pub mod drives;
pub mod g2o;
pub mod motion;
mod numbering;
pub mod relaxation;
pub mod robust;

#[cfg(test)]
mod tests;

use nalgebra::SMatrix;

use crate::geometry::pose::Pose;
pub use motion::Motion;
pub use relaxation::{options, relax};

/// How one pose was measured from another.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Edge<M, const D: usize> {
    /// Index of the pose measured from.
    pub from: usize,
    /// Index of the pose measured.
    pub to: usize,
    /// `from⁻¹ · to` as measured.
    pub measured: M,
    /// Inverse covariance of the measurement along the axes of `to`, symmetric and positive
    /// semidefinite: 1/m², 1/rad².
    pub information: SMatrix<f64, D, D>,
    /// How an outlier counts.
    pub loss: crate::solving::least_squares::Loss,
}

/// Poses and what was measured between them.
#[derive(Debug, Clone, PartialEq)]
pub struct Graph<M, const D: usize> {
    /// The poses, each `map_from_vehicle`; the guess to begin from.
    pub poses: Vec<M>,
    /// Poses that are known and stay where they are. Each connected part should have one; where
    /// it has none, damping alone keeps it from floating away.
    pub fixed: Vec<bool>,
    /// The measurements. Edges that do not join two poses are ignored.
    pub edges: Vec<Edge<M, D>>,
}

/// A graph in space.
pub type SpatialGraph = Graph<Pose, 6>;

impl<M, const D: usize> Graph<M, D> {
    /// Does an edge join two poses of the graph? Others are ignored.
    fn joins(&self, edge: &Edge<M, D>) -> bool {
        edge.from.max(edge.to) < self.poses.len() && edge.from != edge.to
    }
}

impl<M: Motion<D>, const D: usize> Graph<M, D> {
    /// Squared weighted residual of an edge, `rᵀ Ω r`; 0 when it does not join two poses.
    pub fn squared_residual(&self, edge: &Edge<M, D>) -> f64 {
        match (self.poses.get(edge.from), self.poses.get(edge.to)) {
            (Some(from), Some(to)) if edge.from != edge.to => {
                let r = M::residual(&edge.measured, from, to);
                r.dot(&(edge.information * r))
            }
            _ => 0.0,
        }
    }

    /// `½ Σ ρ(rᵀ Ω r)`.
    pub fn cost(&self) -> f64 {
        let costs = self
            .edges
            .iter()
            .map(|edge| edge.loss.cost(self.squared_residual(edge)));
        0.5 * costs.sum::<f64>()
    }
}
