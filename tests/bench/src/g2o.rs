//! Reads the text format of g2o: one vertex or edge per line.
//!
//! ```text
//! VERTEX_SE2 id x y yaw
//! EDGE_SE2 from to x y yaw  xx xy xθ yy yθ θθ
//! VERTEX_SE3:QUAT id x y z qx qy qz qw
//! EDGE_SE3:QUAT from to x y z qx qy qz qw  (upper triangle of the 6×6 information, row by row)
//! FIX id …
//! ```
//!
//! Blank lines and those that begin with `#` are skipped. The information of an edge is that of
//! translation, then rotation, as here. Real files have information with slightly negative eigenvalues: such an edge is
//! read with the nearest matrix that has none, and its line is noted.

use std::collections::BTreeMap;

use evermap_algorithms::geometry::pose::Pose;
use evermap_algorithms::metric_map::pose_graph::{Edge, Graph, Motion, g2o};
use evermap_algorithms::solving::least_squares::Loss;
use nalgebra::{DMatrix, SMatrix};

use crate::planar::{PlanarGraph, PlanarPose};

/// A file: which pose of the graph has which number in it.
#[derive(Debug, Clone, PartialEq)]
pub struct Numbered<M, const D: usize> {
    /// The graph. A pose that the file only mentions in edges is the identity.
    pub graph: Graph<M, D>,
    /// By pose: its number in the file, ascending.
    pub ids: Vec<u64>,
    /// By pose: did the file have a line for it?
    pub given: Vec<bool>,
    /// Lines of edges whose information was not positive semidefinite, counted from 1.
    pub indefinite: Vec<usize>,
}

/// A graph on the plane or in space, as the file has it.
#[derive(Debug, Clone, PartialEq)]
pub enum File {
    /// Of `VERTEX_SE2` and `EDGE_SE2`.
    Planar(Numbered<PlanarPose, 3>),
    /// Of `VERTEX_SE3:QUAT` and `EDGE_SE3:QUAT`.
    Spatial(Numbered<Pose, 6>),
}

/// Why a text is no graph.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("line {line}: {fault}")]
pub struct ReadError {
    /// Counted from 1; 0 for the file as a whole.
    pub line: usize,
    /// What is wrong with it.
    pub fault: LineError,
}

/// What can be wrong with a line.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum LineError {
    /// A tag that is none of those above.
    #[error(
        "expected VERTEX_SE2, EDGE_SE2, VERTEX_SE3:QUAT, EDGE_SE3:QUAT or FIX, found `{found}`"
    )]
    Tag {
        /// The tag.
        found: String,
    },
    /// Too few or too many numbers.
    #[error("expected {expected} numbers after {tag}, found {found}")]
    Count {
        /// The tag.
        tag: &'static str,
        /// How many there should be.
        expected: usize,
        /// How many there are.
        found: usize,
    },
    /// Not a number, or not finite.
    #[error("expected a finite number, found `{found}`")]
    Number {
        /// The word.
        found: String,
    },
    /// Not the number of a vertex.
    #[error("expected the number of a vertex, found `{found}`")]
    Id {
        /// The word.
        found: String,
    },
    /// A quaternion without length.
    #[error("expected a unit quaternion, found one that is nearly zero")]
    Quaternion,
    /// An information matrix that is no information at all.
    #[error(
        "expected an information matrix with a positive eigenvalue or zero, found only negative eigenvalues"
    )]
    Information,
    /// A vertex that was there before.
    #[error("expected each vertex once, found {id} again")]
    Twice {
        /// Its number.
        id: u64,
    },
    /// An edge from a vertex to itself.
    #[error("expected an edge between two vertices, found one from {id} to itself")]
    Loop {
        /// Its number.
        id: u64,
    },
    /// `FIX` of a vertex that is nowhere else.
    #[error("expected a vertex that has a line or an edge, found FIX {id}")]
    Unknown {
        /// Its number.
        id: u64,
    },
    /// Planar and spatial lines together.
    #[error("expected all lines planar (SE2) or all spatial (SE3), found both")]
    Mixed,
    /// Nothing in it.
    #[error("expected vertices or edges, found neither")]
    Empty,
}

/// Reads a graph. Where the file fixes nothing, the vertex with the smallest number is fixed.
///
/// # Errors
/// [`ReadError`] at the first line that is not understood.
pub fn read(text: &str) -> Result<File, ReadError> {
    let mut planar = Lines::<PlanarPose, 3>::default();
    let mut spatial = Lines::<Pose, 6>::default();
    let mut fixed = Vec::new();
    for (index, content) in text.lines().enumerate() {
        let line = index + 1;
        let mut words = content.split_ascii_whitespace();
        let read = match words.next() {
            None => Ok(()),
            Some(tag) if tag.starts_with('#') => Ok(()),
            Some("VERTEX_SE2") => planar.vertex("VERTEX_SE2", words),
            Some("EDGE_SE2") => planar.edge("EDGE_SE2", line, words),
            Some("VERTEX_SE3:QUAT") => spatial.vertex("VERTEX_SE3:QUAT", words),
            Some("EDGE_SE3:QUAT") => spatial.edge("EDGE_SE3:QUAT", line, words),
            Some("FIX") => words.try_for_each(|word| id(word).map(|id| fixed.push((line, id)))),
            Some(tag) => Err(LineError::Tag {
                found: tag.chars().take(40).collect(),
            }),
        };
        read.map_err(|fault| ReadError { line, fault })?;
        if !planar.is_empty() && !spatial.is_empty() {
            let fault = LineError::Mixed;
            return Err(ReadError { line, fault });
        }
    }
    match (planar.is_empty(), spatial.is_empty()) {
        (false, _) => planar.finish(&fixed).map(File::Planar),
        (_, false) => spatial.finish(&fixed).map(File::Spatial),
        _ => Err(ReadError {
            line: 0,
            fault: LineError::Empty,
        }),
    }
}

/// A pose as the words of a line.
trait Read<const D: usize>: Motion<D> {
    const NUMBERS: usize;
    fn from_numbers(numbers: &[f64]) -> Result<Self, LineError>;
}

impl Read<3> for PlanarPose {
    const NUMBERS: usize = 3;

    fn from_numbers(numbers: &[f64]) -> Result<Self, LineError> {
        Ok(PlanarPose::new(numbers[0], numbers[1], numbers[2]))
    }
}

impl Read<6> for Pose {
    const NUMBERS: usize = 7;

    fn from_numbers(numbers: &[f64]) -> Result<Self, LineError> {
        let mut seven = [0.0; 7];
        seven.copy_from_slice(numbers);
        Pose::from_array(seven).map_err(|_| LineError::Quaternion)
    }
}

struct Lines<M, const D: usize> {
    vertices: BTreeMap<u64, M>,
    edges: Vec<(u64, u64, Edge<M, D>)>,
    indefinite: Vec<usize>,
}

impl<M, const D: usize> Default for Lines<M, D> {
    fn default() -> Self {
        Self {
            vertices: BTreeMap::new(),
            edges: Vec::new(),
            indefinite: Vec::new(),
        }
    }
}

impl<M: Read<D>, const D: usize> Lines<M, D> {
    fn is_empty(&self) -> bool {
        self.vertices.is_empty() && self.edges.is_empty()
    }

    fn vertex<'t>(
        &mut self,
        tag: &'static str,
        words: impl Iterator<Item = &'t str>,
    ) -> Result<(), LineError> {
        let words = counted(tag, 1 + M::NUMBERS, words)?;
        let id = id(words[0])?;
        let pose = M::from_numbers(&numbers(&words[1..])?)?;
        match self.vertices.insert(id, pose) {
            Some(_) => Err(LineError::Twice { id }),
            None => Ok(()),
        }
    }

    fn edge<'t>(
        &mut self,
        tag: &'static str,
        line: usize,
        words: impl Iterator<Item = &'t str>,
    ) -> Result<(), LineError> {
        let words = counted(tag, 2 + M::NUMBERS + D * (D + 1) / 2, words)?;
        let (from, to) = (id(words[0])?, id(words[1])?);
        if from == to {
            return Err(LineError::Loop { id: from });
        }
        let numbers = numbers(&words[2..])?;
        let (pose, upper) = numbers.split_at(M::NUMBERS);
        let (information, is_nearest) = information(upper)?;
        if is_nearest {
            self.indefinite.push(line);
        }
        let edge = Edge {
            from: 0,
            to: 0,
            measured: M::from_numbers(pose)?,
            information,
            loss: Loss::Quadratic,
        };
        self.edges.push((from, to, edge));
        Ok(())
    }

    fn finish(self, fixed: &[(usize, u64)]) -> Result<Numbered<M, D>, ReadError> {
        let mut known: BTreeMap<u64, Option<M>> = BTreeMap::new();
        for (from, to, _) in &self.edges {
            known.extend([(*from, None), (*to, None)]);
        }
        known.extend(self.vertices.into_iter().map(|(id, pose)| (id, Some(pose))));
        let ids: Vec<u64> = known.keys().copied().collect();
        let index = |id: u64| ids.binary_search(&id).ok();
        let edges = self.edges.into_iter().filter_map(|(from, to, edge)| {
            Some(Edge {
                from: index(from)?,
                to: index(to)?,
                ..edge
            })
        });
        let edges: Vec<_> = edges.collect();
        let mut is_fixed = vec![false; ids.len()];
        for (line, id) in fixed {
            match index(*id) {
                Some(index) => is_fixed[index] = true,
                None => {
                    let (line, fault) = (*line, LineError::Unknown { id: *id });
                    return Err(ReadError { line, fault });
                }
            }
        }
        if fixed.is_empty() {
            is_fixed[0] = true;
        }
        let poses = known.values().map(|pose| pose.unwrap_or_else(M::identity));
        Ok(Numbered {
            graph: Graph {
                poses: poses.collect(),
                fixed: is_fixed,
                edges,
            },
            given: known.values().map(Option::is_some).collect(),
            ids,
            indefinite: self.indefinite,
        })
    }
}

fn counted<'t>(
    tag: &'static str,
    expected: usize,
    words: impl Iterator<Item = &'t str>,
) -> Result<Vec<&'t str>, LineError> {
    let words: Vec<_> = words.collect();
    if words.len() == expected {
        return Ok(words);
    }
    Err(LineError::Count {
        tag,
        expected,
        found: words.len(),
    })
}

fn id(word: &str) -> Result<u64, LineError> {
    word.parse().map_err(|_| LineError::Id {
        found: word.chars().take(40).collect(),
    })
}

fn numbers(words: &[&str]) -> Result<Vec<f64>, LineError> {
    let number = |word: &&str| match word.parse::<f64>() {
        Ok(value) if value.is_finite() => Ok(value),
        _ => Err(LineError::Number {
            found: word.chars().take(40).collect(),
        }),
    };
    words.iter().map(number).collect()
}

/// A matrix of its upper triangle, row by row, and whether it is another one: the nearest (by Frobenius' norm) that is
/// positive semidefinite, which has 0 for each negative eigenvalue. Source: Higham, *Computing a nearest symmetric
/// positive semidefinite matrix* (1988), theorem 2.1.
fn information<const D: usize>(upper: &[f64]) -> Result<(SMatrix<f64, D, D>, bool), LineError> {
    let mut matrix = SMatrix::<f64, D, D>::zeros();
    let places = (0..D).flat_map(|row| (row..D).map(move |column| (row, column)));
    for ((row, column), value) in places.zip(upper) {
        matrix[(row, column)] = *value;
        matrix[(column, row)] = *value;
    }
    // Rounding may have made a zero eigenvalue slightly negative.
    let slack = 1e-9 * matrix.trace().abs().max(f64::MIN_POSITIVE);
    let shifted = matrix + SMatrix::<f64, D, D>::identity() * slack;
    if shifted.cholesky().is_some() {
        return Ok((matrix, false));
    }
    let eigen = DMatrix::from_column_slice(D, D, matrix.as_slice()).symmetric_eigen();
    if eigen.eigenvalues.max() < 0.0 {
        return Err(LineError::Information);
    }
    let values = DMatrix::from_diagonal(&eigen.eigenvalues.map(|value| value.max(0.0)));
    let nearest = &eigen.eigenvectors * values * eigen.eigenvectors.transpose();
    let symmetric = 0.5 * (&nearest + nearest.transpose());
    Ok((SMatrix::from_column_slice(symmetric.as_slice()), true))
}

/// A planar graph as text; `ids` by pose.
pub fn write_planar(graph: &PlanarGraph, ids: &[u64]) -> String {
    g2o::write("SE2", graph, ids, |pose| {
        vec![pose.translation.x, pose.translation.y, pose.yaw]
    })
}

#[cfg(test)]
mod tests;
