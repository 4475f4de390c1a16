//! What can be asked of the car park.

use super::rig::CAMERAS;
use crate::WorldError;
use crate::error::check;
use serde::{Deserialize, Serialize};

/// Parameters of the simulated car park. The same parameters give byte-identical files.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CarPark {
    /// Everything random is drawn from this number.
    pub seed: u64,
    /// Sessions after the initial one, each with other cars parked, other light and a walker or
    /// two.
    pub revisits: usize,
    /// Image width, pixels. The lens spans 180° across it.
    pub width_px: u32,
    /// Image height, pixels.
    pub height_px: u32,
    /// Rate of each camera, images per second.
    pub rate_hz: f64,
    /// Rate of the wheel odometry, messages per second.
    pub odometry_rate_hz: f64,
    /// Bays side by side in each row of the western island.
    pub west_bays: usize,
    /// Bays side by side in each row of the eastern island.
    pub east_bays: usize,
    /// Share of the bays that are taken, 0 to 1.
    pub occupancy: f64,
    /// Share of the parked cars that never leave, 0 to 1.
    pub residents: f64,
    /// Walkers in each revisit (the initial drive meets nobody).
    pub walkers: usize,
    /// Rise of the floor per metre away from the drain in its middle.
    pub floor_slope: f64,
    /// Speed on straight lanes, m/s; bends are taken slower.
    pub speed_mps: f64,
    /// Loops driven per session. One loop is half of the session's round trip, and two loops
    /// cover every aisle; a fraction stops on the way.
    pub loops: f64,
    /// Distance ahead on the round trip at which sessions start, metres.
    pub start_m: f64,
    /// Relative error of the odometry's distances in every session, beside the small ones that
    /// each session draws.
    pub odometry_scale_error: f64,
    /// Distance of the published principal points from the true ones, pixels, in a direction that
    /// each camera draws.
    pub calibration_error_px: f64,
    /// A camera (`front`, `left`, `rear`, `right`) that sees nothing but the noise of its sensor.
    pub dark_camera: Option<String>,
    /// Sessions at the beginning that are not written, because they were before. The others stay
    /// what they are.
    pub skip: usize,
    /// JPEG quality, 1 to 100.
    pub jpeg_quality: u8,
    /// Sharpness of the painted floor, texels per metre. Memory grows with its square: 100 MB
    /// at 160.
    pub floor_texels_per_m: f64,
    /// Nanoseconds since the epoch at which the initial session starts; revisits follow a day
    /// apart.
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
            dark_camera: None,
            skip: 0,
            jpeg_quality: 85,
            floor_texels_per_m: 160.0,
            start_ns: 1_780_300_800_000_000_000,
        }
    }
}

impl CarPark {
    /// The names of the sessions in order: `initial`, `revisit_1`, …
    pub fn session_names(&self) -> Vec<String> {
        let revisits = (1..=self.revisits).map(|k| format!("revisit_{k}"));
        std::iter::once("initial".to_owned())
            .chain(revisits)
            .collect()
    }

    /// Refuses values that make no world, all at once.
    ///
    /// # Errors
    /// [`WorldError::Parameters`] with one line for each unusable value.
    pub fn check(&self) -> Result<(), WorldError> {
        let known = CAMERAS.join(", ");
        let dark = self.dark_camera.iter();
        let unknown = dark.filter(|name| !CAMERAS.contains(&name.as_str()));
        let limits = [
            ("revisits", self.revisits as f64, 0.0, 1000.0),
            ("width_px", f64::from(self.width_px), 32.0, 4096.0),
            ("height_px", f64::from(self.height_px), 32.0, 4096.0),
            ("rate_hz", self.rate_hz, 0.1, 100.0),
            ("odometry_rate_hz", self.odometry_rate_hz, 1.0, 1000.0),
            ("west_bays", self.west_bays as f64, 1.0, 40.0),
            ("east_bays", self.east_bays as f64, 1.0, 40.0),
            ("occupancy", self.occupancy, 0.0, 1.0),
            ("residents", self.residents, 0.0, 1.0),
            ("walkers", self.walkers as f64, 0.0, 20.0),
            ("speed_mps", self.speed_mps, 0.5, 10.0),
            ("loops", self.loops, 0.02, 100.0),
            ("floor_slope", self.floor_slope, 0.0, 0.1),
            ("start_m", self.start_m, 0.0, 10_000.0),
            ("odometry_scale_error", self.odometry_scale_error, -0.5, 0.5),
            ("calibration_error_px", self.calibration_error_px, 0.0, 20.0),
            ("skip", self.skip as f64, 0.0, self.revisits as f64),
            ("jpeg_quality", f64::from(self.jpeg_quality), 1.0, 100.0),
            ("floor_texels_per_m", self.floor_texels_per_m, 10.0, 400.0),
            ("start_ns", self.start_ns as f64, 0.0, 4e18),
        ];
        check(
            &limits,
            unknown.map(|name| {
                format!("dark_camera: expected one of {known}, found {name}; choose one of them")
            }),
        )
    }
}
