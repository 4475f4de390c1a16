//! Which messages are due: the drives of a map in the order that they were driven, without the days between them.

use std::ops::Range;
use std::time::Duration;

use tokio::time::Instant;

use super::protocol::Status;

/// Where nothing happens for longer, time jumps.
const LONGEST_GAP: Duration = Duration::from_secs(2);
/// A viewer that is further behind sees it all slower.
const LATEST: Duration = Duration::from_secs(1);
/// Messages that are due together at most.
const TOGETHER: usize = 32;
/// The time of drives goes by at most so much faster than that of the world, and at least so much slower.
const SPEEDS: [f64; 2] = [1e-3, 1e3];

/// Plays messages whose instants are known, in order.
pub struct Player<'r> {
    /// Instants of messages, ns.
    stamps: &'r [i64],
    /// The next that was not played.
    next: usize,
    /// What time it was, of the drives, ns.
    at: i64,
    /// When it was that time.
    since: Instant,
    speed: f64,
    playing: bool,
}

impl<'r> Player<'r> {
    /// At the first of the messages, standing still.
    pub fn new(stamps: &'r [i64]) -> Self {
        Self {
            stamps,
            next: 0,
            at: stamps.first().copied().unwrap_or_default(),
            since: Instant::now(),
            speed: 1.0,
            playing: false,
        }
    }

    /// What time it is, of the drives, ns.
    pub fn time(&self, now: Instant) -> i64 {
        if !self.playing || self.has_ended() {
            return self.at;
        }
        let gone = now.duration_since(self.since).as_nanos() as f64 * self.speed;
        // Never past what comes next: it is then that it happens.
        let latest = self.stamps.get(self.next).copied().unwrap_or(self.at);
        self.at.saturating_add(gone as i64).min(latest.max(self.at))
    }

    /// How many messages were played.
    pub fn played(&self) -> usize {
        self.next
    }

    /// How fast it plays.
    pub fn speed(&self) -> f32 {
        self.speed as f32
    }

    /// How it stands.
    pub fn status(&self) -> Status {
        match (self.has_ended(), self.playing) {
            (true, _) => Status::Ended,
            (false, true) => Status::Playing,
            (false, false) => Status::Paused,
        }
    }

    fn has_ended(&self) -> bool {
        self.next >= self.stamps.len()
    }

    /// Goes on or stands still, and how fast.
    pub fn play(&mut self, playing: bool, speed: f64, now: Instant) {
        self.at = self.time(now);
        self.since = now;
        self.playing = playing;
        self.speed = speed.clamp(SPEEDS[0], SPEEDS[1]);
    }

    /// Goes on from an instant of the drives, ns.
    pub fn seek(&mut self, to: i64, now: Instant) {
        self.next = self.stamps.partition_point(|stamp| *stamp < to);
        let [first, last] = [self.stamps.first(), self.stamps.last()].map(Option::<&i64>::copied);
        self.at = to.clamp(first.unwrap_or(to), last.unwrap_or(to));
        self.since = now;
    }

    /// When the next message is due; `None` where none is.
    pub fn next(&mut self, now: Instant) -> Option<Instant> {
        let stamp = *self.stamps.get(self.next).filter(|_| self.playing)?;
        let before = self.stamps[..self.next].last().copied();
        let gap = stamp.saturating_sub(before.map_or(self.at, |before| before.max(self.at)));
        if gap as f64 > LONGEST_GAP.as_nanos() as f64 * self.speed.max(1.0) {
            (self.at, self.since) = (stamp, now);
            return Some(now);
        }
        let to_come = stamp.saturating_sub(self.at).max(0);
        Some(self.since + Duration::from_secs_f64(to_come as f64 * 1e-9 / self.speed))
    }

    /// The messages that are due, and from now on were played.
    pub fn due(&mut self, now: Instant) -> Range<usize> {
        let Some(due) = self.next(now).filter(|due| *due <= now) else {
            return self.next..self.next;
        };
        let begin = self.next;
        if now.duration_since(due) > LATEST {
            (self.at, self.since) = (self.stamps[begin], now);
        }
        let time = self.at as f64 + now.duration_since(self.since).as_nanos() as f64 * self.speed;
        let due = self.stamps[begin..].partition_point(|stamp| *stamp as f64 <= time);
        // Of what is due the first is, whatever rounding makes of it.
        self.next = begin + due.clamp(1, TOGETHER);
        if self.has_ended() {
            (self.at, self.since) = (self.stamps[self.next - 1], now);
        }
        begin..self.next
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    const SECOND: i64 = 1_000_000_000;

    /// Messages as they are played, with when that was, s, until the last one was.
    fn played(player: &mut Player<'_>, mut now: Instant) -> Vec<(usize, f64)> {
        let begun = now;
        let mut all = Vec::new();
        while let Some(next) = player.next(now) {
            now = now.max(next);
            let seconds = now.duration_since(begun).as_secs_f64();
            all.extend(player.due(now).map(|message| (message, seconds)));
        }
        all
    }

    #[test]
    fn drives_come_in_their_own_time_and_days_between_them_go_by_at_once() {
        let stamps = [
            0,
            SECOND,
            SECOND,
            2 * SECOND,
            90_000 * SECOND,
            90_001 * SECOND,
        ];
        let mut player = Player::new(&stamps);
        let now = Instant::now();
        assert_eq!(player.next(now), None);
        player.play(true, 2.0, now);
        let found = played(&mut player, now);
        let expected = [0.0, 0.5, 0.5, 1.0, 1.0, 1.5];
        assert_eq!(found.len(), 6);
        for ((message, seconds), (number, at)) in found.iter().zip(expected.iter().enumerate()) {
            assert!(
                *message == number && (seconds - at).abs() < 1e-3,
                "{found:?}"
            );
        }
        assert_eq!(player.status(), Status::Ended);
        assert_eq!(player.time(now + Duration::from_secs(9)), 90_001 * SECOND);
    }

    #[test]
    fn who_is_late_gets_no_flood() {
        let stamps: Vec<i64> = (0..1000).map(|number| number * SECOND / 10).collect();
        let mut player = Player::new(&stamps);
        let now = Instant::now();
        player.play(true, 1.0, now);
        assert_eq!(player.due(now), 0..1);
        // Half a minute in which nothing was taken.
        let later = now + Duration::from_secs(30);
        assert_eq!(player.due(later), 1..2);
        assert_eq!(player.time(later), SECOND / 10);
        let soon = later + Duration::from_millis(450);
        assert_eq!(player.due(soon), 2..6);
    }

    #[test]
    fn it_goes_on_from_where_it_is_told_to() {
        let stamps: Vec<i64> = (0..100).map(|number| number * SECOND).collect();
        let mut player = Player::new(&stamps);
        let now = Instant::now();
        player.play(true, 1.0, now);
        player.seek(50 * SECOND, now);
        assert_eq!((player.played(), player.time(now)), (50, 50 * SECOND));
        player.play(false, 1.0, now);
        assert_eq!(player.next(now + Duration::from_secs(5)), None);
        assert_eq!(player.status(), Status::Paused);
        for (to, time) in [(i64::MIN, 0), (i64::MAX, 99 * SECOND)] {
            player.seek(to, now);
            assert_eq!(player.time(now), time);
        }
        assert_eq!(player.status(), Status::Ended);
        assert_eq!(Player::new(&[]).status(), Status::Ended);
    }
}
