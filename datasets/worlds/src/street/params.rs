//! What can be asked of the street.

use crate::WorldError;
use crate::error::check;
use serde::{Deserialize, Serialize};

/// Parameters of the simulated street. The same parameters give byte-identical files.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Street {
    /// Everything random is drawn from this number.
    pub seed: u64,
    /// Sessions `visit_a`, `visit_b`, …, years apart: the street stays, cars, light and where
    /// on the lane one drives do not.
    pub visits: usize,
    /// Length of the street, a closed loop, metres.
    pub length_m: f64,
    /// Distance between panoramas, metres.
    pub spacing_m: f64,
    /// Width of the panoramas, pixels; it covers 360°.
    pub width_px: u32,
    /// Height of the panoramas, pixels.
    pub height_px: u32,
    /// Cars on 100 m of street in each visit, most of them parked.
    pub cars: f64,
    /// Share of wrong pixels in the noisy labels, 0 to 0.6.
    pub label_noise: f64,
    /// Whether colour and depth panoramas are made too; without them 13,000 views take minutes.
    pub colour: bool,
    /// Speed on straight streets, m/s; bends are taken slower.
    pub speed_mps: f64,
    /// Rate of the wheel odometry, messages per second.
    pub odometry_rate_hz: f64,
    /// JPEG quality, 1 to 100.
    pub jpeg_quality: u8,
    /// Nanoseconds since the epoch at which the first visit starts; the others follow three
    /// years apart.
    pub start_ns: u64,
}

impl Default for Street {
    fn default() -> Self {
        Self {
            seed: 1,
            visits: 2,
            length_m: 300.0,
            spacing_m: 1.5,
            width_px: 1024,
            height_px: 333,
            cars: 9.0,
            label_noise: 0.18,
            colour: true,
            speed_mps: 2.5,
            odometry_rate_hz: 50.0,
            jpeg_quality: 85,
            start_ns: 1_500_000_000_000_000_000,
        }
    }
}

impl Street {
    /// The names of the sessions in order: `visit_a`, `visit_b`, …
    pub fn session_names(&self) -> Vec<String> {
        let letters = ('a'..='z').take(self.visits);
        letters.map(|letter| format!("visit_{letter}")).collect()
    }

    /// Panoramas of each visit.
    pub fn views(&self) -> usize {
        ((self.length_m / self.spacing_m).floor() as usize).max(1)
    }

    /// Refuses values that make no world, all at once.
    ///
    /// # Errors
    /// [`WorldError::Parameters`] with one line for each unusable value.
    pub fn check(&self) -> Result<(), WorldError> {
        let width = f64::from(self.width_px);
        let limits = [
            ("visits", self.visits as f64, 1.0, 26.0),
            ("length_m", self.length_m, 80.0, 1e6),
            ("spacing_m", self.spacing_m, 0.1, 100.0),
            ("width_px", width, 64.0, 8192.0),
            ("height_px", f64::from(self.height_px), 16.0, 0.5 * width),
            ("cars", self.cars, 0.0, 60.0),
            ("label_noise", self.label_noise, 0.0, 0.6),
            ("speed_mps", self.speed_mps, 0.5, 10.0),
            ("odometry_rate_hz", self.odometry_rate_hz, 1.0, 1000.0),
            ("jpeg_quality", f64::from(self.jpeg_quality), 1.0, 100.0),
            ("start_ns", self.start_ns as f64, 0.0, 4e18),
        ];
        check(&limits, [])
    }
}
