//! Areas as small integers, so that a comparison is a few additions and the same on every machine.

use std::cmp::Reverse;
use std::f32::consts::{PI, TAU};

use super::options::{Options, Scales, divisor};
use crate::semantic_map::semantic_graph::{Area, Graph};

/// One scale's worth of difference.
pub(super) const UNIT: f32 = 64.0;
/// Differences beyond this are all the same: far above every limit.
const FAR: f32 = 20_000.0;

/// Areas that are compared at once.
pub(super) const LANES: usize = 16;
/// The class of lanes without an area.
pub(super) const NO_CLASS: u16 = u16::MAX;

/// Areas side by side, one lane for each. Differences are in [`UNIT`]s of their scales.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Block {
    pub(super) class: [u16; LANES],
    /// `2^16` is a full turn.
    pub(super) bearing: [u16; LANES],
    pub(super) elevation: [u16; LANES],
    pub(super) size: [u16; LANES],
    pub(super) elongation: [u16; LANES],
    /// `2^16` is half a turn.
    pub(super) orientation: [u16; LANES],
    /// The squared eccentricity: `2^16` is 1.
    pub(super) stretch: [u16; LANES],
}

impl Block {
    const EMPTY: Self = Self {
        class: [NO_CLASS; LANES],
        bearing: [0; LANES],
        elevation: [0; LANES],
        size: [0; LANES],
        elongation: [0; LANES],
        orientation: [0; LANES],
        stretch: [0; LANES],
    };
}

/// Areas in blocks; the last one may have lanes without areas.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Areas {
    pub(super) blocks: Vec<Block>,
    /// Areas, lanes without any not counted among the last block's.
    number: usize,
}

/// One area.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct AreaCode {
    pub(super) class: u16,
    pub(super) bearing: u16,
    pub(super) elevation: u16,
    pub(super) size: u16,
    pub(super) elongation: u16,
    pub(super) orientation: u16,
    pub(super) stretch: u16,
}

impl Areas {
    /// Number of areas and of the lanes between them.
    pub(super) fn len(&self) -> usize {
        self.number
    }

    pub(super) fn push(&mut self, area: AreaCode) {
        let (at, lane) = (self.number / LANES, self.number % LANES);
        if lane == 0 {
            self.blocks.push(Block::EMPTY);
        }
        let block = &mut self.blocks[at];
        block.class[lane] = area.class;
        block.bearing[lane] = area.bearing;
        block.elevation[lane] = area.elevation;
        block.size[lane] = area.size;
        block.elongation[lane] = area.elongation;
        block.orientation[lane] = area.orientation;
        block.stretch[lane] = area.stretch;
        self.number += 1;
    }

    /// Adds other areas, from a new block on.
    pub(super) fn append(&mut self, mut other: Self) {
        self.blocks.append(&mut other.blocks);
        self.number = self.blocks.len() * LANES;
    }

    #[inline(always)]
    pub(super) fn at(&self, area: usize) -> AreaCode {
        let (block, lane) = (&self.blocks[area / LANES], area % LANES);
        AreaCode {
            class: block.class[lane],
            bearing: block.bearing[lane],
            elevation: block.elevation[lane],
            size: block.size[lane],
            elongation: block.elongation[lane],
            orientation: block.orientation[lane],
            stretch: block.stretch[lane],
        }
    }
}

/// A value in units of a scale.
fn in_units(value: f32, scale: f64) -> f32 {
    (f64::from(value) / divisor(scale).max(1e-6) * f64::from(UNIT)) as f32
}

/// Options as integers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Measure {
    /// Difference of bearing in units: this many for a full turn.
    pub(super) bearing: u16,
    /// Difference of orientation in units: this many for half a turn.
    pub(super) orientation: u16,
    /// Evidence of two areas without any difference.
    pub(super) limit: u16,
    /// Largest difference of bearing, of `2^16` a turn.
    pub(super) max_bearing: u16,
}

impl Measure {
    pub(super) fn new(options: &Options) -> Self {
        let units = |range: f32, scale: f64| in_units(range, scale).min(FAR) as u16;
        let max_bearing = options.max_bearing_rad / f64::from(TAU) * 65536.0;
        Self {
            bearing: units(TAU, options.scales.bearing_rad),
            orientation: units(PI, options.scales.orientation_rad),
            limit: units(options.limit.max(0.0) as f32, 1.0),
            max_bearing: max_bearing.clamp(0.0, 32768.0) as u16,
        }
    }

    /// The same, but only evidence above `floor` counts, and counts as much less.
    pub(super) fn above(mut self, floor: u16) -> Self {
        self.limit = self.limit.saturating_sub(floor);
        self
    }

    /// How much an area and each of a block's speak for being the same thing: `limit` less their differences, at least 0;
    /// 0 for areas of other classes.
    #[inline(always)]
    pub(super) fn evidence(&self, a: &AreaCode, block: &Block) -> [u16; LANES] {
        let mut evidence = self.likeness(a, block);
        for (evidence, bearing) in evidence.iter_mut().zip(&block.bearing) {
            *evidence = self.at_bearing(*evidence, a.bearing.wrapping_sub(*bearing));
        }
        evidence
    }

    /// The same whichever way one looks: `limit` less the differences of all but the bearing.
    #[inline(always)]
    pub(super) fn likeness(&self, a: &AreaCode, block: &Block) -> [u16; LANES] {
        let mut likeness = [0; LANES];
        for (lane, likeness) in likeness.iter_mut().enumerate() {
            let tilt = a.orientation.wrapping_sub(block.orientation[lane]);
            let tilt = share(tilt.min(tilt.wrapping_neg()), self.orientation);
            let difference = a
                .elevation
                .abs_diff(block.elevation[lane])
                .saturating_add(a.size.abs_diff(block.size[lane]))
                .saturating_add(a.elongation.abs_diff(block.elongation[lane]))
                .saturating_add(share(tilt, a.stretch.min(block.stretch[lane])));
            // Without a branch, so that all lanes are one instruction.
            let same = u16::from(a.class == block.class[lane]).wrapping_neg();
            *likeness = self.limit.saturating_sub(difference) & same;
        }
        likeness
    }

    /// What is left of a likeness where bearings are `apart` (`2^16` is a full turn, either way round).
    #[inline(always)]
    pub(super) fn at_bearing(&self, likeness: u16, apart: u16) -> u16 {
        let turn = apart.min(apart.wrapping_neg());
        let near = u16::from(turn <= self.max_bearing).wrapping_neg();
        likeness.saturating_sub(share(turn, self.bearing)) & near
    }

    /// The difference of bearings that are `apart`, in units.
    #[inline(always)]
    pub(super) fn bearings(&self, apart: u16) -> u16 {
        share(apart.min(apart.wrapping_neg()), self.bearing)
    }
}

/// A share of `2^16`.
#[inline(always)]
pub(super) fn share(value: u16, of: u16) -> u16 {
    ((u32::from(value) * u32::from(of)) >> 16) as u16
}

/// The angle between neighbouring columns (rad).
pub(super) fn rad_per_px(graph: &Graph, options: &Options) -> f32 {
    graph.rad_per_px(options.field_of_view_rad as f32)
}

/// The areas that take part, the largest first: not small ones, nor those of ignored classes, nor those whose numbers are
/// not finite.
pub(super) fn order(graph: &Graph, options: &Options) -> Vec<usize> {
    let around = f64::from(TAU) / f64::from(rad_per_px(graph, options));
    let least = (options.min_area_share * around * f64::from(graph.height)).ceil();
    let takes_part = |area: &Area| {
        let numbers = [
            area.u,
            area.v,
            area.major_px,
            area.minor_px,
            area.eccentricity,
            area.orientation_rad,
        ];
        numbers.iter().all(|number| number.is_finite())
            && f64::from(area.pixels) >= least
            && !options.ignored.contains(&area.class)
    };
    let mut order: Vec<usize> = (0..graph.areas.len())
        .filter(|area| takes_part(&graph.areas[*area]))
        .collect();
    order.sort_by_key(|area| (Reverse(graph.areas[*area].pixels), *area));
    order
}

/// A map's areas that take part: class by class, the largest of each first.
pub(super) fn order_in_map(graph: &Graph, options: &Options) -> Vec<usize> {
    let mut order = order(graph, &options.of_map());
    order.sort_by_key(|area| graph.areas[*area].class);
    order
}

/// The image that areas are of.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Image {
    /// Its middle (px).
    middle: [f32; 2],
    /// The angle between neighbouring columns (rad).
    pub(super) rad_per_px: f32,
    /// Columns of a full turn, where the image wraps (px).
    pub(super) circle_px: Option<f32>,
}

impl Image {
    pub(super) fn new(graph: &Graph, options: &Options) -> Self {
        Self {
            middle: [
                (graph.width as f32 - 1.0) / 2.0,
                (graph.height as f32 - 1.0) / 2.0,
            ],
            rad_per_px: rad_per_px(graph, options),
            circle_px: graph.wraps.then_some(graph.width as f32),
        }
    }

    /// An area as small integers.
    pub(super) fn code(&self, area: &Area, scales: &Scales) -> AreaCode {
        let (rad_per_px, pixels) = (self.rad_per_px, area.pixels.max(1) as f32);
        let units = |value: f32, scale: f64| in_units(value, scale).clamp(-FAR, FAR).round() as i32;
        let modular = |angle: f32, whole: f32| {
            ((angle / whole * 65536.0).round() as i64).rem_euclid(65536) as u16
        };
        let signed = |units: i32| (units + 32768) as u16;
        AreaCode {
            class: u16::from(area.class),
            bearing: modular((area.u - self.middle[0]) * rad_per_px, TAU),
            elevation: signed(units(
                (area.v - self.middle[1]) * rad_per_px,
                scales.elevation_rad,
            )),
            size: signed(units(
                (pixels * rad_per_px * rad_per_px).ln(),
                scales.log_size,
            )),
            elongation: signed(units(area.log_elongation(), scales.log_elongation)),
            orientation: modular(area.orientation_rad, PI),
            stretch: (area.eccentricity.clamp(0.0, 1.0).powi(2) * 65535.0) as u16,
        }
    }
}

/// A view's areas with what touches what: a query's the most important first, a map's class by class.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Description {
    pub(super) areas: Areas,
    /// How much each area counts: at least 1, and together about `2^16`, so that sums of evidence fit 32 bits.
    pub(super) weights: Vec<u32>,
    /// Where each area's neighbours begin, and their number.
    pub(super) starts: Vec<u32>,
    /// Neighbours: area, and the logarithm of the boundary's length.
    pub(super) neighbours: Vec<(u16, f32)>,
}

impl Description {
    /// A graph's areas in some order.
    pub(super) fn new(graph: &Graph, order: &[usize], options: &Options) -> Self {
        let image = Image::new(graph, options);
        let mut described = Self::default();
        let mut weights = Vec::with_capacity(order.len());
        for area in order {
            let area = &graph.areas[*area];
            let pixels = area.pixels.max(1) as f32;
            weights.push(pixels.powf(options.size_power as f32));
            described.areas.push(image.code(area, &options.scales));
        }
        let all: f32 = weights.iter().sum();
        let relative = |weight: &f32| ((weight / all * 65536.0) as u32).max(1);
        described.weights = weights.iter().map(relative).collect();
        described.connect(graph, order, image.rad_per_px);
        described
    }

    fn connect(&mut self, graph: &Graph, order: &[usize], rad_per_px: f32) {
        let mut place = vec![None; graph.areas.len()];
        for (area, at) in order.iter().zip(0_u16..) {
            place[*area] = Some(at);
        }
        let mut lists = vec![Vec::new(); order.len()];
        for edge in &graph.edges {
            let of = |area: u16| place.get(usize::from(area)).copied().flatten();
            if let (Some(a), Some(b)) = (of(edge.a), of(edge.b)) {
                let length = (edge.boundary_px.max(1) as f32 * rad_per_px).ln();
                lists[usize::from(a)].push((b, length));
                lists[usize::from(b)].push((a, length));
            }
        }
        self.starts.push(0);
        for mut list in lists {
            list.sort_by_key(|(other, _)| *other);
            self.neighbours.append(&mut list);
            self.starts.push(self.neighbours.len() as u32);
        }
    }

    /// The areas that an area touches.
    pub(super) fn neighbours(&self, area: usize) -> &[(u16, f32)] {
        let [start, end] = [self.starts[area], self.starts[area + 1]].map(|at| at as usize);
        &self.neighbours[start..end]
    }

    /// What all areas weigh together.
    pub(super) fn weight(&self) -> u32 {
        self.weights.iter().sum()
    }
}

impl Description {
    /// Adds another view's areas after these, from a new block on; neighbours keep their numbers within their view. Weights
    /// are a query's only and stay behind.
    pub(super) fn append(&mut self, mut other: Self) {
        let before = self.neighbours.len() as u32;
        if self.starts.is_empty() {
            self.starts.push(0);
        }
        self.starts
            .extend(other.starts.iter().skip(1).map(|start| start + before));
        self.neighbours.append(&mut other.neighbours);
        self.areas.append(other.areas);
        // Lanes without areas have no neighbours.
        let end = self.neighbours.len() as u32;
        self.starts.resize(self.areas.len() + 1, end);
    }
}
