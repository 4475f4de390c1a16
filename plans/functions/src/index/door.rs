//! Indexes as their context has them whenever they are read. Who opens tables looks at their files again, and answers of
//! indexes whose files are not what they were are refused as those of any layer.

use std::sync::Arc;

use arrow::datatypes::SchemaRef;
use async_trait::async_trait;
use datafusion::catalog::{SchemaProvider, Session, TableProvider};
use datafusion::common::{Result, TableReference, plan_datafusion_err};
use datafusion::logical_expr::{Expr, TableType};
use datafusion::physical_plan::ExecutionPlan;
use datafusion::prelude::{SessionConfig, SessionContext};

/// A table that is opened whenever it is read. It has the tables of its context and not the context, which has the rule that
/// has this.
#[derive(Debug)]
pub(super) struct Door {
    tables: Arc<dyn SchemaProvider>,
    name: &'static str,
    schema: SchemaRef,
}

impl Door {
    /// To a table of a context.
    ///
    /// # Errors
    /// What opening it says.
    pub(super) async fn to(context: &SessionContext, name: &'static str) -> Result<Arc<Self>> {
        let table = TableReference::bare(name);
        let tables = context.state().schema_for_ref(table.clone())?;
        let schema = context.table_provider(table).await?.schema();
        Ok(Arc::new(Self {
            tables,
            name,
            schema,
        }))
    }

    /// The table, as it is now.
    ///
    /// # Errors
    /// What opening it says.
    pub(super) async fn opened(&self) -> Result<Arc<dyn TableProvider>> {
        let found = self.tables.table(self.name).await?;
        found.ok_or_else(|| plan_datafusion_err!("expected a table {}, found none", self.name))
    }

    /// A context of the runtime of another one that has this table alone.
    ///
    /// # Errors
    /// A fault of ours.
    pub(super) fn alone(self: &Arc<Self>, beside: &SessionContext) -> Result<SessionContext> {
        let one = SessionContext::new_with_config_rt(SessionConfig::new(), beside.runtime_env());
        one.register_table(self.name, Arc::clone(self) as Arc<dyn TableProvider>)?;
        Ok(one)
    }
}

#[async_trait]
impl TableProvider for Door {
    fn schema(&self) -> SchemaRef {
        Arc::clone(&self.schema)
    }

    fn table_type(&self) -> TableType {
        TableType::View
    }

    async fn scan(
        &self,
        session: &dyn Session,
        projection: Option<&Vec<usize>>,
        filters: &[Expr],
        limit: Option<usize>,
    ) -> Result<Arc<dyn ExecutionPlan>> {
        let table = self.opened().await?;
        table.scan(session, projection, filters, limit).await
    }
}
