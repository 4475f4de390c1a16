//! A label image as a graph: which areas there are, what shape they have, and which of them touch.
//!
//! ```text
//!   labels ──► runs of equal class ──► areas (union-find) ──► small areas given away ──► moments ──► Graph
//!                      └─────────────► boundaries between areas ──────┘
//! ```
//!
//! Paper 2 (metric-topological-semantic map), section III-A: nodes are areas of one class with their size and
//! eccentricity, edges are weighted by the number of neighbouring pixels. A panorama's last column is next to its
//! first, so an area that lies across the seam is one area, and its centre and ellipse are those of the whole.
//!
//! A graph is some 50 areas where the image had 341,000 pixels: it is what is compared ([`crate::semantic_map::relocation`]) and asked
//! ([`Relation`]).

mod boundaries;
mod relation;
mod runs;
mod shape;
#[cfg(test)]
mod tests;

use std::cmp::Reverse;
use std::f32::consts::TAU;

pub use relation::{Relation, UnknownRelation};
use thiserror::Error;

use boundaries::Boundaries;
use runs::Runs;

/// The label of pixels that belong to no area.
pub const VOID: u8 = u8::MAX;

/// The most classes that labels can tell apart: all values but [`VOID`].
pub const MOST_CLASSES: usize = VOID as usize;

/// Images are at most this wide and this high (px): sums of squares then fit 64 bits.
pub const MAX_SIDE_PX: u32 = 1 << 15;

/// A label image: one class index per pixel, row by row.
#[derive(Debug, Clone, Copy)]
pub struct Labels<'a> {
    /// Width (px).
    pub width: u32,
    /// Height (px).
    pub height: u32,
    /// The classes of the pixels; [`VOID`] where there is none.
    pub values: &'a [u8],
}

impl Labels<'_> {
    /// Pixels whose value is neither a class below `classes` nor [`VOID`]. They belong to no area.
    pub fn unknown_px(&self, classes: u8) -> usize {
        let unknown = |value: &&u8| **value >= classes && **value != VOID;
        self.values.iter().filter(unknown).count()
    }
}

/// How a graph is made.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GraphOptions {
    /// Number of classes: values from here on are no class.
    pub classes: u8,
    /// True where the last column is next to the first, as in a full panorama. Images narrower than 3 px never wrap.
    pub wraps: bool,
    /// Smaller areas are given to a neighbour (px).
    pub min_px: u32,
}

impl GraphOptions {
    /// `share` of an image's pixels, rounded up (px).
    pub fn share_px(share: f64, width: u32, height: u32) -> u32 {
        (share * f64::from(width) * f64::from(height)).ceil() as u32
    }
}

/// One connected area of equal class. Pixels are unit squares with their centres at integers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Area {
    /// The class, an index into the list of classes.
    pub class: u8,
    /// Number of pixels.
    pub pixels: u32,
    /// Column of the centre of gravity (px); from -0.5 to the width less 0.5.
    pub u: f32,
    /// Row of the centre of gravity (px).
    pub v: f32,
    /// Half the longer axis of the ellipse with the area's second moments (px).
    pub major_px: f32,
    /// Half the shorter axis (px).
    pub minor_px: f32,
    /// Direction of the longer axis from the image's x axis toward y, `(-π/2, π/2]`; 0 for a circle.
    pub orientation_rad: f32,
    /// `sqrt(1 - minor²/major²)`: 0 for a circle, near 1 for a line.
    pub eccentricity: f32,
}

impl Area {
    /// The natural logarithm of length over width, where neither is less than a pixel's.
    pub fn log_elongation(&self) -> f32 {
        // Half an axis of the ellipse of a lone row of pixels, 2 · √(1/12).
        let least = 1.0 / 3.0_f32.sqrt();
        (self.major_px.max(least) / self.minor_px.max(least)).ln()
    }
}

/// Two areas that touch.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Edge {
    /// Index of one area; the smaller one.
    pub a: u16,
    /// Index of the other area.
    pub b: u16,
    /// Pairs of neighbouring pixels (four neighbours) across the common boundary.
    pub boundary_px: u32,
}

/// Areas and which of them touch.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Graph {
    /// Width of the image (px).
    pub width: u32,
    /// Height of the image (px).
    pub height: u32,
    /// True where the last column is next to the first.
    pub wraps: bool,
    /// The angle from the left edge of the image to the right one (rad); `None` where that is not known. Labels do not
    /// say it.
    pub field_of_view_rad: Option<f32>,
    /// By class, the largest first; of equal ones the one whose first pixel comes first.
    pub areas: Vec<Area>,
    /// By `a`, then `b`.
    pub edges: Vec<Edge>,
}

/// Why there is no graph of an image.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum GraphError {
    /// The number of labels is not the number of pixels.
    #[error("expected {expected} labels for the size of the image, found {found}")]
    Size {
        /// Width times height.
        expected: u64,
        /// Labels.
        found: usize,
    },
    /// A side is too long.
    #[error("expected an image of at most {MAX_SIDE_PX} px a side, found {width} x {height}")]
    TooLarge {
        /// Width (px).
        width: u32,
        /// Height (px).
        height: u32,
    },
    /// More areas than can be numbered.
    #[error("expected at most 65535 areas, found {0}: a larger min_px leaves fewer")]
    TooManyAreas(usize),
}

impl Graph {
    /// The graph of a label image.
    ///
    /// Areas smaller than `min_px` are given away, the smallest first (of equal ones the one whose first pixel comes
    /// first): all of an area's pixels take the class of the neighbour with the longest common boundary (of equal ones
    /// the larger, then the one whose first pixel comes first), and areas of one class that touch thereby become one. So a
    /// hole in a wall becomes wall, and the boundary between wall and sky is where it was. An area without a neighbour,
    /// all around it void, is left out. Dropping small areas instead would leave gaps across which nothing touches.
    ///
    /// # Errors
    /// [`GraphError`]. An image without pixels has a graph without areas.
    pub fn from_labels(labels: &Labels<'_>, options: &GraphOptions) -> Result<Self, GraphError> {
        Ok(Self::build(labels, options)?.0)
    }

    /// As [`Graph::from_labels`], with the area that each pixel is in, row by row; `None` for pixels of no area.
    ///
    /// # Errors
    /// [`GraphError`].
    pub fn with_pixels(
        labels: &Labels<'_>,
        options: &GraphOptions,
    ) -> Result<(Self, Vec<Option<u16>>), GraphError> {
        let (graph, runs, area_of_run) = Self::build(labels, options)?;
        let mut pixels = Vec::with_capacity(labels.values.len());
        for (run, area) in runs.runs().iter().zip(area_of_run) {
            pixels.resize(pixels.len() + run.len() as usize, area);
        }
        Ok((graph, pixels))
    }

    /// The graph, and the area of each run.
    fn build(
        labels: &Labels<'_>,
        options: &GraphOptions,
    ) -> Result<(Self, Runs, Vec<Option<u16>>), GraphError> {
        let Labels {
            width,
            height,
            values,
        } = *labels;
        let expected = u64::from(width) * u64::from(height);
        if expected != values.len() as u64 {
            let found = values.len();
            return Err(GraphError::Size { expected, found });
        }
        if width.max(height) > MAX_SIDE_PX {
            return Err(GraphError::TooLarge { width, height });
        }
        let wraps = options.wraps && width >= 3;
        let mut runs = Runs::new(values, width as usize, options.classes);
        let joints = runs.connect(wraps);
        let mut boundaries = Boundaries::new(&runs, &joints);
        boundaries.absorb(options.min_px);
        let (graph, area_of_run) = Self::from_runs(&runs, &boundaries, [width, height], wraps)?;
        Ok((graph, runs, area_of_run))
    }

    fn from_runs(
        runs: &Runs,
        boundaries: &Boundaries,
        [width, height]: [u32; 2],
        wraps: bool,
    ) -> Result<(Self, Vec<Option<u16>>), GraphError> {
        let mut kept = boundaries.kept();
        kept.sort_by_key(|region| (region.class, Reverse(region.pixels), region.id));
        if kept.len() > usize::from(u16::MAX) {
            return Err(GraphError::TooManyAreas(kept.len()));
        }
        let mut area_of = vec![None; boundaries.len()];
        for (region, area) in kept.iter().zip(0_u16..) {
            area_of[region.id as usize] = Some(area);
        }
        let area_of_run: Vec<Option<u16>> = runs
            .regions()
            .iter()
            .map(|region| area_of[boundaries.find(*region)? as usize])
            .collect();
        let mut areas = shape::areas(runs, &area_of_run, kept.len(), wraps);
        for (area, region) in areas.iter_mut().zip(&kept) {
            area.class = region.class;
        }
        let graph = Self {
            width,
            height,
            wraps,
            field_of_view_rad: None,
            areas,
            edges: boundaries.edges(&area_of),
        };
        Ok((graph, area_of_run))
    }

    /// The angle between neighbouring columns (rad), on average: of a full turn where the image wraps, else of its field
    /// of view, or of `unknown_rad` where that is not known.
    pub fn rad_per_px(&self, unknown_rad: f32) -> f32 {
        let range = match self.wraps {
            true => TAU,
            false => self.field_of_view_rad.unwrap_or(unknown_rad),
        };
        range / self.width.max(1) as f32
    }

    /// Number of areas of a class.
    pub fn count(&self, class: u8) -> usize {
        self.areas.iter().filter(|area| area.class == class).count()
    }

    /// How far right (px) and how far down (px) one area's centre lies of another's; where the image wraps, the shorter
    /// way around, `(-width/2, width/2]`.
    pub fn offset(&self, from: &Area, to: &Area) -> [f32; 2] {
        let circle_px = self.wraps.then_some(self.width as f32);
        offset([from.u, from.v], [to.u, to.v], circle_px)
    }

    /// Whether some area of class `a` is in `relation` to some other area of class `b`.
    pub fn holds(&self, a: u8, relation: Relation, b: u8) -> bool {
        self.related(relation).any(|[first, second]| {
            let class = |area: usize| self.areas[area].class;
            class(first) == a && class(second) == b
        })
    }

    /// All ordered pairs of areas (indices) of which the first is in `relation` to the second. Edges to areas that do not
    /// exist are passed over.
    pub fn related(&self, relation: Relation) -> impl Iterator<Item = [usize; 2]> + '_ {
        let number = self.areas.len();
        let touching = relation.needs_contact();
        let contacts = self
            .edges
            .iter()
            .filter(move |_| touching)
            .flat_map(|edge| {
                let (a, b) = (usize::from(edge.a), usize::from(edge.b));
                [[a, b], [b, a]]
            });
        let all = (0..if touching { 0 } else { number })
            .flat_map(move |a| (0..number).filter(move |b| *b != a).map(move |b| [a, b]));
        contacts.chain(all).filter(move |[a, b]| {
            let (Some(first), Some(second)) = (self.areas.get(*a), self.areas.get(*b)) else {
                return false;
            };
            relation.fits(self.offset(second, first))
        })
    }
}

/// How far right and how far down a place lies of another (px); the shorter way around where the image is a full circle
/// of so many columns.
pub fn offset(from: [f32; 2], to: [f32; 2], circle_px: Option<f32>) -> [f32; 2] {
    let mut right = to[0] - from[0];
    if let Some(width) = circle_px {
        if right > width / 2.0 {
            right -= width;
        } else if right <= -width / 2.0 {
            right += width;
        }
    }
    [right, to[1] - from[1]]
}
