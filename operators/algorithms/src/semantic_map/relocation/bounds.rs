//! What each view could at best be worth at each heading: an interpretation that breaks no rule because it knows none.
//!
//! What speaks for two areas is computed once for all headings, as only their bearings depend on one.

use super::description::{AreaCode, Areas, Block, Description, LANES, Measure, NO_CLASS};
use super::headings::{Headings, RoundedWeight};
use super::tree::Pair;

/// Views whose sums are kept in the processor's cache together.
const TILE: usize = 2048;
/// Elevations and sizes are sorted into as many bins each; the outermost hold all that is beyond.
const BINS: usize = 32;
/// Width of a bin, in powers of two: a scale.
const BIN: u32 = 6;
/// The number of the first bin, from the least code on.
const FIRST_BIN: usize = (1 << 15 >> BIN) - BINS / 2;

/// All areas of all views.
#[derive(Debug, Clone)]
pub(super) struct Bounds {
    /// What is taken for granted of each area.
    floor: u32,
    /// What is above it.
    measure: Measure,
    headings: Headings,
    tiles: Vec<Tile>,
}

/// The areas of some views in sequence, by class, then by bin of elevation, then by bin of size, then by view.
#[derive(Debug, Clone, Default)]
struct Tile {
    areas: Areas,
    /// The view of each area, from the tile's first one on.
    views: Vec<u16>,
    /// Number of views.
    number: usize,
    /// The classes that there are, ascending.
    classes: Vec<u16>,
    /// Where each class's bins begin, and the number of areas.
    starts: Vec<u32>,
}

impl Bounds {
    /// From the areas of all views, where each view's blocks begin, and the turns that are tried.
    pub(super) fn new(
        described: &Description,
        offsets: &[u32],
        turns: &[u16],
        measure: &Measure,
    ) -> Self {
        // To tell little from nothing takes most of the time and rules hardly a view out.
        let floor = measure.limit / 4;
        let measure = measure.above(floor);
        let number = offsets.len().saturating_sub(1);
        let tiles = (0..number).step_by(TILE).map(|first| {
            let last = (first + TILE).min(number);
            Tile::new(&described.areas, &offsets[first..=last])
        });
        Self {
            floor: u32::from(floor),
            headings: Headings::new(turns, measure),
            tiles: tiles.collect(),
            measure,
        }
    }

    /// Tells a bound for each heading of one view after the other. It is no less than [`Bounds::of_pair`], as it counts all
    /// areas that an area of the query is like, not only the one most like it; [`Bounds::most`] says what it is.
    #[inline(always)]
    pub(super) fn of_all(&self, query: &Description, mut tell: impl FnMut(&[u16])) {
        let row = self.headings.row();
        let granted = self.headings.rounded(query.weight() * self.floor);
        let mut sums = Vec::new();
        for tile in &self.tiles {
            sums.clear();
            sums.resize(tile.number * row, granted);
            for (area, weight) in query.weights.iter().enumerate() {
                let (code, weight) = (query.areas.at(area), RoundedWeight::new(*weight));
                for range in tile.ranges(&code, self.measure.limit).into_iter().flatten() {
                    self.add(tile, range, &code, &weight, &mut sums);
                }
            }
            for view in 0..tile.number {
                let row = &mut sums[view * row..][..row];
                tell(self.headings.closed(row, |a, b| joined(a, b, granted)));
            }
        }
    }

    /// What a bound that was told is.
    #[inline(always)]
    pub(super) fn most(&self, told: u16) -> u32 {
        self.headings.most(told)
    }

    /// Adds what speaks for areas in a range to the sums of their views.
    #[inline(always)]
    fn add(
        &self,
        tile: &Tile,
        range: std::ops::Range<usize>,
        code: &AreaCode,
        weight: &RoundedWeight,
        sums: &mut [u16],
    ) {
        let row = self.headings.row();
        let blocks = range.start / LANES..range.end.div_ceil(LANES);
        let views = tile.views[blocks.start * LANES..].as_chunks::<LANES>().0;
        let first = blocks.start * LANES;
        for (at, (block, views)) in tile.areas.blocks[blocks].iter().zip(views).enumerate() {
            let first = first + at * LANES;
            let mut seen = self.seen(code, block);
            seen.keep(range.start.saturating_sub(first), range.end - first);
            while let Some((lane, pair)) = seen.pop() {
                let sums = &mut sums[usize::from(views[lane]) * row..][..row];
                self.headings.add(pair, weight, sums);
            }
        }
    }

    /// An area of the query beside those of a block.
    #[inline(always)]
    fn seen(&self, code: &AreaCode, block: &Block) -> BlockComparison {
        let likeness = self.measure.likeness(code, block);
        let (mut apart, mut bits) = ([0; LANES], [0; LANES]);
        for (lane, (apart, bit)) in apart.iter_mut().zip(&mut bits).enumerate() {
            *apart = block.bearing[lane].wrapping_sub(code.bearing);
            let tells = self.headings.may_tell(likeness[lane], *apart);
            *bit = u16::from(tells).wrapping_neg() & (1 << lane);
        }
        BlockComparison {
            likeness,
            apart,
            lanes: bits.iter().fold(0, |lanes, bit| lanes | bit),
        }
    }

    /// For each heading the evidence of matching each area of the query with what speaks most for it, or with a quarter of
    /// all that could speak for it where there is less. No interpretation is worth more. The pair's turn does not matter.
    #[inline(always)]
    pub(super) fn of_pair(&self, pair: &Pair<'_>) -> Vec<u32> {
        let row = self.headings.row();
        let mut best = vec![0; row];
        let mut sums = vec![pair.query.weight() * self.floor; row];
        for (area, weight) in pair.query.weights.iter().enumerate() {
            let code = pair.query.areas.at(area);
            best.fill(0);
            for block in &pair.map.areas.blocks[pair.like(&code)] {
                let mut seen = self.seen(&code, block);
                while let Some((_, pair)) = seen.pop() {
                    self.headings.join(pair, *weight, &mut best, u32::max);
                }
            }
            let best = self.headings.closed(&mut best, u32::max);
            for (sum, best) in sums.iter_mut().zip(best) {
                *sum += best;
            }
        }
        sums
    }
}

/// The sum of a heading and that of the same one at the row's end, in which all that is granted is once more. The largest
/// number stands for any beyond.
#[inline(always)]
fn joined(sum: u16, again: u16, granted: u16) -> u16 {
    let both = sum.saturating_add(again - granted);
    if again == u16::MAX { again } else { both }
}

/// An area of the query beside those of a block.
struct BlockComparison {
    likeness: [u16; LANES],
    /// How far each lies to the right: `2^16` is a full turn.
    apart: [u16; LANES],
    /// Of which lanes something may speak for their being the same thing: a bit each.
    lanes: u16,
}

impl BlockComparison {
    /// Leaves out the lanes that are not in a range.
    #[inline(always)]
    fn keep(&mut self, first: usize, end: usize) {
        let below = |lane: usize| ((1_u32 << lane.min(LANES)) - 1) as u16;
        self.lanes &= below(end) & !below(first);
    }

    /// Takes the next such lane: its likeness, and how far apart bearings are.
    #[inline(always)]
    fn pop(&mut self) -> Option<(usize, [u16; 2])> {
        if self.lanes == 0 {
            return None;
        }
        let lane = self.lanes.trailing_zeros() as usize % LANES;
        self.lanes &= self.lanes - 1;
        Some((lane, [self.likeness[lane], self.apart[lane]]))
    }
}

impl Tile {
    /// From the areas of all views, and where the blocks of the tile's views begin and end.
    fn new(areas: &Areas, offsets: &[u32]) -> Self {
        let mut order: Vec<(u16, usize, u16, u32)> = Vec::new();
        for (view, blocks) in (0_u16..).zip(offsets.windows(2)) {
            let lanes = blocks[0] as usize * LANES..blocks[1] as usize * LANES;
            let lanes = lanes.filter(|area| *area < areas.len());
            order.extend(lanes.map(|area| {
                let code = areas.at(area);
                (code.class, bin(&code), view, area as u32)
            }));
        }
        order.retain(|(class, ..)| *class != NO_CLASS);
        order.sort_unstable();
        let mut tile = Self {
            number: offsets.len() - 1,
            ..Self::default()
        };
        for (class, bin, view, area) in order {
            if tile.classes.last() != Some(&class) {
                tile.classes.push(class);
            }
            let bins = (tile.classes.len() - 1) * BINS * BINS + bin;
            let before = tile.areas.len() as u32;
            tile.starts.resize(bins + 1, before);
            tile.areas.push(areas.at(area as usize));
            tile.views.push(view);
        }
        let all = tile.areas.len() as u32;
        tile.starts
            .resize(tile.classes.len() * BINS * BINS + 1, all);
        tile.views.resize(tile.areas.blocks.len() * LANES, 0);
        tile
    }

    /// Where areas of a class lie that may be alike, for each bin of elevation.
    fn ranges(
        &self,
        code: &AreaCode,
        limit: u16,
    ) -> Option<impl Iterator<Item = std::ops::Range<usize>>> {
        let class = self.classes.binary_search(&code.class).ok()?;
        let reach = limit.saturating_sub(1);
        let elevations = bins(code.elevation, reach);
        Some(elevations.filter_map(move |elevation| {
            // What the elevation leaves for the size.
            let left = reach.checked_sub(apart(code.elevation, elevation))?;
            let first = (class * BINS + elevation) * BINS;
            let sizes = bins(code.size, left);
            let start = |size: usize| self.starts[first + size] as usize;
            let range = start(*sizes.start())..start(sizes.end() + 1);
            (!range.is_empty()).then_some(range)
        }))
    }
}

/// Elevation and size.
fn bin(area: &AreaCode) -> usize {
    bin_of(area.elevation) * BINS + bin_of(area.size)
}

fn bin_of(code: u16) -> usize {
    usize::from(code >> BIN)
        .saturating_sub(FIRST_BIN)
        .min(BINS - 1)
}

/// The bins of all codes that differ by no more than `reach`.
fn bins(code: u16, reach: u16) -> std::ops::RangeInclusive<usize> {
    bin_of(code.saturating_sub(reach))..=bin_of(code.saturating_add(reach))
}

/// How far a code is from a bin, at least.
fn apart(code: u16, bin: usize) -> u16 {
    let edge = |bin: usize| ((FIRST_BIN + bin) << BIN) as u16;
    let low = if bin == 0 { 0 } else { edge(bin) };
    let high = if bin == BINS - 1 {
        u16::MAX
    } else {
        edge(bin + 1) - 1
    };
    low.saturating_sub(code).max(code.saturating_sub(high))
}
