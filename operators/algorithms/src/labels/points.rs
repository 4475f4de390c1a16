//! Points seen from above, found by where they are.

use rstar::primitives::GeomWithData;
use rstar::{AABB, RTree};

/// Points of the map, numbered; their heights say nothing.
#[derive(Debug, Clone, Default)]
pub struct PointIndex(RTree<GeomWithData<[f64; 2], usize>>);

impl PointIndex {
    /// Of places in the map, x and y in m, numbered as they come; those that are not finite are never found.
    pub fn new(points: impl IntoIterator<Item = [f64; 2]>) -> Self {
        let points = points.into_iter().enumerate();
        let points = points.filter(|(_, at)| is_finite(at));
        let points = points.map(|(number, at)| GeomWithData::new(at, number));
        Self(RTree::bulk_load(points.collect()))
    }

    /// Numbers of the points that are no farther from a place than this, m, in any order.
    pub fn within(&self, at: [f64; 2], within_m: f64) -> impl Iterator<Item = usize> {
        self.around(at, within_m).map(|(_, number)| number)
    }

    /// Number of the point nearest to a place, the lowest of equally near ones; `None` without points, or for a place that
    /// is not finite.
    pub fn nearest(&self, at: [f64; 2]) -> Option<usize> {
        if !is_finite(&at) {
            return None;
        }
        let found = self.0.nearest_neighbor(&at)?;
        // It is found by the square of its distance, which is rounded otherwise.
        let near = self.around(at, away_m(at, *found.geom()));
        let nearest = near.min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        nearest.map(|(_, number)| number)
    }

    /// Points within a distance, each with its own.
    fn around(&self, at: [f64; 2], within_m: f64) -> impl Iterator<Item = (f64, usize)> {
        // With room for what rounding takes.
        let corner = |sides: f64| at.map(|value| value + sides * within_m);
        let square = AABB::from_corners(corner(-2.0), corner(2.0));
        let points = self.0.locate_in_envelope(&square);
        let points = points.map(move |point| (away_m(at, *point.geom()), point.data));
        points.filter(move |(away_m, _)| *away_m <= within_m)
    }
}

fn is_finite(at: &[f64; 2]) -> bool {
    at.iter().all(|value| value.is_finite())
}

fn away_m(a: [f64; 2], b: [f64; 2]) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        /// Also where many are equally far away, as on a grid.
        #[test]
        fn points_are_found_as_by_looking_at_each(
            grid in proptest::collection::vec([-4..4_i32, -4..4], 0..60),
            at in [-5..5_i32, -5..5],
            shift in 0.0..1.0_f64,
            within_m in prop::sample::select(vec![0.0, 0.1, 0.3, 1.0, f64::INFINITY]),
        ) {
            // Tenths are rounded.
            let metres = |cell: &[i32; 2]| cell.map(|steps| f64::from(steps) * 0.1 + shift);
            let points: Vec<[f64; 2]> = grid.iter().map(metres).collect();
            let index = PointIndex::new(points.iter().copied());
            let at = metres(&at);
            let away = |number: &usize| away_m(at, points[*number]);
            let mut found: Vec<usize> = index.within(at, within_m).collect();
            found.sort_unstable();
            let all = 0..points.len();
            let near: Vec<usize> = all.clone().filter(|number| away(number) <= within_m).collect();
            prop_assert_eq!(found, near);
            // Of equals the first.
            let nearest = all.min_by(|a, b| away(a).total_cmp(&away(b)));
            prop_assert_eq!(index.nearest(at), nearest);
        }
    }

    #[test]
    fn what_is_nowhere_is_not_found_and_keeps_its_number() {
        let index = PointIndex::new([[f64::NAN, 0.0], [1e8, -1e8], [0.0, f64::INFINITY]]);
        assert_eq!(index.nearest([0.0, 0.0]), Some(1));
        assert_eq!(index.within([0.0, 0.0], f64::INFINITY).count(), 1);
        assert_eq!(index.nearest([f64::NAN, 0.0]), None);
        assert_eq!(index.within([f64::NAN, 0.0], 1.0).count(), 0);
        assert_eq!(PointIndex::default().nearest([0.0, 0.0]), None);
    }
}
