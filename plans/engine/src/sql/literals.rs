//! Texts in a query that do not become what they are cast to, or compared with. DataFusion finds out when the query runs,
//! at the first row, and has forgotten where the text stands; here it is told when the query is planned, with its place.

use std::cell::OnceCell;

use arrow::datatypes::DataType;
use arrow::error::ArrowError;
use datafusion::common::tree_node::{TreeNode, TreeNodeRecursion};
use datafusion::common::{DFSchema, Result, ScalarValue};
use datafusion::error::DataFusionError;
use datafusion::logical_expr::expr::{Between, Cast, InList};
use datafusion::logical_expr::type_coercion::other::get_coerce_type_for_list;
use datafusion::logical_expr::utils::merge_schema;
use datafusion::logical_expr::{BinaryExpr, Expr, ExprSchemable, LogicalPlan, Operator};

use crate::sql::statement_text::StatementText;

/// Refuses a plan with a text that does not become what it should.
///
/// # Errors
/// What casting says, with the place of the text where it stands once.
pub fn check_literals(plan: &LogicalPlan, written: &StatementText) -> Result<()> {
    plan.apply_with_subqueries(|node| {
        let literals = Literals {
            node,
            schema: OnceCell::new(),
            written,
        };
        node.apply_expressions(|expr| {
            expr.apply(|term| {
                literals.check(term)?;
                Ok(TreeNodeRecursion::Continue)
            })
        })
    })?;
    Ok(())
}

/// Those of a node.
struct Literals<'p> {
    node: &'p LogicalPlan,
    /// The columns of its inputs, once they are asked for.
    schema: OnceCell<DFSchema>,
    written: &'p StatementText,
}

impl Literals<'_> {
    fn schema(&self) -> &DFSchema {
        self.schema
            .get_or_init(|| merge_schema(&self.node.inputs()))
    }

    fn check(&self, term: &Expr) -> Result<()> {
        match term {
            Expr::Cast(Cast { expr, field }) => self.becomes(expr, field.data_type()),
            Expr::BinaryExpr(BinaryExpr { left, op, right }) if is_comparison(*op) => {
                self.compared(left, &[right.as_ref()])?;
                self.compared(right, &[left.as_ref()])
            }
            Expr::Between(Between {
                expr, low, high, ..
            }) => self.compared(expr, &[low.as_ref(), high.as_ref()]),
            Expr::InList(InList { expr, list, .. }) => {
                self.compared(expr, &list.iter().collect::<Vec<_>>())
            }
            _ => Ok(()),
        }
    }

    /// That the texts among some values become what they and one more are compared as.
    fn compared(&self, value: &Expr, others: &[&Expr]) -> Result<()> {
        if !others.iter().any(|other| text(other).is_some()) {
            return Ok(());
        }
        // What has no type is told elsewhere.
        let Ok(kind) = value.get_type(self.schema()) else {
            return Ok(());
        };
        let types = others.iter().map(|other| other.get_type(self.schema()));
        let Ok(types) = types.collect::<Result<Vec<_>>>() else {
            return Ok(());
        };
        let Some(common) = get_coerce_type_for_list(&kind, &types) else {
            return Ok(());
        };
        let mut others = others.iter();
        others.try_for_each(|other| self.becomes(other, &common))
    }

    /// That a value becomes one of a type, if it is a text.
    fn becomes(&self, value: &Expr, wanted: &DataType) -> Result<()> {
        let Some((text, written)) = text(value) else {
            return Ok(());
        };
        match text.cast_to(wanted) {
            Err(error) if is_of_text(&error) => Err(self.written.placed(error, written)),
            // That there is no such cast is told elsewhere.
            _ => Ok(()),
        }
    }
}

/// A text that stands in a query, as a value and as it is written.
fn text(value: &Expr) -> Option<(&ScalarValue, &str)> {
    let text = value.as_literal()?;
    Some((text, text.try_as_str()??))
}

/// Whether both sides are made alike, to be compared.
pub fn is_comparison(operator: Operator) -> bool {
    matches!(
        operator,
        Operator::Eq
            | Operator::NotEq
            | Operator::Lt
            | Operator::LtEq
            | Operator::Gt
            | Operator::GtEq
            | Operator::IsDistinctFrom
            | Operator::IsNotDistinctFrom
    )
}

/// Whether it is the text that is wrong.
fn is_of_text(error: &DataFusionError) -> bool {
    match error.find_root() {
        DataFusionError::ArrowError(error, _) => matches!(
            error.as_ref(),
            ArrowError::CastError(_) | ArrowError::ParseError(_)
        ),
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use crate::sql::{Limits, context, read_only};

    fn asked(condition: &str) -> String {
        let rows = "(VALUES (TIMESTAMP '2026-01-01', 1, 'a')) AS t (stamp, n, name)";
        format!("SELECT n\nFROM {rows}\nWHERE {condition}")
    }

    #[tokio::test]
    async fn a_text_that_does_not_become_what_it_should_is_told_with_its_place() {
        let context = context(Limits::one_partition()).unwrap();
        for (condition, said, column) in [
            (
                "stamp > 'yesterday'",
                "expected a time, found 'yesterday'",
                15,
            ),
            (
                "stamp > TIMESTAMP 'soon'",
                "expected a time, found 'soon'",
                25,
            ),
            ("n = 'one'", "expected a number, found 'one'", 11),
            ("'one' <> n", "expected a number, found 'one'", 7),
            ("n IN (1, 'one')", "expected a number, found 'one'", 16),
            (
                "stamp BETWEEN '2026-01-01' AND 'later'",
                "expected a time, found 'later'",
                38,
            ),
            (
                "CAST('x' AS BIGINT) = n",
                "expected a number, found 'x'",
                12,
            ),
            (
                "n IN (SELECT 1 WHERE 2 > 'x')",
                "expected a number, found 'x'",
                32,
            ),
        ] {
            let query = asked(condition);
            let fault = read_only(&context, &query).await.err().unwrap();
            assert_eq!(fault.message, said, "{condition}");
            let place = format!("line 3, column {column} of the query");
            assert_eq!(fault.place, place, "{condition}");
        }
        // Which of both is it?
        let twice = asked("n = 'one' OR n < 'one'");
        let fault = read_only(&context, &twice).await.err().unwrap();
        assert_eq!(fault.to_string(), "user: expected a number, found 'one'");
    }

    #[tokio::test]
    async fn texts_that_become_what_they_should_are_compared() {
        let context = context(Limits::one_partition()).unwrap();
        for condition in [
            "n = '1'",
            "name <> 'one'",
            "stamp >= '2026-01-01'",
            "TRY_CAST('x' AS BIGINT) IS NULL",
            "name IN ('a', 'b') AND n BETWEEN '0' AND '5'",
        ] {
            let frame = read_only(&context, &asked(condition)).await.unwrap();
            let rows = frame.collect().await.unwrap();
            assert_eq!(rows[0].num_rows(), 1, "{condition}");
        }
    }
}
