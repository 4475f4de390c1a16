//! How many correspondences agree with some pose by chance.

/// The least number of inliers among `matches` wrong correspondences that chance would reach in less than
/// `false_alarms` of all searches, when one wrong correspondence agrees with a given pose with probability
/// `agreement` (0 to 1).
///
/// Any three of the matches make up to four poses (the rigs at hand are small beside the distances to the points, so
/// that of the eight solutions four are nearly equal to the others), and the expected number of sets of k matches that
/// agree with the pose of three of them is `4 (n - 3) C(n, k) C(k, 3) p^(k - 3)` (Moisan, Stival: A Probabilistic
/// Criterion to Detect Rigid Point Matches, 2004). Never below 4; `matches + 1` where no number is enough.
pub fn inliers_beyond_chance(matches: usize, agreement: f64, false_alarms: f64) -> usize {
    let p = agreement.clamp(0.0, 1.0).max(f64::MIN_POSITIVE).ln();
    let limit = false_alarms.max(f64::MIN_POSITIVE).ln();
    let sets = (4.0 * (matches as f64 - 3.0).max(1.0)).ln();
    let alarms = |k: usize| sets + ln_choose(matches, k) + ln_choose(k, 3) + (k as f64 - 3.0) * p;
    (4..=matches)
        .rev()
        .take_while(|k| alarms(*k) < limit)
        .last()
        .unwrap_or(matches.max(3) + 1)
}

fn ln_choose(n: usize, k: usize) -> f64 {
    let k = k.min(n - k);
    (0..k).map(|i| ((n - i) as f64 / (k - i) as f64).ln()).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_takes_more_of_more() {
        assert_eq!(inliers_beyond_chance(0, 0.01, 1e-3), 4);
        let few = inliers_beyond_chance(30, 0.01, 1e-3);
        let many = inliers_beyond_chance(300, 0.01, 1e-3);
        assert!((6..=12).contains(&few), "{few}");
        assert!((12..=30).contains(&many), "{many}");
        assert!(inliers_beyond_chance(300, 0.05, 1e-3) > many);
        assert!(inliers_beyond_chance(300, 0.01, 1e-9) > many);
        assert_eq!(inliers_beyond_chance(20, 1.0, 1e-3), 21);
    }
}
