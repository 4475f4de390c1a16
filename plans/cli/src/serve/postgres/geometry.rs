//! Geometries as clients of PostGIS know them: of the type `geometry`, as extended well-known binary, in hexadecimal where a
//! client asks for text.
//!
//! A plan says by a mark on its fields which columns are geometries. How they are written is known only when a client binds
//! a format to them.

use std::collections::HashMap;
use std::sync::Arc;

use arrow::array::{ArrayRef, AsArray, BinaryArray, StringArray};
use arrow::datatypes::{DataType, Field, FieldRef};
use datafusion::common::{Column, Result, exec_err};
use datafusion::error::DataFusionError;
use datafusion::logical_expr::{
    ColumnarValue, Expr, LogicalPlan, LogicalPlanBuilder, ReturnFieldArgs, ScalarFunctionArgs,
    ScalarUDF, ScalarUDFImpl, Signature, Volatility,
};
use evermap_engine::sql::described::origin;
use evermap_functions::makes_geometry;
use evermap_schemas::Geometry;
use pgwire::api::Type;
use pgwire::api::results::FieldInfo;

use crate::output::GEOMETRY;

/// The type's number. PostGIS has another in every database; clients ask for it by name.
pub const OID: u32 = 90_001;
/// The key of the mark on a field.
const MARK: &str = "evermap.geometry";

/// The type `geometry`.
fn geometry_type() -> Type {
    let kind = Type::BYTEA.kind().clone();
    Type::new(GEOMETRY.to_owned(), OID, kind, "public".to_owned())
}

/// The plan with geometries as extended well-known binary, and marked.
///
/// # Errors
/// What planning says.
pub fn as_extended(plan: LogicalPlan) -> Result<LogicalPlan, DataFusionError> {
    let places = 0..plan.schema().fields().len();
    let chosen: Vec<bool> = places.map(|index| is_geometry(&plan, index)).collect();
    replaced(plan, calling(&Extended::function(false), &chosen))
}

/// A plan of [`as_extended`] with geometries in hexadecimal, those columns that a client asks for as text.
///
/// # Errors
/// What planning says.
pub fn as_text(
    plan: LogicalPlan,
    is_text: impl Fn(usize) -> bool,
) -> Result<LogicalPlan, DataFusionError> {
    let fields = plan.schema().fields().iter().enumerate();
    let chosen = fields.map(|(index, field)| is_marked(field) && is_text(index));
    let chosen: Vec<bool> = chosen.collect();
    replaced(plan, calling(&Extended::function(true), &chosen))
}

/// What a function makes of chosen columns, for [`replaced`].
pub fn calling(function: &ScalarUDF, chosen: &[bool]) -> impl Fn(usize, Expr) -> Option<Expr> {
    move |place, column| chosen[place].then(|| function.call(vec![column]))
}

/// The plan with what is made of columns, each with its place, in their place and under their names; `None` leaves one as it
/// is.
///
/// # Errors
/// What planning says.
pub fn replaced(
    plan: LogicalPlan,
    made: impl Fn(usize, Expr) -> Option<Expr>,
) -> Result<LogicalPlan, DataFusionError> {
    let schema = Arc::clone(plan.schema());
    let mut columns = Vec::with_capacity(schema.fields().len());
    let mut is_any = false;
    for (place, (qualifier, field)) in schema.iter().enumerate() {
        let column = Expr::Column(Column::new(qualifier.cloned(), field.name()));
        let made = made(place, column.clone());
        is_any |= made.is_some();
        columns.push(made.map_or(column, |made| made.alias(field.name())));
    }
    match is_any {
        true => LogicalPlanBuilder::from(plan).project(columns)?.build(),
        false => Ok(plan),
    }
}

/// Whether a plan of [`as_extended`] has geometries.
pub fn has_any(plan: &LogicalPlan) -> bool {
    let mut fields = plan.schema().fields().iter();
    fields.any(|field| is_marked(field))
}

/// What clients are told of columns, where these have the type that they have in Postgres.
pub fn told(plan: &LogicalPlan, columns: Vec<FieldInfo>) -> Vec<FieldInfo> {
    let fields = plan.schema().fields().iter();
    let told = columns.into_iter().zip(fields).map(|(column, field)| {
        if !is_marked(field) {
            return column;
        }
        let name = column.name().to_owned();
        let (table, number) = (column.table_id(), column.column_id());
        let told = FieldInfo::new(name, table, number, geometry_type(), column.format());
        told.with_format_options(Arc::clone(column.format_options()))
    });
    told.collect()
}

fn is_marked(field: &Field) -> bool {
    field.metadata().contains_key(MARK)
}

/// Whether a column is a geometry: binary, and a column of that name, or made by a function.
fn is_geometry(plan: &LogicalPlan, index: usize) -> bool {
    let field = plan.schema().field(index);
    let binary = matches!(
        field.data_type(),
        DataType::Binary | DataType::BinaryView | DataType::LargeBinary
    );
    binary
        && (field.name() == GEOMETRY
            || origin(plan, index)
                .is_some_and(|found| found.members.is_empty() && found.column.name() == GEOMETRY)
            || is_made(plan, index))
}

/// Whether the values of a column are made by a function, beneath what only chooses and orders rows and columns.
fn is_made(plan: &LogicalPlan, index: usize) -> bool {
    match plan {
        LogicalPlan::Projection(projection) => {
            match projection.expr.get(index).map(without_alias) {
                Some(Expr::ScalarFunction(call)) => makes_geometry(call.func.name()),
                Some(Expr::Column(column)) => {
                    let beneath = projection.input.schema().maybe_index_of_column(column);
                    beneath.is_some_and(|index| is_made(&projection.input, index))
                }
                _ => false,
            }
        }
        LogicalPlan::Sort(sort) => is_made(&sort.input, index),
        LogicalPlan::Limit(limit) => is_made(&limit.input, index),
        LogicalPlan::Filter(filter) => is_made(&filter.input, index),
        LogicalPlan::SubqueryAlias(alias) => is_made(&alias.input, index),
        _ => false,
    }
}

fn without_alias(expression: &Expr) -> &Expr {
    match expression {
        Expr::Alias(alias) => without_alias(&alias.expr),
        other => other,
    }
}

/// Well-known binary as PostGIS writes it: bytes, or text in hexadecimal.
#[derive(Debug, PartialEq, Eq, Hash)]
struct Extended {
    text: bool,
    signature: Signature,
}

impl Extended {
    fn function(text: bool) -> ScalarUDF {
        let signature = Signature::any(1, Volatility::Immutable);
        ScalarUDF::from(Self { text, signature })
    }

    fn data_type(&self) -> DataType {
        match self.text {
            true => DataType::Utf8,
            false => DataType::Binary,
        }
    }
}

impl ScalarUDFImpl for Extended {
    fn name(&self) -> &str {
        match self.text {
            true => "hexadecimal_geometry",
            false => "extended_geometry",
        }
    }

    fn signature(&self) -> &Signature {
        &self.signature
    }

    fn return_type(&self, _: &[DataType]) -> Result<DataType, DataFusionError> {
        Ok(self.data_type())
    }

    fn return_field_from_args(&self, _: ReturnFieldArgs<'_>) -> Result<FieldRef, DataFusionError> {
        let mark = HashMap::from([(MARK.to_owned(), String::new())]);
        let field = Field::new(self.name(), self.data_type(), true);
        Ok(Arc::new(field.with_metadata(mark)))
    }

    fn invoke_with_args(&self, args: ScalarFunctionArgs) -> Result<ColumnarValue, DataFusionError> {
        let columns = ColumnarValue::values_to_arrays(&args.args)?;
        let [column] = columns.as_slice() else {
            return exec_err!("expected one argument, found {}", columns.len());
        };
        let values: Vec<Option<&[u8]>> = match column.data_type() {
            DataType::Binary => column.as_binary::<i32>().iter().collect(),
            DataType::LargeBinary => column.as_binary::<i64>().iter().collect(),
            DataType::BinaryView => column.as_binary_view().iter().collect(),
            other => return exec_err!("expected a geometry, found {other}"),
        };
        let values = values.into_iter().map(|value| value.map(extended));
        let made: ArrayRef = match self.text {
            true => Arc::new(
                values
                    .map(|value| value.map(hexadecimal))
                    .collect::<StringArray>(),
            ),
            false => Arc::new(values.collect::<BinaryArray>()),
        };
        Ok(ColumnarValue::Array(made))
    }
}

/// A geometry as PostGIS has it; what is none stays what it is.
fn extended(value: &[u8]) -> Vec<u8> {
    Geometry::from_wkb(value).map_or_else(|_| value.to_vec(), |geometry| geometry.to_ewkb())
}

/// In upper case, as PostGIS writes it.
fn hexadecimal(value: Vec<u8>) -> String {
    const DIGITS: &[u8; 16] = b"0123456789ABCDEF";
    let digits = value.iter().flat_map(|byte| [byte >> 4, byte & 15]);
    digits
        .map(|digit| char::from(DIGITS[usize::from(digit)]))
        .collect()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use evermap_engine::sql::{Limits, context, read_only};

    use super::*;
    use crate::serve::postgres::nested::as_json;

    /// What is nested becomes JSON in a projection above those of the query.
    #[tokio::test]
    async fn what_a_function_makes_is_a_geometry_beside_what_is_nested_too() {
        let context = context(Limits::one_partition()).unwrap();
        let cases: [(&str, &[bool]); 5] = [
            ("SELECT st_point(1, 2)", &[true]),
            ("SELECT st_point(1, 2), [[1]] AS l", &[true, false]),
            (
                "SELECT [[1]] AS l, g FROM (SELECT st_point(1, 2) AS g) AS t LIMIT 1",
                &[false, true],
            ),
            (
                "SELECT arrow_cast('a', 'Binary') AS b, [[1]] AS l",
                &[false; 2],
            ),
            (
                "SELECT st_x(g) AS x FROM (SELECT st_point(1, 2) AS g) AS t",
                &[false],
            ),
        ];
        for (query, expected) in cases {
            let frame = read_only(&context, query).await.unwrap();
            let plan = as_json(frame.logical_plan().clone()).unwrap();
            let plan = as_extended(plan).unwrap();
            let fields = plan.schema().fields().iter();
            let found: Vec<bool> = fields.map(|field| is_marked(field)).collect();
            assert_eq!(found, expected, "{query}");
        }
    }
}
