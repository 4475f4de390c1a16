//! The map's layers: what operators yield, and what SQL users read.

mod boxes;
mod earth;
mod labels;
mod metric_map;
mod people;
mod semantic_map;
mod stable_map;

use std::collections::BTreeMap;

use crate::{Bytes, ImageRef, LayerRow, Pose, Stamp, Wkb, record};

pub use boxes::*;
pub use earth::*;
pub use labels::*;
pub use metric_map::*;
pub use people::*;
pub use semantic_map::*;
pub use stable_map::*;

record! {
    /// The part of a session that a row was made from. It may have gone elsewhere in between.
    pub struct Source {
        /// The session.
        session: String,
        /// Stamp of the first row of the session that counted.
        first_stamp: Stamp ["ns"],
        /// Stamp of the last row of the session that counted; never before the first.
        last_stamp: Stamp ["ns"],
    }
}

/// Sources of one row while they are gathered: what comes out depends neither on order nor on grouping.
#[derive(Debug, Clone, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Sources(BTreeMap<String, (Stamp, Stamp)>);

impl Sources {
    /// The part of a session from one stamp to another, in either order, counted in.
    pub fn add(&mut self, session: &str, one: Stamp, other: Stamp) {
        let (first, last) = (one.min(other), one.max(other));
        if let Some(part) = self.0.get_mut(session) {
            *part = (part.0.min(first), part.1.max(last));
        } else {
            self.0.insert(session.to_owned(), (first, last));
        }
    }

    /// The parts so far, ordered by session.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = (&str, Stamp, Stamp)> {
        let parts = self.0.iter();
        parts.map(|(session, (first, last))| (session.as_str(), *first, *last))
    }

    /// The column's value, ordered by session.
    pub fn into_rows(self) -> Vec<Source> {
        let parts = self.0.into_iter();
        parts
            .map(|(session, (first_stamp, last_stamp))| Source {
                session,
                first_stamp,
                last_stamp,
            })
            .collect()
    }
}

record! {
    /// One camera's image within a keyframe.
    pub struct KeyframeImage {
        /// Camera that took it.
        camera: String,
        /// Exposure instant, which may differ from the keyframe's.
        stamp: Stamp ["ns"],
        /// Where the pixels are.
        image: ImageRef,
    }
}

record! {
    /// One frame set: the images of all cameras at one place of the drive.
    #[layer("keyframes", key(site, session, stamp))]
    pub struct Keyframe {
        /// Site that was driven.
        site: String,
        /// Session that was driven.
        session: String,
        /// Instant of the keyframe.
        stamp: Stamp ["ns"],
        /// Counted from 0 along the session.
        keyframe: u32,
        /// Driven path from the session's start.
        distance_m: f64 ["m"],
        /// Stretches of unbroken odometry are counted from 0 along the session: how the vehicle moved from one to the next
        /// is not known.
        stretch: u32,
        /// The vehicle in the frame that the stretch's odometry began in, drifting, interpolated to the stamp.
        odom_from_vehicle: Pose ["", "odom"],
        /// The frame set, ordered by camera; empty where no image was near in time.
        images: Vec<KeyframeImage>,
    }
}

record! {
    /// The vehicle's pose in the map at one instant.
    #[layer("poses", key(site, session, stamp))]
    pub struct VehiclePose {
        /// Site of the map.
        site: String,
        /// Session that was driven.
        session: String,
        /// Instant of the pose.
        stamp: Stamp ["ns"],
        /// The vehicle in the map.
        map_from_vehicle: Pose ["", "map"],
    }
}

record! {
    /// How fast the vehicle drove, along its path, at the instant of an odometry message.
    #[layer("speeds", key(site, session, stamp))]
    pub struct Speed {
        /// Site.
        site: String,
        /// Session that was driven.
        session: String,
        /// Instant.
        stamp: Stamp ["ns"],
        /// Speed along the vehicle's forward axis; negative in reverse.
        speed_mps: f64 ["m/s"],
        /// Change of the speed.
        acceleration_mps2: f64 ["m/s²"],
    }
}

record! {
    /// One image with the vehicle's pose at its exposure: what ground patches are made from.
    #[layer("posed_images", key(site, session, stamp, camera))]
    pub struct PosedImage {
        /// Site of the map.
        site: String,
        /// Session that was driven.
        session: String,
        /// Exposure instant.
        stamp: Stamp ["ns"],
        /// Camera that took it.
        camera: String,
        /// The vehicle in the map at the exposure.
        map_from_vehicle: Pose ["", "map"],
        /// Where the pixels are.
        image: ImageRef,
    }
}

record! {
    /// One image seen from above: the cells of the ground plane that it shows.
    #[layer("ground_patches", key(site, session, stamp, camera))]
    pub struct GroundPatch {
        /// Site of the map.
        site: String,
        /// Session that was driven.
        session: String,
        /// Exposure instant.
        stamp: Stamp ["ns"],
        /// Camera that took it.
        camera: String,
        /// Side of a cell.
        cell_m: f64 ["m"],
        /// Column of the patch's first cell; cell i covers `[i, i + 1) * cell_m` along the map's x axis.
        column: i32 ["", "map"],
        /// Row of the patch's first cell; rows grow along the map's y axis.
        row: i32 ["", "map"],
        /// Cells along x.
        width: u32,
        /// Cells along y.
        height: u32,
        /// Grey value of each cell, row by row; of what is in colour red, green and blue of each, three times as many.
        values: Bytes,
        /// Weight of each cell by viewing angle, 1 to 255; 0 where the image does not show it.
        weights: Bytes,
    }
}

record! {
    /// One tile of the overhead image: the weighted running mean of all images that show it.
    #[layer("overhead_tiles", key(site, zoom, tile_x, tile_y), geometry(geometry))]
    pub struct OverheadTile {
        /// Site of the map.
        site: String,
        /// Level: 0 is the finest; each next one has cells twice as large.
        zoom: u32,
        /// Tile column: tile i covers `[i, i + 1) * size_m` along the map's x axis.
        tile_x: i32 ["", "map"],
        /// Tile row: tile j covers `[j, j + 1) * size_m` along the map's y axis.
        tile_y: i32 ["", "map"],
        /// Side of a cell at this level.
        cell_m: f64 ["m"],
        /// Side of the tile.
        size_m: f64 ["m"],
        /// Cells that at least one image showed.
        covered: u32,
        /// Weights of all observations of a cell, added up; the mean over the covered cells.
        mean_weight: f64,
        /// The tile as a PNG with alpha (0 where nothing was seen), in colour where a cell is, else grey; the first row is the
        /// northernmost.
        png: Bytes,
        /// What it shows: per session, from the first to the last image that added to it; ordered by session.
        sources: Vec<Source>,
        /// Footprint of the tile, in the map.
        geometry: Wkb ["m", "map"],
    }
}

record! {
    /// One lane of the road network, from one intersection or dead end to the next.
    #[layer("lanes", key(site, lane), geometry(geometry))]
    pub struct Lane {
        /// Site of the map.
        site: String,
        /// Counted from 0 within the site.
        lane: u32,
        /// Node that the lane starts at; lanes that share a node meet there.
        start_node: u32,
        /// Node that the lane ends at.
        end_node: u32,
        /// What is at the start: `intersection`, `dead_end` or `loop`.
        start_kind: String,
        /// What is at the end: `intersection`, `dead_end` or `loop`.
        end_kind: String,
        /// How it was driven: `forward` (from start to end), `backward`, `both`, or `unknown` where no pass follows
        /// more than half of it.
        direction: String,
        /// Passes from start to end.
        forward_passes: u32,
        /// Passes from end to start.
        backward_passes: u32,
        /// Length along the centre line.
        length_m: f64 ["m"],
        /// The vehicle's width and what its passes scatter by.
        width_m: f64 ["m"],
        /// Lanes that drives went on to from the end, ascending.
        next_lanes: Vec<u32>,
        /// Lanes that drives went on to from the start, having come from the end; ascending.
        next_lanes_backward: Vec<u32>,
        /// The centre line, from start to end.
        points: Vec<[f64; 3]> ["m", "map"],
        /// Who drove it: per session, from the first to the last pose on it; ordered by session. For a lane that only
        /// joins places near each other, who came by its ends.
        sources: Vec<Source>,
        /// The centre line as a line string.
        geometry: Wkb ["m", "map"],
    }
}

record! {
    /// A place where more than two lane ends meet.
    #[layer("intersections", key(site, node), geometry(geometry))]
    pub struct Intersection {
        /// Site of the map.
        site: String,
        /// The node's number, as lanes name it.
        node: u32,
        /// Lane ends that meet here.
        degree: u32,
        /// Where it is.
        x: f64 ["m", "map"],
        /// Where it is.
        y: f64 ["m", "map"],
        /// Where it is.
        z: f64 ["m", "map"],
        /// Sources of the lanes that meet here, joined; ordered by session.
        sources: Vec<Source>,
        /// Where it is, as a point.
        geometry: Wkb ["m", "map"],
    }
}

/// Every layer that operators yield or read, sorted by name; the reference page lists these.
pub fn all() -> Vec<crate::Layer> {
    let mut layers = vec![
        AdjustedPose::layer(),
        BodyMask::layer(),
        BoxHypothesis::layer(),
        BoxModel::layer(),
        Features::layer(),
        FrameImage::layer(),
        FramePose::layer(),
        GraphPose::layer(),
        Landmark::layer(),
        Localisation::layer(),
        LoopClosure::layer(),
        MapFrame::layer(),
        Track::layer(),
        Danger::layer(),
        DangerSetting::layer(),
        Exposure::layer(),
        LaneSpeed::layer(),
        PersonHypothesis::layer(),
        PersonExample::layer(),
        PersonModel::layer(),
        Person::layer(),
        PersonQuestion::layer(),
        PersonOnGround::layer(),
        SpeedCell::layer(),
        ClassLeaf::layer(),
        ClassScores::layer(),
        CrfSetting::layer(),
        DecisionTree::layer(),
        PixelPerceptron::layer(),
        LabelAnchor::layer(),
        LabelImage::layer(),
        LabelledFrame::layer(),
        PixelSamples::layer(),
        RelatedViews::layer(),
        RelocationCalibration::layer(),
        Relocation::layer(),
        ScoredFrame::layer(),
        LabelledScores::layer(),
        View::layer(),
        SphereView::layer(),
        ViewRegistration::layer(),
        ViewLink::layer(),
        WarpedLabels::layer(),
        OcclusionCount::layer(),
        OcclusionProbability::layer(),
        InferredLabels::layer(),
        Georeference::layer(),
        AntennaPosition::layer(),
        GroundPatch::layer(),
        Intersection::layer(),
        Keyframe::layer(),
        Lane::layer(),
        OverheadGradients::layer(),
        OverheadTile::layer(),
        ParkingSpace::layer(),
        PlacedLabel::layer(),
        PosedImage::layer(),
        SpaceOccupancy::layer(),
        Speed::layer(),
        SurfacePoint::layer(),
        VehiclePose::layer(),
    ];
    layers.extend(crate::roles::ALL.iter().map(crate::roles::Role::layer));
    layers.sort_by_key(|layer| layer.name);
    layers
}

/// The layer of a name, where operators yield or read one.
pub fn named(name: &str) -> Option<crate::Layer> {
    all().into_iter().find(|layer| layer.name == name)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::{batch, rows};

    #[test]
    fn sources_are_one_part_per_session_in_any_order() {
        let parts = [("b", 5, 9), ("a", 7, 7), ("b", 2, 3), ("a", 8, 6)];
        let gathered = |order: &[usize]| {
            let mut sources = Sources::default();
            for (session, one, other) in order.iter().map(|at| parts[*at]) {
                sources.add(session, Stamp(one), Stamp(other));
            }
            sources
        };
        let found = gathered(&[0, 1, 2, 3]);
        assert_eq!(found, gathered(&[3, 2, 0, 1]));
        let listed: Vec<_> = found.iter().collect();
        assert_eq!(
            listed,
            [("a", Stamp(6), Stamp(8)), ("b", Stamp(2), Stamp(9))]
        );
        let place = Intersection {
            site: "lot".into(),
            node: 1,
            degree: 3,
            x: 0.0,
            y: 0.0,
            z: 0.0,
            sources: found.into_rows(),
            geometry: Wkb::point([0.0; 3]),
        };
        let columns = batch(vec![place.clone()]).unwrap();
        assert_eq!(rows::<Intersection>(&columns).unwrap(), [place]);
    }
}
