//! The vehicle whose odometry a run reads: the one that the steps of its plan are told.

use evermap_datasets::Dataset;
use evermap_datasets::manifest::Vehicle;
use evermap_language::{Body, Plan, Step};
use evermap_schemas::Fault;
use serde_json::Value;

/// The vehicles that steps of a plan are told, after its manifest, presets and settings: each once, with the first step
/// that is.
pub struct Vehicles(Vec<(Vehicle, String)>);

impl Vehicles {
    /// Those of a plan.
    pub fn of_plan(plan: &Plan) -> Self {
        let mut vehicles: Vec<(Vehicle, String)> = Vec::new();
        for step in &plan.steps {
            let Some(vehicle) = told(step) else {
                continue;
            };
            let is_same = |(known, _): &(Vehicle, String)| known.frame() == vehicle.frame();
            if !vehicles.iter().any(is_same) {
                vehicles.push((vehicle, step.name.clone()));
            }
        }
        Self(vehicles)
    }

    /// The one that logs are read for; `None` where no step is told any, and a manifest alone may say it.
    pub fn first(&self) -> Option<&Vehicle> {
        self.0.first().map(|(vehicle, _)| vehicle)
    }

    /// That steps are told the same where rows of these logs depend on it, as the odometry of a session is of one vehicle.
    ///
    /// # Errors
    /// A user fault that names the steps.
    pub fn agree(&self, given: &Dataset) -> Result<(), Fault> {
        let depends = |vehicle: &Vehicle| !vehicle.frame().is_empty();
        let mut sessions = given.sessions.iter();
        let session = sessions.find(|session| depends(&session.vehicle));
        match (session, self.0.as_slice()) {
            (Some(session), [(first, one), (second, other), ..]) => Err(Fault::user(format!(
                "expected one {} in all steps, as the odometry of session {} is found by it, found {} \
                 (step {one}) and {} (step {other})",
                Vehicle::PARAMETER,
                session.name,
                first.frame(),
                second.frame(),
            ))
            .next(format!(
                "say it once, in `defaults: {{ {}: {} }}` of the plan or of a session manifest",
                Vehicle::PARAMETER,
                first.frame(),
            ))),
            _ => Ok(()),
        }
    }
}

/// The vehicle that a step is told.
fn told(step: &Step) -> Option<Vehicle> {
    let Body::Op { params, .. } = &step.body else {
        return None;
    };
    let frame = params.get(Vehicle::PARAMETER).and_then(Value::as_str)?;
    let vehicle = Vehicle::of_frame(frame);
    (!vehicle.frame().is_empty()).then_some(vehicle)
}
