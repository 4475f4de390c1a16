//! The three shapes of work.

use std::collections::BTreeMap;

use arrow::array::{ArrayRef, RecordBatch};
use arrow::compute::partition;
use evermap_schemas::{Fault, Record, rows};

use crate::{Emit, FoldKernel, Port};

/// The tables of the ports other than the driving one, by port name. They hold at least the rows that belong with
/// the driving rows (a session's, or the whole site's, as the port's grain says), in the order of the layer's key.
#[derive(Debug, Clone, Default)]
pub struct Sides(BTreeMap<String, Vec<RecordBatch>>);

impl Sides {
    /// Sides from tables by port name.
    pub fn new(tables: BTreeMap<String, Vec<RecordBatch>>) -> Self {
        Self(tables)
    }

    /// The typed rows of a port; none where it is not connected.
    ///
    /// # Errors
    /// As [`evermap_schemas::rows`].
    pub fn rows<T: Record>(&self, port: &str) -> Result<Vec<T>, Fault> {
        let mut all = Vec::new();
        for batch in self.batches(port) {
            all.extend(rows::<T>(batch).map_err(|fault| fault.at(format!("port {port}")))?);
        }
        Ok(all)
    }

    /// The batches of a port.
    pub fn batches(&self, port: &str) -> &[RecordBatch] {
        self.0.get(port).map_or(&[], Vec::as_slice)
    }

    /// What belongs with a group of the driving port: the rows that are equal in the key columns of a `Key` port, of
    /// the same site for a `Whole` one, everything of a `Row` one. Rows are ordered by those columns already.
    ///
    /// # Errors
    /// When a key column cannot be compared.
    pub fn belonging(&self, ports: &[Port], group: &RecordBatch) -> Result<Sides, Fault> {
        let mut tables = BTreeMap::new();
        for port in ports {
            let columns = port.grain.group_columns();
            let mut kept = Vec::new();
            for batch in self.batches(port.name) {
                for part in runs_of_equal(batch, columns)? {
                    if same_group(&part, group, columns) {
                        kept.push(part);
                    }
                }
            }
            tables.insert(port.name.to_owned(), kept);
        }
        Ok(Sides::new(tables))
    }
}

/// Whether the first rows of two batches are of one group: equal in these columns, as far as both have them.
pub fn same_group(a: &RecordBatch, b: &RecordBatch, columns: &[&str]) -> bool {
    columns.iter().all(
        |name| match (a.column_by_name(name), b.column_by_name(name)) {
            (Some(a), Some(b)) if !a.is_empty() && !b.is_empty() => {
                a.slice(0, 1).to_data() == b.slice(0, 1).to_data()
            }
            _ => true,
        },
    )
}

/// Runs of rows with equal values in these columns, by which the rows are ordered already; all rows where there are
/// no such columns.
///
/// # Errors
/// When a column cannot be compared.
pub fn runs_of_equal(rows: &RecordBatch, columns: &[&str]) -> Result<Vec<RecordBatch>, Fault> {
    let columns: Vec<ArrayRef> = columns
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

/// An operator's work, ready to run.
pub enum Kernel {
    /// Batch to rows; any split of the input gives the same rows.
    Map(Box<dyn MapKernel>),
    /// One key's ordered rows to rows.
    Group(Box<dyn GroupKernel>),
    /// Lift, merge, finish.
    Fold(Box<dyn FoldKernel>),
}

/// A Map before it has seen its sides.
pub trait MapKernel: Send + Sync {
    /// Prepares for rows, once per partition: look-up tables are made here.
    ///
    /// # Errors
    /// A data fault when the sides make no sense.
    fn open(&self, sides: &Sides) -> Result<Box<dyn Mapper>, Fault>;
}

/// A Map at work.
pub trait Mapper: Send + Sync {
    /// Turns one batch into rows.
    ///
    /// # Errors
    /// Only for what makes the whole run senseless; a bad row is skipped with [`Emit::skip`].
    fn map(&self, rows: &RecordBatch, emit: &mut Emit<'_>) -> Result<(), Fault>;
}

/// A Group before it has seen its sides.
pub trait GroupKernel: Send + Sync {
    /// Prepares for the rows of one key, given the sides.
    ///
    /// # Errors
    /// A data fault when the sides make no sense.
    fn open(&self, sides: &Sides) -> Result<Box<dyn Group>, Fault>;
}

/// A Group at work on one key. Rows arrive in order, in batches of any size; rows may be emitted at any time.
pub trait Group: Send {
    /// Takes the next rows of the key.
    ///
    /// # Errors
    /// As [`Mapper::map`].
    fn push(&mut self, rows: &RecordBatch, emit: &mut Emit<'_>) -> Result<(), Fault>;

    /// The key's rows have all been pushed.
    ///
    /// # Errors
    /// As [`Mapper::map`].
    fn close(&mut self, emit: &mut Emit<'_>) -> Result<(), Fault>;
}

/// A Group that needs all rows of its key at once: typed rows in, work done when the key closes.
pub fn group_whole<In, F>(work: F) -> Kernel
where
    In: Record + Send + Sync + 'static,
    F: Fn(Vec<In>, &Sides, &mut Emit<'_>) -> Result<(), Fault> + Send + Sync + Clone + 'static,
{
    Kernel::Group(Box::new(WholeKernel {
        work,
        rows: std::marker::PhantomData::<fn() -> In>,
    }))
}

struct WholeKernel<In, F> {
    work: F,
    rows: std::marker::PhantomData<fn() -> In>,
}

struct WholeGroup<In, F> {
    work: F,
    sides: Sides,
    rows: Vec<In>,
}

impl<In, F> GroupKernel for WholeKernel<In, F>
where
    In: Record + Send + Sync + 'static,
    F: Fn(Vec<In>, &Sides, &mut Emit<'_>) -> Result<(), Fault> + Send + Sync + Clone + 'static,
{
    fn open(&self, sides: &Sides) -> Result<Box<dyn Group>, Fault> {
        Ok(Box::new(WholeGroup {
            work: self.work.clone(),
            sides: sides.clone(),
            rows: Vec::<In>::new(),
        }))
    }
}

impl<In, F> Group for WholeGroup<In, F>
where
    In: Record + Send,
    F: Fn(Vec<In>, &Sides, &mut Emit<'_>) -> Result<(), Fault> + Send,
{
    fn push(&mut self, batch: &RecordBatch, _: &mut Emit<'_>) -> Result<(), Fault> {
        self.rows.extend(rows::<In>(batch)?);
        Ok(())
    }

    fn close(&mut self, emit: &mut Emit<'_>) -> Result<(), Fault> {
        (self.work)(std::mem::take(&mut self.rows), &self.sides, emit)
    }
}
