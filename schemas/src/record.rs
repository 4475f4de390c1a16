//! A row with named columns, and the one macro that declares it.

use std::collections::HashMap;
use std::sync::Arc;

use arrow::array::{ArrayRef, AsArray, RecordBatch, StructArray, new_null_array};
use arrow::datatypes::{DataType, Field, Fields};

use crate::cell::expect;
use crate::{Cell, Fault, layer};

/// A declared column: its Arrow field, and what it means.
#[derive(Debug, Clone, PartialEq)]
pub struct Column {
    /// Column name, as SQL sees it.
    pub name: &'static str,
    /// Arrow type.
    pub data_type: DataType,
    /// Whether nulls may occur; their meaning is in `doc`.
    pub nullable: bool,
    /// SI unit, or empty for a pure number or a name.
    pub unit: &'static str,
    /// Frame of reference, or empty where there is none.
    pub frame: &'static str,
    /// One or two sentences for the reference page.
    pub doc: String,
    /// The columns within it: of a struct, or of a list's items.
    pub members: Vec<Column>,
}

impl Column {
    /// The Arrow field. Its metadata are the unit and the frame (`unit`, `frame`), so that they stay with a Parquet file;
    /// and those of what is within it, behind the path to it (`x.unit`).
    pub fn field(&self) -> Field {
        let mut metadata = HashMap::new();
        self.note("", &mut metadata);
        Field::new(self.name, self.data_type.clone(), self.nullable).with_metadata(metadata)
    }

    /// Its values in a batch: nulls where the batch does not have it and they may be, as of a layer that was stored before
    /// the column was declared.
    ///
    /// # Errors
    /// A data fault where it is missing and may have no nulls.
    pub fn of(&self, batch: &RecordBatch) -> Result<ArrayRef, Fault> {
        match layer::column(batch, self.name) {
            Ok(found) => Ok(Arc::clone(found)),
            Err(_) if self.nullable => Ok(new_null_array(&self.data_type, batch.num_rows())),
            Err(missing) => Err(missing),
        }
    }

    fn note(&self, path: &str, metadata: &mut HashMap<String, String>) {
        for (key, value) in [("unit", self.unit), ("frame", self.frame)] {
            if !value.is_empty() {
                metadata.insert(format!("{path}{key}"), value.to_owned());
            }
        }
        for member in &self.members {
            member.note(&format!("{path}{}.", member.name), metadata);
        }
    }
}

/// A struct whose fields are columns. Declared with [`record!`](crate::record), never by hand.
pub trait Record: Sized {
    /// What one row is: the struct's documentation.
    const DOC: &'static str;

    /// The columns, in order.
    fn columns() -> Vec<Column>;

    /// One array per column.
    ///
    /// # Errors
    /// As [`Cell::encode`].
    fn encode_columns(rows: Vec<Self>) -> Result<Vec<ArrayRef>, Fault>;

    /// Rows from one array per column, in order and of equal length.
    ///
    /// # Errors
    /// As [`Cell::decode`], with the column's name.
    fn decode_columns(columns: &[ArrayRef]) -> Result<Vec<Self>, Fault>;
}

fn struct_fields<T: Record>() -> Fields {
    // Nested fields carry no metadata, their column does: Arrow compares struct types with it, and SQL engines drop it.
    T::columns()
        .iter()
        .map(|column| Field::new(column.name, column.data_type.clone(), column.nullable))
        .collect()
}

/// A record inside another is a struct column.
impl<T: Record> Cell for T {
    fn data_type() -> DataType {
        DataType::Struct(struct_fields::<T>())
    }

    fn members() -> Vec<Column> {
        T::columns()
    }

    fn encode(values: Vec<Self>) -> Result<ArrayRef, Fault> {
        let columns = T::encode_columns(values)?;
        Ok(Arc::new(StructArray::try_new(
            struct_fields::<T>(),
            columns,
            None,
        )?))
    }

    fn decode(column: &ArrayRef) -> Result<Vec<Self>, Fault> {
        expect::<Self>(column)?;
        T::decode_columns(column.as_struct().columns())
    }
}

/// Takes the next column of a record; the name goes into the error.
#[doc(hidden)]
pub fn decode_column<T: Cell>(
    columns: &[ArrayRef],
    index: usize,
    name: &str,
) -> Result<std::vec::IntoIter<T>, Fault> {
    let column = columns
        .get(index)
        .ok_or_else(|| Fault::bug(format!("record lacks column {name}")))?;
    Ok(T::decode(column)
        .map_err(|fault| fault.at(format!("column {name}")))?
        .into_iter())
}

/// Declares a record: a struct, its columns with units and frames, and its way into Arrow and back.
///
/// The attribute `layer` makes it the row of a [layer](crate::LayerRow): it gives the layer's name, the columns that
/// order a row and, where there is one, the column with the geometry. The struct's documentation becomes the layer's.
///
/// ```
/// evermap_schemas::record! {
///     /// A place that was visited.
///     #[layer("visits", key(session, distance_m))]
///     pub struct Visit {
///         /// Name of the session.
///         session: String,
///         /// Distance from the start.
///         distance_m: f64 ["m"],
///         /// Height above the floor; null where it was not measured.
///         height_m: Option<f64> ["m", "map"],
///     }
/// }
/// ```
#[macro_export]
macro_rules! record {
    (
        $(#[doc = $doc:literal])+
        $(#[derive($($derived:path),+)])?
        $(#[layer($layer:expr, key($($key:ident),+) $(, geometry($geometry:ident))?)])?
        pub struct $name:ident {
            $(
                $(#[doc = $column_doc:literal])+
                $column:ident: $type:ty $([$unit:literal $(, $frame:literal)?])?
            ),+ $(,)?
        }
    ) => {
        $(#[doc = $doc])+
        #[derive(Debug, Clone, PartialEq $($(, $derived)+)?)]
        pub struct $name {
            $(
                $(#[doc = $column_doc])+
                pub $column: $type
            ),+
        }

        impl $crate::Record for $name {
            const DOC: &'static str = concat!($($doc),+).trim_ascii_start();

            fn columns() -> Vec<$crate::Column> {
                vec![$($crate::Column {
                    name: stringify!($column),
                    data_type: <$type as $crate::Cell>::data_type(),
                    nullable: <$type as $crate::Cell>::NULLABLE,
                    unit: concat!($($unit)?),
                    frame: concat!($($($frame)?)?),
                    doc: [$($column_doc.trim()),+].join(" "),
                    members: <$type as $crate::Cell>::members(),
                }),+]
            }

            fn encode_columns(rows: Vec<Self>) -> Result<Vec<$crate::arrow::array::ArrayRef>, $crate::Fault> {
                $(let mut $column = Vec::with_capacity(rows.len());)+
                for row in rows {
                    $($column.push(row.$column);)+
                }
                Ok(vec![$(<$type as $crate::Cell>::encode($column)?),+])
            }

            fn decode_columns(columns: &[$crate::arrow::array::ArrayRef]) -> Result<Vec<Self>, $crate::Fault> {
                let rows = columns.first().map_or(0, |column| $crate::arrow::array::Array::len(column));
                let mut index = 0..;
                $(let mut $column = $crate::decode_column::<$type>(columns, index.next().unwrap_or(0), stringify!($column))?;)+
                let next = || Some(Self { $($column: $column.next()?),+ });
                Ok(std::iter::from_fn(next).take(rows).collect())
            }
        }

        $(impl $crate::LayerRow for $name {
            const NAME: &'static str = $layer;
            const KEY: &'static [&'static str] = &[$(stringify!($key)),+];
            $(const GEOMETRY: Option<&'static str> = Some(stringify!($geometry));)?
        })?
    };
}
