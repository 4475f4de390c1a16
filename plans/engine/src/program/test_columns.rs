//! Columns that rows of a plan's tests name, and that their tables do not have.

use std::collections::BTreeSet;

use arrow::datatypes::{DataType, Fields};
use evermap_language::{Row, nearest};
use serde_json::Value;

/// One sentence for each column that rows name and that there is not.
pub fn unknown(columns: &Fields, rows: &[Row]) -> BTreeSet<String> {
    let mut unknown = BTreeSet::new();
    rows.iter()
        .for_each(|row| check(columns, row, "", &mut unknown));
    unknown
}

fn check(columns: &Fields, row: &Row, within: &str, unknown: &mut BTreeSet<String>) {
    for (name, value) in row {
        let path = format!("{within}{name}");
        match (
            columns.find(name).map(|(_, column)| column.data_type()),
            value,
        ) {
            (Some(DataType::Struct(members)), Value::Object(row)) => {
                check(members, row, &format!("{path}."), unknown);
            }
            (Some(_), _) => {}
            (None, _) => {
                let known = columns.iter().map(|column| column.name().as_str());
                let near = nearest(name, known);
                let meant =
                    near.map_or_else(String::new, |near| format!("; did you mean `{near}`?"));
                unknown.insert(format!("no column `{path}`{meant}"));
            }
        }
    }
}
