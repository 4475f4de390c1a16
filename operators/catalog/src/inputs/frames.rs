//! Map frames by place.

use evermap_schemas::layers::{MapFrame, VehiclePose};
use rstar::RTree;
use rstar::primitives::GeomWithData;

/// The frames of one site, to which frames may be added.
#[derive(Default)]
pub(crate) struct Frames {
    rows: Vec<MapFrame>,
    places: RTree<GeomWithData<[f64; 3], usize>>,
}

impl FromIterator<MapFrame> for Frames {
    fn from_iter<I: IntoIterator<Item = MapFrame>>(rows: I) -> Self {
        let mut frames = Self::default();
        rows.into_iter().for_each(|frame| frames.push(frame));
        frames
    }
}

impl Frames {
    /// Adds a frame as it is; one whose pose is not a rigid transform can never be the nearest.
    fn push(&mut self, frame: MapFrame) {
        let pose = &frame.map_from_frame;
        if pose.to_array().iter().all(|value| value.is_finite()) {
            let place = GeomWithData::new([pose.x, pose.y, pose.z], self.rows.len());
            self.places.insert(place);
        }
        self.rows.push(frame);
    }

    /// Makes a pose a frame.
    pub(crate) fn push_pose(&mut self, pose: VehiclePose) {
        let last = self.rows.iter().map(|frame| frame.frame).max();
        self.push(MapFrame {
            site: pose.site,
            frame: last.map_or(0, |last| last.saturating_add(1)),
            session: pose.session,
            stamp: pose.stamp,
            map_from_frame: pose.map_from_vehicle,
            moved_m: None,
            moved_rad: None,
        });
    }

    /// The nearest frame and how far away it is (m); of several, the one with the lowest number.
    pub(crate) fn nearest(&self, position: [f64; 3]) -> Option<(&MapFrame, f64)> {
        let squared = |frame: &MapFrame| {
            let pose = &frame.map_from_frame;
            let away = [
                pose.x - position[0],
                pose.y - position[1],
                pose.z - position[2],
            ];
            away.iter().map(|x| x * x).sum::<f64>()
        };
        let nearest = self.places.nearest_neighbor(&position)?;
        let least = squared(&self.rows[nearest.data]);
        let equal = self
            .places
            .nearest_neighbor_iter_with_distance_2(&position)
            .take_while(|(_, found)| *found <= least)
            .map(|(place, _)| &self.rows[place.data]);
        let frame = equal.min_by_key(|frame| frame.frame)?;
        Some((frame, least.sqrt()))
    }

    /// The frames in the order they were added.
    pub(crate) fn into_rows(self) -> Vec<MapFrame> {
        self.rows
    }
}
