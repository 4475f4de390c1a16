//! What can be asked of the street.

use crate::WorldError;
use crate::error::check;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Parameters of the simulated street. The same parameters give byte-identical files.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Street {
    /// Everything random is drawn from this number.
    pub seed: u64,
    /// Sessions `visit_a`, `visit_b`, …, years apart: the street stays, cars, light and where
    /// on the lane one drives do not.
    #[schemars(range(min = 1, max = 26))]
    pub visits: usize,
    /// Length of the street, a closed loop, metres.
    #[schemars(range(min = 80.0, max = 1e6))]
    pub length_m: f64,
    /// Distance between panoramas, metres.
    #[schemars(range(min = 0.1, max = 100.0))]
    pub spacing_m: f64,
    /// Width of the panoramas, pixels; it covers 360°.
    #[schemars(range(min = 64, max = 8192))]
    pub width_px: u32,
    /// Height of the panoramas, pixels.
    #[schemars(range(min = 16, max = 4096))]
    pub height_px: u32,
    /// Cars on 100 m of street in each visit, most of them parked.
    #[schemars(range(min = 0.0, max = 60.0))]
    pub cars: f64,
    /// Share of wrong pixels in the noisy labels.
    #[schemars(range(min = 0.0, max = 0.6))]
    pub label_noise: f64,
    /// Of what misleads the labeller for a whole visit, the share that does so in every visit: the rest is another in each,
    /// as light and seasons are.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub repeated_mistakes: f64,
    /// Whether colour and depth panoramas are made too; without them 13,000 views take minutes.
    pub colour: bool,
    /// Speed on straight streets, m/s; bends are taken slower.
    #[schemars(range(min = 0.5, max = 10.0))]
    pub speed_mps: f64,
    /// Rate of the wheel odometry, messages per second.
    #[schemars(range(min = 1.0, max = 1000.0))]
    pub odometry_rate_hz: f64,
    /// JPEG quality.
    #[schemars(range(min = 1, max = 100))]
    pub jpeg_quality: u8,
    /// Nanoseconds since the epoch at which the first visit starts; the others follow three
    /// years apart.
    #[schemars(range(min = 0, max = 4_000_000_000_000_000_000_u64))]
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
            repeated_mistakes: 0.5,
            colour: true,
            speed_mps: 2.5,
            odometry_rate_hz: 50.0,
            jpeg_quality: 85,
            start_ns: 1_500_000_000_000_000_000,
        }
    }
}

impl Street {
    /// Panoramas of each visit.
    pub fn views(&self) -> usize {
        ((self.length_m / self.spacing_m).floor() as usize).max(1)
    }

    /// Refuses values that make no world, all at once.
    ///
    /// # Errors
    /// [`WorldError::Parameters`] with one line for each unusable value.
    pub fn check(&self) -> Result<(), WorldError> {
        let (half, height) = (self.width_px / 2, self.height_px);
        let tall = (height > half).then(|| {
            format!("height_px: expected at most {half} (half the width), found {height}")
        });
        check(self, [tall])
    }
}
