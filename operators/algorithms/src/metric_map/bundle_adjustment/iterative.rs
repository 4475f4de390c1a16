//! The reduced system solved without being formed: conjugate gradients, preconditioned on two levels.
//!
//! A product with `S` is two passes over the observations, one by landmark and one by pose. How many products it takes
//! is up to the preconditioner `M⁻¹ = Σ Rᵀ Sᵣ⁻¹ R + P (Pᵀ S P)⁻¹ Pᵀ`:
//! - *near*: the blocks `Sᵣ` of poses that see the same landmarks are factorised, a group at a time;
//! - *far*: whole clusters move rigidly (`P`), with a small dense system `Pᵀ S P` between them. What is left of drift
//!   bends a map over many keyframes, which is just what groups cannot see.
//!
//! Sources: Agarwal, Snavely, Seitz, Szeliski, *Bundle Adjustment in the Large* (ECCV 2010) for the implicit product;
//! Kushal & Agarwal (CVPR 2012) for groups by visibility; Toselli & Widlund, *Domain Decomposition Methods* (2005),
//! chapter 3, for the second level, without which iterations grow with the length of the map.

use rayon::prelude::*;

use super::blocks::{Block, Blocks, Dense};
use super::clusters::Clusters;
use super::coarse::Coarse;
use super::elimination::{Layout, Point, Sighted, fill, pieces};
use super::schur::Bundle;
use crate::processor::vectorised;
use crate::solving::least_squares::SystemError;

/// Poses of a group that are factorised together. Larger groups save few products and take more to form.
const GROUP: usize = 8;

/// Clusters that may move rigidly: their dense system stays small beside a pass over the observations.
pub(super) const CLUSTERS: usize = 200;

/// Fewer unknowns than this in a cluster are better factorised.
const CLUSTER: usize = 6;

/// Products with the matrix before a step is taken as it is.
const MAX_ITERATIONS: usize = 200;

/// The residual, in the preconditioner's norm, is left at this part of the first. Each further tenth takes a few
/// products more, and a step that is less exact takes further rounds of everything else.
const TOLERANCE: f64 = 1e-3;

/// A reduced system that is never formed.
pub(super) struct Iterative<const C: usize> {
    groups: Vec<Group>,
    near: Blocks<C>,
    far: Option<Coarse<C>>,
    sights: ByBlock<C>,
}

/// What a product reads of each observation, in the order that it is read in: far from each other in memory, they would
/// take longer to come than to be used.
struct ByBlock<const C: usize> {
    /// Block after block, derivatives by the camera side: in half the memory, as digits beyond the seventh mean nothing to
    /// a solution of three.
    cameras: Vec<Vec<[[f32; C]; 2]>>,
    /// In the order of landmarks, what [`Point::follow`] leaves.
    moved: Vec<[f64; 2]>,
}

/// Poses that are factorised together.
struct Group {
    members: Vec<u32>,
    system: Dense,
    right: Vec<f64>,
}

impl<const C: usize> Iterative<C> {
    /// Also gives the layout anew, with the sights of a group beside each other.
    pub(super) fn new<B: Bundle<C>>(
        landmarks: usize,
        layout: Layout,
        bundle: &B,
    ) -> Result<(Layout, Self), SystemError> {
        let blocks = layout.by_block.len();
        let clusters = clusters(&layout, landmarks, &bundle.kin(blocks));
        let parts = clusters.cut(GROUP);
        let members = parts.members();
        let mut order: Vec<u32> = (0..blocks as u32).collect();
        order.sort_by_key(|block| {
            (
                clusters.of[*block as usize],
                parts.of[*block as usize],
                *block,
            )
        });
        let mut rank = vec![0; blocks];
        for (place, block) in (0_u32..).zip(&order) {
            rank[*block as usize] = place;
        }
        let layout = Layout::new(landmarks, layout.sights, &rank);
        let pairs = members.iter().flat_map(|members| {
            let each = members.iter().enumerate();
            each.flat_map(|(at, a)| members[at + 1..].iter().map(move |b| (*a, *b)))
        });
        let mut pairs: Vec<(u32, u32)> = pairs.collect();
        pairs.sort_unstable();
        let groups = members.into_iter().map(|members| {
            Some(Group {
                system: Dense::new(members.len() * C)?,
                right: vec![0.0; members.len() * C],
                members,
            })
        });
        let groups: Option<Vec<Group>> = groups.collect();
        let far = Coarse::new(&layout, landmarks, clusters, bundle);
        let sights = ByBlock::new(&layout);
        Ok((
            layout,
            Self {
                groups: groups.ok_or(SystemError::OutOfMemory)?,
                near: Blocks::new(blocks, &pairs),
                far,
                sights,
            },
        ))
    }

    /// As [`super::system::System::solve`]; the solution is inexact.
    pub(super) fn solve(
        &mut self,
        layout: &Layout,
        sighted: &[Sighted<C>],
        points: &mut [Point],
        own: (&Blocks<C>, &[[f64; C]]),
        right: &mut [[f64; C]],
    ) -> Option<()> {
        self.factorise(layout, sighted, own)?;
        self.sights.gather(layout, sighted);
        let mut residual = right.to_vec();
        right.fill([0.0; C]);
        let mut conditioned = self.condition(&residual);
        let mut direction = conditioned.clone();
        let first = dot(&residual, &conditioned);
        let mut size = first;
        for _ in 0..MAX_ITERATIONS {
            if size <= TOLERANCE * TOLERANCE * first {
                break;
            }
            let product = (self.sights).product(layout, sighted, points, own, &direction);
            let curvature = dot(&direction, &product);
            if curvature.is_nan() || curvature <= 0.0 {
                break;
            }
            let length = size / curvature;
            add(right, length, &direction);
            add(&mut residual, -length, &product);
            conditioned = self.condition(&residual);
            let before = std::mem::replace(&mut size, dot(&residual, &conditioned));
            for (direction, conditioned) in direction.iter_mut().zip(&conditioned) {
                for c in 0..C {
                    direction[c] = conditioned[c] + size / before * direction[c];
                }
            }
        }
        let finite = right.as_flattened().iter().all(|x| x.is_finite());
        finite.then_some(())
    }

    fn factorise(
        &mut self,
        layout: &Layout,
        sighted: &[Sighted<C>],
        own: (&Blocks<C>, &[[f64; C]]),
    ) -> Option<()> {
        fill(&mut self.near, layout, sighted, own);
        let near = &self.near;
        let factorised: Option<Vec<()>> = self
            .groups
            .par_iter_mut()
            .map(|group| group.factorise(near))
            .collect();
        factorised?;
        if let Some(far) = &mut self.far
            && far.factorise(layout, sighted, own).is_none()
        {
            self.far = None;
        }
        Some(())
    }

    /// `M⁻¹ r`.
    fn condition(&mut self, residual: &[[f64; C]]) -> Vec<[f64; C]> {
        self.groups
            .par_iter_mut()
            .for_each(|group| group.solve(residual));
        let mut all = vec![[0.0; C]; residual.len()];
        for group in &self.groups {
            let parts = group.right.as_chunks::<C>().0;
            for (member, part) in group.members.iter().zip(parts) {
                all[*member as usize] = *part;
            }
        }
        if let Some(far) = &mut self.far {
            far.add_solution(residual, &mut all);
        }
        all
    }
}

/// What moves rigidly: never more than [`CLUSTERS`], as memory grows with their square and time with their cube.
pub(super) fn clusters(layout: &Layout, landmarks: usize, kin: &[u32]) -> Clusters {
    let most = CLUSTERS.min(layout.by_block.len() / CLUSTER + 1);
    Clusters::by_visibility(layout, landmarks, kin, most).joined(CLUSTERS)
}

impl Group {
    fn factorise<const C: usize>(&mut self, near: &Blocks<C>) -> Option<()> {
        self.system.clear();
        for (row, member) in self.members.iter().enumerate() {
            let first = near.starts[*member as usize];
            for column in row..self.members.len() {
                self.system
                    .add(row, column, &near.entries[first + column - row]);
            }
        }
        self.system.factorise()
    }

    fn solve<const C: usize>(&mut self, residual: &[[f64; C]]) {
        let parts = self.right.as_chunks_mut::<C>().0;
        for (member, part) in self.members.iter().zip(parts) {
            *part = residual[*member as usize];
        }
        self.system.solve(&mut self.right);
    }
}

impl<const C: usize> ByBlock<C> {
    fn new(layout: &Layout) -> Self {
        let blocks = layout.by_block.iter();
        Self {
            cameras: blocks.map(|own| vec![[[0.0; C]; 2]; own.len()]).collect(),
            moved: vec![[0.0; 2]; layout.sights.len()],
        }
    }

    fn gather(&mut self, layout: &Layout, sighted: &[Sighted<C>]) {
        let blocks = self.cameras.par_iter_mut().zip(&layout.by_block);
        blocks.with_min_len(8).for_each(|(cameras, own)| {
            for (camera, place) in cameras.iter_mut().zip(own) {
                let precise = &sighted[*place as usize].linear.camera;
                *camera = precise.map(|row| row.map(|entry| entry as f32));
            }
        });
    }

    /// `S x`.
    fn product(
        &mut self,
        layout: &Layout,
        sighted: &[Sighted<C>],
        points: &mut [Point],
        (terms, damping): (&Blocks<C>, &[[f64; C]]),
        x: &[[f64; C]],
    ) -> Vec<[f64; C]> {
        pieces(layout, points, &mut self.moved)
            .into_par_iter()
            .for_each(|piece| {
                vectorised(
                    #[inline(always)]
                    || {
                        piece.each(
                            #[inline(always)]
                            |landmark, sights, _, moved| {
                                let sighted = &sighted[layout.of_landmark(landmark)];
                                Point::follow(sights, sighted, moved, x);
                            },
                        );
                    },
                );
            });
        let mut product = terms.product(x);
        let moved = &self.moved;
        let sights = self.cameras.par_iter().zip(&layout.by_block);
        let all = product.par_iter_mut().zip(sights);
        let all = all.zip(x.par_iter().zip(damping)).with_min_len(8);
        all.for_each(|((sum, (cameras, own)), (x, damping))| {
            vectorised(
                #[inline(always)]
                || {
                    (0..C).for_each(|c| sum[c] += damping[c] * x[c]);
                    for ([j, k], place) in cameras.iter().zip(own) {
                        let [a, b] = moved[*place as usize];
                        (0..C).for_each(|c| sum[c] += f64::from(j[c]) * a + f64::from(k[c]) * b);
                    }
                },
            );
        });
        product
    }
}

fn dot<const C: usize>(a: &[[f64; C]], b: &[[f64; C]]) -> f64 {
    let pairs = a.as_flattened().iter().zip(b.as_flattened());
    pairs.map(|(a, b)| a * b).sum()
}

/// `a += factor b`.
fn add<const C: usize>(a: &mut [[f64; C]], factor: f64, b: &[[f64; C]]) {
    for (a, b) in a.as_flattened_mut().iter_mut().zip(b.as_flattened()) {
        *a += factor * b;
    }
}

/// `Aᵀ B A'` of blocks.
pub(super) fn between<const C: usize>(a: &Block<C>, b: &Block<C>, c: &Block<C>) -> Block<C> {
    let right: Block<C> = std::array::from_fn(|r| {
        std::array::from_fn(|k| (0..C).fold(0.0, |sum, m| sum + b[r][m] * c[m][k]))
    });
    std::array::from_fn(|r| {
        std::array::from_fn(|k| (0..C).fold(0.0, |sum, m| sum + a[m][r] * right[m][k]))
    })
}
