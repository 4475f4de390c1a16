//! A plan node that a query reads as a table.

use std::fmt;
use std::sync::Arc;

use arrow::datatypes::SchemaRef;
use async_trait::async_trait;
use datafusion::catalog::{Session, TableProvider};
use datafusion::error::Result;
use datafusion::logical_expr::{Expr, TableType};
use datafusion::physical_expr::projection::ProjectionExprs;
use datafusion::physical_plan::ExecutionPlan;
use datafusion::physical_plan::projection::ProjectionExec;

/// The rows of a plan node.
pub struct PlannedTable(pub Arc<dyn ExecutionPlan>);

impl fmt::Debug for PlannedTable {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "PlannedTable({:?})", self.0)
    }
}

#[async_trait]
impl TableProvider for PlannedTable {
    fn schema(&self) -> SchemaRef {
        self.0.schema()
    }

    fn table_type(&self) -> TableType {
        TableType::Temporary
    }

    async fn scan(
        &self,
        _: &dyn Session,
        projection: Option<&Vec<usize>>,
        _: &[Expr],
        _: Option<usize>,
    ) -> Result<Arc<dyn ExecutionPlan>> {
        let Some(projection) = projection else {
            return Ok(Arc::clone(&self.0));
        };
        let columns = ProjectionExprs::from_indices(projection, &self.0.schema());
        let projected = ProjectionExec::try_new(columns.iter().cloned(), Arc::clone(&self.0));
        Ok(Arc::new(projected?))
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::sql::{Limits, context};
    use datafusion::dataframe::DataFrameWriteOptions;
    use datafusion::prelude::ParquetReadOptions;

    #[tokio::test]
    async fn a_node_that_a_query_reads_twice_gives_its_rows_twice() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("numbers.parquet");
        let file = file.to_str().unwrap();
        let context = context(Limits::default()).unwrap();
        let numbers = context.sql("SELECT * FROM (VALUES (1), (2)) AS t(n)").await;
        let options = DataFrameWriteOptions::new();
        let written = numbers.unwrap().write_parquet(file, options, None).await;
        written.unwrap();
        let stored = context.read_parquet(file, ParquetReadOptions::default());
        let plan = stored.await.unwrap().create_physical_plan().await.unwrap();
        let table = Arc::new(PlannedTable(plan));
        context.register_table("numbers", table).unwrap();
        let twice = "SELECT n FROM numbers UNION ALL SELECT n + 10 FROM numbers";
        let rows = context.sql(twice).await.unwrap().collect().await.unwrap();
        assert_eq!(rows.iter().map(|batch| batch.num_rows()).sum::<usize>(), 4);
    }
}
