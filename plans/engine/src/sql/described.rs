//! Units and frames of the columns of a query: those of the table's column that each one is, or is a member of, under
//! whatever name. What is computed has none.
//!
//! DataFusion would carry them through queries itself: onto casts and unions too, and it refuses aggregates of unions
//! whose sides differ in them. So they are put on what comes out: the metadata of a field, as
//! [`evermap_schemas::Column::field`] writes them.

use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;

use arrow::datatypes::{DataType, FieldRef, Schema, SchemaRef};
use datafusion::common::{Column, TableReference};
use datafusion::logical_expr::logical_plan::builder::UNNAMED_TABLE;
use datafusion::logical_expr::{Distinct, Expr, LogicalPlan, Unnest};

use crate::conform::with_metadata;

/// What columns say of themselves beside their types, by name: as [`evermap_schemas::Column::field`] writes it.
pub type Notes = BTreeMap<String, BTreeMap<String, String>>;

/// The column of a table that a column of a plan's rows is, or is a member of.
#[derive(Debug, Clone)]
pub struct Origin {
    /// The table.
    pub table: TableReference,
    /// The column, as the table has it.
    pub column: FieldRef,
    /// The names that lead to the member; none for the whole column. Items of a list are described as the list is.
    pub members: Vec<String>,
}

/// The columns of a plan's rows with units and frames, as far as they are columns of tables. `known` has columns that are
/// described elsewhere than in their table.
pub fn described(plan: &LogicalPlan, known: impl Fn(&Origin) -> Option<FieldRef>) -> SchemaRef {
    with_metadata(plan.schema().as_arrow(), |index, field| {
        origin(plan, index).map_or_else(HashMap::new, |found| {
            let column = known(&found).unwrap_or_else(|| Arc::clone(&found.column));
            of_member(&column, &found.members, field.name())
        })
    })
}

/// What the columns of a table say of themselves, those that say anything.
pub fn notes(schema: &Schema) -> Notes {
    let fields = schema.fields().iter();
    let fields = fields.filter(|field| !field.metadata().is_empty());
    let note = |field: &FieldRef| {
        let metadata = field.metadata().clone();
        (field.name().clone(), metadata.into_iter().collect())
    };
    fields.map(note).collect()
}

/// The columns of a table with just these notes.
pub fn noted(schema: &Schema, notes: &Notes) -> SchemaRef {
    with_metadata(schema, |_, field| {
        let metadata = notes.get(field.name()).cloned().unwrap_or_default();
        metadata.into_iter().collect()
    })
}

/// What is known of a column, or of the member that these names lead to, under another name.
fn of_member(column: &FieldRef, members: &[String], name: &str) -> HashMap<String, String> {
    let path: String = members.iter().map(|member| format!("{member}.")).collect();
    let known = column.metadata().iter();
    let within = known.filter_map(|(key, value)| Some((key.strip_prefix(&path)?, value)));
    let mut metadata: HashMap<String, String> = within
        .map(|(key, value)| (key.to_owned(), value.clone()))
        .collect();
    let was = said_frame(members.last().unwrap_or(column.name()));
    let is_in =
        |frame: &String| said_frame(name).is_none_or(|said| said == frame || was == Some(said));
    if !metadata.get("frame").is_none_or(is_in) {
        metadata.remove("frame");
    }
    metadata
}

/// The frame that a pose's name says: `odom_from_vehicle AS map_from_vehicle` is said to be in the map, whatever it was
/// in.
fn said_frame(name: &str) -> Option<&str> {
    name.split_once("_from_").map(|(frame, _)| frame)
}

/// Where a column of a plan's rows comes from; `None` where it is computed.
pub fn origin(plan: &LogicalPlan, index: usize) -> Option<Origin> {
    match plan {
        LogicalPlan::TableScan(scan) => Some(Origin {
            table: scan.table_name.clone(),
            column: Arc::clone(scan.projected_schema.fields().get(index)?),
            members: Vec::new(),
        }),
        LogicalPlan::Projection(projection) => {
            of_expression(&projection.input, projection.expr.get(index)?)
        }
        LogicalPlan::Aggregate(aggregate) => {
            of_expression(&aggregate.input, aggregate.group_expr.get(index)?)
        }
        LogicalPlan::Distinct(Distinct::On(distinct)) => {
            of_expression(&distinct.input, distinct.select_expr.get(index)?)
        }
        LogicalPlan::Unnest(unnest) => unnested(unnest, index),
        // A view's rows are scanned without a name: the view has it, and columns of its own.
        LogicalPlan::SubqueryAlias(alias) => match origin(&alias.input, index)? {
            found if found.table.table() == UNNAMED_TABLE => Some(Origin {
                table: alias.alias.clone(),
                column: Arc::clone(alias.schema.fields().get(index)?),
                members: Vec::new(),
            }),
            found => Some(found),
        },
        // Rows that are chosen or put beside others keep their columns. Of a union each side has its own.
        LogicalPlan::Union(_) | LogicalPlan::RecursiveQuery(_) => None,
        other => {
            let column = Column::from(other.schema().qualified_field(index));
            let mut inputs = other.inputs().into_iter();
            inputs.find_map(|input| of_column(input, &column))
        }
    }
}

fn of_column(input: &LogicalPlan, column: &Column) -> Option<Origin> {
    origin(input, input.schema().maybe_index_of_column(column)?)
}

/// The column or member that an expression is, under whatever name.
fn of_expression(input: &LogicalPlan, expression: &Expr) -> Option<Origin> {
    match expression {
        Expr::Column(column) => of_column(input, column),
        Expr::Alias(alias) => of_expression(input, &alias.expr),
        Expr::ScalarFunction(call) => {
            let (whole, arguments) = call.args.split_first()?;
            match call.func.name() {
                "array_element" => of_expression(input, whole),
                "get_field" => {
                    let mut found = of_expression(input, whole)?;
                    for argument in arguments {
                        let name = argument.as_literal()?.try_as_str()??;
                        found.members.push(name.to_owned());
                    }
                    Some(found)
                }
                _ => None,
            }
        }
        _ => None,
    }
}

/// An item of a list is in the list's column; a struct becomes a column for each member.
fn unnested(unnest: &Unnest, index: usize) -> Option<Origin> {
    let whole = *unnest.dependency_indices.get(index)?;
    let mut found = origin(&unnest.input, whole)?;
    if unnest.struct_type_columns.contains(&whole) {
        let first = unnest
            .dependency_indices
            .iter()
            .position(|of| *of == whole)?;
        let DataType::Struct(members) = unnest.input.schema().field(whole).data_type() else {
            return None;
        };
        found
            .members
            .push(members.get(index - first)?.name().clone());
    }
    Some(found)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use arrow::array::RecordBatch;
    use datafusion::prelude::SessionContext;
    use evermap_schemas::LayerRow;
    use evermap_schemas::layers::{Keyframe, Lane};

    use super::*;
    use crate::sql::{Limits, context};

    /// `lanes` as maps have layers, views of rows without metadata; `keyframes` as a plan's steps, with them.
    fn some() -> SessionContext {
        let context = context(Limits::one_partition()).unwrap();
        let bare = noted(&Lane::layer().schema(), &Notes::new());
        let bare = context.read_batch(RecordBatch::new_empty(bare)).unwrap();
        context.register_table("lanes", bare.into_view()).unwrap();
        let rows = RecordBatch::new_empty(Keyframe::layer().schema());
        context.register_batch("keyframes", rows).unwrap();
        context
    }

    /// Unit and frame of the columns of an answer.
    async fn told(query: &str) -> Vec<[String; 2]> {
        let frame = some().sql(query).await.unwrap();
        let lanes = Lane::layer().schema();
        let known = |origin: &Origin| {
            let of_lanes = origin.table.table() == "lanes";
            let (_, field) = lanes
                .fields()
                .find(origin.column.name())
                .filter(|_| of_lanes)?;
            Some(Arc::clone(field))
        };
        let described = described(frame.logical_plan(), known);
        let fields = described.fields().iter();
        let note =
            |field: &FieldRef, key: &str| field.metadata().get(key).cloned().unwrap_or_default();
        fields
            .map(|field| ["unit", "frame"].map(|key| note(field, key)))
            .collect()
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
            ("SELECT DISTINCT ON (lane) length_m AS far FROM lanes", "m"),
            ("SELECT length_m * 2 FROM lanes", ""),
            ("SELECT -length_m AS length_m FROM lanes", ""),
            ("SELECT max(length_m) AS length_m FROM lanes", ""),
            (
                "SELECT CAST(distance_m AS BIGINT) AS distance_m FROM keyframes",
                "",
            ),
            (
                "SELECT DISTINCT ON (lane) length_m * 2 AS length_m FROM lanes",
                "",
            ),
            ("SELECT lane FROM lanes", ""),
            (
                "SELECT length_m FROM lanes UNION ALL SELECT width_m FROM lanes",
                "",
            ),
            (
                "WITH RECURSIVE r AS (SELECT length_m FROM lanes UNION ALL SELECT length_m * 2 FROM r WHERE length_m < 9) SELECT length_m FROM r",
                "",
            ),
        ];
        for (query, unit) in cases {
            let told = told(query).await;
            assert!(
                matches!(&told[..], [[found, _]] if found == unit),
                "{query}: {told:?}"
            );
        }
    }

    #[tokio::test]
    async fn members_and_items_have_units_of_their_own() {
        let cases = [
            ("SELECT odom_from_vehicle['x'] AS x FROM keyframes", "m"),
            ("SELECT odom_from_vehicle['qw'] AS w FROM keyframes", ""),
            (
                "SELECT pose['y'] FROM (SELECT odom_from_vehicle AS pose FROM keyframes)",
                "m",
            ),
            ("SELECT images[1]['stamp'] AS at FROM keyframes", "ns"),
            (
                "SELECT image['stamp'] AS at FROM (SELECT unnest(images) AS image FROM keyframes)",
                "ns",
            ),
            ("SELECT unnest(points) AS point FROM lanes", "m"),
            (
                "SELECT image['camera'] AS c FROM (SELECT unnest(images) AS image FROM keyframes)",
                "",
            ),
        ];
        for (query, unit) in cases {
            let told = told(query).await;
            assert!(
                matches!(&told[..], [[found, _]] if found == unit),
                "{query}: {told:?}"
            );
        }
        let pose = told("SELECT session, unnest(odom_from_vehicle) FROM keyframes").await;
        let units: Vec<&str> = pose.iter().map(|[unit, _]| unit.as_str()).collect();
        assert_eq!(units, ["", "m", "m", "m", "", "", "", ""]);
    }

    #[tokio::test]
    async fn a_pose_that_is_said_to_be_in_another_frame_has_none() {
        let cases = [
            ("odom_from_vehicle", "odom"),
            ("odom_from_vehicle AS odom_from_base", "odom"),
            ("odom_from_vehicle AS pose", "odom"),
            ("odom_from_vehicle AS map_from_vehicle", ""),
        ];
        for (column, frame) in cases {
            let told = told(&format!("SELECT {column} FROM keyframes")).await;
            assert!(
                matches!(&told[..], [[_, found]] if found == frame),
                "{column}: {told:?}"
            );
        }
        let shape = told("SELECT geometry AS shape FROM lanes").await;
        assert_eq!(shape, [["m", "map"]]);
    }
}
