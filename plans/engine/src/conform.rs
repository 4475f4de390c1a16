//! Batches brought to a layer's columns: chosen by name, cast where types differ harmlessly.

use std::sync::Arc;

use arrow::array::{Array, ArrayRef, RecordBatch};
use arrow::compute::{can_cast_types, cast};
use arrow::datatypes::{DataType, Field, Schema, SchemaRef};
use evermap_schemas::{Column, Fault, Layer, type_name};

/// The batch with just the layer's columns, in its order and types.
///
/// # Errors
/// As [`conform_to`].
pub fn conform(batch: &RecordBatch, layer: &Layer) -> Result<RecordBatch, Fault> {
    conform_to(batch, &layer.schema())
}

/// The batch with just these columns, in their order and types.
///
/// # Errors
/// A data fault for a column that is missing, of a type that does not convert, or null where it may not be.
pub fn conform_to(batch: &RecordBatch, schema: &SchemaRef) -> Result<RecordBatch, Fault> {
    let columns = schema
        .fields()
        .iter()
        .map(|column| {
            let name = column.name();
            let found = batch
                .column_by_name(name)
                .ok_or_else(|| missing(name, batch.schema_ref()))?;
            let array = convert(found, column.data_type())
                .map_err(|fault| fault.at(format!("column {name}")))?;
            if !column.is_nullable() && array.null_count() > 0 {
                return Err(Fault::data(format!(
                    "column {name} has {} nulls and may have none",
                    array.null_count()
                ))
                .next("filter them out in SQL, or give them a value with coalesce()"));
            }
            Ok(array)
        })
        .collect::<Result<Vec<_>, _>>()?;
    Ok(RecordBatch::try_new(Arc::clone(schema), columns)?)
}

/// The column in another type.
///
/// # Errors
/// A data fault for types that do not convert.
pub fn convert(array: &ArrayRef, to: &DataType) -> Result<ArrayRef, Fault> {
    if array.data_type() == to {
        Ok(Arc::clone(array))
    } else {
        Ok(cast(array, to)?)
    }
}

/// The batch with one more column behind its own, which may hold nulls.
///
/// # Errors
/// A bug fault for a column of another length.
pub fn beside(batch: &RecordBatch, name: &str, column: ArrayRef) -> Result<RecordBatch, Fault> {
    let mut fields = batch.schema_ref().fields().to_vec();
    let mut columns = batch.columns().to_vec();
    fields.push(Arc::new(Field::new(name, column.data_type().clone(), true)));
    columns.push(column);
    let schema = Arc::new(Schema::new(fields));
    Ok(RecordBatch::try_new(schema, columns)?)
}

fn missing(name: &str, schema: &Schema) -> Fault {
    let found: Vec<_> = schema
        .fields()
        .iter()
        .map(|field| field.name().as_str())
        .collect();
    Fault::data(format!(
        "expected a column {name}, found {}",
        found.join(", ")
    ))
}

/// What keeps a table from being given to a port, one sentence a column; none where it fits.
pub fn misfits(table: &Schema, layer: &Layer) -> Vec<String> {
    let misfit = |column: &Column| match table.field_with_name(column.name) {
        Err(_) => Some(format!(
            "lacks the column {} ({})",
            column.name,
            type_name(&column.data_type)
        )),
        Ok(field) if fits(field.data_type(), &column.data_type) => None,
        Ok(field) => {
            let (found, expected) = (type_name(field.data_type()), type_name(&column.data_type));
            Some(format!(
                "has {found} in the column {}, where {expected} is expected",
                column.name
            ))
        }
    };
    layer.columns.iter().filter_map(misfit).collect()
}

/// Whether values convert without a change of meaning: the same shape, and no number from text.
fn fits(from: &DataType, to: &DataType) -> bool {
    match (from, to) {
        (DataType::Struct(from), DataType::Struct(to)) => to.iter().all(|field| {
            from.find(field.name())
                .is_some_and(|(_, found)| fits(found.data_type(), field.data_type()))
        }),
        (DataType::List(from), DataType::List(to)) => fits(from.data_type(), to.data_type()),
        (DataType::FixedSizeList(from, n), DataType::FixedSizeList(to, m)) => {
            n == m && fits(from.data_type(), to.data_type())
        }
        _ if from.equals_datatype(to) || *from == DataType::Null => true,
        _ => {
            from.is_numeric() == to.is_numeric()
                && is_text(from) == is_text(to)
                && can_cast_types(from, to)
        }
    }
}

fn is_text(data_type: &DataType) -> bool {
    matches!(
        data_type,
        DataType::Utf8 | DataType::LargeUtf8 | DataType::Utf8View
    )
}

/// The same columns without metadata, every one nullable: what two tables that may be put together agree on.
pub fn bare(schema: &Schema) -> SchemaRef {
    let fields: Vec<_> = schema
        .fields()
        .iter()
        .map(|field| Field::new(field.name(), field.data_type().clone(), true))
        .collect();
    Arc::new(Schema::new(fields))
}
