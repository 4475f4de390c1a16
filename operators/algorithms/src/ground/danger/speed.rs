//! From the probability of a person to a recommended speed.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// How fast to drive where nobody is expected, and where somebody is.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct SpeedParams {
    /// Speed where a person is to be expected (m/s): that of a person walking, so that nobody is run into from behind.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub min_mps: f64,
    /// Speed where nobody is (m/s): 10 km/h, the customary limit of car parks.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub max_mps: f64,
    /// Time before the vehicle brakes (s).
    #[schemars(range(min = 0.0))]
    pub reaction_s: f64,
    /// How it brakes then (m/s²): firmly, on a floor that may be wet.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub braking_mps2: f64,
    /// Width that it sweeps (m): a car's with its mirrors.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub vehicle_m: f64,
}

impl Default for SpeedParams {
    fn default() -> Self {
        Self {
            min_mps: 1.4,
            max_mps: 2.8,
            reaction_s: 1.0,
            braking_mps2: 3.0,
            vehicle_m: 2.0,
        }
    }
}

/// Why speeds make no sense.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[error("expected min_mps to be at most max_mps, found {min_mps} and {max_mps}")]
pub struct SpeedParamsError {
    min_mps: f64,
    max_mps: f64,
}

impl SpeedParams {
    /// Whether the speeds make sense together.
    ///
    /// # Errors
    /// [`SpeedParamsError`] when the lowest is the higher one.
    pub fn check(&self) -> Result<(), SpeedParamsError> {
        let (min_mps, max_mps) = (self.min_mps, self.max_mps);
        let sound = min_mps <= max_mps;
        sound
            .then_some(())
            .ok_or(SpeedParamsError { min_mps, max_mps })
    }

    /// The probability of a person in one cell at which one is expected, on average, in what the vehicle sweeps before it
    /// stands, were all of that like this cell: one over the number of its cells.
    pub fn full_danger(&self, cell_m: f64) -> f64 {
        let stopping_m = self.max_mps * self.reaction_s
            + self.max_mps * self.max_mps / (2.0 * self.braking_mps2);
        (cell_m * cell_m / (stopping_m * self.vehicle_m)).min(1.0)
    }

    /// Metres per second, linear in the probability: `max_mps` at 0, `min_mps` from [`SpeedParams::full_danger`] on.
    pub fn speed(&self, danger: f64, cell_m: f64) -> f64 {
        let share = (danger / self.full_danger(cell_m)).clamp(0.0, 1.0);
        self.max_mps - share * (self.max_mps - self.min_mps)
    }
}
