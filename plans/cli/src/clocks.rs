//! Stamps of clocks that differ: poses are taken at the stamps of images, and fixes are put beside those of odometry.

use evermap_datasets::{Dataset, Session};
use evermap_schemas::roles::{depth_frames, frames, gnss_fixes, imu, label_frames, odometry};

use crate::odometry_frame::LOOKED_AT;

/// Messages are logged milliseconds after their stamps, and some tenths of a second where images are packed and sent by radio
/// before (ns). What is a second later than odometry, or earlier, has another clock: GPS time alone is 18 s from UTC.
const APART: i64 = 1_000_000_000;

/// What is put beside odometry by its stamps.
const BESIDE: [&str; 5] = [
    frames::ROLE.name,
    depth_frames::ROLE.name,
    label_frames::ROLE.name,
    imu::ROLE.name,
    gnss_fixes::ROLE.name,
];

/// What a person is told of the first [`LOOKED_AT`] sessions whose topics have stamps of other clocks than odometry: each was
/// logged much sooner or later after its stamps. Of the roles that `reads` says are read.
pub async fn notes(dataset: &Dataset, reads: impl Fn(&str) -> bool) -> Vec<String> {
    let mut notes = Vec::new();
    if !reads(odometry::ROLE.name) {
        return notes;
    }
    for session in dataset.sessions.iter().take(LOOKED_AT) {
        let of_odometry = Dataset::delays(session, odometry::ROLE.name).await;
        let Some((topic, delay)) = of_odometry.first() else {
            continue;
        };
        let of_others = of_others(session, &reads, *delay).await;
        notes.extend(of_others.into_iter().map(|(other, behind)| {
            let (seconds, side) = (behind.unsigned_abs() as f64 / 1e9, side(behind));
            format!(
                "session {}: expected stamps of one clock, found those of {other} {seconds:.1} s {side} those of {topic} by \
                 when messages were logged; its rows are put beside poses of another instant: synchronise the clocks and \
                 record again",
                session.name
            )
        }));
    }
    notes
}

/// How far the stamps of topics are behind those of odometry, which was logged so long after its own (ns); of those that are
/// far from them.
async fn of_others(
    session: &Session,
    reads: impl Fn(&str) -> bool,
    of_odometry: i64,
) -> Vec<(String, i64)> {
    let mut others = Vec::new();
    for role in BESIDE.into_iter().filter(|role| reads(role)) {
        let delays = Dataset::delays(session, role).await.into_iter();
        others.extend(delays.map(|(topic, delay)| (topic, delay.saturating_sub(of_odometry))));
    }
    others.retain(|(_, behind)| behind.saturating_abs() > APART);
    others
}

fn side(behind: i64) -> &'static str {
    match behind > 0 {
        true => "behind",
        false => "ahead of",
    }
}
