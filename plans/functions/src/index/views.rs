//! The layer `views` in a query's plan, told from what is only called so.

use datafusion::common::tree_node::{TreeNode, TreeNodeRecursion};
use datafusion::common::{ResolvedTableReference, Result, TableReference};
use datafusion::logical_expr::LogicalPlan;
use datafusion::prelude::SessionContext;
use evermap_schemas::LayerRow;
use evermap_schemas::layers::View;

/// The layer, as plans have it.
pub(super) struct Views {
    /// Other maps may have a layer of that name, in a schema of their own.
    name: ResolvedTableReference,
    /// What stands for it, where it is itself a query on files.
    query: LogicalPlan,
}

impl Views {
    /// That of a context.
    ///
    /// # Errors
    /// When it cannot be planned.
    pub(super) async fn of(context: &SessionContext) -> Result<Self> {
        let plan = context.table(View::NAME).await?.into_unoptimized_plan();
        let state = context.state();
        let options = state.config_options();
        let plan = state
            .analyzer()
            .execute_and_check(plan, options, |_, _| {})?;
        let names = &options.catalog;
        let name = TableReference::bare(View::NAME);
        Ok(Self {
            name: name.resolve(&names.default_catalog, &names.default_schema),
            query: match plan {
                LogicalPlan::SubqueryAlias(alias) => alias.input.as_ref().clone(),
                plan => plan,
            },
        })
    }

    /// Whether a table of a plan's input is this layer, perhaps under another name. Whatever else the input calls by that
    /// name is, too.
    pub(super) fn are(&self, input: &LogicalPlan, table: &TableReference) -> bool {
        let mut meant = Vec::new();
        // Never fails: nothing in the closure does.
        let _ = input.apply(|plan| {
            match plan {
                LogicalPlan::SubqueryAlias(alias) if alias.alias == *table => {
                    meant.push(self.is(plan));
                    return Ok(TreeNodeRecursion::Jump);
                }
                LogicalPlan::TableScan(scan) if scan.table_name == *table => {
                    meant.push(self.is(plan));
                }
                _ => {}
            }
            Ok(TreeNodeRecursion::Continue)
        });
        !meant.is_empty() && meant.into_iter().all(|views| views)
    }

    fn is(&self, plan: &LogicalPlan) -> bool {
        match plan {
            LogicalPlan::TableScan(scan) => self.named(&scan.table_name),
            LogicalPlan::SubqueryAlias(alias) => {
                self.is(&alias.input) || self.named(&alias.alias) && *alias.input == self.query
            }
            _ => false,
        }
    }

    fn named(&self, table: &TableReference) -> bool {
        let (catalog, schema) = (&self.name.catalog, &self.name.schema);
        table.clone().resolve(catalog, schema) == self.name
    }
}
