//! What can be asked of the car park.

use super::rig::CAMERAS;
use crate::WorldError;
use crate::error::check;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Parameters of the simulated car park. The same parameters give byte-identical files.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct CarPark {
    /// Everything random is drawn from this number.
    pub seed: u64,
    /// Sessions after the initial one, each with other cars parked, other light and a walker or
    /// two.
    #[schemars(range(min = 0, max = 1000))]
    pub revisits: usize,
    /// Image width, pixels. The lens spans 180° across it.
    #[schemars(range(min = 32, max = 4096))]
    pub width_px: u32,
    /// Image height, pixels.
    #[schemars(range(min = 32, max = 4096))]
    pub height_px: u32,
    /// Rate of each camera, images per second.
    #[schemars(range(min = 0.1, max = 100.0))]
    pub rate_hz: f64,
    /// Rate of the wheel odometry, messages per second.
    #[schemars(range(min = 1.0, max = 1000.0))]
    pub odometry_rate_hz: f64,
    /// Bays side by side in each row of the western island.
    #[schemars(range(min = 1, max = 40))]
    pub west_bays: usize,
    /// Bays side by side in each row of the eastern island.
    #[schemars(range(min = 1, max = 40))]
    pub east_bays: usize,
    /// Share of the bays that are taken.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub occupancy: f64,
    /// Share of the parked cars that never leave.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub residents: f64,
    /// Walkers in each revisit (the initial drive meets nobody).
    #[schemars(range(min = 0, max = 20))]
    pub walkers: usize,
    /// Rise of the floor per metre away from the drain in its middle.
    #[schemars(range(min = 0.0, max = 0.1))]
    pub floor_slope: f64,
    /// Speed on straight lanes, m/s; bends are taken slower.
    #[schemars(range(min = 0.5, max = 10.0))]
    pub speed_mps: f64,
    /// Loops driven per session. One loop is half of the session's round trip, and two loops
    /// cover every aisle; a fraction stops on the way.
    #[schemars(range(min = 0.02, max = 100.0))]
    pub loops: f64,
    /// Distance ahead on the round trip at which sessions start, metres.
    #[schemars(range(min = 0.0, max = 10_000.0))]
    pub start_m: f64,
    /// Relative error of the odometry's distances in every session, beside the small ones that
    /// each session draws.
    #[schemars(range(min = -0.5, max = 0.5))]
    pub odometry_scale_error: f64,
    /// Distance of the published principal points from the true ones, pixels, in a direction that
    /// each camera draws.
    #[schemars(range(min = 0.0, max = 20.0))]
    pub calibration_error_px: f64,
    /// Whether the vehicle has a GNSS receiver. Where the car park lies on earth is in `truth/world.json`.
    pub gnss: bool,
    /// White noise of each fix along east and along north, metres.
    #[schemars(range(min = 0.0, max = 100.0))]
    pub gnss_noise_m: f64,
    /// Standard deviation of the part of the fixes' error that changes within a minute, metres.
    #[schemars(range(min = 0.0, max = 100.0))]
    pub gnss_drift_m: f64,
    /// Seconds in the middle of each session in which there is no fix.
    #[schemars(range(min = 0.0, max = 10_000.0))]
    pub gnss_outage_s: f64,
    /// Whether the vehicle has an IMU, as cars have them.
    pub imu: bool,
    /// A camera that sees nothing but the noise of its sensor.
    #[schemars(extend("enum" = CAMERAS))]
    pub dark_camera: Option<String>,
    /// Whether `annotations.mcap` is written beside the sessions: what somebody who knows the car park says of it, tied to
    /// poses of the initial session. In six rounds 14 parking spaces are drawn, where the drive passes so many, and boxes
    /// rejected that are none; crossings are drawn. Only where asked for, since a run that is given all logs of the folder
    /// would be taught, too.
    pub annotations: bool,
    /// Sessions at the beginning that are not written, because they were before. The others stay
    /// what they are.
    pub skip: usize,
    /// JPEG quality.
    #[schemars(range(min = 1, max = 100))]
    pub jpeg_quality: u8,
    /// Sharpness of the painted floor, texels per metre. Memory grows with its square: 100 MB
    /// at 160.
    #[schemars(range(min = 10.0, max = 400.0))]
    pub floor_texels_per_m: f64,
    /// Nanoseconds since the epoch at which the initial session starts; revisits follow a day
    /// apart.
    #[schemars(range(min = 0, max = 4_000_000_000_000_000_000_u64))]
    pub start_ns: u64,
}

impl Default for CarPark {
    fn default() -> Self {
        Self {
            seed: 1,
            revisits: 2,
            width_px: 1280,
            height_px: 960,
            rate_hz: 12.5,
            odometry_rate_hz: 50.0,
            west_bays: 2,
            east_bays: 4,
            occupancy: 0.6,
            residents: 0.25,
            walkers: 3,
            floor_slope: 0.015,
            speed_mps: 4.2,
            loops: 2.0,
            start_m: 0.0,
            odometry_scale_error: 0.0,
            calibration_error_px: 0.0,
            gnss: false,
            gnss_noise_m: 2.0,
            gnss_drift_m: 0.0,
            gnss_outage_s: 0.0,
            imu: false,
            dark_camera: None,
            annotations: false,
            skip: 0,
            jpeg_quality: 85,
            floor_texels_per_m: 160.0,
            start_ns: 1_780_300_800_000_000_000,
        }
    }
}

impl CarPark {
    /// Refuses values that make no world, all at once.
    ///
    /// # Errors
    /// [`WorldError::Parameters`] with one line for each unusable value.
    pub fn check(&self) -> Result<(), WorldError> {
        let (skip, revisits) = (self.skip, self.revisits);
        let skipped = (skip > revisits)
            .then(|| format!("skip: expected at most {revisits} (revisits), found {skip}"));
        check(self, [skipped])
    }
}
