//! Tables for people.

use evermap_schemas::record;

record! {
    /// One table.
    #[layer("tables", key(table))]
    pub struct TableLine {
        /// Table, as a query names it.
        table: String,
        /// Columns.
        columns: u32,
        /// What one row is.
        rows_are: String,
    }
}
