#![doc = include_str!("stops.md")]

use evermap_contract::{Emit, Fault, Key, Operator, Port, Sides, Work};
use evermap_schemas::layers::Speed;
use evermap_schemas::{Stamp, record};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

record! {
    /// Where in time a vehicle stood.
    #[layer("stops", key(site, session, stamp))]
    pub struct Stop {
        /// Site.
        site: String,
        /// Session that was driven.
        session: String,
        /// When it came to stand.
        stamp: Stamp ["ns"],
        /// How long it stood.
        duration_s: f64 ["s"],
    }
}

/// See the module's page.
pub struct Stops;

/// What counts as standing.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct StopsParams {
    /// Who is slower than this (m/s) stands. Odometry of wheels has steps of about 0.05 m/s.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub below_mps: f64,
    /// Shorter stops (s) are left out.
    #[schemars(range(min = 0))]
    pub least_s: f64,
}

impl Default for StopsParams {
    fn default() -> Self {
        Self {
            below_mps: 0.1,
            least_s: 1.0,
        }
    }
}

impl Operator for Stops {
    const NAME: &'static str = "stops";
    const VERSION: u32 = 1;
    const PAGE: &'static str = include_str!("stops.md");
    type Params = StopsParams;
    type Output = Stop;

    fn work() -> Work<StopsParams> {
        let speeds = Port::session::<Speed>("speeds");
        Work::group(speeds, Key::SESSION, vec![], stops)
    }
}

fn stops(
    params: &StopsParams,
    speeds: Vec<Speed>,
    _: Sides,
    emit: &mut Emit<'_>,
) -> Result<(), Fault> {
    let stands = |speed: &Speed| speed.speed_mps.abs() < params.below_mps;
    let stood = speeds.chunk_by(|one, next| stands(one) == stands(next));
    let stop = |run: &[Speed]| {
        let (first, last) = (run.first().filter(|first| stands(first))?, run.last()?);
        Some(Stop {
            site: first.site.clone(),
            session: first.session.clone(),
            stamp: first.stamp,
            duration_s: (last.stamp.0 - first.stamp.0) as f64 * 1e-9,
        })
    };
    let long = |stop: &Stop| stop.duration_s >= params.least_s;
    emit.rows(stood.filter_map(stop).filter(long).collect())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use evermap_contract::{Entry, laws};

    #[test]
    fn the_example_and_the_laws_hold() {
        laws::check(&Entry::of::<Stops>()).unwrap();
    }
}
