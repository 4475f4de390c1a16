//! What each view could at best be worth, from all views' areas sorted by class and bearing.

use super::description::{AreaCode, Areas, Description, LANES, Measure, NO_CLASS};
use super::tree::Pair;
use crate::processor::vectorised;

/// Bearings are sorted into as many bins.
const BINS: usize = 256;

/// All areas of all views, by class, then by bin of their bearing, then by view.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Bounds {
    areas: Areas,
    /// The view of each area.
    views: Vec<u32>,
    /// Where each class's bins begin, and the number of areas.
    starts: Vec<u32>,
    /// Number of views.
    number: usize,
}

impl Bounds {
    /// From the areas of all views and where each view's blocks begin.
    pub(super) fn new(described: &Description, offsets: &[u32]) -> Self {
        let areas = &described.areas;
        let mut view_of = Vec::with_capacity(areas.blocks.len());
        for (pair, view) in offsets.windows(2).zip(0_u32..) {
            view_of.extend((pair[0]..pair[1]).map(|_| view));
        }
        let mut order: Vec<(usize, u32)> = (0..areas.len() as u32)
            .map(|area| (bin(&areas.at(area as usize)), area))
            .filter(|(bin, _)| *bin < usize::from(NO_CLASS) * BINS)
            .collect();
        order.sort_unstable();
        let mut sorted = Self {
            number: offsets.len().saturating_sub(1),
            ..Self::default()
        };
        for (_, area) in &order {
            sorted.areas.push(areas.at(*area as usize));
            sorted.views.push(view_of[*area as usize / LANES]);
        }
        let lanes = sorted.areas.blocks.len() * LANES;
        sorted.views.resize(lanes, 0);
        let bins = order.last().map_or(0, |(last, _)| (last / BINS + 1) * BINS);
        let before = |bin: usize| order.partition_point(|(of, _)| *of < bin) as u32;
        sorted.starts = (0..=bins).map(before).collect();
        sorted
    }

    /// For each view the evidence of a match that breaks no rule because it knows none: each area of the query matched with
    /// what speaks most for it, or with a quarter of all that could speak for it where there is less: to tell little from
    /// nothing takes most of the time and rules hardly a view out. No interpretation is worth more.
    #[inline(always)]
    pub(super) fn of(&self, query: &Description, turn: u16, measure: &Measure) -> Vec<u32> {
        let (floor, measure) = above_floor(measure);
        let mut bounds = vec![query.weight() * floor; self.number];
        let mut best = vec![0; self.number];
        for (area, weight) in query.weights.iter().enumerate() {
            let mut code = query.areas.at(area);
            code.bearing = code.bearing.wrapping_add(turn);
            best.fill(0);
            for range in self.ranges(&code, &measure) {
                self.raise(range, &code, &measure, &mut best);
            }
            for (bound, best) in bounds.iter_mut().zip(&best) {
                *bound += u32::from(*best) * weight;
            }
        }
        bounds
    }

    /// Where areas of a class lie whose bearings may be near enough.
    fn ranges(&self, code: &AreaCode, measure: &Measure) -> [std::ops::Range<usize>; 2] {
        let first = usize::from(code.class) * BINS;
        if first + BINS >= self.starts.len() {
            return [0..0, 0..0];
        }
        let range = |from: usize, to: usize| {
            self.starts[first + from] as usize..self.starts[first + to] as usize
        };
        let (bearing, most) = (i32::from(code.bearing), i32::from(measure.max_bearing));
        if most >= 32768 {
            return [range(0, BINS), 0..0];
        }
        let (low, high) = ((bearing - most) >> 8, ((bearing + most) >> 8) + 1);
        if high - low >= BINS as i32 {
            return [range(0, BINS), 0..0];
        }
        let (from, to) = (low.rem_euclid(256) as usize, high.rem_euclid(256) as usize);
        if from < to {
            [range(from, to), 0..0]
        } else {
            [range(from, BINS), range(0, to)]
        }
    }

    /// Raises the best of views to what speaks for their areas in a range, or in the same blocks.
    #[inline(always)]
    fn raise(
        &self,
        range: std::ops::Range<usize>,
        code: &AreaCode,
        measure: &Measure,
        best: &mut [u16],
    ) {
        if range.is_empty() {
            return;
        }
        let blocks = range.start / LANES..range.end.div_ceil(LANES);
        let views = self.views[blocks.start * LANES..].as_chunks::<LANES>().0;
        for (block, views) in self.areas.blocks[blocks].iter().zip(views) {
            let evidence = measure.evidence(code, block);
            if evidence != [0; LANES] {
                for (evidence, view) in evidence.iter().zip(views) {
                    let best = &mut best[*view as usize];
                    *best = (*best).max(*evidence);
                }
            }
        }
    }
}

/// The same for one view.
pub(super) fn of_pair(pair: &Pair<'_>, measure: &Measure) -> u32 {
    let (floor, measure) = above_floor(measure);
    let blocks = &pair.map.areas.blocks[pair.blocks.clone()];
    let mut bound = pair.query.weight() * floor;
    vectorised(
        #[inline(always)]
        || {
            for (area, weight) in pair.query.weights.iter().enumerate() {
                let mut code = pair.query.areas.at(area);
                code.bearing = code.bearing.wrapping_add(pair.turn);
                let mut best = [0; LANES];
                for block in blocks {
                    let evidence = measure.evidence(&code, block);
                    for (best, evidence) in best.iter_mut().zip(evidence) {
                        *best = (*best).max(evidence);
                    }
                }
                bound += u32::from(best.into_iter().fold(0, u16::max)) * weight;
            }
        },
    );
    bound
}

/// What is taken for granted of each area, and the measure of what is above it.
fn above_floor(measure: &Measure) -> (u32, Measure) {
    let floor = measure.limit / 4;
    (u32::from(floor), measure.above(floor))
}

/// Class and bearing.
fn bin(area: &AreaCode) -> usize {
    usize::from(area.class) * BINS + usize::from(area.bearing >> 8)
}
