//! An as-of join in a logical plan, and its way into a physical one.

use std::cmp::Ordering;
use std::collections::HashMap;
use std::fmt;
use std::sync::Arc;

use datafusion::catalog::Session;
use datafusion::common::{DFSchema, DFSchemaRef, Result, internal_err};
use datafusion::execution::context::QueryPlanner;
use datafusion::logical_expr::physical_planning_context::PhysicalPlanningContext;
use datafusion::logical_expr::{
    Expr, LogicalPlan, UserDefinedLogicalNode, UserDefinedLogicalNodeCore,
};
use datafusion::physical_plan::ExecutionPlan;
use datafusion::physical_planner::{DefaultPhysicalPlanner, ExtensionPlanner, PhysicalPlanner};
use futures::FutureExt;
use futures::future::{BoxFuture, ready};

use crate::nodes::node::Node;
use crate::sql::as_of::condition::Condition;
use crate::sql::as_of::exec::AsOf;

/// A join of each row of the left table with the nearest in time of the right.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct AsOfJoin {
    left: LogicalPlan,
    right: LogicalPlan,
    /// When rows match.
    pub condition: Condition<Expr>,
    schema: DFSchemaRef,
}

impl AsOfJoin {
    /// A join with the columns of both tables; those of the right may be null.
    ///
    /// # Errors
    /// When both have a column of one name.
    pub fn new(left: LogicalPlan, right: LogicalPlan, condition: Condition<Expr>) -> Result<Self> {
        let of_left = left.schema().iter();
        let of_left = of_left.map(|(table, field)| (table.cloned(), Arc::clone(field)));
        let of_right = right.schema().iter().map(|(table, field)| {
            let nullable = field.as_ref().clone().with_nullable(true);
            (table.cloned(), Arc::new(nullable))
        });
        let fields = of_left.chain(of_right).collect();
        let schema = Arc::new(DFSchema::new_with_metadata(fields, HashMap::new())?);
        Ok(Self {
            left,
            right,
            condition,
            schema,
        })
    }
}

impl PartialOrd for AsOfJoin {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        (self == other).then_some(Ordering::Equal)
    }
}

impl UserDefinedLogicalNodeCore for AsOfJoin {
    fn name(&self) -> &str {
        "AsOfJoin"
    }

    fn inputs(&self) -> Vec<&LogicalPlan> {
        vec![&self.left, &self.right]
    }

    fn schema(&self) -> &DFSchemaRef {
        &self.schema
    }

    fn expressions(&self) -> Vec<Expr> {
        self.condition.values().cloned().collect()
    }

    fn fmt_for_explain(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "AsOfJoin: {}", self.condition)
    }

    fn with_exprs_and_inputs(&self, exprs: Vec<Expr>, inputs: Vec<LogicalPlan>) -> Result<Self> {
        let mut exprs = exprs.into_iter();
        let mut pair = || exprs.next().zip(exprs.next());
        let pairs: Option<Vec<_>> = (0..=self.condition.keys.len()).map(|_| pair()).collect();
        let times_and_keys = pairs.and_then(|mut pairs| Some((pairs.pop()?, pairs)));
        let mut inputs = inputs.into_iter();
        let (Some((times, keys)), Some(left), Some(right)) =
            (times_and_keys, inputs.next(), inputs.next())
        else {
            return internal_err!("an as-of join has two inputs and two values of each key");
        };
        let condition = Condition {
            keys,
            times,
            matching: self.condition.matching,
            limit: exprs.next(),
        };
        Self::new(left, right, condition)
    }

    fn necessary_children_exprs(&self, output_columns: &[usize]) -> Option<Vec<Vec<usize>>> {
        let width = self.left.schema().fields().len();
        let (left, right): (Vec<usize>, Vec<usize>) =
            output_columns.iter().partition(|&&column| column < width);
        let right = right.into_iter().map(|column| column - width).collect();
        Some(vec![left, right])
    }
}

/// Plans queries as DataFusion does, and as-of joins.
#[derive(Debug)]
pub struct Planner;

impl QueryPlanner for Planner {
    // Its future is boxed once: `crate::erased`.
    fn create_physical_plan<'a, 'b, 'c, 'all>(
        &'a self,
        plan: &'b LogicalPlan,
        session: &'c dyn Session,
    ) -> BoxFuture<'all, Result<Arc<dyn ExecutionPlan>>>
    where
        'a: 'all,
        'b: 'all,
        'c: 'all,
        Self: 'all,
    {
        physical(plan, session)
    }
}

fn physical<'a>(
    plan: &'a LogicalPlan,
    session: &'a dyn Session,
) -> BoxFuture<'a, Result<Arc<dyn ExecutionPlan>>> {
    let planned = async move {
        let planner = DefaultPhysicalPlanner::with_extension_planners(vec![Arc::new(Joins)]);
        planner.create_physical_plan(plan, session).await
    };
    planned.boxed()
}

struct Joins;

impl ExtensionPlanner for Joins {
    // Nothing is waited for, and nothing is held: `crate::erased`.
    fn plan_extension<'a, 'b, 'c, 'd, 'e, 'f, 'g, 'h, 'all>(
        &'a self,
        planner: &'b dyn PhysicalPlanner,
        node: &'c dyn UserDefinedLogicalNode,
        _: &'d [&'e LogicalPlan],
        inputs: &'f [Arc<dyn ExecutionPlan>],
        session: &'g dyn Session,
        planning: &'h PhysicalPlanningContext,
    ) -> BoxFuture<'all, Result<Option<Arc<dyn ExecutionPlan>>>>
    where
        'a: 'all,
        'b: 'all,
        'c: 'all,
        'd: 'all,
        'e: 'all,
        'f: 'all,
        'g: 'all,
        'h: 'all,
        Self: 'all,
    {
        let planned = match (node.as_any().downcast_ref::<AsOfJoin>(), inputs) {
            (Some(join), [left, right]) => join
                .planned([left, right], planner, session, planning)
                .map(Some),
            _ => Ok(None),
        };
        ready(planned).boxed()
    }
}

impl AsOfJoin {
    /// What computes it from what computes its tables.
    fn planned(
        &self,
        tables: [&Arc<dyn ExecutionPlan>; 2],
        planner: &dyn PhysicalPlanner,
        session: &dyn Session,
        planning: &PhysicalPlanningContext,
    ) -> Result<Arc<dyn ExecutionPlan>> {
        let value = |expr: &Expr, schema: &DFSchema| {
            planner.create_physical_expr(expr, schema, session, planning)
        };
        let pair = |(of_left, of_right): &(Expr, Expr)| {
            let of_left = value(of_left, self.left.schema())?;
            Ok((of_left, value(of_right, self.right.schema())?))
        };
        let logical = &self.condition;
        let limit = logical.limit.as_ref();
        let condition = Condition {
            keys: logical.keys.iter().map(pair).collect::<Result<_>>()?,
            times: pair(&logical.times)?,
            matching: logical.matching,
            limit: limit.map(|limit| value(limit, &self.schema)).transpose()?,
        };
        let as_of = AsOf {
            condition: Arc::new(condition),
            schema: Arc::clone(self.schema.inner()),
        };
        let children = tables.map(Arc::clone).to_vec();
        Ok(Arc::new(Node::try_new(Arc::new(as_of), children)?))
    }
}
