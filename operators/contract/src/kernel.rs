//! The three shapes of work.

use std::collections::BTreeMap;

use arrow::array::RecordBatch;
use evermap_schemas::{Fault, Record, rows};

use crate::{Emit, FoldKernel};

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
