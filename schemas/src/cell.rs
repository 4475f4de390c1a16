//! One value of one column: how it becomes Arrow and comes back.

use std::collections::BTreeMap;
use std::sync::Arc;

use arrow::array::{
    Array, ArrayRef, AsArray, BooleanArray, FixedSizeListArray, ListArray, MapArray,
    PrimitiveArray, StringArray, StructArray, UInt32Array,
};
use arrow::buffer::OffsetBuffer;
use arrow::compute::{filter, is_not_null, take};
use arrow::datatypes::{ArrowPrimitiveType, DataType, Field, Fields};

use crate::{Column, Fault};

/// A value that knows its Arrow column. Nulls exist only as `Option`.
pub trait Cell: Sized {
    /// Whether the column may hold nulls.
    const NULLABLE: bool = false;

    /// The Arrow type of the column.
    fn data_type() -> DataType;

    /// The columns within the column: of a record, or of the records that it lists.
    fn members() -> Vec<Column> {
        Vec::new()
    }

    /// The column of these values.
    ///
    /// # Errors
    /// A data fault when the values do not fit Arrow's 32-bit offsets.
    fn encode(values: Vec<Self>) -> Result<ArrayRef, Fault>;

    /// The values of a column.
    ///
    /// # Errors
    /// A data fault when the column has another type, or nulls where none may be.
    fn decode(column: &ArrayRef) -> Result<Vec<Self>, Fault>;
}

/// Fails unless the column has the type that `T` declares and no nulls that it may not have.
pub(crate) fn expect<T: Cell>(column: &ArrayRef) -> Result<(), Fault> {
    let (expected, found) = (T::data_type(), column.data_type());
    if !expected.equals_datatype(found) {
        return Err(Fault::data(format!(
            "expected a column of {expected}, found {found}"
        )));
    }
    if !T::NULLABLE && column.null_count() > 0 {
        return Err(
            Fault::data(format!("expected no nulls, found {}", column.null_count()))
                .next("filter them out in SQL, or give them a value with coalesce()"),
        );
    }
    Ok(())
}

macro_rules! primitive_cells {
    ($($native:ty => $arrow:ident),* $(,)?) => {$(
        impl Cell for $native {
            fn data_type() -> DataType {
                arrow::datatypes::$arrow::DATA_TYPE
            }
            fn encode(values: Vec<Self>) -> Result<ArrayRef, Fault> {
                Ok(Arc::new(PrimitiveArray::<arrow::datatypes::$arrow>::from_iter_values(values)))
            }
            fn decode(column: &ArrayRef) -> Result<Vec<Self>, Fault> {
                expect::<Self>(column)?;
                Ok(column.as_primitive::<arrow::datatypes::$arrow>().values().to_vec())
            }
        }
    )*};
}
primitive_cells! {
    f64 => Float64Type, f32 => Float32Type,
    i64 => Int64Type, i32 => Int32Type, i16 => Int16Type, i8 => Int8Type,
    u64 => UInt64Type, u32 => UInt32Type, u16 => UInt16Type, u8 => UInt8Type,
}

impl Cell for bool {
    fn data_type() -> DataType {
        DataType::Boolean
    }
    fn encode(values: Vec<Self>) -> Result<ArrayRef, Fault> {
        Ok(Arc::new(BooleanArray::from(values)))
    }
    fn decode(column: &ArrayRef) -> Result<Vec<Self>, Fault> {
        expect::<Self>(column)?;
        Ok(column.as_boolean().values().iter().collect())
    }
}

impl Cell for String {
    fn data_type() -> DataType {
        DataType::Utf8
    }
    fn encode(values: Vec<Self>) -> Result<ArrayRef, Fault> {
        Ok(Arc::new(StringArray::from_iter_values(values)))
    }
    fn decode(column: &ArrayRef) -> Result<Vec<Self>, Fault> {
        expect::<Self>(column)?;
        Ok(column
            .as_string::<i32>()
            .iter()
            .map(|text| text.unwrap_or_default().to_owned())
            .collect())
    }
}

/// A null stays out of the dense column and comes back through the index.
impl<T: Cell> Cell for Option<T> {
    const NULLABLE: bool = true;

    fn data_type() -> DataType {
        T::data_type()
    }

    fn members() -> Vec<Column> {
        T::members()
    }

    fn encode(values: Vec<Self>) -> Result<ArrayRef, Fault> {
        let mut next = 0;
        let index: UInt32Array = values
            .iter()
            .map(|value| {
                value.as_ref().map(|_| {
                    next += 1;
                    next - 1
                })
            })
            .collect();
        let dense = T::encode(values.into_iter().flatten().collect())?;
        Ok(take(&dense, &index, None)?)
    }

    fn decode(column: &ArrayRef) -> Result<Vec<Self>, Fault> {
        expect::<Self>(column)?;
        let dense = filter(column, &is_not_null(column)?)?;
        let mut values = T::decode(&dense)?.into_iter();
        Ok((0..column.len())
            .map(|row| {
                if column.is_null(row) {
                    None
                } else {
                    values.next()
                }
            })
            .collect())
    }
}

fn item<T: Cell>() -> Arc<Field> {
    Arc::new(Field::new_list_field(T::data_type(), T::NULLABLE))
}

impl<T: Cell> Cell for Vec<T> {
    fn data_type() -> DataType {
        DataType::List(item::<T>())
    }

    fn members() -> Vec<Column> {
        T::members()
    }

    fn encode(values: Vec<Self>) -> Result<ArrayRef, Fault> {
        let lengths: Vec<usize> = values.iter().map(Vec::len).collect();
        if lengths.iter().sum::<usize>() > i32::MAX as usize {
            return Err(
                Fault::data("more than 2^31 list items in one batch").next("use smaller batches")
            );
        }
        let items = T::encode(values.into_iter().flatten().collect())?;
        Ok(Arc::new(ListArray::try_new(
            item::<T>(),
            OffsetBuffer::from_lengths(lengths),
            items,
            None,
        )?))
    }

    fn decode(column: &ArrayRef) -> Result<Vec<Self>, Fault> {
        expect::<Self>(column)?;
        let list = column.as_list::<i32>();
        let offsets = list.value_offsets();
        let (Some(&first), Some(&last)) = (offsets.first(), offsets.last()) else {
            return Ok(Vec::new());
        };
        let items = list.values().slice(first as usize, (last - first) as usize);
        let mut items = T::decode(&items)?.into_iter();
        Ok(offsets
            .windows(2)
            .map(|pair| items.by_ref().take((pair[1] - pair[0]) as usize).collect())
            .collect())
    }
}

impl<T: Cell + Copy, const N: usize> Cell for [T; N] {
    fn data_type() -> DataType {
        DataType::FixedSizeList(item::<T>(), N as i32)
    }

    fn members() -> Vec<Column> {
        T::members()
    }

    fn encode(values: Vec<Self>) -> Result<ArrayRef, Fault> {
        let items = T::encode(values.into_iter().flatten().collect())?;
        Ok(Arc::new(FixedSizeListArray::try_new(
            item::<T>(),
            N as i32,
            items,
            None,
        )?))
    }

    fn decode(column: &ArrayRef) -> Result<Vec<Self>, Fault> {
        expect::<Self>(column)?;
        let list = column.as_fixed_size_list();
        let items = list
            .values()
            .slice(list.value_offset(0) as usize, list.len() * N);
        let items = T::decode(&items)?;
        Ok(items.as_chunks::<N>().0.to_vec())
    }
}

fn map_entries() -> Fields {
    Fields::from(vec![
        Field::new("keys", DataType::Utf8, false),
        Field::new("values", DataType::Utf8, true),
    ])
}

/// Text by text.
impl Cell for BTreeMap<String, String> {
    fn data_type() -> DataType {
        let entries = Field::new("entries", DataType::Struct(map_entries()), false);
        DataType::Map(Arc::new(entries), false)
    }

    fn encode(values: Vec<Self>) -> Result<ArrayRef, Fault> {
        let offsets = OffsetBuffer::from_lengths(values.iter().map(BTreeMap::len));
        let (keys, texts): (Vec<String>, Vec<String>) = values.into_iter().flatten().unzip();
        let columns = vec![String::encode(keys)?, String::encode(texts)?];
        let entries = StructArray::try_new(map_entries(), columns, None)?;
        let field = Field::new("entries", entries.data_type().clone(), false);
        let map = MapArray::try_new(Arc::new(field), offsets, entries, None, false)?;
        Ok(Arc::new(map))
    }

    fn decode(column: &ArrayRef) -> Result<Vec<Self>, Fault> {
        expect::<Self>(column)?;
        let map = column.as_map();
        let texts = |entries: &StructArray, of: usize| String::decode(entries.column(of));
        (0..map.len())
            .map(|row| {
                let entries = map.value(row);
                let pairs = texts(&entries, 0)?.into_iter().zip(texts(&entries, 1)?);
                Ok(pairs.collect())
            })
            .collect()
    }
}
