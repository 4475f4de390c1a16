//! Units that are fetched together, as each request costs its own time: with one where they lie near each other, else side
//! by side.

use std::collections::VecDeque;
use std::ops::Range;

use bytes::Bytes;

use crate::log::index::Unit;
use crate::log::window::{SIDE_BY_SIDE, near};
use crate::scan::plan::PlannedUnit;
use crate::scan::worker::Units;

/// Units in the order of the file; at least one.
#[derive(Debug, Default)]
pub(super) struct Stretch {
    pub units: VecDeque<PlannedUnit>,
    /// Where their bytes lie, and what is between near ones.
    ranges: Vec<Range<u64>>,
}

impl FromIterator<PlannedUnit> for Stretch {
    fn from_iter<I: IntoIterator<Item = PlannedUnit>>(units: I) -> Self {
        let mut stretch = Self::default();
        units.into_iter().for_each(|planned| stretch.push(planned));
        stretch
    }
}

impl Stretch {
    /// What is fetched: one request each.
    pub fn ranges(&self) -> Vec<Range<u64>> {
        self.ranges.clone()
    }

    /// Bytes that are fetched.
    pub fn length(&self) -> u64 {
        let lengths = self.ranges.iter().map(|range| range.end - range.start);
        lengths.fold(0, u64::saturating_add)
    }

    /// Bytes of the largest unit, once it is opened, as the index says.
    pub fn opened(&self) -> u64 {
        let sizes = self.units.iter().map(|planned| planned.unit.size);
        sizes.max().unwrap_or(0)
    }

    /// Whether the next unit of the file can be fetched with these: all are so many bytes at most, in few requests.
    pub fn takes(&self, next: &Unit, most: u64) -> bool {
        let next = range(next);
        let (more, few) = match self.ranges.last() {
            Some(last) if near(last, &next) => (next.end - last.end, true),
            _ => (next.end - next.start, self.ranges.len() < SIDE_BY_SIDE),
        };
        few && self.length().saturating_add(more) <= most
    }

    /// Adds the next unit of the file.
    pub fn push(&mut self, planned: PlannedUnit) {
        let next = range(&planned.unit);
        match self.ranges.last_mut() {
            Some(last) if near(last, &next) => last.end = next.end,
            _ => self.ranges.push(next),
        }
        self.units.push_back(planned);
    }

    /// Each unit with its bytes, of those of the ranges.
    pub fn cut(self, fetched: &[Bytes]) -> Units {
        let Self { units, ranges } = self;
        let own = |unit: &Unit| {
            let at = ranges.partition_point(|range| range.end <= unit.offset);
            let (range, bytes) = (ranges.get(at)?, fetched.get(at)?);
            let within = |offset: u64| {
                let from = offset.saturating_sub(range.start);
                usize::try_from(from).map_or(bytes.len(), |from| from.min(bytes.len()))
            };
            Some(bytes.slice(within(unit.offset)..within(unit.end())))
        };
        let each = units.into_iter().map(|planned| {
            let bytes = own(&planned.unit).unwrap_or_default();
            (planned, bytes)
        });
        each.collect()
    }
}

fn range(unit: &Unit) -> Range<u64> {
    unit.offset..unit.end()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::log::index::UnitKind;

    fn unit(offset: u64, length: u64) -> PlannedUnit {
        PlannedUnit {
            unit: Unit::of_record(UnitKind::Attachment, offset, length, 0),
            channels: None,
        }
    }

    /// The stretch of the first of these units that are together so many bytes at most.
    fn stretch(units: &[(u64, u64)], most: u64) -> Stretch {
        let mut units = units.iter().map(|(offset, length)| unit(*offset, *length));
        let mut stretch: Stretch = units.next().into_iter().collect();
        for next in units {
            if !stretch.takes(&next.unit, most) {
                break;
            }
            stretch.push(next);
        }
        stretch
    }

    fn places(stretch: &Stretch) -> Vec<(u64, u64)> {
        let ranges = stretch.ranges.iter();
        ranges.map(|range| (range.start, range.end)).collect()
    }

    #[test]
    fn near_units_are_one_request_and_others_a_few() {
        let far = 1 << 20;
        let units = [(10, 5), (20, 5), (far, 5), (far + 5, 5), (2 * far, 5)];
        let all = stretch(&units, 1000);
        let expected = [(10, 25), (far, far + 10), (2 * far, 2 * far + 5)];
        assert_eq!((places(&all), all.length()), (expected.to_vec(), 30));
        // What lies between near ones counts.
        assert_eq!(places(&stretch(&units, 14)), [(10, 15)]);
        assert_eq!(places(&stretch(&units, 15)), [(10, 25)]);
        assert_eq!(places(&stretch(&units, 25)), expected[..2]);
        // The first comes however large it is, and never more than some requests.
        assert_eq!(places(&stretch(&[(10, 5)], 0)), [(10, 15)]);
        let sparse: Vec<(u64, u64)> = (0..100).map(|at| (at * far, 5)).collect();
        assert_eq!(places(&stretch(&sparse, u64::MAX)).len(), SIDE_BY_SIDE);
    }

    #[test]
    fn each_unit_has_its_own_bytes() {
        let far = 1 << 20;
        let units = [(10, 2), (14, 3), (far, 1), (far + 1, 2)];
        let fetched = [Bytes::from("ab--cde"), Bytes::from("fgh")];
        let cut = stretch(&units, 100).cut(&fetched);
        let bytes: Vec<Bytes> = cut.into_iter().map(|(_, bytes)| bytes).collect();
        assert_eq!(bytes, ["ab", "cde", "f", "gh"]);
        // A store that gives less takes nothing else with it.
        let cut = stretch(&units, 100).cut(&fetched[..1]);
        let lengths: Vec<usize> = cut.iter().map(|(_, bytes)| bytes.len()).collect();
        assert_eq!(lengths, [2, 3, 0, 0]);
    }
}
