//! Tests of a plan: tables of rows in, tables of rows out.

use std::collections::BTreeSet;

use super::{LocatedName, TEST_KEYS, WrittenTest, tolerance};
use crate::fault::PlanFaults;
use crate::plan::Row;
use crate::suggest::quoted;
use crate::yaml::{Entry, Fields, Kind, Node};

pub(super) fn tests(node: &Node, faults: &mut PlanFaults) -> Vec<WrittenTest> {
    let Some(items) = node.sequence("`tests`", faults) else {
        return Vec::new();
    };
    let mut tests: Vec<WrittenTest> = Vec::new();
    let mut names = BTreeSet::new();
    for item in items {
        let Some(test) = test(item, faults) else {
            continue;
        };
        if !names.insert(test.name.name.clone()) {
            let name = quoted(&test.name.name);
            faults.error(test.name.location, format!("two tests are named {name}"));
        }
        tests.push(test);
    }
    tests
}

fn test(node: &Node, faults: &mut PlanFaults) -> Option<WrittenTest> {
    let fields = Fields::of(node, "a test", &TEST_KEYS, faults)?;
    let name = fields.require("name", "the test", faults);
    let name = name.and_then(|entry| {
        let name = entry.value.text("the name of a test", faults)?;
        let (name, location) = (name.to_owned(), entry.value.location);
        Some(LocatedName { name, location })
    });
    let given = fields.get("given");
    let given = given.map_or_else(Vec::new, |entry| tables("`given`", &entry.value, faults));
    let tables_of = |key: &str, faults: &mut PlanFaults| {
        let entry = fields.get(key)?;
        let what = format!("`{key}`");
        if matches!(&entry.value.kind, Kind::Mapping(entries) if entries.is_empty()) {
            faults.error(
                entry.value.location,
                format!("{what} must have at least one table"),
            );
        }
        Some(tables(&what, &entry.value, faults))
    };
    let (expect, contains) = (tables_of("expect", faults), tables_of("contains", faults));
    if expect.is_none() && contains.is_none() {
        fields.require("expect", "the test", faults);
    }
    let (expect, contains) = (expect.unwrap_or_default(), contains.unwrap_or_default());
    let tolerance = tolerance(&fields, faults);
    // Without a name the tables are still checked; the missing name is already a fault.
    let name = name.unwrap_or(LocatedName {
        name: format!("test at line {}", node.location.position().line),
        location: node.location,
    });
    Some(WrittenTest {
        name,
        given,
        expect,
        contains,
        tolerance,
    })
}

fn tables(what: &str, node: &Node, faults: &mut PlanFaults) -> Vec<(LocatedName, Vec<Row>)> {
    let Some(entries) = node.mapping(what, faults) else {
        return Vec::new();
    };
    entries
        .iter()
        .map(|entry| {
            let name = entry.key.clone();
            let location = entry.location;
            (LocatedName { name, location }, rows(entry, faults))
        })
        .collect()
}

fn rows(entry: &Entry, faults: &mut PlanFaults) -> Vec<Row> {
    let what = format!("the rows of {}", quoted(&entry.key));
    let items = entry.value.sequence(&what, faults).unwrap_or_default();
    let mut rows = Vec::new();
    for item in items {
        let what = format!("a row of {}", quoted(&entry.key));
        if let Some(columns) = item.mapping(&what, faults) {
            rows.push(crate::yaml::json_object(columns, faults));
        }
    }
    rows
}
