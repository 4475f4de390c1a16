//! One step: an operator with ports and parameters, or a query.

use std::collections::{BTreeMap, BTreeSet};

use serde_json::{Map, Value};

use super::{Context, Named, STEP_KEYS, WrittenStep, is_null};
use crate::fault::Faults;
use crate::plan::Body;
use crate::schema;
use crate::suggest::{listed, quoted};
use crate::vocabulary::OperatorSpec;
use crate::yaml::{Entry, Fields, Kind, Node};

pub(super) fn step(entry: &Entry, context: &Context<'_>, faults: &mut Faults) -> WrittenStep {
    let mut step = WrittenStep {
        name: Named {
            name: entry.key.clone(),
            place: entry.place,
        },
        inputs: Vec::new(),
        body: None,
    };
    let what = format!("step {}", quoted(&entry.key));
    let Some(fields) = Fields::of(&entry.value, &what, &STEP_KEYS, faults) else {
        return step;
    };
    match (fields.get("op"), fields.get("sql")) {
        (Some(op), None) => operator(&mut step, op, &fields, context, faults),
        (None, Some(sql)) => query(&mut step, sql, &fields, context, faults),
        (Some(_), Some(sql)) => {
            faults.error(
                sql.place,
                format!("{what} has both `op` and `sql`; it is one of them"),
            );
            ports(&mut step, None, fields.get("in"), faults);
        }
        (None, None) => {
            faults.error(entry.place, format!("{what} has neither `op` nor `sql`"));
            ports(&mut step, None, fields.get("in"), faults);
        }
    }
    step
}

fn operator(
    step: &mut WrittenStep,
    op: &Entry,
    fields: &Fields<'_>,
    context: &Context<'_>,
    faults: &mut Faults,
) {
    let name = op.value.text("`op`", faults);
    let spec = name.and_then(|name| context.vocabulary.operator(name));
    if let (Some(name), None) = (name, spec) {
        let message = format!("unknown operator {}", quoted(name));
        faults.unknown(
            op.value.place,
            message,
            name,
            context.vocabulary.operator_names(),
        );
    }
    ports(step, spec.map(|spec| (spec, op)), fields.get("in"), faults);
    let Some(spec) = spec else {
        return;
    };
    let params = parameters(spec, op, fields.get("with"), faults);
    step.body = params.map(|params| Body::Op {
        op: spec.name.clone(),
        inputs: BTreeMap::new(),
        params,
    });
}

/// Reads `in`. Without an operator the ports cannot be checked, but what they name can.
fn ports(
    step: &mut WrittenStep,
    spec: Option<(&OperatorSpec, &Entry)>,
    inputs: Option<&Entry>,
    faults: &mut Faults,
) {
    let given = inputs.filter(|entry| !is_null(&entry.value));
    let entries = match given {
        Some(entry) => match entry.value.mapping("`in`", faults) {
            Some(entries) => entries,
            None => return,
        },
        None => &[],
    };
    for entry in entries {
        if let Some((spec, _)) = spec
            && spec.port(&entry.key).is_none()
        {
            unknown_port(spec, entry, faults);
        }
        let what = format!("port {}", quoted(&entry.key));
        if let Some(name) = entry.value.text(&what, faults) {
            let name = name.to_owned();
            let place = entry.value.place;
            step.inputs.push((entry.key.clone(), Named { name, place }));
        }
    }
    let Some((spec, op)) = spec else {
        return;
    };
    let is_open = |name: &str| !entries.iter().any(|entry| entry.key == name);
    for port in spec
        .ports
        .iter()
        .filter(|port| !port.optional && is_open(&port.name))
    {
        let place = given.map_or(op.value.place, |entry| entry.value.place);
        let (port, operator) = (quoted(&port.name), quoted(&spec.name));
        faults.error(place, format!("port {port} of {operator} is not connected"));
    }
}

fn unknown_port(spec: &OperatorSpec, entry: &Entry, faults: &mut Faults) {
    let known = spec.ports.iter().map(|port| port.name.as_str());
    let (port, operator) = (quoted(&entry.key), quoted(&spec.name));
    let ports = listed(known.clone());
    let message = format!("{operator} has no port {port}; its ports are {ports}");
    faults.unknown(entry.place, message, &entry.key, known);
}

/// Checks `with` and lays it over the defaults.
fn parameters(
    spec: &OperatorSpec,
    op: &Entry,
    with: Option<&Entry>,
    faults: &mut Faults,
) -> Option<Value> {
    let nothing = Node {
        place: op.value.place,
        kind: Kind::Mapping(Vec::new()),
    };
    let written = with.map_or(&nothing, |entry| &entry.value);
    let written = if is_null(written) { &nothing } else { written };
    let entries = written.mapping("`with`", faults)?;
    let has_default = |name: &str| spec.default_of(name).is_some();
    let before = faults.error_count();
    schema::check_parameters(written, &spec.params, &has_default, faults);
    if faults.error_count() > before {
        return None;
    }
    let mut params: Map<String, Value> = spec.defaults.as_object().cloned().unwrap_or_default();
    for entry in entries {
        params.insert(entry.key.clone(), entry.value.json(faults));
    }
    Some(Value::Object(params))
}

fn query(
    step: &mut WrittenStep,
    sql: &Entry,
    fields: &Fields<'_>,
    context: &Context<'_>,
    faults: &mut Faults,
) {
    for key in ["in", "with"] {
        if let Some(entry) = fields.get(key) {
            faults.error(
                entry.place,
                format!("`{key}` belongs to `op`; a query names its tables itself"),
            );
        }
    }
    let Some(query) = sql.value.text("`sql`", faults) else {
        return;
    };
    if query.trim().is_empty() {
        faults.error(sql.value.place, "`sql` is empty");
        return;
    }
    match (context.sql_tables)(query) {
        Ok(tables) => {
            let mut seen = BTreeSet::new();
            for name in tables {
                if seen.insert(name.clone()) {
                    let place = sql.value.place;
                    step.inputs.push((String::new(), Named { name, place }));
                }
            }
            step.body = Some(Body::Sql {
                query: query.to_owned(),
                inputs: Vec::new(),
            });
        }
        Err(error) => faults.error(sql.value.place, format!("SQL: {}", one_line(&error))),
    }
}

fn one_line(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}
