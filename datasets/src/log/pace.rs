//! When the messages of a channel came.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

/// When the messages of a channel came, by log time.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Pace {
    /// How many there are.
    pub messages: u64,
    /// The earliest, ns.
    pub first: i64,
    /// The latest, ns.
    pub last: i64,
    /// The longest time from one to the next, ns; 0 for a single message.
    pub longest_gap: i64,
    /// When that began, ns.
    pub gap_from: i64,
}

impl Pace {
    /// Of one message.
    pub(crate) fn of(time: i64) -> Self {
        Self {
            messages: 1,
            first: time,
            last: time,
            longest_gap: 0,
            gap_from: time,
        }
    }

    /// With the messages that were recorded after these.
    pub(crate) fn then(self, next: Self) -> Self {
        let between = next.first.saturating_sub(self.last);
        let gaps = [
            (self.longest_gap, self.gap_from),
            (between, self.last),
            (next.longest_gap, next.gap_from),
        ];
        // Of equal gaps the first.
        let longest = gaps
            .into_iter()
            .reduce(|longest, gap| match gap.0 > longest.0 {
                true => gap,
                false => longest,
            });
        let (longest_gap, gap_from) = longest.unwrap_or_default();
        Self {
            messages: self.messages.saturating_add(next.messages),
            first: self.first.min(next.first),
            last: self.last.max(next.last),
            longest_gap,
            gap_from,
        }
    }

    /// Messages a second between the first and the last; `None` where they have one time.
    pub fn rate_hz(&self) -> Option<f64> {
        let seconds = self.last.saturating_sub(self.first) as f64 * 1e-9;
        (seconds > 0.0).then(|| (self.messages - 1) as f64 / seconds)
    }
}

/// Adds messages that were recorded after those of their channel so far.
pub(crate) fn add(paces: &mut BTreeMap<u16, Pace>, channel: u16, next: Pace) {
    let pace = paces.entry(channel);
    pace.and_modify(|pace| *pace = pace.then(next))
        .or_insert(next);
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pace(times: &[i64]) -> Option<Pace> {
        times.iter().copied().map(Pace::of).reduce(Pace::then)
    }

    #[test]
    fn rate_and_longest_gap_follow_from_times_in_any_order_and_portion() {
        let second = 1_000_000_000;
        let times = [0, 1, 2, 5, 6, 10].map(|time| time * second);
        let whole = pace(&times);
        assert_eq!(
            whole.map(|pace| (pace.longest_gap, pace.gap_from)),
            Some((4 * second, 6 * second))
        );
        assert_eq!(whole.and_then(|pace| pace.rate_hz()), Some(0.5));
        for at in 1..times.len() {
            let (before, after) = times.split_at(at);
            let joined = pace(before).zip(pace(after)).map(|(a, b)| a.then(b));
            assert_eq!(joined, whole, "cut at {at}");
        }
        let back =
            pace(&[second, 0, 2 * second]).map(|pace| (pace.first, pace.last, pace.longest_gap));
        assert_eq!(back, Some((0, 2 * second, second)));
        assert_eq!(pace(&[7]).and_then(|pace| pace.rate_hz()), None);
        assert_eq!(
            pace(&[i64::MIN, i64::MAX]).map(|pace| pace.longest_gap),
            Some(i64::MAX)
        );
    }
}
