//! Plans: YAML text to a checked graph of steps, with all faults at once.
//!
//! ```text
//! text ──yaml::read──▶ tree with positions ──set──▶ ──written──▶ names ──graph──▶ Plan
//!                      └──────────── every stage records faults and goes on ──────────▶ Faults
//! ```
//!
//! This crate knows no operator, no table and no SQL: a [`Vocabulary`] describes operators
//! (ports, parameters as JSON Schema) and sources, and a callback lists the tables that a
//! query names. It depends on neither DataFusion nor Arrow.
//!
//! ```
//! use evermap_language::{Vocabulary, parse};
//!
//! let vocabulary = Vocabulary { sources: vec!["poses".into()], ..Vocabulary::default() };
//! let text = "plan: count\nsteps:\n  counts: { sql: SELECT count(*) FROM pose }\nwrite: [count]";
//! let tables = |_: &str| Ok(vec!["pose".to_owned()]);
//! let faults = parse(text, "count.yaml", &vocabulary, &tables, &[]).unwrap_err();
//! assert_eq!(
//!     faults.to_string(),
//!     "count.yaml:3:18: the query of `counts` reads `pose`, which is neither a step nor a \
//!      source; did you mean `poses`?\n\
//!      count.yaml:4:9: `write` names `count`, which is no step; did you mean `counts`?\n"
//! );
//! ```

mod editor;
mod fault;
mod graph;
mod plan;
pub mod schema;
mod setting;
mod suggest;
mod vocabulary;
mod written;
pub mod yaml;

pub use editor::json_schema;
pub use fault::{Fault, Faults, Place, Position, Severity};
pub use plan::{Body, DEFAULT_TOLERANCE, Input, Plan, PlanTest, Row, Step};
pub use setting::set;
pub use vocabulary::{OperatorSpec, PortSpec, Vocabulary};

/// Lists the tables a query reads (not those it defines itself with `WITH`), under the names
/// that steps and sources have: `poses`, `/odom`, `previous.lanes`. Its error is one sentence.
pub type SqlTables<'a> = &'a dyn Fn(&str) -> Result<Vec<String>, String>;

/// Reads and checks a plan.
///
/// `origin` names the text in messages. `settings` are `step.param=value` options that
/// replace parameters before checking, see [`set`].
///
/// # Errors
/// Every fault found, warnings included, if one of them is an error. Warnings alone are in
/// [`Plan::warnings`].
pub fn parse(
    text: &str,
    origin: &str,
    vocabulary: &Vocabulary,
    sql_tables: SqlTables<'_>,
    settings: &[String],
) -> Result<Plan, Faults> {
    let mut faults = Faults::new(origin, text).with_settings(settings);
    let context = written::Context {
        vocabulary,
        sql_tables,
    };
    let plan = yaml::read(text, &mut faults).and_then(|mut root| {
        set(&mut root, settings, &mut faults);
        let written = written::plan(&root, &context, &mut faults)?;
        graph::plan(written, vocabulary, &mut faults)
    });
    let (mut plan, warnings) = faults.into_result(plan)?;
    plan.warnings = warnings;
    Ok(plan)
}

/// The text of a file's bytes.
///
/// # Errors
/// A fault at the first byte that is not UTF-8.
pub fn utf8<'b>(bytes: &'b [u8], origin: &str) -> Result<&'b str, Faults> {
    std::str::from_utf8(bytes).map_err(|error| {
        let sound = bytes.get(..error.valid_up_to()).unwrap_or_default();
        let sound = String::from_utf8_lossy(sound);
        let line = sound.matches('\n').count() + 1;
        let column = sound
            .rsplit('\n')
            .next()
            .map_or(0, |last| last.chars().count())
            + 1;
        let mut faults = Faults::new(origin, &sound);
        let place = Place::Text(Position { line, column });
        faults.error_with(place, "not UTF-8 text", "save the file as UTF-8");
        faults
    })
}
