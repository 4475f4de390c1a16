//! Where the driven path reaches the next multiple of the baseline.

use super::KeyframeParams;
use crate::geometry::pose::Pose;

/// Where a keyframe is due.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Due {
    /// When the path length was reached, ns UTC.
    pub stamp: i64,
    /// Pose of the vehicle at that stamp, in the frame of the odometry.
    pub odom_from_vehicle: Pose,
    /// Driven path since the start of the stretch, metres: a multiple of the baseline.
    pub path_m: f64,
    /// 0 for the first stretch; one more behind each break.
    pub stretch: u32,
}

#[derive(Debug, Clone, Copy)]
struct Sample {
    stamp: i64,
    pose: Pose,
    /// Distance from the anchor, metres.
    away_m: f64,
}

/// A sample from which the vehicle never came back closer to the anchor, and the one after it.
#[derive(Debug, Clone, Copy)]
struct Outward {
    from: Sample,
    to: Option<Sample>,
}

/// Turns a stream of odometry into due points. Memory stays small however long the vehicle waits.
#[derive(Debug, Clone)]
pub struct KeyframeSelector {
    params: KeyframeParams,
    /// Path counted up to the anchor, metres.
    path_m: f64,
    /// Number of due points given in this stretch.
    given: u64,
    stretch: u32,
    /// Since the anchor, in order of time and of distance; the first is the anchor, the last is
    /// the latest message. Empty before the first message.
    outward: Vec<Outward>,
}

impl KeyframeSelector {
    /// A selector that has seen nothing yet; its parameters have passed [`KeyframeParams::check`].
    pub fn new(params: KeyframeParams) -> Self {
        Self {
            params,
            path_m: 0.0,
            given: 0,
            stretch: 0,
            outward: Vec::new(),
        }
    }

    /// The next pose begins a stretch: nobody knows how the vehicle came there.
    pub fn break_off(&mut self) {
        self.stretch += u32::from(!self.outward.is_empty());
        self.outward.clear();
    }

    /// Takes the next pose, later than the one before, and gives the due points it reaches, mostly none.
    pub fn push(&mut self, stamp: i64, odom_from_vehicle: &Pose) -> Vec<Due> {
        let Some(anchor) = self.outward.first() else {
            return vec![self.begin(stamp, odom_from_vehicle)];
        };
        let away_m = (odom_from_vehicle.translation - anchor.from.pose.translation).norm();
        self.extend(Sample {
            stamp,
            pose: *odom_from_vehicle,
            away_m,
        });
        if away_m <= self.params.deadband_m {
            return Vec::new();
        }
        self.count_chord(away_m)
    }

    /// Starts a stretch: at its first pose a keyframe is due.
    fn begin(&mut self, stamp: i64, pose: &Pose) -> Due {
        self.path_m = 0.0;
        self.given = 1;
        self.anchor(Sample {
            stamp,
            pose: *pose,
            away_m: 0.0,
        });
        Due {
            stamp,
            odom_from_vehicle: *pose,
            path_m: 0.0,
            stretch: self.stretch,
        }
    }

    fn anchor(&mut self, sample: Sample) {
        self.outward.clear();
        self.outward.push(Outward {
            from: Sample {
                away_m: 0.0,
                ..sample
            },
            to: None,
        });
    }

    /// Appends a message, forgetting those the vehicle has come back behind since.
    fn extend(&mut self, sample: Sample) {
        if let Some(last) = self.outward.last_mut() {
            last.to = Some(sample);
        }
        while self.outward.len() > 1
            && self
                .outward
                .last()
                .is_some_and(|last| last.from.away_m >= sample.away_m)
        {
            self.outward.pop();
        }
        self.outward.push(Outward {
            from: sample,
            to: None,
        });
    }

    /// Adds the chord from the anchor to the latest message and moves the anchor there.
    fn count_chord(&mut self, chord_m: f64) -> Vec<Due> {
        let mut reached = Vec::new();
        let end_m = self.path_m + chord_m;
        loop {
            let due_m = self.given as f64 * self.params.baseline_m;
            if due_m > end_m {
                break;
            }
            let (stamp, odom_from_vehicle) = self.crossing(due_m - self.path_m);
            reached.push(Due {
                stamp,
                odom_from_vehicle,
                path_m: due_m,
                stretch: self.stretch,
            });
            self.given += 1;
        }
        self.path_m = end_m;
        if let Some(last) = self.outward.last() {
            self.anchor(last.from);
        }
        reached
    }

    /// When and where the distance `away_m` from the anchor was passed last on the way out.
    fn crossing(&self, away_m: f64) -> (i64, Pose) {
        let after = self
            .outward
            .partition_point(|step| step.from.away_m < away_m);
        let step = &self.outward[after.saturating_sub(1)];
        let from = &step.from;
        let Some(to) = &step.to else {
            return (from.stamp, from.pose);
        };
        let gained = to.away_m - from.away_m;
        let t = if gained > 0.0 {
            ((away_m - from.away_m) / gained).clamp(0.0, 1.0)
        } else {
            0.0
        };
        let offset = (to.stamp.saturating_sub(from.stamp) as f64 * t).round() as i64;
        (
            from.stamp.saturating_add(offset),
            from.pose.interpolate(&to.pose, t),
        )
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
    use super::*;
    use proptest::prelude::*;

    const HZ50: i64 = 20_000_000;

    fn select(params: KeyframeParams, xs: impl IntoIterator<Item = (f64, f64)>) -> Vec<Due> {
        let mut selector = KeyframeSelector::new(params);
        let mut found = Vec::new();
        for (i, (x, y)) in xs.into_iter().enumerate() {
            found.extend(selector.push(i as i64 * HZ50, &Pose::from_yaw(x, y, 0.0)));
        }
        found
    }

    #[test]
    fn a_straight_drive_gives_exact_crossings() {
        let found = select(
            KeyframeParams::default(),
            (0..1001).map(|i| (f64::from(i) * 0.03, 0.0)),
        );
        assert_eq!(found.len(), 151);
        for (k, due) in found.iter().enumerate() {
            let x = k as f64 * 0.2;
            assert!((due.odom_from_vehicle.translation.x - x).abs() < 1e-9);
            assert!((due.stamp as f64 - x / 0.03 * HZ50 as f64).abs() <= 1.0);
        }
    }

    #[test]
    fn reversing_counts_and_standing_does_not() {
        let tremble = |i: i32| 0.004 * f64::from((i * 7919) % 5 - 2);
        let out = (0..100).map(|i| (f64::from(i) * 0.01, 0.0));
        let wait = (0..50_000).map(|i| (0.99 + tremble(i), tremble(i + 3)));
        let back = (0..100).map(|i| (0.99 - f64::from(i) * 0.01, 0.0));
        let found = select(KeyframeParams::default(), out.chain(wait).chain(back));
        // 1.98 m of path: one at the start and nine more.
        assert_eq!(found.len(), 10);
        let waiting = (105 * HZ50)..(50_095 * HZ50);
        assert!(found.iter().all(|due| !waiting.contains(&due.stamp)));
        assert!(
            (found[6].odom_from_vehicle.translation.x - 0.78).abs() < 0.03,
            "{found:?}"
        );
    }

    #[test]
    fn a_break_starts_a_new_stretch() {
        let mut selector = KeyframeSelector::new(KeyframeParams::default());
        selector.break_off();
        let first = selector.push(0, &Pose::identity());
        selector.push(1, &Pose::from_yaw(0.5, 0.0, 0.0));
        selector.break_off();
        let far = selector.push(2, &Pose::from_yaw(1e12, 0.0, 0.0));
        assert_eq!((first.len(), far.len()), (1, 1));
        assert_eq!((first[0].stretch, far[0].stretch), (0, 1));
        assert_eq!(far[0].path_m, 0.0);
    }

    #[test]
    fn senseless_parameters_are_refused() {
        let refused = |baseline_m, deadband_m| {
            let params = KeyframeParams {
                baseline_m,
                deadband_m,
                ..KeyframeParams::default()
            };
            params.check().is_err()
        };
        assert!(refused(0.2, 0.3) && refused(f64::NAN, 0.0) && !refused(0.2, 0.02));
    }

    proptest! {
        /// Without a dead-band the naive answer is the polyline's arc length.
        #[test]
        fn agrees_with_arc_length(steps in prop::collection::vec((-0.5..0.5f64, -0.5..0.5f64), 1..60)) {
            let mut points = vec![(0.0, 0.0)];
            for (dx, dy) in steps {
                let &(x, y) = points.last().unwrap();
                points.push((x + dx, y + dy));
            }
            let params = KeyframeParams { deadband_m: 0.0, ..KeyframeParams::default() };
            let found = select(params, points.iter().copied());
            let (mut length, mut due, mut expected) = (0.0, 0.2, vec![(0.0, 0.0)]);
            for pair in points.windows(2) {
                let (dx, dy) = (pair[1].0 - pair[0].0, pair[1].1 - pair[0].1);
                let step = dx.hypot(dy);
                while due <= length + step {
                    let t = (due - length) / step;
                    expected.push((pair[0].0 + t * dx, pair[0].1 + t * dy));
                    due += 0.2;
                }
                length += step;
            }
            prop_assert!(found.len().abs_diff(expected.len()) <= 1);
            for (due, (x, y)) in found.iter().zip(expected) {
                let at = due.odom_from_vehicle.translation;
                prop_assert!((at.x - x).hypot(at.y - y) < 1e-6);
            }
            prop_assert!(found.windows(2).all(|pair| pair[0].stamp <= pair[1].stamp));
        }
    }
}
