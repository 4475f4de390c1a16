//! Which boxes are near one.

use std::collections::BTreeMap;

use super::GroundBox;

/// Boxes by squares of the ground.
#[derive(Debug, Clone)]
pub struct BoxIndex {
    /// Side of a square: no box reaches farther from its middle than half of it.
    side_m: f64,
    squares: BTreeMap<[i64; 2], Vec<(usize, GroundBox)>>,
    count: usize,
}

impl BoxIndex {
    /// Without boxes, for boxes no larger than these.
    pub fn new(sizes: impl Iterator<Item = GroundBox>) -> Self {
        let reach = sizes.map(|one| one.length_m.hypot(one.width_m));
        Self {
            side_m: reach.fold(f64::MIN_POSITIVE, f64::max),
            squares: BTreeMap::new(),
            count: 0,
        }
    }

    /// Of boxes.
    pub fn of(boxes: &[GroundBox]) -> Self {
        let mut index = Self::new(boxes.iter().copied());
        boxes.iter().for_each(|one| index.add(*one));
        index
    }

    fn square(&self, place: &GroundBox) -> [i64; 2] {
        place.centre.map(|at| (at / self.side_m).floor() as i64)
    }

    /// One more.
    pub fn add(&mut self, place: GroundBox) {
        let square = self.square(&place);
        let boxes = self.squares.entry(square).or_default();
        boxes.push((self.count, place));
        self.count += 1;
    }

    /// All boxes that may overlap this one or touch it, and some others: which one it was that was added, and the box.
    pub(super) fn numbered_near(
        &self,
        place: &GroundBox,
    ) -> impl Iterator<Item = &(usize, GroundBox)> {
        let [x, y] = self.square(place);
        let reach_m = 0.5 * (self.side_m + place.length_m.hypot(place.width_m));
        let reach = (reach_m / self.side_m).ceil() as i64;
        let [first, last] = [-1, 1].map(|sign| x.saturating_add(sign * reach));
        let columns = self.squares.range([first, i64::MIN]..=[last, i64::MAX]);
        columns
            .filter(move |([_, row], _)| row.abs_diff(y) <= reach.unsigned_abs())
            .flat_map(|(_, boxes)| boxes)
    }

    /// All boxes that may overlap this one, and some others.
    pub fn near(&self, place: &GroundBox) -> impl Iterator<Item = &GroundBox> {
        self.numbered_near(place).map(|(_, other)| other)
    }

    /// Of all boxes that touch this one, and some others, which they were of those that were added.
    pub fn indices_near(&self, place: &GroundBox) -> impl Iterator<Item = usize> {
        self.numbered_near(place).map(|(number, _)| *number)
    }

    /// The most that any of them overlaps this one.
    pub fn overlap(&self, place: &GroundBox) -> f64 {
        let overlaps = self.near(place).map(|other| other.overlap(place));
        overlaps.fold(0.0, f64::max)
    }
}
