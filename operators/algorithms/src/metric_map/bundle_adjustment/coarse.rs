//! The far level of the preconditioner: clusters of poses that move as rigid bodies.
//!
//! `Pᵀ S P` is formed like `S` itself, with a cluster in place of a pose: what all sightings of a landmark from one
//! cluster say is summed first.

use rayon::prelude::*;

use super::blocks::{Block, Blocks, Dense, diagonal, transposed};
use super::clusters::Clusters;
use super::elimination::{Layout, Sighted};
use super::iterative::between;
use super::schur::Bundle;

pub(super) struct Coarse<const C: usize> {
    clusters: Clusters,
    /// `P`, block by block.
    motions: Vec<Block<C>>,
    /// By landmark, then by cluster.
    shares: Vec<Share>,
    /// By share: where the landmark's shares end.
    ends: Vec<u32>,
    /// By cluster its shares.
    by_cluster: Vec<Vec<u32>>,
    system: Dense,
}

/// Sightings of one landmark from one cluster.
struct Share {
    cluster: u32,
    /// Their places.
    first: u32,
    end: u32,
}

impl<const C: usize> Coarse<C> {
    /// `None` without memory for it.
    pub(super) fn new<B: Bundle<C>>(
        layout: &Layout,
        landmarks: usize,
        clusters: Clusters,
        bundle: &B,
    ) -> Option<Self> {
        let mut shares: Vec<Share> = Vec::new();
        let mut ends = Vec::new();
        let mut by_cluster = vec![Vec::new(); clusters.count];
        for landmark in 0..landmarks {
            let begin = shares.len();
            for place in layout.of_landmark(landmark) {
                let Some(cluster) = clusters.of.get(layout.sights[place].block as usize) else {
                    break;
                };
                let place = place as u32;
                match shares[begin..].last_mut() {
                    Some(share) if share.cluster == *cluster => share.end = place + 1,
                    _ => {
                        by_cluster[*cluster as usize].push(shares.len() as u32);
                        shares.push(Share {
                            cluster: *cluster,
                            first: place,
                            end: place + 1,
                        });
                    }
                }
            }
            ends.resize(shares.len(), shares.len() as u32);
        }
        Some(Self {
            motions: bundle.common_motions(&clusters.of),
            system: Dense::new(clusters.count * C)?,
            clusters,
            shares,
            ends,
            by_cluster,
        })
    }

    pub(super) fn factorise(
        &mut self,
        layout: &Layout,
        sighted: &[Sighted<C>],
        (terms, damping): (&Blocks<C>, &[[f64; C]]),
    ) -> Option<()> {
        self.system.clear();
        self.add_landmarks(layout, sighted);
        for (row, column, block) in terms.iter() {
            self.add_block(row, column, block);
        }
        for (block, damping) in damping.iter().enumerate() {
            self.add_block(block, block, &diagonal(damping));
        }
        self.system.factorise()
    }

    /// A block of `S` of two unknowns.
    fn add_block(&mut self, row: usize, column: usize, block: &Block<C>) {
        let (a, b) = (
            self.clusters.of[row] as usize,
            self.clusters.of[column] as usize,
        );
        let product = between(&self.motions[row], block, &self.motions[column]);
        if a <= b {
            self.system.add(a, b, &product);
        }
        if a > b || (a == b && row != column) {
            self.system.add(b, a, &transposed(&product));
        }
    }

    /// What landmarks say: `Σ ĴᵀĴ - Gᵀ G` with `Ĵ = J P` and `G = Σ Bᵀ Ĵ` over the sightings of a share.
    fn add_landmarks(&mut self, layout: &Layout, sighted: &[Sighted<C>]) {
        let motions = &self.motions;
        let together = |share: &Share| -> ([[f64; C]; 3], Block<C>) {
            let mut sum = [[0.0; C]; 3];
            let mut square = [[0.0; C]; C];
            for place in share.first as usize..share.end as usize {
                let block = layout.sights[place].block as usize;
                let sighted = &sighted[place];
                for row in 0..2 {
                    let camera = &sighted.linear.camera[row];
                    let moved = times(camera, &motions[block]);
                    for (sum, b) in sum.iter_mut().zip(sighted.eliminated[row]) {
                        (0..C).for_each(|c| sum[c] += b * moved[c]);
                    }
                    for r in 0..C {
                        (0..C).for_each(|c| square[r][c] += moved[r] * moved[c]);
                    }
                }
            }
            (sum, square)
        };
        let shares: Vec<([[f64; C]; 3], Block<C>)> = self.shares.par_iter().map(together).collect();
        let count = self.clusters.count;
        let rows: Vec<Vec<Block<C>>> = self
            .by_cluster
            .par_iter()
            .enumerate()
            .map(|(cluster, own)| {
                let mut row = vec![[[0.0; C]; C]; count - cluster];
                for share in own {
                    let (sum, square) = &shares[*share as usize];
                    for r in 0..C {
                        (0..C).for_each(|c| row[0][r][c] += square[r][c]);
                    }
                    for other in *share..self.ends[*share as usize] {
                        let column = self.shares[other as usize].cluster as usize - cluster;
                        subtract(&mut row[column], sum, &shares[other as usize].0);
                    }
                }
                row
            })
            .collect();
        for (cluster, row) in rows.iter().enumerate() {
            for (after, block) in row.iter().enumerate() {
                self.system.add(cluster, cluster + after, block);
            }
        }
    }

    /// `z += P (Pᵀ S P)⁻¹ Pᵀ r`.
    pub(super) fn add_solution(&mut self, residual: &[[f64; C]], all: &mut [[f64; C]]) {
        let mut right = vec![[0.0; C]; self.clusters.count];
        let blocks = self.clusters.of.iter().zip(&self.motions);
        for ((cluster, motion), residual) in blocks.clone().zip(residual) {
            let sum = &mut right[*cluster as usize];
            for (residual, row) in residual.iter().zip(motion) {
                (0..C).for_each(|c| sum[c] += row[c] * residual);
            }
        }
        self.system.solve(right.as_flattened_mut());
        for ((cluster, motion), all) in blocks.zip(all) {
            let step = &right[*cluster as usize];
            for (entry, row) in all.iter_mut().zip(motion) {
                *entry += (0..C).fold(0.0, |sum, c| sum + row[c] * step[c]);
            }
        }
    }
}

/// A row times a block.
#[inline(always)]
fn times<const C: usize>(row: &[f64; C], block: &Block<C>) -> [f64; C] {
    let mut product = [0.0; C];
    for (entry, row) in row.iter().zip(block) {
        (0..C).for_each(|c| product[c] += entry * row[c]);
    }
    product
}

/// `block -= aᵀ b`.
#[inline(always)]
fn subtract<const C: usize>(block: &mut Block<C>, a: &[[f64; C]; 3], b: &[[f64; C]; 3]) {
    for (a, b) in a.iter().zip(b) {
        for r in 0..C {
            (0..C).for_each(|c| block[r][c] -= a[r] * b[c]);
        }
    }
}
