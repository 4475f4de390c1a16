//! Layers for programs that know no structs: each member is a column, `map_from_vehicle_x`.

use arrow::datatypes::{DataType, Schema};
use datafusion::error::Result;
use datafusion::functions::core::get_field;
use datafusion::prelude::{DataFrame, Expr, ident, lit};

/// What is behind the name of a layer that is flat: `poses_flat`.
pub const SUFFIX: &str = "_flat";

/// Whether some column is a struct.
pub fn has_structs(schema: &Schema) -> bool {
    let mut fields = schema.fields().iter();
    fields.any(|field| matches!(field.data_type(), DataType::Struct(_)))
}

/// The rows with the members of structs as columns, named after both. Lists stay.
///
/// # Errors
/// What planning says.
pub fn flat(rows: DataFrame) -> Result<DataFrame> {
    let mut columns = Vec::new();
    for field in rows.schema().as_arrow().fields() {
        add(
            ident(field.name()),
            field.name(),
            field.data_type(),
            &mut columns,
        );
    }
    rows.select(columns)
}

fn add(value: Expr, name: &str, kind: &DataType, columns: &mut Vec<Expr>) {
    match kind {
        DataType::Struct(members) => {
            for member in members {
                let inner = get_field().call(vec![value.clone(), lit(member.name())]);
                let name = format!("{name}_{}", member.name());
                add(inner, &name, member.data_type(), columns);
            }
        }
        _ => columns.push(value.alias(name)),
    }
}
