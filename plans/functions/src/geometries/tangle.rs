//! Geometries that are near themselves, or each other, too often: what is made of them has a corner wherever edges cross,
//! and of two combs of ten thousand teeth that is a hundred million times.

use datafusion::common::{DataFusionError, Result};
use geo::Line;

use crate::geometries::shapes::{Shape, edges};

/// Pairs of edges that may cross at most.
const MOST_PAIRS: usize = 4_000_000;

/// Pairs of edges at most that are compared to count those, along one axis.
const MOST_LOOKS: usize = 40_000_000;

/// The rectangle along the axes that an edge fills: from where to where along x and y.
type Reach = [[f64; 2]; 2];

/// Refuses geometries of which nothing is computed before the memory, or the patience, has an end. Edges count that come as
/// near as twice a distance.
///
/// # Errors
/// With the numbers.
pub(super) fn check_tangle(shapes: &[&Shape], distance: f64) -> Result<()> {
    let edges = shapes.iter().flat_map(|shape| edges(shape));
    let mut reaches: Vec<Reach> = edges.map(|edge| reach(edge, distance.abs())).collect();
    // Edges side by side along one axis lie one behind the other along the other.
    let is_fine = [0, 1]
        .into_iter()
        .any(|axis| are_few(&mut reaches, axis) == Some(true));
    match is_fine {
        true => Ok(()),
        false => Err(DataFusionError::Execution(format!(
            "expected geometries whose edges come near each other at most {MOST_PAIRS} times, found more with {} edges; simplify them, or take them apart",
            reaches.len()
        ))),
    }
}

fn reach(edge: Line, distance: f64) -> Reach {
    let along = |a: f64, b: f64| [a.min(b) - distance, a.max(b) + distance];
    let Line { start, end } = edge;
    [along(start.x, end.x), along(start.y, end.y)]
}

/// Whether few enough edges come near each other, looking along an axis; `None` where that takes too many looks.
fn are_few(reaches: &mut [Reach], axis: usize) -> Option<bool> {
    reaches.sort_by(|a, b| a[axis][0].total_cmp(&b[axis][0]));
    let across = 1 - axis;
    let (mut pairs, mut looks) = (0, 0);
    // Those that are not behind the one that is looked at.
    let mut open: Vec<&Reach> = Vec::new();
    for next in reaches.iter() {
        open.retain(|before| before[axis][1] >= next[axis][0]);
        let meet = |before: &&&Reach| {
            before[across][0] <= next[across][1] && next[across][0] <= before[across][1]
        };
        pairs += open.iter().filter(meet).count();
        looks += open.len();
        if pairs > MOST_PAIRS {
            return Some(false);
        }
        if looks > MOST_LOOKS {
            return None;
        }
        open.push(next);
    }
    Some(true)
}

#[cfg(test)]
mod tests {
    use std::time::{Duration, Instant};

    use geo::{Coord, Polygon};

    use super::*;

    /// A comb of so many teeth, 1 m apart and as long as it is wide, that stand along y, or along x.
    fn comb(teeth: usize, stands: bool) -> Shape {
        let width = teeth as f64;
        let tooth = (0..teeth).flat_map(|tooth| {
            let at = tooth as f64;
            [(at, 0.0), (at + 0.2, width), (at + 0.4, 0.0)]
        });
        let corners = tooth.chain([(width, -1.0), (0.0, -1.0)]);
        let turned = corners.map(|(x, y)| match stands {
            true => Coord { x, y },
            false => Coord { x: y, y: x },
        });
        Shape::Polygon(Polygon::new(turned.collect(), Vec::new()))
    }

    #[test]
    fn combs_across_each_other_are_refused_and_side_by_side_they_are_not() {
        let begun = Instant::now();
        let (up, along) = (comb(3_000, true), comb(3_000, false));
        let error = check_tangle(&[&up, &along], 0.0).err();
        let said = error.map(|error| error.to_string()).unwrap_or_default();
        assert!(
            said.contains("at most 4000000 times") && said.contains("18004 edges"),
            "{said}"
        );
        assert!(check_tangle(&[&up], 0.0).is_ok());
        assert!(check_tangle(&[&along], 0.0).is_ok());
        // As wide as a thousand teeth.
        assert!(check_tangle(&[&up], 0.1).is_ok());
        assert!(check_tangle(&[&along], -500.0).is_err());
        let small = [comb(300, true), comb(300, false)];
        assert!(check_tangle(&[&small[0], &small[1]], 0.0).is_ok());
        let long = (0..200_000).map(|at| (f64::from(at), 0.0));
        let long = Shape::LineString(long.collect());
        assert!(check_tangle(&[&long], 3.0).is_ok());
        assert!(begun.elapsed() < Duration::from_secs(30));
    }
}
