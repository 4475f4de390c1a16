//! What all of the engine's plan nodes share: DataFusion's wide trait, implemented once.

use std::fmt;
use std::sync::Arc;

use arrow::compute::SortOptions;
use arrow::datatypes::Schema;
use datafusion::common::tree_node::TreeNodeRecursion;
use datafusion::error::{DataFusionError, Result};
use datafusion::execution::{SendableRecordBatchStream, TaskContext};
use datafusion::physical_expr::expressions::Column;
use datafusion::physical_expr::{
    Distribution, EquivalenceProperties, LexOrdering, OrderingRequirements, PhysicalExpr,
    PhysicalSortExpr,
};
use datafusion::physical_plan::execution_plan::{Boundedness, EmissionType};
use datafusion::physical_plan::metrics::{ExecutionPlanMetricsSet, MetricsSet};
use datafusion::physical_plan::{
    DisplayAs, DisplayFormatType, ExecutionPlan, ExecutionPlanProperties,
    InputDistributionRequirements, Partitioning, PlanProperties,
};

/// How the rows of a child are dealt out to partitions.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Deal {
    /// Rows with equal values in these columns together; as they come, where there are none.
    ByKey(&'static [&'static str]),
    /// All together.
    Single,
}

/// How the rows of a child must come. DataFusion's optimizer puts in front of the child what is needed for that.
#[derive(Debug, Clone)]
pub struct Need {
    /// How they are dealt out.
    pub deal: Deal,
    /// The columns that order them within a partition.
    pub sorting: Vec<&'static str>,
    /// Whether more partitions would help.
    pub parallel: bool,
}

impl Need {
    /// Rows as they come, in no order, from as many partitions as there are.
    pub fn any() -> Self {
        Self {
            deal: Deal::ByKey(&[]),
            sorting: Vec::new(),
            parallel: false,
        }
    }

    /// A whole table in this order.
    pub fn whole(sorting: Vec<&'static str>) -> Self {
        Self {
            deal: Deal::Single,
            sorting,
            parallel: false,
        }
    }

    fn distribution(&self, schema: &Schema) -> Distribution {
        let Deal::ByKey(columns) = &self.deal else {
            return Distribution::SinglePartition;
        };
        let column = |name: &&str| -> Option<Arc<dyn PhysicalExpr>> {
            Some(Arc::new(Column::new_with_schema(name, schema).ok()?))
        };
        let key: Vec<Arc<dyn PhysicalExpr>> = columns.iter().filter_map(column).collect();
        match key.is_empty() {
            true => Distribution::UnspecifiedDistribution,
            false => Distribution::KeyPartitioned(key),
        }
    }
}

/// The order by these columns, as far as the schema has them; `None` where it has none.
pub fn ordering<'n>(
    columns: impl IntoIterator<Item = &'n str>,
    schema: &Schema,
) -> Option<LexOrdering> {
    let options = SortOptions {
        descending: false,
        nulls_first: true,
    };
    LexOrdering::new(columns.into_iter().filter_map(|name| {
        let column = Column::new_with_schema(name, schema).ok()?;
        Some(PhysicalSortExpr::new(Arc::new(column), options))
    }))
}

/// What a node is for. It displays as what `EXPLAIN` says behind its name.
pub trait Duty: fmt::Display + Send + Sync + Sized + 'static {
    /// The node's name in `EXPLAIN`.
    const NAME: &'static str;

    /// What the partitions of a running node share.
    type Shared: Default + Send + Sync;

    /// How the rows of each child must come; those of an only child as they do, where nothing else is said.
    fn needs(&self) -> Vec<Need> {
        vec![Need::any()]
    }

    /// What comes out, given the children: columns, what is known of their order, partitions; those of the first child, where
    /// nothing else is said.
    ///
    /// # Errors
    /// When the children make no sense.
    fn output(
        &self,
        children: &[Arc<dyn ExecutionPlan>],
    ) -> Result<(EquivalenceProperties, Partitioning)> {
        let child = first(children)?;
        let (known, dealt) = (child.equivalence_properties(), child.output_partitioning());
        Ok((known.clone(), dealt.clone()))
    }

    /// How the rows of all children must be dealt out.
    fn distribution(&self, children: &[Arc<dyn ExecutionPlan>]) -> InputDistributionRequirements {
        let needs = self.needs();
        let children = needs.iter().zip(children);
        let distributions = children.map(|(need, child)| need.distribution(&child.schema()));
        InputDistributionRequirements::new(distributions.collect())
    }

    /// How the rows of each child must be ordered.
    fn ordering(&self, children: &[Arc<dyn ExecutionPlan>]) -> Vec<Option<OrderingRequirements>> {
        let needs = self.needs();
        let children = needs.iter().zip(children);
        let order = |(need, child): (&Need, &Arc<dyn ExecutionPlan>)| {
            let sorting = need.sorting.iter().copied();
            ordering(sorting, &child.schema()).map(OrderingRequirements::from)
        };
        children.map(order).collect()
    }

    /// What it evaluates.
    fn expressions(&self) -> Vec<&Arc<dyn PhysicalExpr>> {
        Vec::new()
    }

    /// Whether rows end.
    fn boundedness(&self) -> Boundedness {
        Boundedness::Bounded
    }

    /// Whether rows come out in the order of the first child's.
    fn keeps_order(&self) -> bool {
        false
    }

    /// The rows of one partition.
    ///
    /// # Errors
    /// When a child cannot be executed.
    fn execute(
        node: &Node<Self>,
        partition: usize,
        context: Arc<TaskContext>,
    ) -> Result<SendableRecordBatchStream>;
}

/// A plan node with a duty.
pub struct Node<D: Duty> {
    /// What it is for.
    pub duty: Arc<D>,
    /// What it reads.
    pub children: Vec<Arc<dyn ExecutionPlan>>,
    /// What it counts.
    pub metrics: ExecutionPlanMetricsSet,
    /// What its partitions share.
    pub shared: D::Shared,
    properties: Arc<PlanProperties>,
}

impl<D: Duty> Node<D> {
    /// A node over these children.
    ///
    /// # Errors
    /// As [`Duty::output`].
    pub fn try_new(duty: Arc<D>, children: Vec<Arc<dyn ExecutionPlan>>) -> Result<Self> {
        let (equivalences, partitioning) = duty.output(&children)?;
        let boundedness = duty.boundedness();
        let properties = PlanProperties::new(
            equivalences,
            partitioning,
            EmissionType::Incremental,
            boundedness,
        );
        Ok(Self {
            duty,
            children,
            metrics: ExecutionPlanMetricsSet::new(),
            shared: D::Shared::default(),
            properties: Arc::new(properties),
        })
    }
}

/// The first child.
///
/// # Errors
/// When there is none.
pub fn first(children: &[Arc<dyn ExecutionPlan>]) -> Result<&Arc<dyn ExecutionPlan>> {
    let missing = || DataFusionError::Internal("a plan node lacks its child".to_owned());
    children.first().ok_or_else(missing)
}

impl<D: Duty> fmt::Debug for Node<D> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", D::NAME, self.duty)
    }
}

impl<D: Duty> DisplayAs for Node<D> {
    fn fmt_as(&self, _: DisplayFormatType, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", D::NAME, self.duty)
    }
}

impl<D: Duty> ExecutionPlan for Node<D> {
    fn name(&self) -> &str {
        D::NAME
    }

    fn properties(&self) -> &Arc<PlanProperties> {
        &self.properties
    }

    fn children(&self) -> Vec<&Arc<dyn ExecutionPlan>> {
        self.children.iter().collect()
    }

    fn input_distribution_requirements(&self) -> InputDistributionRequirements {
        self.duty.distribution(&self.children)
    }

    fn required_input_ordering(&self) -> Vec<Option<OrderingRequirements>> {
        self.duty.ordering(&self.children)
    }

    fn maintains_input_order(&self) -> Vec<bool> {
        let mut keeps = vec![false; self.children.len()];
        keeps
            .iter_mut()
            .take(1)
            .for_each(|first| *first = self.duty.keeps_order());
        keeps
    }

    fn benefits_from_input_partitioning(&self) -> Vec<bool> {
        let needs = self.duty.needs();
        needs.iter().map(|need| need.parallel).collect()
    }

    fn apply_expressions(
        &self,
        f: &mut dyn FnMut(&Arc<dyn PhysicalExpr>) -> Result<TreeNodeRecursion>,
    ) -> Result<TreeNodeRecursion> {
        for expression in self.duty.expressions() {
            if f(expression)? == TreeNodeRecursion::Stop {
                return Ok(TreeNodeRecursion::Stop);
            }
        }
        Ok(TreeNodeRecursion::Continue)
    }

    fn with_new_children(
        self: Arc<Self>,
        children: Vec<Arc<dyn ExecutionPlan>>,
    ) -> Result<Arc<dyn ExecutionPlan>> {
        Ok(Arc::new(Self::try_new(Arc::clone(&self.duty), children)?))
    }

    fn execute(
        &self,
        partition: usize,
        context: Arc<TaskContext>,
    ) -> Result<SendableRecordBatchStream> {
        D::execute(self, partition, context)
    }

    fn metrics(&self) -> Option<MetricsSet> {
        Some(self.metrics.clone_inner())
    }
}
