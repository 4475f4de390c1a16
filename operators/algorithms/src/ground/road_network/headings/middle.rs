//! The middle of the passes of a lane, and how far they scatter around it.

/// One pass in so many may have gone around something and does not widen the lane.
const STRAY: usize = 8;

/// The middle of the window of this width that holds most offsets, among equals the one nearest to their median: as few
/// passes as can be are farther away than half of the width. Where all fit it is half-way between the outermost; one who
/// swerves moves it by half of the width at most.
///
/// Sorts the offsets; there is at least one.
pub(super) fn middle(offsets: &mut [f64], width_m: f64) -> f64 {
    offsets.sort_unstable_by(f64::total_cmp);
    let median = 0.5 * (offsets[(offsets.len() - 1) / 2] + offsets[offsets.len() / 2]);
    let mut end = 0;
    let windows = (0..offsets.len()).map(|start| {
        while end < offsets.len() && offsets[end] - offsets[start] <= width_m {
            end += 1;
        }
        (end - start, 0.5 * (offsets[start] + offsets[end - 1]))
    });
    let better = |a: (usize, f64), b: (usize, f64)| {
        let nearer = (b.1 - median).abs() < (a.1 - median).abs();
        if b.0 > a.0 || (b.0 == a.0 && nearer) {
            b
        } else {
            a
        }
    };
    windows.reduce(better).map_or(median, |(_, middle)| middle)
}

/// The width around the middle that holds the passes, strays left out.
pub(super) fn scatter(offsets: &[f64], middle: f64) -> f64 {
    let mut aside: Vec<f64> = offsets
        .iter()
        .map(|offset| (offset - middle).abs())
        .collect();
    aside.sort_unstable_by(f64::total_cmp);
    let strays = aside.len() / STRAY;
    2.0 * aside
        .get(aside.len().saturating_sub(1 + strays))
        .copied()
        .unwrap_or_default()
}
