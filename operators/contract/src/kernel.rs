//! Kernels as the engines run them: without types, on batches of one site.

use arrow::array::RecordBatch;
use evermap_schemas::{Bytes, Fault};

use crate::{Emit, Sides};

/// Makes something once for all rows of a site, from the tables of its side ports.
pub(crate) type Prepare<T> = Box<dyn Fn(&Sides) -> Result<T, Fault> + Send + Sync>;

/// Begins with a key, given the tables of its side ports to keep.
pub(crate) type GroupOpener = Box<dyn Fn(Sides) -> Result<Box<dyn Rows>, Fault> + Send + Sync>;

/// A Map at work: any rows of its site to rows.
pub(crate) type Mapper =
    Box<dyn Fn(&RecordBatch, &mut Emit<'_>) -> Result<(), Fault> + Send + Sync>;

/// An operator's work with its parameters.
pub(crate) enum Kernel {
    /// Any rows to rows.
    Map(Prepare<Mapper>),
    /// One key's ordered rows to rows.
    Group(GroupOpener),
    /// Rows to states by key, states to one row.
    Fold(Prepare<Box<dyn Folding>>),
}

/// Something that takes rows, and may emit at any time.
pub(crate) trait Rows: Send {
    /// Takes the next rows.
    fn push(&mut self, rows: &RecordBatch, emit: &mut Emit<'_>) -> Result<(), Fault>;

    /// Rows that it has taken and works on when there are no more.
    fn held(&self) -> usize {
        0
    }

    /// There are no more rows.
    fn close(self: Box<Self>, emit: &mut Emit<'_>) -> Result<(), Fault>;
}

/// A fold of one site.
pub(crate) trait Folding: Send + Sync {
    /// Takes rows, emits states.
    fn lifter<'a>(&'a self, site: &str) -> Box<dyn Rows + 'a>;

    /// Merges all states of a key and emits its row.
    fn finish(
        &self,
        site: &str,
        key: &Bytes,
        states: Vec<Bytes>,
        emit: &mut Emit<'_>,
    ) -> Result<(), Fault>;
}
