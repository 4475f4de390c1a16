//! The tables that a kernel reads beside its driving rows, and the images that came with rows.

use std::collections::BTreeMap;
use std::sync::Arc;

use arrow::array::{Array, AsArray, BinaryArray, RecordBatch};
use arrow::compute::partition;
use evermap_schemas::{Fault, Record, rows};

use crate::Port;
use crate::port::pixels_column;
use crate::row_store::{FetchedRows, RowStore};

/// The tables of the ports other than the driving one, by port name: the rows of one site, or of the group at hand, in
/// the order of the layer's key.
#[derive(Debug, Clone, Default)]
pub struct Sides {
    /// By port; of one that is fetched, the catalogue of its rows.
    tables: BTreeMap<String, Vec<RecordBatch>>,
    /// By port that is fetched: its rows.
    stores: BTreeMap<String, Arc<dyn RowStore>>,
}

impl Sides {
    /// Sides from tables by port name.
    pub fn new(tables: BTreeMap<String, Vec<RecordBatch>>) -> Self {
        Self {
            tables,
            stores: BTreeMap::new(),
        }
    }

    /// Adds the table of a port.
    pub fn add(&mut self, port: &str, table: Vec<RecordBatch>) {
        self.tables.insert(port.to_owned(), table);
    }

    /// Adds the rows of a port that is [fetched](Port::fetched()), which this is the [catalogue](crate::catalogue) of.
    pub fn store(&mut self, port: &str, catalogue: Vec<RecordBatch>, store: Arc<dyn RowStore>) {
        self.add(port, catalogue);
        self.stores.insert(port.to_owned(), store);
    }

    /// The rows of a port that is [fetched](Port::fetched()), to be fetched one at a time; what its catalogue has of them are
    /// its [`Sides::rows`].
    ///
    /// # Errors
    /// A bug fault where the port was not declared as fetched.
    pub fn fetched<T: Record>(&self, port: &str) -> Result<FetchedRows<T>, Fault> {
        let fetched = FetchedRows::of(self.batches(port), self.stores.get(port).cloned());
        fetched.map_err(|fault| fault.at(format!("port {port}")))
    }

    /// The typed rows of a port; none where it is not connected.
    ///
    /// # Errors
    /// As [`evermap_schemas::rows`].
    pub fn rows<T: Record>(&self, port: &str) -> Result<Vec<T>, Fault> {
        let mut all = Vec::new();
        for batch in self.batches(port) {
            all.extend(typed::<T>(batch, port)?);
        }
        Ok(all)
    }

    /// As [`Sides::rows`], letting go of the table while its rows are made: for tables that fill the memory.
    ///
    /// # Errors
    /// As [`Sides::rows`].
    pub fn take<T: Record>(&mut self, port: &str) -> Result<Vec<T>, Fault> {
        let mut all = Vec::new();
        for batch in self.tables.remove(port).unwrap_or_default() {
            all.extend(typed::<T>(&batch, port)?);
        }
        Ok(all)
    }

    /// The images of a port's column, row for row with [`Sides::rows`].
    ///
    /// # Errors
    /// A bug fault where the port was not declared with pixels of that column.
    pub fn pixels(&self, port: &str, column: &str) -> Result<Pixels, Fault> {
        Pixels::of(self.batches(port), Some(column))
            .map_err(|fault| fault.at(format!("port {port}")))
    }

    fn batches(&self, port: &str) -> &[RecordBatch] {
        self.tables.get(port).map_or(&[], Vec::as_slice)
    }

    /// Whether a table that is needed has no rows.
    pub(crate) fn lacks(&self, ports: &[Port]) -> bool {
        let empty = |port: &Port| {
            self.batches(port.name)
                .iter()
                .all(|rows| rows.num_rows() == 0)
        };
        ports.iter().any(|port| port.needed && empty(port))
    }

    /// The tables cut by site. A table without a column `site` belongs to every site.
    pub(crate) fn by_site(&self) -> Result<BTreeMap<String, Sides>, Fault> {
        let mut sites: BTreeMap<String, Sides> = BTreeMap::new();
        for (port, batches) in &self.tables {
            for batch in batches {
                for part in runs_of_equal(batch, &["site"])? {
                    if let Some(site) = site_of(&part) {
                        let tables = &mut sites.entry(site.to_owned()).or_default().tables;
                        tables.entry(port.clone()).or_default().push(part);
                    }
                }
            }
        }
        for sides in sites.values_mut() {
            sides.tables.extend(self.everywhere().tables);
            sides.stores = self.stores.clone();
        }
        Ok(sites)
    }

    /// The tables that belong to no site.
    pub(crate) fn everywhere(&self) -> Sides {
        let no_site = |batches: &&Vec<RecordBatch>| {
            batches
                .iter()
                .all(|batch| batch.column_by_name("site").is_none())
        };
        let tables = self.tables.iter();
        let tables = tables.filter(|(_, batches)| no_site(batches));
        Sides {
            tables: tables
                .map(|(port, batches)| (port.clone(), batches.clone()))
                .collect(),
            stores: self.stores.clone(),
        }
    }

    /// What belongs with a group of the driving port: the rows that are equal in those of the group's columns that say
    /// how far the port reaches. Rows that no other group can want leave with it.
    pub(crate) fn leave(
        &mut self,
        ports: &[Port],
        group: &RecordBatch,
        group_columns: &[&str],
    ) -> Result<Sides, Fault> {
        let mut own = BTreeMap::new();
        for port in ports {
            let Some(batches) = self.tables.get_mut(port.name) else {
                continue;
            };
            let mut columns = port.reach.columns().to_vec();
            columns.retain(|column| group_columns.contains(column));
            let shared = columns.len() < group_columns.len();
            let (mut kept, mut left) = (Vec::new(), Vec::new());
            for batch in std::mem::take(batches) {
                for part in runs_of_equal(&batch, &columns)? {
                    let belongs = same_group(&part, group, &columns);
                    if belongs {
                        kept.push(part.clone());
                    }
                    if shared || !belongs {
                        left.push(part);
                    }
                }
            }
            *batches = left;
            own.insert(port.name.to_owned(), kept);
        }
        Ok(Sides {
            tables: own,
            stores: self.stores.clone(),
        })
    }
}

fn typed<T: Record>(batch: &RecordBatch, port: &str) -> Result<Vec<T>, Fault> {
    rows(batch).map_err(|fault| fault.at(format!("port {port}")))
}

/// The encoded images that came with rows, by row.
#[derive(Debug, Clone, Default)]
pub struct Pixels {
    /// The first row of each batch, and its images.
    batches: Vec<(usize, BinaryArray)>,
}

impl Pixels {
    /// Of a column; there are none where no column is named.
    pub(crate) fn of(batches: &[RecordBatch], column: Option<&str>) -> Result<Self, Fault> {
        let mut pixels = Self::default();
        let mut first = 0;
        for batch in batches {
            if let Some(column) = column {
                pixels.batches.push((first, images(batch, column)?));
            }
            first += batch.num_rows();
        }
        Ok(pixels)
    }

    /// The image of a row; `None` where it could not be fetched, which is counted already, with its topic and encoding.
    pub fn get(&self, row: usize) -> Option<&[u8]> {
        let batch = self.batches.partition_point(|(first, _)| *first <= row);
        let (first, images) = self.batches.get(batch.checked_sub(1)?)?;
        let row = row - first;
        (row < images.len() && !images.is_null(row)).then(|| images.value(row))
    }
}

fn images(batch: &RecordBatch, column: &str) -> Result<BinaryArray, Fault> {
    batch
        .column_by_name(&pixels_column(column))
        .and_then(|images| images.as_binary_opt::<i32>())
        .cloned()
        .ok_or_else(|| Fault::bug(format!("column {column} comes without its pixels")))
}

/// The site of a batch's first row; `None` where there is none.
pub(crate) fn site_of(rows: &RecordBatch) -> Option<&str> {
    let sites = rows.column_by_name("site")?.as_string_opt::<i32>()?;
    (!sites.is_empty()).then(|| sites.value(0))
}

/// Whether the first rows of two batches are of one group: equal in these columns, as far as both have them.
pub(crate) fn same_group(a: &RecordBatch, b: &RecordBatch, columns: &[&str]) -> bool {
    columns.iter().all(
        |name| match (a.column_by_name(name), b.column_by_name(name)) {
            (Some(a), Some(b)) if !a.is_empty() && !b.is_empty() => {
                a.slice(0, 1).to_data() == b.slice(0, 1).to_data()
            }
            _ => true,
        },
    )
}

/// Runs of rows with equal values in these columns; all rows where there are no such columns.
///
/// # Errors
/// When a column cannot be compared.
pub(crate) fn runs_of_equal(
    rows: &RecordBatch,
    columns: &[&str],
) -> Result<Vec<RecordBatch>, Fault> {
    let columns: Vec<_> = columns
        .iter()
        .filter_map(|name| rows.column_by_name(name).cloned())
        .collect();
    if rows.num_rows() == 0 {
        return Ok(Vec::new());
    }
    if columns.is_empty() {
        return Ok(vec![rows.clone()]);
    }
    Ok(partition(&columns)?
        .ranges()
        .into_iter()
        .map(|range| rows.slice(range.start, range.len()))
        .collect())
}
