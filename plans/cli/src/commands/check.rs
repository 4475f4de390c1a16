//! `evermap check`, `test` and `schema`.

use std::io::Write;

use datafusion::execution::runtime_env::RuntimeEnv;
use evermap_contract::Registry;
use evermap_datasets::{Dataset, Manifest};
use evermap_engine::plan_test::{given_faults, run_tests};
use evermap_engine::preflight::players::Players;
use evermap_engine::preflight::{Needs, idle, in_words, unknown};
use evermap_engine::prepare::{self, vocabulary};
use evermap_engine::program::Program;
use evermap_language::{Plan, json_schema};
use evermap_schemas::Fault;
use evermap_schemas::roles::{calibration, frames, odometry};
use serde_json::Value;

use crate::arguments::{PlanArgs, SchemaKind};
use crate::ending::{DONE, Ending, Failure};
use crate::progress::line;
use crate::quantity::of;
use crate::sessions::{lost, open};
use crate::shipped;
use crate::{camera_frames, clocks, fixes, masks, odometry_frame, operators, pictures};

/// Checks a plan.
///
/// # Errors
/// All its faults.
pub async fn check(args: &PlanArgs) -> Ending {
    let registry = operators::registry();
    let (parsed, program, dataset) = checked(args, &registry).await?;
    let given = given_faults(&parsed, &program, &registry, &dataset).await?;
    if !given.is_empty() {
        return Err(Failure::Plan(given.pretty()));
    }
    if let Some(warning) = masks::warning(&masks::masked(&program), &dataset).await? {
        line(&format!("warning: {warning}"));
    }
    let vehicle = odometry_frame::vehicle(&program);
    let of_odometry = odometry_frame::notes(&dataset, vehicle).await?;
    let unmoved = match program.reads_source(odometry::ROLE.name) {
        true => odometry_frame::unmoved(&dataset).await.1,
        false => Vec::new(),
    };
    let roles = [calibration::ROLE, frames::ROLE];
    let of_cameras = match roles.iter().any(|role| program.reads_source(role.name)) {
        true => camera_frames::notes(&dataset, vehicle).await?,
        false => Vec::new(),
    };
    let of_pictures = match program.reads_source(frames::ROLE.name) {
        true => pictures::notes(&dataset).await?,
        false => Vec::new(),
    };
    let of_fixes = fixes::notes(&dataset, &program).await?;
    let of_clocks = clocks::notes(&dataset, |role| program.reads_source(role)).await;
    let notes = [
        of_odometry,
        unmoved,
        of_clocks,
        of_cameras,
        of_pictures,
        of_fixes,
    ];
    for note in notes.iter().flatten() {
        line(&format!("note: {note}"));
    }
    let players = Players::of(&dataset, std::iter::empty());
    let sites = players.sites();
    if let Some(warning) = unknown::origins(&program, &sites) {
        line(&format!("warning: {warning}"));
    }
    let needs = Needs::of_program(&program, &registry, &sites);
    let idle = idle(&needs, &dataset, &players)?;
    for (session, lacks) in &idle {
        let lacks = in_words(lacks);
        line(&format!(
            "warning: the plan cannot use session {session}: it lacks {lacks}"
        ));
    }
    for note in needs.untold(&dataset, &players, &idle) {
        line(&format!("note: {note}"));
    }
    if !dataset.sessions.is_empty() {
        let unplayed = needs.unplayed(&program, &players.all());
        unplayed.notes().iter().for_each(|note| line(note));
    }
    if !parsed.warnings.is_empty() {
        line(parsed.warnings.pretty().trim_end());
    }
    let (steps, layers) = (
        of(parsed.steps.len() as u64, "step"),
        of(parsed.write.len() as u64, "layer"),
    );
    writeln!(
        std::io::stdout(),
        "{}: {steps}, {layers}, no faults",
        parsed.name
    )?;
    Ok(lost([&dataset]))
}

/// The plan, its program, and the sessions that it was checked on; its own faults are told before any log is opened.
async fn checked(
    args: &PlanArgs,
    registry: &Registry,
) -> Result<(Plan, Program, Dataset), Failure> {
    let plan = shipped::of(args)?;
    prepare::check_text(&plan, registry).await?;
    let vehicle = prepare::vehicle_of(&plan, registry)?;
    let dataset = open(&RuntimeEnv::default(), &args.sessions, vehicle).await?;
    let (parsed, program) = prepare::check(&plan, registry, &dataset).await?;
    Ok((parsed, program, dataset))
}

/// Runs the tests of a plan.
///
/// # Errors
/// That one fails, or what keeps them from being run.
pub async fn test(args: &PlanArgs) -> Ending {
    let registry = operators::registry();
    let (parsed, program, dataset) = checked(args, &registry).await?;
    let outcomes = run_tests(&parsed, &program, &registry, &dataset).await?;
    let mut stdout = std::io::stdout().lock();
    for outcome in &outcomes {
        match &outcome.failure {
            None => writeln!(stdout, "ok      {}", outcome.name)?,
            Some(difference) => writeln!(stdout, "FAILED  {}: {difference}", outcome.name)?,
        }
    }
    let failed = outcomes
        .iter()
        .filter(|outcome| outcome.failure.is_some())
        .count();
    if outcomes.is_empty() {
        line(&format!("{} has no tests", parsed.name));
    }
    if failed > 0 {
        line(&format!(
            "error: {failed} of {} failed",
            of(outcomes.len() as u64, "test")
        ));
        return Err(Failure::Said);
    }
    DONE
}

/// Prints the JSON Schema of plans, or of session manifests.
///
/// # Errors
/// That the output is closed.
pub fn schema(of: SchemaKind) -> Ending {
    let mut schema = json_schema(&vocabulary(&operators::registry()));
    if of == SchemaKind::Manifest {
        schema = manifest_schema(&schema);
    }
    let text =
        serde_json::to_string_pretty(&schema).map_err(|error| Fault::bug(error.to_string()))?;
    writeln!(std::io::stdout(), "{text}")?;
    DONE
}

/// The JSON Schema of manifests, with the parameters that the schema of plans has.
fn manifest_schema(plans: &Value) -> Value {
    let mut schema = Manifest::json_schema();
    let parameters = &plans["properties"]["defaults"]["properties"];
    schema["properties"]["defaults"]["properties"] = parameters.clone();
    schema["properties"]["defaults"]["additionalProperties"] = Value::Bool(false);
    for (name, definition) in plans["$defs"].as_object().into_iter().flatten() {
        schema["$defs"][name] = definition.clone();
    }
    schema
}
