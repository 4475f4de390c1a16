//! The plan as written: decoded from the tree, names not yet resolved.

mod python;
mod step;
mod table;

use std::collections::BTreeSet;
use std::path::Path;

use crate::fault::{Location, PlanFaults, Position};
use crate::plan::{Body, DEFAULT_TOLERANCE, ManifestPath, Row};
use crate::suggest::quoted;
use crate::vocabulary::{Host, OperatorSpec, Vocabulary};
use crate::yaml::{Entry, Fields, Kind, Node};

pub(crate) use self::step::check_alone;

/// The keys of a plan. A composed one has no `extends`, `drop` and `presets` any more.
const PLAN_KEYS: [&str; 11] = [
    "plan", "extends", "doc", "needs", "sessions", "defaults", "presets", "steps", "drop", "write",
    "tests",
];
/// The keys of a step.
const STEP_KEYS: [&str; 9] = [
    "op", "in", "with", "sql", "python", "grain", "output", "pixels", "once",
];
/// The keys that say what a step does; it has one of them.
pub(crate) const BODY_KEYS: [&str; 3] = ["op", "sql", "python"];
/// The keys of a test.
const TEST_KEYS: [&str; 5] = ["name", "given", "expect", "contains", "tolerance"];
/// More steps than this are refused; checking the graph takes time by its square at worst.
pub(crate) const MOST_STEPS: usize = 4096;

/// A name and where it is written.
#[derive(Debug, Clone)]
pub(crate) struct LocatedName {
    pub name: String,
    pub location: Location,
}

/// A plan whose names are not yet resolved. What was at fault is absent.
pub(crate) struct WrittenPlan {
    pub name: String,
    pub doc: Option<String>,
    pub needs: Vec<LocatedName>,
    pub sessions: Option<ManifestPath>,
    pub steps: Vec<WrittenStep>,
    pub write: Vec<LocatedName>,
    /// Whether all of `write` could be read, so that what it lacks is known to be lacking.
    pub write_is_whole: bool,
    pub tests: Vec<WrittenTest>,
}

pub(crate) struct WrittenStep {
    pub name: LocatedName,
    pub inputs: Vec<WrittenInput>,
    /// What it does; `None` if at fault.
    pub body: Option<Body>,
    /// Where that is written.
    pub body_location: Location,
    /// Whether each session keeps what the step made when it came.
    pub once: bool,
    /// Whether nothing that is written in the step is at fault.
    pub is_sound: bool,
}

/// What a step reads.
pub(crate) struct WrittenInput {
    /// Under which port; `None` for queries.
    pub port: Option<String>,
    pub table: LocatedName,
    /// Whether the port is not named, so that the table of its own name is meant.
    pub is_implied: bool,
}

pub(crate) struct WrittenTest {
    pub name: LocatedName,
    pub given: Vec<(LocatedName, Vec<Row>)>,
    pub expect: Vec<(LocatedName, Vec<Row>)>,
    pub contains: Vec<(LocatedName, Vec<Row>)>,
    pub tolerance: f64,
}

/// What decoding needs beside the tree.
pub(crate) struct Context<'c> {
    pub vocabulary: &'c Vocabulary,
    pub host: &'c dyn Host,
}

/// What steps are decoded with.
struct StepContext<'c> {
    around: &'c Context<'c>,
    /// Parameters for all steps that have them.
    defaults: &'c [Entry],
}

pub(crate) fn plan(
    root: &Node,
    context: &Context<'_>,
    faults: &mut PlanFaults,
) -> Option<WrittenPlan> {
    let fields = Fields::of(root, "the plan", &PLAN_KEYS, faults)?;
    let name = fields
        .require("plan", "the plan", faults)
        .and_then(|entry| {
            entry
                .value
                .text("the name of the plan", faults)
                .map(|name| (entry, name))
        });
    if let Some((entry, name)) = name {
        check_name(name, "a plan", entry.value.location, faults);
    }
    let doc = fields.get("doc");
    let doc = doc.and_then(|entry| entry.value.text("`doc`", faults));
    let needs = fields.get("needs");
    let needs = needs.and_then(|entry| names_of(&entry.value, "`needs`", faults));
    let sessions = fields.get("sessions").and_then(|entry| {
        let (path, location) = (
            entry.value.text("`sessions`", faults)?,
            entry.value.location,
        );
        Some(ManifestPath {
            path: path.to_owned(),
            origin: faults.origin(location).to_owned(),
            from_plan: from_plan(path, location, faults),
        })
    });
    let defaults = fields.get("defaults");
    let defaults = defaults.and_then(|entry| entry.value.mapping("`defaults`", faults));
    let defaults = defaults.unwrap_or_default();
    let steps = fields.require("steps", "the plan", faults);
    let steps = steps.map_or_else(Vec::new, |entry| {
        check_defaults(defaults, &entry.value, context.vocabulary, faults);
        let around = context;
        steps_of(&entry.value, &StepContext { around, defaults }, faults)
    });
    let write = fields.require("write", "the plan", faults);
    let before = faults.error_count();
    let named = write.and_then(|entry| write_of(&entry.value, faults));
    let write_is_whole = named.is_some() && faults.error_count() == before;
    let tests = fields.get("tests");
    let tests = tests.map_or_else(Vec::new, |entry| table::tests(&entry.value, faults));
    Some(WrittenPlan {
        name: name.map_or_else(String::new, |(_, name)| name.to_owned()),
        doc: doc.map(str::to_owned),
        needs: needs.unwrap_or_default(),
        sessions,
        steps,
        write: named.unwrap_or_default(),
        write_is_whole,
        tests,
    })
}

/// Names are `[a-z][a-z0-9_]*`: they are names of tables, files and columns.
fn check_name(name: &str, what: &str, location: Location, faults: &mut PlanFaults) -> bool {
    const LONGEST: usize = 64;
    let starts_well = name.starts_with(|c: char| c.is_ascii_lowercase());
    let continues_well = name
        .chars()
        .all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_');
    if starts_well && continues_well && name.len() <= LONGEST {
        return true;
    }
    if name.len() > LONGEST {
        faults.error(
            location,
            format!("the name of {what} has more than {LONGEST} letters"),
        );
        return false;
    }
    let message = format!(
        "the name of {what} is lower-case letters, digits and `_`, starting with a letter, \
         found {}",
        quoted(name)
    );
    match mended(name) {
        Some(mended) => faults.error_with(location, message, format!("did you mean `{mended}`?")),
        None => faults.error(location, message),
    }
    false
}

/// The nearest name that is allowed.
fn mended(name: &str) -> Option<String> {
    let fit = |c: char| {
        if c.is_ascii_alphanumeric() {
            c.to_ascii_lowercase()
        } else {
            '_'
        }
    };
    let mended: String = name.chars().map(fit).collect();
    let mended = mended.trim_start_matches(|c: char| !c.is_ascii_lowercase());
    (!mended.is_empty()).then(|| mended.to_owned())
}

/// A default is a parameter of some step. One that is taken over need not be: the step that had
/// it may have been dropped.
fn check_defaults(
    defaults: &[Entry],
    steps: &Node,
    vocabulary: &Vocabulary,
    faults: &mut PlanFaults,
) {
    let Kind::Mapping(steps) = &steps.kind else {
        return;
    };
    let operator = |step: &Entry| match &step.value.get("op")?.value.kind {
        Kind::Text(name) => vocabulary.operator(name),
        _ => None,
    };
    let operators = steps.iter().filter_map(operator);
    let known: BTreeSet<&str> = operators.flat_map(OperatorSpec::parameter_names).collect();
    for default in defaults.iter().filter(|default| default.is_own()) {
        if !known.contains(default.key.as_str()) {
            let name = quoted(&default.key);
            let message = format!("`defaults` sets {name}, which is a parameter of no step");
            let known = known.iter().copied();
            faults.unknown(default.location, message, &default.key, known);
        }
    }
}

fn steps_of(node: &Node, context: &StepContext<'_>, faults: &mut PlanFaults) -> Vec<WrittenStep> {
    let Some(entries) = node.mapping("`steps`", faults) else {
        return Vec::new();
    };
    if entries.is_empty() {
        faults.error(node.location, "`steps` must have at least one step");
    }
    if entries.len() > MOST_STEPS {
        let message = format!("more than {MOST_STEPS} steps");
        faults.error(node.location, message);
        return Vec::new();
    }
    let mut steps = Vec::new();
    for entry in entries {
        let before = faults.error_count();
        check_name(&entry.key, "a step", entry.location, faults);
        if let Some(other) = context.around.vocabulary.taken_by(&entry.key) {
            let name = quoted(&entry.key);
            faults.error(
                entry.location,
                format!("a step cannot be named {name}: that is {other}"),
            );
        }
        let mut step = step::step(entry, context, faults);
        step.is_sound = faults.error_count() == before;
        steps.push(step);
    }
    steps
}

fn write_of(node: &Node, faults: &mut PlanFaults) -> Option<Vec<LocatedName>> {
    let names = names_of(node, "`write`", faults)?;
    if node.sequence("`write`", faults)?.is_empty() {
        faults.error(node.location, "`write` must name at least one step");
        return None;
    }
    Some(names)
}

/// A list of names under a key.
fn names_of(node: &Node, key: &str, faults: &mut PlanFaults) -> Option<Vec<LocatedName>> {
    let items = node.sequence(key, faults)?;
    let named = |item: &Node| {
        let name = item.text(&format!("an item of {key}"), faults)?.to_owned();
        let location = item.location;
        Some(LocatedName { name, location })
    };
    Some(items.iter().filter_map(named).collect())
}

fn tolerance(fields: &Fields<'_>, faults: &mut PlanFaults) -> f64 {
    let Some(entry) = fields.get("tolerance") else {
        return DEFAULT_TOLERANCE;
    };
    match entry.value.number("`tolerance`", faults) {
        Some(value) if value >= 0.0 && value.is_finite() => value,
        Some(_) => {
            let found = entry.value.described();
            let message = format!("`tolerance` must be at least 0 and finite, found {found}");
            faults.error(entry.value.location, message);
            DEFAULT_TOLERANCE
        }
        None => DEFAULT_TOLERANCE,
    }
}

/// The path of a file, which is relative to the text at a location, relative to the plan itself.
fn from_plan(file: &str, location: Location, faults: &PlanFaults) -> String {
    let folder = |location| Path::new(faults.origin(location)).parent();
    let there = folder(location).unwrap_or(Path::new(""));
    let here = folder(Location::Text(Position::start_of(0))).unwrap_or(Path::new(""));
    match there.strip_prefix(here).unwrap_or(there) {
        same if same == Path::new("") => file.to_owned(),
        other => other.join(file).display().to_string(),
    }
}

/// An entry that may be left empty: `in:` with nothing after it.
fn is_null(node: &Node) -> bool {
    node.kind == Kind::Null
}
