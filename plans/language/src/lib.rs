//! Plans: YAML text to a checked graph of steps, with all faults at once.
//!
//! ```text
//! text ──yaml──▶ tree with positions ──extends──▶ composed ──manifest, set──▶ ──written──▶ names ──graph──▶ Plan
//!                └────────────── every stage records faults and goes on ──────────────▶ PlanFaults
//! ```
//!
//! This crate knows no operator, no table, no SQL and no file: a [`Vocabulary`] describes
//! operators (ports, parameters as JSON Schema) and sources, and a [`Host`] is asked which
//! tables a query names, what is wrong with parameters, for the text of a plan that another
//! extends or of a file of Python that a step names, and for files that parameters name. It depends on neither DataFusion nor Arrow.
//!
//! ```
//! use evermap_language::{Host, ParameterFault, QueryFault, Source, Vocabulary, parse};
//!
//! struct Tables;
//! impl Host for Tables {
//!     fn tables(&self, _query: &str) -> Result<Vec<String>, QueryFault> {
//!         Ok(vec!["pose".to_owned()])
//!     }
//!     fn parameter_faults(&self, _: &str, _: &serde_json::Value) -> Vec<ParameterFault> {
//!         vec![]
//!     }
//!     fn plan(&self, name: &str, _: &str) -> Result<Source, String> {
//!         Err(format!("there is no plan {name}"))
//!     }
//! }
//!
//! let vocabulary = Vocabulary { sources: vec!["poses".into()], ..Vocabulary::default() };
//! let text = "plan: count\nsteps:\n  counts: { sql: SELECT count(*) FROM pose }\nwrite: [count]";
//! let source = Source { origin: "count.yaml".into(), text: text.into() };
//! let faults = parse(&source, &[], &vocabulary, &Tables).unwrap_err();
//! assert_eq!(
//!     faults.to_string(),
//!     "count.yaml:3:39: the query of `counts` reads `pose`, which is neither a step nor a \
//!      source; did you mean `poses`?\n\
//!      count.yaml:4:9: `write` names `count`, which is not a step; did you mean `counts`?\n"
//! );
//! ```

mod editor;
mod extends;
mod fault;
mod graph;
mod inside;
mod manifest;
mod plan;
mod preset;
mod print;
mod setting;
mod suggest;
mod vocabulary;
mod written;
mod yaml;

pub use editor::json_schema;
pub use fault::{Location, PlanFault, PlanFaults, Position, Severity, Source};
pub use inside::QueryPosition;
pub use manifest::{entry_position, role_positions};
pub use plan::{
    Body, DEFAULT_TOLERANCE, Grain, Input, ManifestPath, Plan, PlanTest, PythonStep, Row, Step,
};
pub use print::wrapped;
pub use suggest::{listed, nearest};
pub use vocabulary::{Host, OperatorSpec, ParameterFault, PortSpec, QueryFault, Vocabulary};
pub use yaml::LONGEST_TEXT;

/// Reads and checks a plan, with all that it extends, and the `defaults` of the session manifest that the host has.
///
/// `settings` are options that replace parameters before checking: `step.param=value`, or the name of a preset.
///
/// # Errors
/// Every fault found, warnings included, if one of them is an error. Warnings alone are in
/// [`Plan::warnings`].
pub fn parse(
    source: &Source,
    settings: &[String],
    vocabulary: &Vocabulary,
    host: &dyn Host,
) -> Result<Plan, PlanFaults> {
    let (plan, faults) = read(source, settings, vocabulary, host);
    let (mut plan, warnings) = faults.into_result(plan)?;
    plan.warnings = warnings;
    Ok(plan)
}

/// As [`parse`], for a check that goes on where the text is at fault: all faults, and the plan of the steps and tests that
/// have none, nor read a step that has one. `None` for a text that is no plan at all.
pub fn read(
    source: &Source,
    settings: &[String],
    vocabulary: &Vocabulary,
    host: &dyn Host,
) -> (Option<Plan>, PlanFaults) {
    let mut faults = PlanFaults::default().with_settings(settings);
    let context = written::Context { vocabulary, host };
    let plan = extends::read(source, host, &mut faults).and_then(|mut root| {
        if let Some(manifest) = host.manifest() {
            manifest::lay(&mut root, &manifest, vocabulary, &mut faults);
        }
        setting::set(&mut root, settings, &context, &mut faults);
        let written = written::plan(&root, &context, &mut faults)?;
        Some(graph::plan(written, vocabulary, &mut faults))
    });
    (plan, faults)
}

/// The text of a file's bytes.
///
/// # Errors
/// A fault at the first byte that is not UTF-8.
pub fn utf8<'b>(bytes: &'b [u8], origin: &str) -> Result<&'b str, PlanFaults> {
    std::str::from_utf8(bytes).map_err(|error| {
        let sound = bytes.get(..error.valid_up_to()).unwrap_or_default();
        let sound = String::from_utf8_lossy(sound).into_owned();
        let line = sound.matches('\n').count() + 1;
        let last = sound.rsplit('\n').next();
        let column = last.map_or(0, |last| last.chars().count()) + 1;
        let mut faults = PlanFaults::default();
        let source = faults.open(Source {
            origin: origin.to_owned(),
            text: sound,
        });
        let location = Location::Text(Position {
            source,
            line,
            column,
        });
        faults.error_with(location, "not UTF-8 text", "save the file as UTF-8");
        faults
    })
}
