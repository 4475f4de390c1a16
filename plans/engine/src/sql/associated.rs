//! What stands behind `IS DISTINCT FROM` ends where it ends behind `IS`. The parser (sqlparser 0.62) takes all that follows for
//! one operand: `a IS DISTINCT FROM b AND c` would be `a IS DISTINCT FROM (b AND c)`. What stands in parentheses stays.

use std::convert::Infallible;
use std::ops::ControlFlow;

use datafusion::sql::sqlparser::ast::{
    BinaryOperator, Expr, Statement, UnaryOperator, Value, VisitMut, VisitorMut,
};

/// Reads each `IS [NOT] DISTINCT FROM` of a statement as SQL means it.
pub fn associated(statement: &mut Statement) {
    let ControlFlow::Continue(()) = statement.visit(&mut Associated);
}

struct Associated;

impl VisitorMut for Associated {
    type Break = Infallible;

    fn post_visit_expr(&mut self, expr: &mut Expr) -> ControlFlow<Infallible> {
        let limit = limit(expr);
        let is_looser = last_operand(expr).is_some_and(|right| strength(right) < limit);
        // Of other expressions the parser has it right, and programs may leave parentheses out.
        if is_looser
            && has_distinct(expr)
            && let Some(right) = last_operand(expr)
        {
            let mut whole = std::mem::replace(right, nothing());
            let first = first_operand(&mut whole, limit);
            std::mem::swap(right, first);
            std::mem::swap(expr, first);
            *expr = whole;
        }
        ControlFlow::Continue(())
    }
}

/// What stands in a place for a moment.
pub fn nothing() -> Expr {
    Expr::Value(Value::Null.into())
}

/// How strongly an operator holds its operands together, as the parser has it.
const OR: u8 = 5;
const AND: u8 = 10;
const NOT: u8 = 15;
const IS: u8 = 17;
const OTHER: u8 = 100;

/// How strongly an expression holds together.
fn strength(expr: &Expr) -> u8 {
    match expr {
        Expr::BinaryOp { op, .. } => match op {
            BinaryOperator::Or => OR,
            BinaryOperator::And => AND,
            _ => OTHER,
        },
        Expr::IsDistinctFrom(..)
        | Expr::IsNotDistinctFrom(..)
        | Expr::IsNull(_)
        | Expr::IsNotNull(_)
        | Expr::IsTrue(_)
        | Expr::IsNotTrue(_)
        | Expr::IsFalse(_)
        | Expr::IsNotFalse(_)
        | Expr::IsUnknown(_)
        | Expr::IsNotUnknown(_) => IS,
        _ => OTHER,
    }
}

/// How strong the last operand of an expression must be at least.
fn limit(expr: &Expr) -> u8 {
    match expr {
        Expr::IsDistinctFrom(..) | Expr::IsNotDistinctFrom(..) => IS + 1,
        Expr::BinaryOp { op, .. } => match op {
            BinaryOperator::Or => OR,
            BinaryOperator::And => AND,
            _ => NOT,
        },
        _ => NOT,
    }
}

/// The operand that an expression ends with.
fn last_operand(expr: &mut Expr) -> Option<&mut Expr> {
    match expr {
        Expr::BinaryOp { right: last, .. }
        | Expr::IsDistinctFrom(_, last)
        | Expr::IsNotDistinctFrom(_, last)
        | Expr::UnaryOp {
            op: UnaryOperator::Not,
            expr: last,
        } => Some(last.as_mut()),
        _ => None,
    }
}

/// The first operand of an expression that is so strong.
fn first_operand(expr: &mut Expr, limit: u8) -> &mut Expr {
    if strength(expr) >= limit {
        return expr;
    }
    match expr {
        Expr::BinaryOp { left: first, .. }
        | Expr::IsDistinctFrom(first, _)
        | Expr::IsNotDistinctFrom(first, _)
        | Expr::IsNull(first)
        | Expr::IsNotNull(first)
        | Expr::IsTrue(first)
        | Expr::IsNotTrue(first)
        | Expr::IsFalse(first)
        | Expr::IsNotFalse(first)
        | Expr::IsUnknown(first)
        | Expr::IsNotUnknown(first) => first_operand(first, limit),
        other => other,
    }
}

/// Whether an expression has, outside of parentheses, what the parser reads too far.
fn has_distinct(expr: &Expr) -> bool {
    match expr {
        Expr::IsDistinctFrom(..) | Expr::IsNotDistinctFrom(..) => true,
        Expr::BinaryOp { left, right, .. } => has_distinct(left) || has_distinct(right),
        Expr::UnaryOp {
            op: UnaryOperator::Not,
            expr: inner,
        }
        | Expr::IsNull(inner)
        | Expr::IsNotNull(inner)
        | Expr::IsTrue(inner)
        | Expr::IsNotTrue(inner)
        | Expr::IsFalse(inner)
        | Expr::IsNotFalse(inner)
        | Expr::IsUnknown(inner)
        | Expr::IsNotUnknown(inner) => has_distinct(inner),
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use datafusion::sql::sqlparser::ast::{visit_expressions, visit_expressions_mut};
    use datafusion::sql::sqlparser::dialect::GenericDialect;
    use datafusion::sql::sqlparser::parser::Parser;

    use super::*;

    /// A query that says `condition`, as it is read, with all parentheses.
    fn read(condition: &str) -> Expr {
        let mut parsed =
            Parser::parse_sql(&GenericDialect {}, &format!("SELECT {condition}")).unwrap();
        associated(&mut parsed[0]);
        let mut found = None;
        let _ = visit_expressions(&parsed[0], |expr| {
            found.get_or_insert_with(|| expr.clone());
            ControlFlow::<()>::Continue(())
        });
        bare(found.unwrap())
    }

    /// Without the parentheses that are written.
    fn bare(mut expr: Expr) -> Expr {
        let _ = visit_expressions_mut(&mut expr, |expr| {
            while let Expr::Nested(inner) = expr {
                *expr = std::mem::replace(inner.as_mut(), nothing());
            }
            ControlFlow::<()>::Continue(())
        });
        expr
    }

    #[test]
    fn what_follows_a_distinct_operand_is_not_part_of_it() {
        for (written, meant) in [
            ("a IS DISTINCT FROM b AND c", "(a IS DISTINCT FROM b) AND c"),
            (
                "a IS NOT DISTINCT FROM b OR c AND d",
                "(a IS NOT DISTINCT FROM b) OR (c AND d)",
            ),
            (
                "a IS DISTINCT FROM b AND c OR d",
                "((a IS DISTINCT FROM b) AND c) OR d",
            ),
            (
                "p AND a IS DISTINCT FROM b OR c",
                "(p AND (a IS DISTINCT FROM b)) OR c",
            ),
            (
                "p OR a IS DISTINCT FROM b AND c",
                "p OR ((a IS DISTINCT FROM b) AND c)",
            ),
            (
                "NOT a IS DISTINCT FROM b AND c",
                "(NOT (a IS DISTINCT FROM b)) AND c",
            ),
            (
                "p AND NOT a IS DISTINCT FROM b AND q OR c",
                "(p AND ((NOT (a IS DISTINCT FROM b)) AND q)) OR c",
            ),
            (
                "a IS DISTINCT FROM b AND c IS DISTINCT FROM d AND e",
                "(a IS DISTINCT FROM b) AND ((c IS DISTINCT FROM d) AND e)",
            ),
            (
                "a IS DISTINCT FROM b IS NULL OR c",
                "((a IS DISTINCT FROM b) IS NULL) OR c",
            ),
            (
                "p AND a IS DISTINCT FROM b IS NULL OR c",
                "(p AND ((a IS DISTINCT FROM b) IS NULL)) OR c",
            ),
            (
                "a IS DISTINCT FROM b IS NOT DISTINCT FROM c",
                "(a IS DISTINCT FROM b) IS NOT DISTINCT FROM c",
            ),
            // As Postgres has it, too.
            (
                "a IS DISTINCT FROM b = c AND d",
                "(a IS DISTINCT FROM (b = c)) AND d",
            ),
            (
                "a IS DISTINCT FROM b + e AND c",
                "(a IS DISTINCT FROM (b + e)) AND c",
            ),
        ] {
            assert_eq!(read(written), read(meant), "{written}");
        }
        // What stands in parentheses, or is read rightly, stays.
        for (written, same) in [
            (
                "a IS DISTINCT FROM (b AND c)",
                "a IS DISTINCT FROM ((b AND c))",
            ),
            (
                "(p OR a IS DISTINCT FROM b) AND c",
                "((p OR a IS DISTINCT FROM b)) AND c",
            ),
            (
                "CASE WHEN a IS DISTINCT FROM b THEN c END OR d",
                "(CASE WHEN a IS DISTINCT FROM b THEN c END) OR d",
            ),
        ] {
            assert_eq!(read(written), read(same), "{written}");
        }
        assert_ne!(
            read("a IS DISTINCT FROM (b AND c)"),
            read("a IS DISTINCT FROM b AND c")
        );
    }
}
