//! Somebody who knows the car park, and says once what is in it: spaces, boxes that are none, crossings.
//!
//! The effort is that of paper 1 (lifelong metric and semantic maps), section VI-A: 14 spaces drawn by hand in six rounds, and
//! in each round boxes rejected, about as many as are asked about at a sitting. Nobody has a map yet, so they are what a
//! program that has seen few spaces takes for more of them. What is said is tied to vehicle poses of the first session, as
//! they truly were.

use super::Hall;
use super::layout::{AISLES, BAY_DEPTH_M, BAY_WIDTH_M, Layout, NOSE_M, Node, Rect};
use crate::WorldError;
use crate::plane::{Pose2, between, distance, heading};
use crate::random::nanoseconds;
use crate::record::{LIBRARY, SimulatedSession};
use crate::vehicle::Ground;
use evermap_algorithms::geometry::pose::Pose;
use evermap_algorithms::ground::boxes::GroundBox;
use evermap_recording::annotations::{Anchor, Annotation, AnnotationLog, Geometry};
use evermap_recording::{LogWriter, unfinished_folder};
use std::f64::consts::FRAC_PI_2;
use std::path::{Path, PathBuf};

/// Spaces that are drawn.
const DRAWN: usize = 14;
/// Sittings; in each some spaces are drawn, and some boxes are rejected.
const ROUNDS: usize = 6;
/// Boxes of each kind of mistake that are rejected in a sitting.
const REJECTED: usize = 2;
/// The first sitting begins so long after the first session, and each other one so long after the one before, seconds.
const SITTING_S: f64 = 300.0;
/// Spaces are drawn whose middle is so near to a pose that cameras saw them whole, metres.
const WHOLE_M: f64 = 6.0;
/// Farther from the drive than this nothing is looked at, metres.
const REACH_M: f64 = 7.5;
/// How far boxes that lie askew are turned, radians.
const ASKEW_RAD: f64 = 0.3;
/// A box that overlaps a space by less than this is none.
const NONE: f64 = 0.5;
/// Nothing is tied to the first and last bit of the drive, metres: keyframes need not begin and end where images do.
const ENDS_M: f64 = 0.5;

/// Writes `annotations.mcap` into `out`, in place of an older one, and gives its path.
pub(super) fn write(hall: &Hall<'_>, out: &Path) -> Result<PathBuf, WorldError> {
    let target = out.join("annotations.mcap");
    LogWriter::may_replace(&target, LIBRARY)?;
    let said = said(hall);
    let partial = unfinished_folder(out).map_err(|error| WorldError::io(&target, error))?;
    let whole = partial.path().join("annotations.mcap");
    let mut log = AnnotationLog::begin(&whole, |_| false, LIBRARY)?;
    log.say_all(&said)?;
    let written = log.finish()?;
    std::fs::rename(&written, &target).map_err(|error| WorldError::io(&target, error))?;
    Ok(target)
}

/// What is said, in order.
fn said(hall: &Hall<'_>) -> Vec<Annotation> {
    let Some(first) = hall.visits.first() else {
        return Vec::new();
    };
    let drive = AnnotatedDrive::new(&first.session, hall.layout.ground);
    let mut acts = Vec::new();
    let crossings = hall.layout.crossings.iter().enumerate();
    acts.extend(crossings.filter_map(|(index, crossing)| {
        let Rect { x0, y0, x1, y1 } = crossing.rect;
        let place = Pose2::new(crossing.rect.centre(), 0.0);
        let outline = Outline {
            kind: "crossing",
            shape: "polygon",
            sides_m: [x1 - x0, y1 - y0],
        };
        drive.act(0, format!("crossing {}", index + 1), &outline, place)
    }));
    let bays = hall.layout.bays.iter();
    let bays = bays.map(|bay| (bay.label.as_str(), bay.entry()));
    let seen: Vec<(&str, Pose2)> = bays
        .filter(|(_, place)| drive.passes(*place, WHOLE_M))
        .collect();
    let drawn = spread(&seen, DRAWN, |(_, place)| *place);
    acts.extend(drawn.iter().enumerate().filter_map(|(at, (label, place))| {
        let round = at * ROUNDS / DRAWN;
        drive.act(round, format!("space {label}"), &SPACE, *place)
    }));
    for (name, mut places) in mistakes(&hall.layout) {
        places.retain(|place| is_none(&hall.layout, *place) && drive.passes(*place, REACH_M));
        let rejected = spread(&places, ROUNDS * REJECTED, |place| *place);
        acts.extend(rejected.into_iter().enumerate().filter_map(|(at, place)| {
            let id = format!("{name} {}", at + 1);
            let said = drive.act(at / REJECTED, id, &SPACE, place)?;
            let act = "rejected".to_owned();
            Some(Annotation { act, ..said })
        }));
    }
    acts.sort_by_key(|act| act.stamp_ns);
    for (sequence, act) in (0..).zip(&mut acts) {
        act.sequence = sequence;
    }
    acts
}

/// Boxes of a space's size that may be taken for one, by what is wrong with them.
fn mistakes(layout: &Layout) -> [(&'static str, Vec<Pose2>); 7] {
    let bays = || layout.bays.iter().map(|bay| bay.entry());
    let between = neighbours(layout).map(|[a, b]| Pose2::new(between(a.at(), b.at(), 0.5), a.yaw));
    let short = bays().map(|bay| Pose2::new(bay.point([-0.5 * BAY_DEPTH_M, 0.0]), bay.yaw));
    let turned = bays().map(|bay| bay.turned(FRAC_PI_2));
    // One and two spaces on from every space: beyond the end of a row.
    let beyond = bays().flat_map(|bay| {
        let aside = [-2.0, -1.0, 1.0, 2.0].map(|count| count * BAY_WIDTH_M);
        aside.map(|left| Pose2::new(bay.point([0.0, left]), bay.yaw))
    });
    let lanes: Vec<Pose2> = lanes(layout).collect();
    let turned_by = |by: [f64; 2]| lanes.iter().flat_map(move |at| by.map(|by| at.turned(by)));
    let hatched = layout.islands.iter().flat_map(|island| {
        let [_, middle] = island.centre();
        let ends = [island.x0 + 0.5 * NOSE_M, island.x1 - 0.5 * NOSE_M];
        ends.into_iter().flat_map(move |x| {
            [-0.5, 0.5].map(|part| Pose2::new([x, middle + part * BAY_DEPTH_M], FRAC_PI_2))
        })
    });
    [
        ("between", between.collect()),
        ("half outside", short.collect()),
        ("across", turned.collect()),
        ("beyond", beyond.collect()),
        ("lane", turned_by([0.0, FRAC_PI_2]).collect()),
        (
            "askew",
            turned_by([ASKEW_RAD, FRAC_PI_2 - ASKEW_RAD]).collect(),
        ),
        ("hatched", hatched.collect()),
    ]
}

/// Spaces side by side.
fn neighbours(layout: &Layout) -> impl Iterator<Item = [Pose2; 2]> {
    let pairs = layout.bays.windows(2);
    let pairs = pairs.map(|pair| [pair[0].entry(), pair[1].entry()]);
    pairs.filter(|[a, b]| (distance(a.at(), b.at()) - BAY_WIDTH_M).abs() < 1e-6)
}

/// Places on both sides of the middle of each aisle, looking along it.
fn lanes(layout: &Layout) -> impl Iterator<Item = Pose2> {
    let aisles = AISLES.iter().filter(|(from, _)| *from != Node::Gate);
    aisles.flat_map(|(from, to)| {
        let (from, to) = (layout.node(*from), layout.node(*to));
        [0.0, 0.2, 0.4, 0.6, 0.8, 1.0]
            .into_iter()
            .flat_map(move |share| {
                let middle = Pose2::new(between(from, to, share), heading(from, to));
                [-1.5, 1.5].map(|left| Pose2::new(middle.point([0.0, left]), middle.yaw))
            })
    })
}

/// Whether a box of a space's size is no space.
fn is_none(layout: &Layout, place: Pose2) -> bool {
    let bays = layout.bays.iter().map(|bay| space(bay.entry()));
    bays.into_iter()
        .all(|bay| bay.overlap(&space(place)) < NONE)
}

fn space(place: Pose2) -> GroundBox {
    GroundBox {
        centre: place.at(),
        yaw: place.yaw,
        length_m: BAY_DEPTH_M,
        width_m: BAY_WIDTH_M,
    }
}

/// So many of these, or all: the first, then always the one that is farthest from all chosen.
fn spread<T: Copy>(from: &[T], count: usize, place: impl Fn(&T) -> Pose2) -> Vec<T> {
    let mut chosen: Vec<T> = from.first().copied().into_iter().collect();
    while chosen.len() < count.min(from.len()) {
        let away = |one: &T| {
            let away = chosen
                .iter()
                .map(|other| distance(place(one).at(), place(other).at()));
            away.fold(f64::INFINITY, f64::min)
        };
        let farthest = from.iter().max_by(|a, b| away(a).total_cmp(&away(b)));
        chosen.extend(farthest.copied());
    }
    chosen
}

/// What an outline is of, and how large it is.
struct Outline {
    kind: &'static str,
    shape: &'static str,
    /// Along its heading and across it, metres.
    sides_m: [f64; 2],
}

const SPACE: Outline = Outline {
    kind: "parking_space",
    shape: "box",
    sides_m: [BAY_DEPTH_M, BAY_WIDTH_M],
};

/// The drive whose poses labels are tied to.
struct AnnotatedDrive<'a> {
    session: &'a SimulatedSession,
    ground: Ground,
    /// When images were taken under way, and where.
    poses: Vec<(u64, Pose)>,
    /// The frame of a map whose origin is where the drive begins.
    map_from_truth: Pose,
}

impl<'a> AnnotatedDrive<'a> {
    fn new(session: &'a SimulatedSession, ground: Ground) -> Self {
        let under_way = ENDS_M..session.drive.length_m() - ENDS_M;
        let driven = |stamp: &u64| session.drive.motion(session.seconds(*stamp)).s;
        let stamps = session.stamps.iter().copied();
        let stamps = stamps.filter(|stamp| under_way.contains(&driven(stamp)));
        Self {
            poses: stamps
                .map(|stamp| (stamp, session.map_from_vehicle(stamp)))
                .collect(),
            map_from_truth: session.map_from_vehicle(session.start_ns).inverse(),
            session,
            ground,
        }
    }

    /// The pose nearest to a place, and how far it is, metres.
    fn nearest(&self, place: Pose2) -> Option<(&(u64, Pose), f64)> {
        let away_m = |(_, pose): &&(u64, Pose)| {
            let [x, y, ..] = pose.to_array();
            distance([x, y], place.at())
        };
        let nearest = self.poses.iter();
        let nearest = nearest.min_by(|a, b| away_m(a).total_cmp(&away_m(b)));
        nearest.map(|nearest| (nearest, away_m(&nearest)))
    }

    /// Whether the drive passes a place so near.
    fn passes(&self, place: Pose2, within_m: f64) -> bool {
        self.nearest(place)
            .is_some_and(|(_, away_m)| away_m <= within_m)
    }

    /// That an outline is there; `None` where nobody passed.
    fn act(&self, round: usize, id: String, outline: &Outline, place: Pose2) -> Option<Annotation> {
        let near_enough = |(_, away_m): &(_, f64)| *away_m <= REACH_M;
        let (nearest, _) = self.nearest(place).filter(near_enough)?;
        let (stamp_ns, truth_from_vehicle) = nearest;
        let truth_from_label = self.ground.place(&place);
        let vehicle_from_label = truth_from_vehicle.inverse().compose(&truth_from_label);
        let map_from_label = self.map_from_truth.compose(&truth_from_label);
        let [x, y] = outline.sides_m.map(|side| 0.5 * side);
        let corners = [[x, y], [-x, y], [-x, -y], [x, -y]];
        let since_s = self.session.drive.duration_s() + (round + 1) as f64 * SITTING_S;
        Some(Annotation {
            stamp_ns: self.session.start_ns + nanoseconds(since_s),
            author: "annotator".to_owned(),
            sequence: 0,
            id,
            kind: outline.kind.to_owned(),
            act: "drawn".to_owned(),
            map_version: None,
            geometry: Some(Geometry {
                shape: outline.shape.to_owned(),
                points: corners.map(|[x, y]| [x, y, 0.0]).to_vec(),
                map_from_label: map_from_label.to_array(),
            }),
            anchor: Some(Anchor {
                session: self.session.name.clone(),
                stamp_ns: *stamp_ns,
                camera: None,
                vehicle_from_label: vehicle_from_label.to_array(),
            }),
            image: None,
        })
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
    use super::*;
    use crate::CarPark;
    use std::collections::BTreeSet;

    /// Where an act's label truly is, as its anchor has it.
    fn placed(hall: &Hall<'_>, act: &Annotation) -> Pose {
        let anchor = act.anchor.as_ref().unwrap();
        let session = &hall.visits[0].session;
        assert_eq!(anchor.session, session.name);
        assert!(session.stamps.contains(&anchor.stamp_ns));
        let vehicle_from_label = Pose::from_array(anchor.vehicle_from_label).unwrap();
        session
            .map_from_vehicle(anchor.stamp_ns)
            .compose(&vehicle_from_label)
    }

    #[test]
    fn what_is_said_is_true() {
        for (west_bays, loops) in [(2, 2.0), (7, 0.8)] {
            let world = CarPark {
                west_bays,
                loops,
                floor_texels_per_m: 10.0,
                ..CarPark::default()
            };
            let hall = Hall::new(&world);
            let acts = said(&hall);
            let bays: Vec<GroundBox> = hall
                .layout
                .bays
                .iter()
                .map(|bay| space(bay.entry()))
                .collect();
            let mut counts = [0, 0];
            for act in acts.iter().filter(|act| act.kind == "parking_space") {
                let place = placed(&hall, act);
                let [x, y, ..] = place.to_array();
                let said = space(Pose2::new([x, y], place.yaw()));
                let overlap = bays.iter().map(|bay| bay.overlap(&said));
                let overlap = overlap.fold(0.0, f64::max);
                match act.act.as_str() {
                    "drawn" => assert!(overlap > 0.999, "{act:?}: {overlap}"),
                    _ => assert!(overlap < NONE, "{act:?}: {overlap}"),
                }
                counts[usize::from(act.act == "rejected")] += 1;
            }
            assert_eq!(counts[0], DRAWN);
            assert!(
                counts[1] > 4 * ROUNDS * REJECTED && counts[1] <= 7 * ROUNDS * REJECTED,
                "{counts:?}"
            );
            let sittings: BTreeSet<u64> = acts.iter().map(|act| act.stamp_ns).collect();
            assert_eq!(sittings.len(), ROUNDS);
            let names: BTreeSet<&str> = acts.iter().map(|act| act.id.as_str()).collect();
            assert_eq!(names.len(), acts.len());
            let order = acts.iter().map(|act| (act.stamp_ns, act.sequence));
            assert!(order.is_sorted());
        }
    }

    #[test]
    fn nothing_is_said_of_what_nobody_passed() {
        let world = CarPark {
            loops: 0.02,
            floor_texels_per_m: 10.0,
            ..CarPark::default()
        };
        let hall = Hall::new(&world);
        let near = |act: &Annotation| {
            let [x, y, ..] = act.anchor.as_ref().unwrap().vehicle_from_label;
            x.hypot(y) <= REACH_M + 1e-6
        };
        let acts = said(&hall);
        assert!(acts.len() < 60 && acts.iter().all(near));
    }
}
