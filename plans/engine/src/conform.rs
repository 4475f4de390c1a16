//! Batches brought to a layer's columns: chosen by name, cast where types differ harmlessly.

use std::collections::HashMap;
use std::sync::Arc;

use arrow::array::{Array, ArrayRef, AsArray, RecordBatch};
use arrow::compute::kernels::cmp::distinct;
use arrow::compute::{CastOptions, can_cast_types, cast, cast_with_options};
use arrow::datatypes::{DataType, Field, FieldRef, Float64Type, Schema, SchemaRef};
use arrow::util::display::array_value_to_string;
use evermap_schemas::{Column, Fault, Layer, column, type_name};

/// The batch with just the layer's columns, in its order and types; null in those that it does not have and that may be
/// so ([`Column::of`]).
///
/// # Errors
/// As [`conform_to`].
pub fn conform(batch: &RecordBatch, layer: &Layer) -> Result<RecordBatch, Fault> {
    let found = layer.columns.iter().map(|column| column.of(batch));
    converted(&found.collect::<Result<Vec<_>, _>>()?, &layer.schema())
}

/// The batch with just these columns, in their order and types.
///
/// # Errors
/// A data fault for a column that is missing, of a type that does not convert, or null where it may not be.
pub fn conform_to(batch: &RecordBatch, schema: &SchemaRef) -> Result<RecordBatch, Fault> {
    let names = schema.fields().iter().map(|field| field.name());
    let found = names.map(|name| column(batch, name).cloned());
    converted(&found.collect::<Result<Vec<_>, _>>()?, schema)
}

/// The batch of these columns, in the types of a schema that has as many.
fn converted(found: &[ArrayRef], schema: &SchemaRef) -> Result<RecordBatch, Fault> {
    let columns = schema
        .fields()
        .iter()
        .zip(found)
        .map(|(column, found)| {
            let name = column.name();
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

/// The column in another type. No value becomes null on the way, no number loses its fraction, and no whole one its last
/// digits.
///
/// # Errors
/// A data fault for types that do not convert, and for a value that the type does not hold.
pub fn convert(array: &ArrayRef, to: &DataType) -> Result<ArrayRef, Fault> {
    if array.data_type() == to {
        return Ok(Arc::clone(array));
    }
    let expected = || format!("expected {}", type_name(to));
    if !fits(array.data_type(), to) {
        let found = type_name(array.data_type());
        return Err(Fault::data(format!("{}, found {found}", expected())));
    }
    let exact = CastOptions {
        safe: false,
        ..CastOptions::default()
    };
    let converted = cast_with_options(array, to, &exact).map_err(|error| {
        let reason = error.to_string();
        let reason = reason.trim_start_matches("Cast error: ");
        Fault::data(format!("{}: {reason}", expected()))
    })?;
    match lost(array, &converted)? {
        Some(value) => Err(Fault::data(format!("{}, found {value}", expected()))),
        None => Ok(converted),
    }
}

/// The first value, as text, that became another one: whole numbers are kept as they are; others may be rounded, and not
/// become infinite. (Instants are brought to nanoseconds, which casts check.)
fn lost(from: &ArrayRef, to: &ArrayRef) -> Result<Option<String>, Fault> {
    match (from.data_type(), to.data_type()) {
        (DataType::Dictionary(_, values), _) => lost(&cast(from, values)?, to),
        (found, kept) if found == kept || found.is_integer() && kept.is_integer() => Ok(None),
        (found, kept) if found.is_floating() && kept.is_floating() => {
            first(from, infinite(from, to)?)
        }
        (found, kept) if are_numbers(found, kept) && (is_whole(found) || is_whole(kept)) => {
            let back = cast(to, found)?;
            let changed = distinct(&back, from)?;
            first(from, changed.values().set_indices().next())
        }
        (DataType::Struct(_), DataType::Struct(fields)) => {
            for (field, to) in fields.iter().zip(to.as_struct().columns()) {
                let found = from.as_struct().column_by_name(field.name());
                if let Some(value) = found.map_or(Ok(None), |from| lost(from, to))? {
                    return Ok(Some(value));
                }
            }
            Ok(None)
        }
        (DataType::List(_), DataType::List(_)) => {
            lost(from.as_list::<i32>().values(), to.as_list::<i32>().values())
        }
        (DataType::LargeList(_), DataType::List(_)) => {
            lost(from.as_list::<i64>().values(), to.as_list::<i32>().values())
        }
        (DataType::FixedSizeList(..), DataType::FixedSizeList(..)) => lost(
            from.as_fixed_size_list().values(),
            to.as_fixed_size_list().values(),
        ),
        _ => Ok(None),
    }
}

fn are_numbers(found: &DataType, kept: &DataType) -> bool {
    found.is_numeric() && kept.is_numeric()
}

fn is_whole(kind: &DataType) -> bool {
    match kind {
        DataType::Decimal128(_, scale) | DataType::Decimal256(_, scale) => *scale <= 0,
        kind => kind.is_integer(),
    }
}

/// The row of the first number that became infinite.
fn infinite(from: &ArrayRef, to: &ArrayRef) -> Result<Option<usize>, Fault> {
    let [from, to] = [from, to].map(|numbers| cast(numbers, &DataType::Float64));
    let (from, to) = (from?, to?);
    let to = to.as_primitive::<Float64Type>();
    let mut rows = from.as_primitive::<Float64Type>().iter().zip(to);
    Ok(rows.position(|(found, kept)| {
        found.is_some_and(f64::is_finite) && kept.is_some_and(f64::is_infinite)
    }))
}

/// The value of a row, as text.
fn first(values: &ArrayRef, row: Option<usize>) -> Result<Option<String>, Fault> {
    let value = row.map(|row| array_value_to_string(values, row));
    Ok(value.transpose()?)
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
        (DataType::List(from) | DataType::LargeList(from), DataType::List(to)) => {
            fits(from.data_type(), to.data_type())
        }
        (DataType::FixedSizeList(from, n), DataType::FixedSizeList(to, m)) => {
            n == m && fits(from.data_type(), to.data_type())
        }
        (DataType::Dictionary(_, from), to) => fits(from, to),
        // Whole nanoseconds, as pandas and numpy count them.
        (whole, DataType::Timestamp(..)) if whole.is_integer() => true,
        _ if from.equals_datatype(to) || *from == DataType::Null => true,
        _ => {
            from.is_numeric() == to.is_numeric()
                && from.is_string() == to.is_string()
                && can_cast_types(from, to)
        }
    }
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

/// The columns with the units and frames of those that the layer declares by their names, as far as their values are
/// such; the others as they are.
pub fn declared(table: &Schema, layer: &Layer) -> SchemaRef {
    with_metadata(table, |_, field| {
        let column = layer.column(field.name());
        match column.filter(|column| fits(field.data_type(), &column.data_type)) {
            Some(column) => column.field().metadata().clone(),
            None => field.metadata().clone(),
        }
    })
}

/// The same columns with other metadata: of each, by its place.
pub fn with_metadata(
    schema: &Schema,
    metadata: impl Fn(usize, &Field) -> HashMap<String, String>,
) -> SchemaRef {
    let fields = schema.fields().iter().enumerate();
    let field = |(index, field): (usize, &FieldRef)| {
        let field = field.as_ref();
        field.clone().with_metadata(metadata(index, field))
    };
    Arc::new(Schema::new(fields.map(field).collect::<Vec<_>>()))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use arrow::array::{
        BooleanArray, Decimal128Array, FixedSizeListArray, Float32Array, Float64Array, Int64Array,
        LargeListArray, ListArray, StringArray, StructArray, TimestampMicrosecondArray,
        UInt64Array, new_empty_array,
    };
    use arrow::datatypes::Int32Type;
    use evermap_schemas::roles::Calibration;
    use evermap_schemas::{Cell, LayerRow, Stamp};

    use super::*;

    fn told(array: impl Array + 'static, to: &DataType) -> String {
        let array: ArrayRef = Arc::new(array);
        convert(&array, to).unwrap_err().to_string()
    }

    #[test]
    fn no_value_becomes_null_or_another_one() {
        let texts = || StringArray::from(vec!["1.5", "maybe"]);
        for to in [
            DataType::Float64,
            DataType::Int64,
            DataType::Boolean,
            Stamp::data_type(),
        ] {
            assert!(told(texts(), &to).contains("found text"), "{to}");
        }
        let numbers = |values: Vec<f64>| Float64Array::from(values);
        let fraction = told(numbers(vec![1.0, 1.7]), &DataType::Int64);
        assert!(fraction.contains("expected i64, found 1.7"), "{fraction}");
        let large = told(numbers(vec![3e20]), &DataType::Int64);
        assert!(large.contains("expected i64"), "{large}");
        assert!(told(Int64Array::from(vec![-1]), &DataType::UInt8).contains("expected u8"));
        let flags = BooleanArray::from(vec![true]);
        assert!(told(flags, &DataType::Int64).contains("found bool"));
        let field = Arc::new(Field::new("x", DataType::Float64, true));
        let values: ArrayRef = Arc::new(numbers(vec![0.5]));
        let nested = StructArray::from(vec![(field, values)]);
        let whole = Field::new("x", DataType::Int32, true);
        assert!(told(nested, &DataType::Struct(vec![whole].into())).contains("found 0.5"));
        let item = |kind| Arc::new(Field::new_list_field(kind, true));
        let pair: ArrayRef = Arc::new(numbers(vec![1.0, 2.5]));
        let pair = FixedSizeListArray::new(item(DataType::Float64), 2, pair, None);
        let whole = DataType::FixedSizeList(item(DataType::Int32), 2);
        assert!(told(pair, &whole).contains("found 2.5"));
    }

    #[test]
    fn whole_numbers_keep_their_last_digits_and_no_number_becomes_infinite() {
        const FIRST: i64 = (1 << 53) + 1;
        let whole = |value: i64| Int64Array::from(vec![Some(1), None, Some(value)]);
        let decimal = |value: i128, scale: i8| {
            let values = Decimal128Array::from(vec![value]);
            values.with_precision_and_scale(20, scale).unwrap()
        };
        let (single, double) = (DataType::Float32, DataType::Float64);
        let refused = [
            (told(whole(FIRST), &double), "f64, found 9007199254740993"),
            (told(whole(-FIRST), &double), "f64, found -9007199254740993"),
            (
                told(whole(i64::MAX), &double),
                "f64, found 9223372036854775807",
            ),
            (
                told(UInt64Array::from(vec![u64::MAX]), &double),
                "f64, found 18446744073709551615",
            ),
            (told(whole((1 << 24) + 1), &single), "f32, found 16777217"),
            (
                told(Float64Array::from(vec![1.0, 1e300]), &single),
                "f32, found 1e300",
            ),
            (
                told(UInt64Array::from(vec![u64::MAX]), &DataType::Int64),
                "expected i64",
            ),
            (told(decimal(150, 2), &DataType::Int64), "i64, found 1.50"),
            (
                told(decimal(FIRST.into(), 0), &double),
                "f64, found 9007199254740993",
            ),
        ];
        for (said, expected) in refused {
            assert!(said.contains(expected), "{said}: {expected}");
        }
        let keys = DataType::Dictionary(DataType::Int8.into(), double.clone().into());
        let dictionary = cast(&Float64Array::from(vec![0.5]), &keys).unwrap();
        assert!(convert(&dictionary, &DataType::Int32).is_err());
        let far = TimestampMicrosecondArray::from(vec![i64::MAX]);
        assert!(told(far, &Stamp::data_type()).contains("verflow"));
        let item = |kind| Arc::new(Field::new_list_field(kind, true));
        let lists = vec![Some(vec![Some(1), None]), None];
        let large = LargeListArray::from_iter_primitive::<Float64Type, _, _>(vec![Some(vec![
            Some(1.0),
            Some(0.5),
        ])]);
        let said = told(large, &DataType::List(item(DataType::Int32)));
        assert!(said.contains("found 0.5"), "{said}");

        let kept: [(ArrayRef, DataType); 6] = [
            (Arc::new(whole(FIRST - 1)), double.clone()),
            (Arc::new(whole(i64::MIN)), double.clone()),
            (Arc::new(whole(1 << 24)), single.clone()),
            (
                Arc::new(Float64Array::from(vec![f64::INFINITY, f64::NAN])),
                single,
            ),
            (Arc::new(decimal(333_333_333_333_333_333, 18)), double),
            (
                Arc::new(LargeListArray::from_iter_primitive::<Int32Type, _, _>(
                    lists,
                )),
                DataType::List(item(DataType::Float64)),
            ),
        ];
        for (values, to) in kept {
            assert!(convert(&values, &to).is_ok(), "{to}");
        }
    }

    #[test]
    fn columns_that_a_layer_has_got_since_are_null_and_others_are_missed() {
        let layer = Calibration::layer();
        let lacks = |name: &str| {
            let kept = layer.columns.iter().filter(|column| column.name != name);
            let fields: Vec<_> = kept.map(Column::field).collect();
            let columns = fields.iter();
            let columns = columns.map(|field| new_empty_array(field.data_type()));
            let schema = Arc::new(Schema::new(fields.clone()));
            RecordBatch::try_new(schema, columns.collect()).unwrap()
        };
        let older = lacks("mount");
        let filled = conform(&older, &layer).unwrap();
        assert_eq!(filled.schema(), layer.schema());
        // A function in Python says all columns of what it makes.
        for refused in [
            conform(&lacks("camera"), &layer),
            conform_to(&older, &layer.schema()),
        ] {
            let said = refused.unwrap_err().to_string();
            assert!(said.contains("expected a column"), "{said}");
        }
    }

    #[test]
    fn what_a_type_holds_converts() {
        let whole: ArrayRef = Arc::new(Float64Array::from(vec![Some(2.0), None]));
        let converted = convert(&whole, &DataType::UInt32).unwrap();
        assert_eq!(converted.null_count(), 1);
        let precise: ArrayRef = Arc::new(Float64Array::from(vec![0.1]));
        let rounded = convert(&precise, &DataType::Float32).unwrap();
        assert_eq!(rounded.as_ref(), &Float32Array::from(vec![0.1]));
        let lists = vec![Some(vec![Some(1), None])];
        let lists: ArrayRef = Arc::new(ListArray::from_iter_primitive::<Int32Type, _, _>(lists));
        let item = Arc::new(Field::new_list_field(DataType::Float64, true));
        assert!(convert(&lists, &DataType::List(item)).is_ok());
    }
}
