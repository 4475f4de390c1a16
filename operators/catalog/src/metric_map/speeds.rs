#![doc = include_str!("speeds.md")]

use evermap_algorithms::metric_map::drive;
use evermap_contract::{Key, Operator, Port, Work};
use evermap_schemas::{layers::Speed, roles::OdometryPose};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// See the module's page.
pub struct Speeds;

/// How odometry is smoothed.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct SpeedsParams {
    /// Poses count that are at most half of this before or after an instant (s).
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub window_s: f64,
}

impl Default for SpeedsParams {
    fn default() -> Self {
        Self { window_s: 0.5 }
    }
}

impl Operator for Speeds {
    const NAME: &'static str = "speeds";
    const VERSION: u32 = 2;
    const PAGE: &'static str = include_str!("speeds.md");
    type Params = SpeedsParams;
    type Output = Speed;

    fn work() -> Work<SpeedsParams> {
        let odometry = Port::session::<OdometryPose>("odometry");
        Work::group(odometry, Key::SESSION, vec![], |params, rows, _, emit| {
            let pose = |row: &OdometryPose| (row.stamp.0, row.odom_from_vehicle.to_array());
            let path: Vec<_> = rows.iter().map(pose).collect();
            let mut speeds = Vec::with_capacity(rows.len());
            for (row, found) in rows.into_iter().zip(drive::speeds(&path, params.window_s)) {
                match found {
                    Some(found) => speeds.push(Speed {
                        site: row.site,
                        session: row.session,
                        stamp: row.stamp,
                        speed_mps: found.speed_mps,
                        acceleration_mps2: found.acceleration_mps2,
                    }),
                    None => emit.skip("odometry pose without a speed", 1),
                }
            }
            emit.rows(speeds)
        })
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use evermap_contract::{Entry, laws};

    #[test]
    fn the_example_and_the_laws_hold() {
        laws::check(&Entry::of::<Speeds>()).unwrap();
    }
}
