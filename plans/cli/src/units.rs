//! Units and frames of the columns of an answer: those of the layer's column that each one is, under whatever name.
//!
//! DataFusion would carry them through queries itself, and refuses unions and joins whose sides differ in them. So they
//! are put on what comes out, where other programs find them: the metadata of a field, `unit` and `frame`.

use std::sync::Arc;

use arrow::datatypes::{FieldRef, Schema, SchemaRef};
use datafusion::common::{Column, TableReference};
use datafusion::logical_expr::logical_plan::builder::UNNAMED_TABLE;
use datafusion::logical_expr::{Expr, LogicalPlan};
use evermap_schemas::Layer;

/// The columns of an answer with units and frames, as far as they are columns of layers that are declared.
pub fn described(plan: &LogicalPlan, declared: impl Fn(&str) -> Option<Layer>) -> SchemaRef {
    let schema = plan.schema().as_arrow();
    let fields = schema.fields().iter().enumerate().map(|(index, field)| {
        let origin = origin(plan, index);
        let layer = origin.and_then(|(table, name)| Some((declared(table.table())?, name)));
        match layer {
            Some((layer, name)) => with_unit(field, &layer, &name),
            None => Arc::clone(field),
        }
    });
    let fields: Vec<FieldRef> = fields.collect();
    Arc::new(Schema::new_with_metadata(fields, schema.metadata().clone()))
}

/// The columns of a layer's rows with its units and frames.
pub fn of_layer(schema: &Schema, layer: &Layer) -> SchemaRef {
    let fields = schema.fields().iter();
    let fields: Vec<FieldRef> = fields
        .map(|field| with_unit(field, layer, field.name()))
        .collect();
    Arc::new(Schema::new_with_metadata(fields, schema.metadata().clone()))
}

/// The field with the unit and frame of a column that a layer declares.
fn with_unit(field: &FieldRef, layer: &Layer, column: &str) -> FieldRef {
    let column = layer.columns.iter().find(|known| known.name == column);
    let Some(declared) = column.map(|column| column.field()) else {
        return Arc::clone(field);
    };
    let mut metadata = field.metadata().clone();
    metadata.extend(declared.metadata().clone());
    Arc::new(field.as_ref().clone().with_metadata(metadata))
}

/// The table and column that a column of a plan's rows is; `None` where it is computed.
pub fn origin(plan: &LogicalPlan, index: usize) -> Option<(TableReference, String)> {
    let from = |input: &LogicalPlan, column: &Column| {
        origin(input, input.schema().maybe_index_of_column(column)?)
    };
    match plan {
        LogicalPlan::TableScan(scan) => {
            let name = scan.projected_schema.field(index).name();
            Some((scan.table_name.clone(), name.clone()))
        }
        LogicalPlan::Projection(projection) => {
            from(&projection.input, column(projection.expr.get(index)?)?)
        }
        LogicalPlan::Aggregate(aggregate) => {
            from(&aggregate.input, column(aggregate.group_expr.get(index)?)?)
        }
        // A view's rows are scanned without a name: the view has it.
        LogicalPlan::SubqueryAlias(alias) => match origin(&alias.input, index)? {
            (table, name) if table.table() == UNNAMED_TABLE => Some((alias.alias.clone(), name)),
            named => Some(named),
        },
        // Rows that are chosen or put beside others keep their columns. Of a union each side has its own.
        LogicalPlan::Union(_) => None,
        other => {
            let column = Column::from(other.schema().qualified_field(index));
            let mut inputs = other.inputs().into_iter();
            inputs.find_map(|input| from(input, &column))
        }
    }
}

/// The column that an expression is, under whatever name.
fn column(expression: &Expr) -> Option<&Column> {
    match expression {
        Expr::Column(column) => Some(column),
        Expr::Alias(alias) => column(&alias.expr),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use arrow::array::RecordBatch;
    use datafusion::prelude::SessionContext;
    use evermap_schemas::LayerRow;
    use evermap_schemas::layers::Lane;

    use super::*;

    async fn units(query: &str) -> Vec<String> {
        let context = SessionContext::new();
        let lanes = RecordBatch::new_empty(Lane::layer().schema());
        // As maps have them: views of rows.
        let bare = context.read_batch(bare(&lanes)).unwrap();
        context.register_table("lanes", bare.into_view()).unwrap();
        let frame = context.sql(query).await.unwrap();
        let declared = |name: &str| (name == "lanes").then(Lane::layer);
        let described = described(frame.logical_plan(), declared);
        let unit = |field: &FieldRef| field.metadata().get("unit").cloned().unwrap_or_default();
        described.fields().iter().map(unit).collect()
    }

    /// As layers are read: without metadata.
    fn bare(rows: &RecordBatch) -> RecordBatch {
        let fields = rows.schema_ref().fields().iter();
        let fields: Vec<_> = fields
            .map(|field| field.as_ref().clone().with_metadata(Default::default()))
            .collect();
        RecordBatch::new_empty(Arc::new(Schema::new(fields)))
    }

    #[tokio::test]
    async fn a_column_keeps_its_unit_under_another_name() {
        let cases = [
            ("SELECT length_m FROM lanes", "m"),
            (
                "SELECT l.length_m AS metres FROM lanes AS l ORDER BY 1 LIMIT 3",
                "m",
            ),
            (
                "WITH far AS (SELECT length_m AS far FROM lanes) SELECT far FROM far WHERE far > 3",
                "m",
            ),
            (
                "SELECT a.width_m FROM lanes a JOIN lanes b ON a.lane = b.lane",
                "m",
            ),
            ("SELECT length_m FROM lanes GROUP BY length_m", "m"),
            ("SELECT length_m * 2 FROM lanes", ""),
            ("SELECT lane FROM lanes", ""),
            (
                "SELECT length_m FROM lanes UNION ALL SELECT width_m FROM lanes",
                "",
            ),
        ];
        for (query, unit) in cases {
            assert_eq!(units(query).await, [unit], "{query}");
        }
    }
}
