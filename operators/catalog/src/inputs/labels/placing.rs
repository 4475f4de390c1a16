//! Where labels are in a version of a map: composed again under its poses.

use std::collections::BTreeMap;

use evermap_algorithms::geometry::pose::Pose;
use evermap_algorithms::labels::shapes::size;
use evermap_schemas::layers::{LabelAnchor, MapFrame, PlacedLabel, VehiclePose};
use evermap_schemas::roles::Anchor;
use evermap_schemas::{Stamp, Wkb};
use nalgebra::Vector3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::Tell;

/// What lies farther than this outside of all that the vehicle's poses span is not of the map, m: whatever covers the labels
/// would cover all in between.
const OUTSIDE_M: f64 = 2000.0;

/// Between which poses a label may hang.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct PlacingParams {
    /// Where the map has no pose at a label's instant any more (its keyframes were chosen anew), the pose between the two
    /// before and after it, if these are no farther apart than this (m): five keyframes.
    #[schemars(range(min = 0.0))]
    pub gap_m: f64,
}

impl Default for PlacingParams {
    fn default() -> Self {
        Self { gap_m: 1.0 }
    }
}

/// The poses and frames of one version of a site's map.
pub struct Placer {
    gap_m: f64,
    poses: BTreeMap<String, BTreeMap<Stamp, Pose>>,
    /// By the session and instant of the pose that each was made from: their numbers are others' once a session is replaced.
    frames: BTreeMap<(String, Stamp), Pose>,
    /// Labels where they were in the version before, by name.
    before: BTreeMap<String, PlacedLabel>,
    /// Least and largest coordinates of poses and frames, m; `None` without any.
    span: Option<[[f64; 3]; 2]>,
}

impl Placer {
    /// Of a map's rows, and the labels that were placed in the version before; poses and frames that are no rigid transform
    /// are left out.
    pub fn new(
        poses: Vec<VehiclePose>,
        frames: Vec<MapFrame>,
        before: Vec<PlacedLabel>,
        params: &PlacingParams,
    ) -> Self {
        let mut sessions: BTreeMap<String, BTreeMap<Stamp, Pose>> = BTreeMap::new();
        for row in poses {
            if let Some(pose) = rigid(&row.map_from_vehicle) {
                let of_session = sessions.entry(row.session).or_default();
                of_session.insert(row.stamp, pose);
            }
        }
        let frame = |row: MapFrame| Some(((row.session, row.stamp), rigid(&row.map_from_frame)?));
        let frames: BTreeMap<_, _> = frames.into_iter().filter_map(frame).collect();
        let stood = sessions.values().flat_map(BTreeMap::values);
        Self {
            gap_m: params.gap_m,
            span: span(stood.chain(frames.values())),
            poses: sessions,
            frames,
            before: before
                .into_iter()
                .map(|row| (row.label.clone(), row))
                .collect(),
        }
    }

    /// A label where it is now, far away as it may be; `None` where its own pose is not a rigid transform.
    pub fn placed(&self, row: LabelAnchor, tell: Tell<'_>) -> Option<PlacedLabel> {
        let anchor = row.anchor.as_ref();
        let by_pose = anchor.and_then(|anchor| self.by_pose(anchor));
        let by_frame = || self.by_frame(&row).map(|pose| (pose, "frame"));
        let as_before = || self.as_before(&row).map(|pose| (pose, "before"));
        let as_drawn = || Some((rigid(&row.map_from_label)?, "drawing"));
        let (map_from_label, placed_by) = match by_pose {
            Some(pose) => (pose, "pose"),
            None => by_frame().or_else(as_before).or_else(as_drawn)?,
        };
        let point = |point: &[f64; 3]| map_from_label.transform(&Vector3::from(*point)).into();
        let points: Vec<[f64; 3]> = row.points.iter().map(point).collect();
        let told = match self.is_far(&points) {
            true => Some("label kilometres from every vehicle pose, in no layer that labels make"),
            false => self.told(&row, placed_by),
        };
        if let Some(reason) = told {
            tell(reason.into(), 1);
        }
        let size = (row.shape == "box").then(|| size(&row.points)).flatten();
        Some(PlacedLabel {
            geometry: match row.shape.as_str() {
                "polyline" => Wkb::line_string(&points),
                _ => Wkb::polygon(&points.iter().map(|[x, y, _]| [*x, *y]).collect::<Vec<_>>()),
            },
            site: row.site,
            label: row.label,
            kind: row.kind,
            standing: row.standing,
            author: row.author,
            said: row.said,
            placed_by: placed_by.to_owned(),
            anchor: row.anchor,
            shape: row.shape,
            map_from_label: evermap_schemas::Pose::from_array(map_from_label.to_array()),
            length_m: size.map(|[length, _]| length),
            width_m: size.map(|[_, width]| width),
            points,
        })
    }

    /// What is to be told of where a label is placed.
    fn told(&self, row: &LabelAnchor, placed_by: &str) -> Option<&'static str> {
        let anchor = row.anchor.as_ref();
        let has_session = anchor.is_some_and(|anchor| self.poses.contains_key(&anchor.session));
        match (placed_by, anchor, has_session) {
            ("frame", Some(_), false) => Some("label whose session is gone, placed by its frame"),
            ("frame", Some(_), true) => {
                Some("label of an instant that its session has no pose at, placed by its frame")
            }
            ("before", _, false) => Some("label whose session is gone, placed where it was before"),
            ("before", _, true) => Some(
                "label of an instant that its session has no pose at, placed where it was before",
            ),
            ("drawing", _, true) => {
                Some("label of an instant that its session has no pose at, placed as it was drawn")
            }
            ("drawing", _, false) if row.frame.is_some() => {
                Some("label whose session is gone, placed as it was drawn")
            }
            ("drawing", _, false) => {
                Some("label not tied to any pose of the map, placed as it was drawn")
            }
            _ => None,
        }
    }

    /// Whether any of these points, m, is kilometres from every pose and frame of the map; never where it has none.
    pub fn is_far(&self, points: &[[f64; 3]]) -> bool {
        let Some([least, largest]) = &self.span else {
            return false;
        };
        let is_near = |axis: usize, value: f64| {
            let within = least[axis] - OUTSIDE_M..=largest[axis] + OUTSIDE_M;
            within.contains(&value)
        };
        let is_near = |point: &[f64; 3]| (0..3).all(|axis| is_near(axis, point[axis]));
        !points.iter().all(is_near)
    }

    /// Where the vehicle of a session stood at an instant; `None` where the map does not say, or poses are too far apart.
    pub fn map_from_vehicle(&self, session: &str, stamp: Stamp) -> Option<Pose> {
        let of_session = self.poses.get(session)?;
        let before = of_session.range(..=stamp).next_back()?;
        let after = of_session.range(stamp..).next()?;
        let apart_m = (before.1.translation - after.1.translation).norm();
        let between = (before.0.0, before.1);
        let pose = Pose::at_stamp(stamp.0, between, (after.0.0, after.1));
        (apart_m <= self.gap_m).then_some(pose)
    }

    fn by_pose(&self, anchor: &Anchor) -> Option<Pose> {
        let pose = self.map_from_vehicle(&anchor.session, anchor.stamp)?;
        Some(pose.compose(&rigid(&anchor.vehicle_from_label)?))
    }

    fn by_frame(&self, row: &LabelAnchor) -> Option<Pose> {
        let frame = (row.frame_session.clone()?, row.frame_stamp?);
        let map_from_frame = self.frames.get(&frame)?;
        Some(map_from_frame.compose(&rigid(row.frame_from_label.as_ref()?)?))
    }

    /// Where the version before had it, if it is tied to the same pose since: else it was drawn anew.
    fn as_before(&self, row: &LabelAnchor) -> Option<Pose> {
        let before = self.before.get(&row.label)?;
        let is_same = before.anchor.is_some() && before.anchor == row.anchor;
        is_same.then(|| rigid(&before.map_from_label)).flatten()
    }
}

/// Least and largest coordinates of poses, m.
fn span<'p>(poses: impl Iterator<Item = &'p Pose>) -> Option<[[f64; 3]; 2]> {
    let points = poses.map(|pose| -> [f64; 3] { pose.translation.into() });
    let points = points.map(|point| [point, point]);
    points.reduce(|[least, largest], [point, _]| {
        [
            [0, 1, 2].map(|axis| point[axis].min(least[axis])),
            [0, 1, 2].map(|axis| point[axis].max(largest[axis])),
        ]
    })
}

fn rigid(pose: &evermap_schemas::Pose) -> Option<Pose> {
    Pose::from_array(pose.to_array()).ok()
}
