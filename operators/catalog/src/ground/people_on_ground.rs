#![doc = include_str!("people_on_ground.md")]

use std::collections::BTreeMap;

use evermap_algorithms::geometry::pose::Pose;
use evermap_algorithms::ground::people::placing;
use evermap_contract::{Fault, Operator, Port, Reason, Sides, Work};
use evermap_schemas::Stamp;
use evermap_schemas::layers::{Person, PersonOnGround, VehiclePose};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// See the module's page.
pub struct PeopleOnGround;

/// What is not known of the vehicle's poses.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct PoseNoise {
    /// Standard deviation of their places, along each axis (m).
    #[schemars(range(min = 0.0, max = 100.0))]
    pub place_sd_m: f64,
    /// Standard deviation of their headings (rad).
    #[schemars(range(min = 0.0, max = 3.0))]
    pub heading_sd_rad: f64,
}

impl Default for PoseNoise {
    fn default() -> Self {
        Self {
            place_sd_m: 0.05,
            heading_sd_rad: 0.005,
        }
    }
}

impl Operator for PeopleOnGround {
    const NAME: &'static str = "people_on_ground";
    const VERSION: u32 = 1;
    const PAGE: &'static str = include_str!("people_on_ground.md");
    type Params = PoseNoise;
    type Output = PersonOnGround;

    fn work() -> Work<Self::Params> {
        let people = Port::session::<Person>("people");
        let poses = Port::session::<VehiclePose>("poses");
        Work::each_row(people, vec![poses], Placing::new, Placing::placed)
    }
}

struct Placing {
    noise: PoseNoise,
    /// By session and stamp.
    poses: BTreeMap<(String, Stamp), Pose>,
}

impl Placing {
    fn new(noise: &PoseNoise, sides: &Sides) -> Result<Self, Fault> {
        let rows: Vec<VehiclePose> = sides.rows("poses")?;
        let pose = |row: VehiclePose| {
            let pose = Pose::from_array(row.map_from_vehicle.to_array()).ok()?;
            Some(((row.session, row.stamp), pose))
        };
        Ok(Self {
            noise: noise.clone(),
            poses: rows.into_iter().filter_map(pose).collect(),
        })
    }

    fn placed(&self, person: Person) -> Result<[PersonOnGround; 1], Reason> {
        let key = (person.session.clone(), person.stamp);
        let pose = self
            .poses
            .get(&key)
            .ok_or("vehicle has no pose in the map")?;
        let numbers = [
            person.x,
            person.y,
            person.z,
            person.var_x_m2,
            person.cov_xy_m2,
            person.var_y_m2,
        ];
        if numbers.iter().any(|number| !number.is_finite()) {
            return Err("person without a position");
        }
        let [x, y, z, xx, xy, yy] = numbers;
        let at = pose.transform(&nalgebra::Vector3::new(x, y, z));
        let noise = [self.noise.place_sd_m, self.noise.heading_sd_rad];
        let covariance = placing::in_map([xx, xy, yy], [x, y], pose.yaw(), noise);
        Ok([PersonOnGround {
            site: person.site,
            session: person.session,
            stamp: person.stamp,
            camera: person.camera,
            person: person.person,
            x: at.x,
            y: at.y,
            z: at.z,
            var_x_m2: covariance[0],
            cov_xy_m2: covariance[1],
            var_y_m2: covariance[2],
            range_m: person.range_m,
            probability: person.probability,
        }])
    }
}
