//! Where a map lies on earth.

use super::Source;
use crate::{Stamp, record};

record! {
    /// Where a GNSS antenna was at a fix: on earth, and seen from the keyframe before.
    #[layer("antenna_positions", key(site, session, stamp))]
    pub struct AntennaPosition {
        /// Site that was driven.
        site: String,
        /// Session that was driven.
        session: String,
        /// Instant of the fix.
        stamp: Stamp ["ns"],
        /// Instant of the keyframe.
        keyframe_stamp: Stamp ["ns"],
        /// The antenna from the vehicle at the keyframe.
        x: f64 ["m", "vehicle"],
        /// The antenna from the vehicle at the keyframe.
        y: f64 ["m", "vehicle"],
        /// The antenna from the vehicle at the keyframe.
        z: f64 ["m", "vehicle"],
        /// Latitude of the antenna.
        latitude_deg: f64 ["deg", "WGS 84"],
        /// Longitude of the antenna.
        longitude_deg: f64 ["deg", "WGS 84"],
        /// Height of the antenna above the ellipsoid; null where the receiver does not know it.
        height_m: Option<f64> ["m", "WGS 84"],
        /// The receiver's own standard deviation along east and along north; null where it does not know it.
        horizontal_sd_m: Option<f64> ["m"],
        /// The receiver's own standard deviation of the height; null where it does not know it.
        vertical_sd_m: Option<f64> ["m"],
    }
}

record! {
    /// Where a site's map lies on earth. East, north and up are those of the tangent plane at the map's origin:
    /// `east = cos(heading) x - sin(heading) y`, `north = sin(heading) x + cos(heading) y`, `up = z`.
    #[layer("georeference", key(site))]
    pub struct Georeference {
        /// Site of the map.
        site: String,
        /// Latitude of the map's origin.
        latitude_deg: f64 ["deg", "WGS 84"],
        /// Longitude of the map's origin.
        longitude_deg: f64 ["deg", "WGS 84"],
        /// Height of the map's origin above the ellipsoid; null where no fix has a height.
        height_m: Option<f64> ["m", "WGS 84"],
        /// Direction of the map's x axis, counter-clockwise from east.
        heading_rad: f64 ["rad"],
        /// Covariance of the origin's east and north and of the heading, three rows of three; null where the place was given.
        covariance: Option<Vec<f64>> ["m², m rad, rad²"],
        /// Standard deviation of the height; null where there is none, or it was given.
        height_sd_m: Option<f64> ["m"],
        /// Fixes that have a pose.
        fixes: u32,
        /// Those of them that lie too far off to be believed: more than five standard deviations.
        outliers: u32,
        /// Noise of one fix along east and along north, beside the drift; null where the place was given.
        noise_m: Option<f64> ["m"],
        /// Standard deviation of the part of the error that drifts; null where the place was given.
        drift_m: Option<f64> ["m"],
        /// Time in which the drift forgets itself; null where there is none.
        drift_s: Option<f64> ["s"],
        /// The drives that it is from, ordered by session; empty where the place was given.
        sources: Vec<Source>,
    }
}
