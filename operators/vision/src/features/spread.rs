//! A subset of key points that covers the image evenly and prefers strong ones.
//!
//! Oleksandr Bailo et al.: *Efficient adaptive non-maximal suppression algorithms for homogeneous spatial keypoint
//! distribution*, 2018: suppression via square covering. The strongest point claims a square around itself, then the
//! strongest that is left, and so on; the side of the squares is searched for so that as many remain as are wanted.

/// A point to choose from.
#[derive(Debug, Clone, Copy)]
pub(super) struct Candidate {
    pub(super) at: [f32; 2],
    pub(super) response: f32,
}

/// The squares' side is right when at most this share of the wanted points is missing.
const TOLERANCE: f64 = 0.03;

/// Indices of `wanted` candidates, or of all where there are fewer. Candidates lie within `size`, from 0.
pub(super) fn spread(candidates: &[Candidate], size: [f32; 2], wanted: usize) -> Vec<usize> {
    let mut order: Vec<usize> = (0..candidates.len()).collect();
    let key = |index: usize| {
        let Candidate { at, response } = candidates[index];
        (response, at)
    };
    order.sort_by(|a, b| {
        let ((x, [xu, xv]), (y, [yu, yv])) = (key(*a), key(*b));
        y.total_cmp(&x)
            .then(xv.total_cmp(&yv))
            .then(xu.total_cmp(&yu))
            .then(a.cmp(b))
    });
    if order.len() <= wanted {
        return order;
    }
    let enough = (wanted as f64 * (1.0 - TOLERANCE)).ceil() as usize;
    // A radius of 0 keeps everything; one of the image's size, a single point.
    let (mut low, mut high) = (0.0_f32, size[0].max(size[1]));
    let (mut best, mut surplus) = (Vec::new(), order.clone());
    for _ in 0..16 {
        let radius = 0.5 * (low + high);
        let kept = covered(&order, candidates, size, radius);
        if kept.len() > wanted {
            (low, surplus) = (radius, kept);
            continue;
        }
        high = radius;
        if kept.len() > best.len() {
            best = kept;
        }
        if best.len() >= enough {
            break;
        }
    }
    // No radius gives just as many where points lie in a pattern.
    let mut free = vec![true; candidates.len()];
    best.iter().for_each(|index: &usize| free[*index] = false);
    let missing = surplus.into_iter().filter(|index| free[*index]);
    let missing: Vec<usize> = missing.take(wanted - best.len()).collect();
    best.extend(missing);
    best
}

/// Those that no stronger one covers: in cells of half the radius, a point covers two cells to every side.
fn covered(order: &[usize], candidates: &[Candidate], size: [f32; 2], radius: f32) -> Vec<usize> {
    let cell = (0.5 * radius).max(0.25);
    let cells = size.map(|side| (side / cell) as usize + 1);
    let mut taken = vec![false; cells[0] * cells[1]];
    let mut kept = Vec::new();
    for index in order {
        let at = candidates[*index].at;
        let [column, row] = [0, 1].map(|axis| ((at[axis] / cell) as usize).min(cells[axis] - 1));
        if taken[row * cells[0] + column] {
            continue;
        }
        kept.push(*index);
        let columns = column.saturating_sub(2)..(column + 3).min(cells[0]);
        for row in row.saturating_sub(2)..(row + 3).min(cells[1]) {
            taken[row * cells[0]..][columns.clone()].fill(true);
        }
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn candidates() -> impl Strategy<Value = Vec<Candidate>> {
        let one = (0.0..400.0_f32, 0.0..300.0_f32, 1.0..255.0_f32);
        let one = one.prop_map(|(u, v, response)| Candidate {
            at: [u, v],
            response,
        });
        prop::collection::vec(one, 0..800)
    }

    proptest! {
        #[test]
        fn as_many_as_wanted_each_once(
            all in candidates(), wanted in 0_usize..400
        ) {
            let kept = spread(&all, [400.0, 300.0], wanted);
            prop_assert!(kept.len() <= wanted);
            if all.len() <= wanted {
                prop_assert_eq!(kept.len(), all.len());
            } else {
                prop_assert_eq!(kept.len(), wanted);
            }
            let mut unique = kept.clone();
            unique.sort_unstable();
            unique.dedup();
            prop_assert_eq!(unique.len(), kept.len());
        }
    }

    #[test]
    fn a_weak_corner_far_from_strong_ones_stays() {
        let strong = (0_u16..1000).map(|i| Candidate {
            at: [f32::from(i % 32), f32::from(i / 32)],
            response: 100.0,
        });
        let weak = Candidate {
            at: [390.0, 290.0],
            response: 6.0,
        };
        let all: Vec<_> = strong.chain([weak]).collect();
        assert!(spread(&all, [400.0, 300.0], 50).contains(&1000));
    }
}
