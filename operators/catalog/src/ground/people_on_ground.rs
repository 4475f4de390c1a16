#![doc = include_str!("people_on_ground.md")]

use std::collections::BTreeMap;

use evermap_algorithms::geometry::pose::Pose;
use evermap_algorithms::ground::floor::Floor;
use evermap_algorithms::ground::people::placing;
use evermap_contract::{Fault, Operator, Port, Reach, Reason, Sides, Work};
use evermap_schemas::Stamp;
use evermap_schemas::layers::{Person, PersonOnGround, VehiclePose};
use nalgebra::Vector3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::inputs::floors::floors;
use crate::inputs::rig::{self, OfVehicle, Rig, frame};

/// See the module's page.
pub struct PeopleOnGround;

/// Where the ground is, and what is not known of the vehicle's poses.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct PlacingParams {
    /// Standard deviation of their places, along each axis (m).
    #[schemars(range(min = 0.0, max = 100.0))]
    pub place_sd_m: f64,
    /// Standard deviation of their headings (rad).
    #[schemars(range(min = 0.0, max = 3.0))]
    pub heading_sd_rad: f64,
    /// Height of the ground in the vehicle frame (m): 0 where that frame lies on it.
    #[schemars(range(min = -100.0, max = 100.0))]
    pub plane_m: f64,
}

impl Default for PlacingParams {
    fn default() -> Self {
        Self {
            place_sd_m: 0.05,
            heading_sd_rad: 0.005,
            plane_m: 0.0,
        }
    }
}

impl Operator for PeopleOnGround {
    const NAME: &'static str = "people_on_ground";
    const VERSION: u32 = 2;
    const PAGE: &'static str = include_str!("people_on_ground.md");
    type Params = OfVehicle<PlacingParams>;
    type Output = PersonOnGround;

    fn work() -> Work<Self::Params> {
        let people = Port::session::<Person>("people");
        let poses = Port::session::<VehiclePose>("poses");
        let mut sides = vec![poses];
        sides.extend(rig::ports(Reach::Session).map(Port::optional));
        Work::each_row(people, sides, Placing::new, Placing::placed)
    }
}

/// The floor is asked for this far from where the vehicle drove (m): people are hardly found farther away.
const REACH_M: f64 = 24.0;

struct Placing {
    params: OfVehicle<PlacingParams>,
    /// By session and stamp.
    poses: BTreeMap<(String, Stamp), Pose>,
    /// By session.
    floors: BTreeMap<String, Floor>,
    rigs: BTreeMap<String, Rig>,
}

impl Placing {
    fn new(params: &OfVehicle<PlacingParams>, sides: &Sides) -> Result<Self, Fault> {
        let rows: Vec<VehiclePose> = sides.rows("poses")?;
        let floors = floors(&rows, params.options.plane_m, REACH_M);
        let pose = |row: VehiclePose| {
            let pose = Pose::from_array(row.map_from_vehicle.to_array()).ok()?;
            Some(((row.session, row.stamp), pose))
        };
        Ok(Self {
            params: params.clone(),
            floors,
            rigs: rig::rigs(sides.rows("calibration")?, sides.rows("transforms")?),
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
            return Err("person without a position".into());
        }
        let [x, y, z, xx, xy, yy] = numbers;
        let flat = pose.transform(&Vector3::new(x, y, z));
        let at = self.on_floor(&person, pose, &flat).unwrap_or(flat);
        let PlacingParams {
            place_sd_m,
            heading_sd_rad,
            ..
        } = self.params.options;
        let noise = [place_sd_m, heading_sd_rad];
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

    /// Where the line of sight to a person meets the floor; `None` where the floor is not known, or where the camera sits.
    fn on_floor(&self, person: &Person, pose: &Pose, flat: &Vector3<f64>) -> Option<Vector3<f64>> {
        let (vehicle, camera) = (self.params.vehicle.name(), frame(&person.camera));
        let rig = self.rigs.get(&person.session)?;
        let mounted = rig.vehicle_from_image(vehicle, camera, person.stamp).ok()?;
        let floor = self.floors.get(&person.session)?;
        floor.met_by(&pose.transform(&mounted.translation), flat)
    }
}
