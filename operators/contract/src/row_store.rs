//! Rows of a side that a kernel fetches one at a time, where all of them would fill the memory.
//!
//! An engine keeps the rows of a port that is [fetched](crate::Port::fetched()) where there is room, on a disk too. What is
//! held of them is a catalogue: the columns that are light, and a number by which each row is found.

use std::fmt;
use std::marker::PhantomData;
use std::sync::Arc;

use arrow::array::{AsArray, RecordBatch, UInt64Array};
use arrow::compute::take_record_batch;
use arrow::datatypes::{DataType, Field, Schema, UInt64Type};
use evermap_schemas::{Fault, Record, rows};

/// Rows by number.
pub trait RowStore: fmt::Debug + Send + Sync {
    /// The row of this number, which counts from 0 in the order in which the rows came, as a batch of one.
    ///
    /// # Errors
    /// When it cannot be fetched.
    fn row(&self, number: u64) -> Result<RecordBatch, Fault>;
}

/// A row store in memory.
#[derive(Debug, Default)]
pub struct InMemory {
    /// The number of the first row of each batch, and the batch.
    batches: Vec<(u64, RecordBatch)>,
}

impl InMemory {
    /// The rows of these batches.
    pub fn new(batches: Vec<RecordBatch>) -> Self {
        let mut next = 0;
        let numbered = batches.into_iter().map(|batch| {
            let first = next;
            next += batch.num_rows() as u64;
            (first, batch)
        });
        Self {
            batches: numbered.collect(),
        }
    }
}

impl RowStore for InMemory {
    fn row(&self, number: u64) -> Result<RecordBatch, Fault> {
        let behind = self.batches.partition_point(|(first, _)| *first <= number);
        let found = behind.checked_sub(1).and_then(|at| {
            let (first, batch) = &self.batches[at];
            let row = (number - first) as usize;
            (row < batch.num_rows()).then(|| batch.slice(row, 1))
        });
        found.ok_or_else(|| no_row(number))
    }
}

/// The column of a catalogue with the numbers of its rows.
const NUMBER: &str = "number_in_store";

/// What is held of rows in a row store, whose numbers are those from `first` on: their columns that hold neither lists,
/// structs nor bytes, and the numbers. It shares no memory with the rows.
///
/// # Errors
/// When the rows do not fit Arrow.
pub fn catalogue(rows: &RecordBatch, first: u64) -> Result<RecordBatch, Fault> {
    let schema = rows.schema_ref();
    let all = schema.fields().iter().zip(rows.columns());
    let light = all.filter(|(field, _)| is_light(field.data_type()));
    let (mut fields, mut columns): (Vec<_>, Vec<_>) = light
        .map(|(field, column)| (Arc::clone(field), Arc::clone(column)))
        .unzip();
    let count = rows.num_rows() as u64;
    fields.push(Arc::new(Field::new(NUMBER, DataType::UInt64, false)));
    columns.push(Arc::new(UInt64Array::from_iter_values(
        first..first + count,
    )));
    let shared = RecordBatch::try_new(Arc::new(Schema::new(fields)), columns)?;
    let every = UInt64Array::from_iter_values(0..count);
    Ok(take_record_batch(&shared, &every)?)
}

fn is_light(column: &DataType) -> bool {
    let bytes = [
        DataType::Binary,
        DataType::LargeBinary,
        DataType::BinaryView,
    ];
    !column.is_nested() && !bytes.contains(column)
}

/// The rows of a port that is fetched, of the site or the group at hand. They are counted as those that
/// [`Sides::rows`](crate::Sides::rows) gives of the port, in the same order.
pub struct FetchedRows<T> {
    numbers: Vec<u64>,
    store: Option<Arc<dyn RowStore>>,
    rows: PhantomData<fn() -> T>,
}

impl<T: Record> FetchedRows<T> {
    /// The rows of a catalogue; there are none where the port is not connected.
    pub(crate) fn of(
        catalogue: &[RecordBatch],
        store: Option<Arc<dyn RowStore>>,
    ) -> Result<Self, Fault> {
        let mut numbers = Vec::new();
        for batch in catalogue {
            let column = batch.column_by_name(NUMBER);
            let column = column.and_then(|column| column.as_primitive_opt::<UInt64Type>());
            let column = column.ok_or_else(|| Fault::bug("the port is not declared as fetched"))?;
            numbers.extend_from_slice(column.values());
        }
        Ok(Self {
            numbers,
            store,
            rows: PhantomData,
        })
    }

    /// The row at this place.
    ///
    /// # Errors
    /// A resource fault when it cannot be fetched, a data fault when it is not of this type, and a bug fault when there is
    /// no such place.
    pub fn row(&self, at: usize) -> Result<T, Fault> {
        let missing = || no_row(at as u64);
        let number = self.numbers.get(at).ok_or_else(missing)?;
        let store = self.store.as_ref().ok_or_else(missing)?;
        let row = rows(&store.row(*number)?)?.pop();
        row.ok_or_else(missing)
    }
}

fn no_row(number: u64) -> Fault {
    Fault::bug(format!("there is no row {number} in the store"))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::{Key, Port, Sides};
    use arrow::array::Array;
    use evermap_schemas::{Bytes, batch, record};

    record! {
        /// A thing with more to it than its name.
        #[layer("things", key(site, thing))]
        pub struct Thing {
            /// Site.
            site: String,
            /// Its number.
            thing: u32,
            /// Sizes.
            sizes: Vec<f32>,
            /// What it looks like.
            look: Bytes,
        }
    }

    record! {
        /// What a catalogue has of a thing.
        pub struct Name {
            /// Site.
            site: String,
            /// Its number.
            thing: u32,
        }
    }

    fn thing(site: &str, thing: u32) -> Thing {
        Thing {
            site: site.to_owned(),
            thing,
            sizes: vec![0.5; thing as usize],
            look: Bytes(vec![thing as u8; 3]),
        }
    }

    /// Four things of two sites, in three batches.
    fn sides() -> (Port, Sides) {
        let port = Port::site::<Thing>("things").fetched();
        let rows = [
            vec![thing("a", 1)],
            vec![thing("a", 2), thing("b", 1)],
            vec![thing("b", 3)],
        ];
        let batches: Vec<_> = rows.map(|rows| batch(rows).unwrap()).into();
        let firsts = [0, 1, 3];
        let catalogue = batches.iter().zip(firsts);
        let catalogue = catalogue.map(|(rows, first)| super::catalogue(rows, first).unwrap());
        let mut sides = Sides::default();
        let catalogue = catalogue.collect();
        sides.store(port.name, catalogue, Arc::new(InMemory::new(batches)));
        (port, sides)
    }

    fn of(sides: &Sides) -> Vec<Thing> {
        let names: Vec<Name> = sides.rows("things").unwrap();
        let fetched = sides.fetched::<Thing>("things").unwrap();
        assert!(fetched.row(names.len()).is_err());
        let rows = names.iter().enumerate().map(|(at, name)| {
            let row = fetched.row(at).unwrap();
            assert_eq!((&row.site, row.thing), (&name.site, name.thing));
            row
        });
        rows.collect()
    }

    #[test]
    fn rows_of_a_store_are_those_of_the_group_at_hand() {
        let (port, mut sides) = sides();
        let all = [thing("a", 1), thing("a", 2), thing("b", 1), thing("b", 3)];
        assert_eq!(of(&sides), all);
        let sites = sides.by_site().unwrap();
        assert_eq!(of(&sites["b"]), all[2..]);
        let group = batch(vec![thing("b", 7)]).unwrap();
        let columns = Key::SITE.columns;
        let own = sides.leave(&[port], &group, columns).unwrap();
        assert_eq!(of(&own), all[2..]);
        assert_eq!(of(&sides), all[..2]);
    }

    #[test]
    fn a_catalogue_has_what_is_light_and_shares_nothing_with_its_rows() {
        let rows = batch(vec![thing("a", 1), thing("a", 2)]).unwrap();
        let held = catalogue(&rows, 5).unwrap();
        let names: Vec<_> = held
            .schema_ref()
            .fields()
            .iter()
            .map(|field| field.name().clone())
            .collect();
        assert_eq!(names, ["site", "thing", NUMBER]);
        let buffers = |batch: &RecordBatch| {
            let things = batch.column_by_name("thing").unwrap().to_data();
            things.buffers()[0].as_ptr()
        };
        assert_ne!(buffers(&held), buffers(&rows));
    }

    #[test]
    fn a_port_that_is_not_connected_has_no_rows_and_one_that_is_not_fetched_is_told() {
        let none = Sides::default();
        assert!(none.fetched::<Thing>("things").unwrap().row(0).is_err());
        let rows = batch(vec![thing("a", 1)]).unwrap();
        let whole = Sides::new([("things".to_owned(), vec![rows])].into());
        assert!(whole.fetched::<Thing>("things").is_err());
    }
}
