//! Planning that asks whether somebody still waits: a query of some thousand terms is planned for minutes, without a pause
//! at which its task could be dropped.

use std::sync::Arc;

use datafusion::common::DFSchema;
use datafusion::common::config::ConfigOptions;
use datafusion::common::tree_node::Transformed;
use datafusion::error::Result;
use datafusion::execution::SessionStateBuilder;
use datafusion::logical_expr::LogicalPlan;
use datafusion::logical_expr::planner::{ExprPlanner, PlannerResult, RawBinaryExpr};
use datafusion::optimizer::{
    Analyzer, AnalyzerRule, ApplyOrder, Optimizer, OptimizerConfig, OptimizerRule,
};

use crate::sql::term::go_on;

/// Has DataFusion's own rules ask before they look at a plan, or at a node of it.
pub(super) fn asking(builder: SessionStateBuilder) -> SessionStateBuilder {
    let mut analyzing: Vec<Arc<dyn AnalyzerRule + Send + Sync>> = Vec::new();
    for rule in Analyzer::new().rules {
        analyzing.push(Arc::new(Analyzing(rule)));
    }
    let mut optimizing: Vec<Arc<dyn OptimizerRule + Send + Sync>> = Vec::new();
    for rule in Optimizer::new().rules {
        optimizing.push(Arc::new(Optimizing(rule)));
    }
    builder
        .with_analyzer_rules(analyzing)
        .with_optimizer_rules(optimizing)
}

/// Asks at each operator of a query that is read. It plans none itself, and has to come first.
#[derive(Debug)]
pub(super) struct Operators;

impl ExprPlanner for Operators {
    fn plan_binary_op(
        &self,
        expr: RawBinaryExpr,
        _: &DFSchema,
    ) -> Result<PlannerResult<RawBinaryExpr>> {
        go_on()?;
        Ok(PlannerResult::Original(expr))
    }
}

#[derive(Debug)]
struct Analyzing(Arc<dyn AnalyzerRule + Send + Sync>);

impl AnalyzerRule for Analyzing {
    fn analyze(&self, plan: LogicalPlan, config: &ConfigOptions) -> Result<LogicalPlan> {
        go_on()?;
        self.0.analyze(plan, config)
    }

    fn name(&self) -> &str {
        self.0.name()
    }
}

#[derive(Debug)]
struct Optimizing(Arc<dyn OptimizerRule + Send + Sync>);

impl OptimizerRule for Optimizing {
    fn name(&self) -> &str {
        self.0.name()
    }

    fn apply_order(&self) -> Option<ApplyOrder> {
        self.0.apply_order()
    }

    fn rewrite(
        &self,
        plan: LogicalPlan,
        config: &dyn OptimizerConfig,
    ) -> Result<Transformed<LogicalPlan>> {
        go_on()?;
        self.0.rewrite(plan, config)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use crate::sql::{Limits, Term, context, read_only};

    #[tokio::test]
    async fn planning_ends_wherever_it_is_when_its_term_is_over() {
        let context = context(Limits::one_partition()).unwrap();
        let query = "SELECT value FROM generate_series(1, 3) WHERE value > 2";
        let frame = read_only(&context, query).await.unwrap();
        let (state, plan) = (context.state(), frame.logical_plan());
        let over = Term::default();
        over.end();
        let said = |ended: Option<String>| {
            let ended = ended.unwrap_or_default();
            assert!(ended.contains("stopped"), "{ended}");
        };
        let read = over.of(read_only(&context, query)).await;
        said(read.err().map(|fault| fault.to_string()));
        let optimizer = state.optimizer();
        let optimized = over.of(async { optimizer.optimize(plan.clone(), &state, |_, _| {}) });
        said(optimized.await.err().map(|error| error.to_string()));
        let analyzer = state.analyzer();
        let options = state.config_options();
        let analyzed =
            over.of(async { analyzer.execute_and_check(plan.clone(), options, |_, _| {}) });
        said(analyzed.await.err().map(|error| error.to_string()));
        let ran = over.of(frame.clone().create_physical_plan()).await;
        said(ran.err().map(|error| error.to_string()));
        // Nobody's plans are as they were.
        assert!(read_only(&context, query).await.is_ok());
        frame.create_physical_plan().await.unwrap();
    }
}
