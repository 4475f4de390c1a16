//! Layers of the metric map: features, tracks, loops, poses, landmarks.

use super::Source;
use crate::{Bytes, ImageRef, Pose, Stamp, Wkb, record};

record! {
    /// One image of a keyframe, by reference.
    #[layer("keyframe_images", key(site, session, stamp, camera))]
    pub struct FrameImage {
        /// Site that was driven.
        site: String,
        /// Session that was driven.
        session: String,
        /// Instant of the keyframe.
        stamp: Stamp ["ns"],
        /// The keyframe's number within the session.
        keyframe: u32,
        /// Camera that took it.
        camera: String,
        /// Where the pixels are.
        image: ImageRef,
    }
}

record! {
    /// Which pixels of a camera show the vehicle that carries it.
    #[layer("body_masks", key(site, session, camera))]
    pub struct BodyMask {
        /// Site that was driven.
        site: String,
        /// Session that was driven.
        session: String,
        /// The camera.
        camera: String,
        /// Width of its images.
        width: u32 ["px"],
        /// Height of its images.
        height: u32 ["px"],
        /// Images that were compared; too few show nothing. 0 where somebody gave a mask instead.
        images: u32,
        /// Share of the image that shows the vehicle.
        share: f64,
        /// An 8-bit grey PNG of the image's size: 255 where a pixel shows the vehicle, else 0.
        png: Bytes,
    }
}

record! {
    /// The features of one image, where they are and what they look like: lists of equal length, one entry per feature.
    #[layer("features", key(site, session, stamp, camera))]
    pub struct Features {
        /// Site that was driven.
        site: String,
        /// Session that was driven.
        session: String,
        /// Instant of the keyframe.
        stamp: Stamp ["ns"],
        /// The keyframe's number within the session.
        keyframe: u32,
        /// Camera that took the image.
        camera: String,
        /// Width of the image.
        width: u32 ["px"],
        /// Height of the image.
        height: u32 ["px"],
        /// Columns of the features in the full image; 0 is the centre of the first pixel.
        u: Vec<f32> ["px"],
        /// Rows of the features in the full image; 0 is the centre of the first pixel.
        v: Vec<f32> ["px"],
        /// Diameters of the features' neighbourhoods in the full image.
        size_px: Vec<f32> ["px"],
        /// Binary descriptors, 64 bytes for each feature, one after the other.
        descriptors: Bytes,
    }
}

record! {
    /// One sighting of a track.
    pub struct TrackPoint {
        /// The keyframe's number within the session.
        keyframe: u32,
        /// The feature's index in the image's lists.
        feature: u32,
    }
}

record! {
    /// One point of the world followed through the images of one camera.
    #[layer("tracks", key(site, session, camera, track))]
    pub struct Track {
        /// Site that was driven.
        site: String,
        /// Session that was driven.
        session: String,
        /// Camera that saw it.
        camera: String,
        /// Counted from 0 for each camera of a session, in the order of first sight.
        track: u32,
        /// Where it was seen: two or more keyframes, in order.
        points: Vec<TrackPoint>,
    }
}

record! {
    /// A point of what stood around one drive: what was parked there during it, and what always is.
    #[layer("surface_points", key(site, session, point))]
    pub struct SurfacePoint {
        /// Site of the map.
        site: String,
        /// Session that saw it.
        session: String,
        /// Counted from 0 within the session.
        point: u32,
        /// Where it is.
        x: f64 ["m", "map"],
        /// Where it is.
        y: f64 ["m", "map"],
        /// Where it is.
        z: f64 ["m", "map"],
        /// Above the plane that the wheels stood on where it was seen from nearest.
        height_m: f64 ["m"],
        /// Root of the sum of the variances along three axes, the poses taken for exact.
        sigma_m: f64 ["m"],
        /// Instant of the first keyframe that saw it.
        first_stamp: Stamp ["ns"],
        /// Instant of the last keyframe that saw it.
        last_stamp: Stamp ["ns"],
    }
}

record! {
    /// Two keyframes that see the same place, and how the vehicle stood in one relative to the other.
    #[layer("loop_closures", key(site, session, stamp, other_session, other_stamp))]
    pub struct LoopClosure {
        /// Site that both belong to.
        site: String,
        /// Session of the later keyframe.
        session: String,
        /// Instant of the later keyframe.
        stamp: Stamp ["ns"],
        /// The later keyframe's number within its session.
        keyframe: u32,
        /// Session of the earlier keyframe; the same session, or another of the site.
        other_session: String,
        /// Instant of the earlier keyframe.
        other_stamp: Stamp ["ns"],
        /// The earlier keyframe's number within its session.
        other_keyframe: u32,
        /// The vehicle of the later keyframe, in the vehicle frame of the earlier one.
        other_from_vehicle: Pose,
        /// Features that matched by descriptor.
        matches: u32,
        /// Matches that agree with the relative pose.
        inliers: u32,
        /// Standard deviation of the relative position, from the inliers' reprojection errors.
        sigma_m: f64 ["m"],
        /// Standard deviation of the relative orientation.
        sigma_rad: f64 ["rad"],
    }
}

record! {
    /// A loop closure after relaxation.
    pub struct LoopEdge {
        /// Session of the other keyframe.
        session: String,
        /// The other keyframe's number within its session.
        keyframe: u32,
        /// How far the relaxed poses are from what the loop closure says.
        residual_m: f64 ["m"],
        /// How far the relaxed orientations are from what the loop closure says.
        residual_rad: f64 ["rad"],
        /// How much it counted: 1 fully, near 0 it was found to be false.
        weight: f64,
    }
}

record! {
    /// A keyframe's pose after pose-graph relaxation, before bundle adjustment.
    #[layer("graph_poses", key(site, session, stamp))]
    pub struct GraphPose {
        /// Site of the map.
        site: String,
        /// Session that was driven.
        session: String,
        /// Instant of the keyframe.
        stamp: Stamp ["ns"],
        /// The keyframe's number within the session.
        keyframe: u32,
        /// The vehicle in the map.
        map_from_vehicle: Pose ["", "map"],
        /// Loop closures from this keyframe to earlier ones.
        loops: Vec<LoopEdge>,
        /// Could other poses fit odometry and what was believed of the loop closures better, by more than a hundredth
        /// of the cost? `optimal`: none, which is proven; `not_optimal`: such are known; `unknown`. One answer for all
        /// keyframes of a site.
        optimality: String,
    }
}

record! {
    /// A landmark as one image of a keyframe shows it.
    pub struct Observation {
        /// Camera that saw it.
        camera: String,
        /// The feature's index in the image's lists.
        feature: u32,
        /// The feature's column in the full image; 0 is the centre of the first pixel.
        u: f32 ["px"],
        /// The feature's row in the full image; 0 is the centre of the first pixel.
        v: f32 ["px"],
        /// Diameter of the feature's neighbourhood in the full image.
        size_px: f32 ["px"],
        /// The landmark.
        landmark: u32,
        /// Distance in the image between the feature and the projected landmark.
        residual_px: f32 ["px"],
        /// How much it counted: 1 fully, near 0 it was found to be false.
        weight: f32,
    }
}

record! {
    /// The size of a camera's images.
    pub struct ImageSize {
        /// The camera.
        camera: String,
        /// Width of its images.
        width: u32 ["px"],
        /// Height of its images.
        height: u32 ["px"],
    }
}

record! {
    /// A keyframe that holds the map up: its pose after bundle adjustment, with the landmarks it sees, and what of it a
    /// later adjustment needs.
    #[layer("adjusted_poses", key(site, session, stamp))]
    pub struct AdjustedPose {
        /// Site of the map.
        site: String,
        /// Session that was driven.
        session: String,
        /// Instant of the keyframe.
        stamp: Stamp ["ns"],
        /// The keyframe's number within the session.
        keyframe: u32,
        /// The vehicle in the map.
        map_from_vehicle: Pose ["", "map"],
        /// The stretch of unbroken odometry that it belongs to; see `keyframes`.
        stretch: u32,
        /// The vehicle in the session's drifting odometry frame.
        odom_from_vehicle: Pose,
        /// The landmarks it sees, ordered by camera and feature.
        observations: Vec<Observation>,
        /// The observations' descriptors, 64 bytes for each, one after the other.
        descriptors: Bytes,
        /// The sizes of its images, ordered by camera.
        images: Vec<ImageSize>,
    }
}

record! {
    /// Where a landmark was seen.
    pub struct Sighting {
        /// Session.
        session: String,
        /// The keyframe's number within the session.
        keyframe: u32,
        /// Camera.
        camera: String,
        /// The feature's index in the image's lists.
        feature: u32,
    }
}

record! {
    /// A point of the world that cameras recognise.
    #[layer("landmarks", key(site, landmark), geometry(geometry))]
    pub struct Landmark {
        /// Site of the map.
        site: String,
        /// Counted from 0 within the site.
        landmark: u32,
        /// Where it is.
        x: f64 ["m", "map"],
        /// Where it is.
        y: f64 ["m", "map"],
        /// Where it is.
        z: f64 ["m", "map"],
        /// Largest standard deviation of its position in any direction, given the poses.
        sigma_m: f64 ["m"],
        /// Largest angle between two rays to it.
        parallax_rad: f64 ["rad"],
        /// Root mean square of the distances between features and projected landmark.
        rms_px: f64 ["px"],
        /// Mean direction from the landmark to the cameras that saw it; a unit vector.
        view: [f64; 3] ["", "map"],
        /// Cosine of the largest angle between `view` and a direction that it was seen from.
        view_cos: f64,
        /// Nearest range it was seen at.
        near_m: f64 ["m"],
        /// Farthest range it was seen at.
        far_m: f64 ["m"],
        /// What it looks like: one or more binary descriptors of 64 bytes, one after the other.
        descriptors: Bytes,
        /// Where it was seen, ordered by session, keyframe, camera.
        sightings: Vec<Sighting>,
        /// Per session, from first to last sight; ordered by session.
        sources: Vec<Source>,
        /// Where it is, as a point.
        geometry: Wkb ["m", "map"],
    }
}

record! {
    /// A frame of the map: a keyframe that stays in it. Poses hang off it, and move with it.
    #[layer("map_frames", key(site, frame))]
    pub struct MapFrame {
        /// Site of the map.
        site: String,
        /// Counted from 0 within the site.
        frame: u32,
        /// Session whose pose it was made from.
        session: String,
        /// Instant of that pose.
        stamp: Stamp ["ns"],
        /// The frame in the map.
        map_from_frame: Pose ["", "map"],
        /// How far it has moved since the version before; null in the version that made it.
        moved_m: Option<f64> ["m"],
        /// How far it has turned since the version before; null in the version that made it.
        moved_rad: Option<f64> ["rad"],
    }
}

record! {
    /// A vehicle pose that hangs off a map frame nearby: `map_from_frame * frame_from_vehicle` is `map_from_vehicle`, but
    /// for what a map that has settled does not follow.
    #[layer("frame_poses", key(site, session, stamp))]
    pub struct FramePose {
        /// Site of the map.
        site: String,
        /// Session that was driven.
        session: String,
        /// Instant of the pose.
        stamp: Stamp ["ns"],
        /// The map frame nearby.
        frame: u32,
        /// The vehicle in that frame.
        frame_from_vehicle: Pose,
        /// The vehicle in the map.
        map_from_vehicle: Pose ["", "map"],
    }
}

record! {
    /// A keyframe localised against a map, or lost.
    #[layer("localisations", key(site, session, stamp))]
    pub struct Localisation {
        /// Site of the map.
        site: String,
        /// Session that was driven.
        session: String,
        /// Instant of the keyframe.
        stamp: Stamp ["ns"],
        /// The keyframe's number within the session.
        keyframe: u32,
        /// `localised`; `recovered` where it was found again by place, without a guess; `lost`.
        state: String,
        /// The vehicle in the map; null where lost.
        map_from_vehicle: Option<Pose> ["", "map"],
        /// Covariance of the pose, 6×6 row by row: translation along the map's axes (m²), then rotation about them
        /// (rad²); empty where lost.
        covariance: Vec<f64>,
        /// Standard deviation of the position; null where lost.
        sigma_m: Option<f64> ["m"],
        /// Standard deviation of the orientation; null where lost.
        sigma_rad: Option<f64> ["rad"],
        /// Landmarks that should be in view.
        candidates: u32,
        /// Landmarks that matched a feature.
        matches: u32,
        /// Matches that agree with the pose.
        inliers: u32,
        /// Root mean square of the inliers' distances in the image; null where lost.
        rms_px: Option<f64> ["px"],
        /// The inliers.
        observations: Vec<Observation>,
    }
}
