//! What neighbouring views say about a view's pixels: the temporal unary.
//!
//! Paper 2 (map-based relocation by semantics), section III-B2: the unary potential of a pixel is the mean of the
//! classifier's predictions for it in the views of a neighbourhood N, brought here by projection through the depth image
//! and odometry,
//!
//! ```text
//! ψ(y_i) = α Σ_{n ∈ N} ψ_n(y_i)          α = 1 / number of views that see the point
//! ```
//! Each pixel of the view is lifted by its depth, moved into a neighbour's frame and projected. The neighbour has a say
//! where its own depth there is that of the point: where something is in front of it, or where it has gone, the
//! neighbour's pixel shows another thing. What is beyond range (the sky) is at infinity: only the rotation matters, and
//! the neighbour must see nothing nearer either.
//!
//! A pixel where nothing was measured may be sky, or a hole in a near wall. Its neighbours tell: where two or more of them
//! measured something on its ray, and no more see nothing in its direction, it is a hole and as far away as the nearest
//! that they measured. Where they do not tell, it keeps its own prediction.

#[cfg(test)]
mod tests;
mod view;

use nalgebra::Vector3;
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::geometry::camera::{Camera, Model};
use crate::geometry::pose::Pose;
use crate::semantic_map::class_scores::ScoresView;
use view::Depth;
pub use view::{DepthView, ScoredView};

/// Cells that one task works on.
const CHUNK: usize = 4096;

/// How votes are gathered.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct VoteOptions {
    /// Inverse depths that differ by no more than this are of the same thing (1/m): by default 12 cm at 5 m, 2 m at
    /// 20 m. Inverse depth is what stereo cameras measure with equal noise at all distances, and what grows by a constant
    /// per pixel along a plane.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub same_per_m: f64,
}

impl Default for VoteOptions {
    /// One pixel of a panorama of 1024 columns (1/163 rad) further along the ground, seen from 1.2 m above it, is 0.005
    /// 1/m; steps and noise of stereo depth (2 to 3 · 10⁻⁴ 1/m) and of odometry over some metres are well within.
    fn default() -> Self {
        Self { same_per_m: 0.005 }
    }
}

/// What is the same for all views of a camera.
#[derive(Debug, Clone)]
pub struct Voter {
    camera: Camera,
    /// Whether the last column is next to the first one.
    wraps: bool,
    /// Whether depth images hold the distance along the optical axis, not along the ray.
    along_axis: bool,
    options: VoteOptions,
}

impl Voter {
    /// For the views of a camera. Depth is the distance along the ray; of a pinhole camera, along the optical axis, as
    /// is usual with each.
    pub fn new(camera: &Camera, options: &VoteOptions) -> Self {
        Self {
            camera: camera.clone(),
            wraps: camera.wraps(),
            along_axis: matches!(camera.model, Model::Pinhole(_)),
            options: *options,
        }
    }

    /// The mean of a view's own probabilities and of those that its neighbours have for the same points: `1/255` per
    /// unit, in the view's cells. A cell without a ray, and a view without depth, keep what they have; neighbours without
    /// depth, with other classes or of another size have no say.
    pub fn vote(&self, view: &ScoredView<'_>, neighbours: &[ScoredView<'_>]) -> Vec<u8> {
        let scores = &view.scores;
        let Some(depth) = view.depth.filter(|depth| depth.fits(&self.camera)) else {
            return scores.probabilities().to_vec();
        };
        let alike = |other: &&ScoredView<'_>| {
            let same = other.scores.classes() == scores.classes();
            same && other.scores.size() == scores.size()
        };
        let neighbours: Vec<Neighbour<'_>> = neighbours
            .iter()
            .filter(alike)
            .filter_map(|other| {
                let depth = other.depth.filter(|depth| depth.fits(&self.camera))?;
                let there_from_here = other
                    .odom_from_camera
                    .inverse()
                    .compose(&view.odom_from_camera);
                Some(Neighbour {
                    scores: other.scores,
                    depth,
                    there_from_here,
                })
            })
            .collect();
        let measured: Vec<Vec<f32>> = neighbours
            .par_iter()
            .filter(|_| depth.has_holes())
            .map(|neighbour| self.measured(scores, neighbour))
            .collect();
        let mut votes = scores.probabilities().to_vec();
        let chunks = votes.par_chunks_mut(CHUNK * scores.classes()).enumerate();
        chunks.for_each(|(chunk, votes)| {
            let mut sums = vec![0; scores.classes()];
            for (cell, votes) in votes.chunks_exact_mut(scores.classes()).enumerate() {
                let cell = chunk * CHUNK + cell;
                let centre = scores.centre(cell);
                let Some(ray) = self.camera.unproject(centre) else {
                    continue;
                };
                let point = match depth.nearest(centre) {
                    Depth::At(depth_m) => Some(Point::At(self.lift(&ray, depth_m))),
                    Depth::Beyond => Some(Point::Towards(ray)),
                    Depth::Unknown => {
                        let measured = measured.iter().map(|there| there[cell]);
                        self.unmeasured(&ray, measured, &neighbours)
                    }
                };
                if let Some(point) = point {
                    self.gather(&point, &neighbours, &mut sums, votes);
                }
            }
        });
        votes
    }

    /// What a neighbour measured, as it would be seen from here: by cell, the inverse distance of the nearest (1/m), 0 where
    /// there is nothing.
    fn measured(&self, scores: &ScoresView<'_>, neighbour: &Neighbour<'_>) -> Vec<f32> {
        let cells = scores.columns() * scores.rows();
        let here_from_there = neighbour.there_from_here.inverse();
        let mut nearest = vec![0.0_f32; cells];
        for centre in (0..cells).map(|cell| scores.centre(cell)) {
            let Depth::At(depth_m) = neighbour.depth.nearest(centre) else {
                continue;
            };
            let Some(ray) = self.camera.unproject(centre) else {
                continue;
            };
            let point = here_from_there.transform(&self.lift(&ray, depth_m));
            let pixel = self.camera.project(&point);
            let [pixel, ..] = pixel.map_or([None; 4], |pixel| self.around(pixel));
            if let Some(cell) = pixel.and_then(|pixel| scores.at(pixel)) {
                nearest[cell] = nearest[cell].max(1.0 / self.depth_m(&point) as f32);
            }
        }
        nearest
    }

    /// What a pixel sees where nothing was measured, by what each neighbour measured on its ray (1/m) and sees in its
    /// direction; `None` where they do not tell.
    fn unmeasured(
        &self,
        ray: &Vector3<f64>,
        measured: impl Iterator<Item = f32>,
        neighbours: &[Neighbour<'_>],
    ) -> Option<Point> {
        let (mut near, mut nearest) = (0, 0.0);
        for inverse in measured.filter(|inverse| *inverse > 0.0) {
            near += 1;
            nearest = f32::max(nearest, inverse);
        }
        let sky = Point::Towards(*ray);
        let see_nothing = neighbours
            .iter()
            .filter(|neighbour| self.look_up(&sky, neighbour).is_some())
            .count();
        if see_nothing > near {
            return Some(sky);
        }
        // What one neighbour alone measured may have moved since.
        (near > 1).then(|| Point::At(self.lift(ray, 1.0 / f64::from(nearest))))
    }

    /// The point of a ray that is so far away as depth images tell it.
    fn lift(&self, ray: &Vector3<f64>, depth_m: f64) -> Vector3<f64> {
        match self.along_axis {
            true => ray * (depth_m / ray.z),
            false => ray * depth_m,
        }
    }

    /// How far away depth images say that a point is.
    fn depth_m(&self, point: &Vector3<f64>) -> f64 {
        match self.along_axis {
            true => point.z,
            false => point.norm(),
        }
    }

    /// Turns a cell's own probabilities into the mean of all that see its point.
    fn gather(
        &self,
        point: &Point,
        neighbours: &[Neighbour<'_>],
        sums: &mut [u32],
        votes: &mut [u8],
    ) {
        let mut views = 1;
        for (sum, own) in sums.iter_mut().zip(votes.iter()) {
            *sum = u32::from(*own);
        }
        for neighbour in neighbours {
            let Some(seen) = self.look_up(point, neighbour) else {
                continue;
            };
            views += 1;
            for (sum, vote) in sums.iter_mut().zip(seen) {
                *sum += u32::from(*vote);
            }
        }
        for (vote, sum) in votes.iter_mut().zip(sums.iter()) {
            *vote = ((2 * sum + views) / (2 * views)) as u8;
        }
    }

    /// A neighbour's probabilities for a point, where it sees it.
    fn look_up<'a>(&self, point: &Point, neighbour: &Neighbour<'a>) -> Option<&'a [u8]> {
        let there = match point {
            Point::At(point) => neighbour.there_from_here.transform(point),
            Point::Towards(ray) => neighbour.there_from_here.rotate(ray),
        };
        let expected = match point {
            Point::At(_) => 1.0 / self.depth_m(&there),
            Point::Towards(_) => 0.0,
        };
        let pixel = self.camera.project(&there)?;
        let mut best: Option<(f64, [f64; 2])> = None;
        for pixel in self.around(pixel).into_iter().flatten() {
            let found = match (neighbour.depth.nearest(pixel), point) {
                (Depth::At(depth_m), _) => 1.0 / depth_m,
                (Depth::Beyond, _) | (Depth::Unknown, Point::Towards(_)) => 0.0,
                (Depth::Unknown, Point::At(_)) => continue,
            };
            let apart = (found - expected).abs();
            if apart <= self.options.same_per_m && best.is_none_or(|(least, _)| apart < least) {
                best = Some((apart, pixel));
            }
        }
        let (_, pixel) = best?;
        let seen = neighbour.scores.cell(neighbour.scores.at(pixel)?);
        // A cell that knows nothing has no say.
        (seen.iter().any(|vote| *vote > 0)).then_some(seen)
    }

    /// The nearest pixel and its neighbours on the side of the point, as far as they are in the image. The nearest one
    /// comes first, and wins where depths are equal.
    fn around(&self, [u, v]: [f64; 2]) -> [Option<[f64; 2]>; 4] {
        let (width, height) = (f64::from(self.camera.width), f64::from(self.camera.height));
        let beside = |x: f64| {
            if x < x.round() {
                x.round() - 1.0
            } else {
                x.round() + 1.0
            }
        };
        let inside = |u: f64, v: f64| {
            let u = if self.wraps { u.rem_euclid(width) } else { u };
            let seen = u >= 0.0 && u < width && v >= 0.0 && v < height;
            seen.then_some([u, v])
        };
        let (near_u, near_v) = (u.round(), v.round());
        [
            inside(near_u, near_v),
            inside(beside(u), near_v),
            inside(near_u, beside(v)),
            inside(beside(u), beside(v)),
        ]
    }
}

/// What a pixel sees, in the view's frame.
enum Point {
    At(Vector3<f64>),
    /// Beyond range.
    Towards(Vector3<f64>),
}

struct Neighbour<'a> {
    scores: ScoresView<'a>,
    depth: DepthView<'a>,
    there_from_here: Pose,
}
