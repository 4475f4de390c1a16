//! What SQL reads as something else than those mean who write it: numbers with `_` between their digits, and powers; and
//! what DataFusion does: INTERSECT ALL and EXCEPT ALL give each row as often as the first query does if the other one has it
//! once.

use std::ops::ControlFlow;

use datafusion::sql::sqlparser::ast::{
    BinaryOperator, Expr, Query, Select, SelectItem, SetExpr, SetOperator, SetQuantifier, Spanned,
    Statement, UnaryOperator, Value, Visit, Visitor,
};
use datafusion::sql::sqlparser::tokenizer::Span;
use evermap_schemas::Fault;

/// Refuses `1_000`, which is a column `1` that is called `_000`, `x ^ 2`, which is no power, and operators on rows that would
/// have to count them.
///
/// # Errors
/// A user fault with the place.
pub fn check_misread(statement: &Statement) -> Result<(), Fault> {
    let found = statement.visit(&mut Misread).break_value();
    found.map_or(Ok(()), Err)
}

struct Misread;

impl Visitor for Misread {
    type Break = Fault;

    fn pre_visit_query(&mut self, query: &Query) -> ControlFlow<Fault> {
        counts(&query.body)
    }

    fn pre_visit_select(&mut self, select: &Select) -> ControlFlow<Fault> {
        for item in &select.projection {
            if let SelectItem::ExprWithAlias { expr, alias } = item
                && alias.quote_style.is_none()
                && is_digits(&alias.value)
                && is_number(last(expr))
                // What programs have written anew has no places.
                && alias.span.start.line > 0
                && expr.span().end == alias.span.start
            {
                let digits = alias.value.replace('_', "");
                let fault =
                    Fault::user(format!("expected a number without _, found {expr}{alias}"));
                let fault = fault.next(format!("write {expr}{digits}"));
                return ControlFlow::Break(at(fault, expr.span()));
            }
        }
        ControlFlow::Continue(())
    }

    fn pre_visit_expr(&mut self, expr: &Expr) -> ControlFlow<Fault> {
        let Expr::BinaryOp {
            left,
            op: BinaryOperator::BitwiseXor,
            right,
        } = expr
        else {
            return ControlFlow::Continue(());
        };
        let (left, right) = (last(left), first(right));
        if !is_number(left) && !is_number(right) {
            return ControlFlow::Continue(());
        }
        let fault = Fault::user(format!(
            "expected a power, found {left} ^ {right}, which is an exclusive or of bits"
        ));
        let fault = fault.next(format!(
            "write power({left}, {right}), or for the bits ({left} | {right}) - ({left} & {right})"
        ));
        ControlFlow::Break(at(fault, expr.span()))
    }
}

/// Refuses an operator on rows that is not what it says.
fn counts(body: &SetExpr) -> ControlFlow<Fault> {
    let SetExpr::SetOperation {
        left,
        op,
        set_quantifier,
        right,
    } = body
    else {
        return ControlFlow::Continue(());
    };
    if *set_quantifier == SetQuantifier::All && *op != SetOperator::Union {
        let fault = Fault::user(format!(
            "not supported: {op} ALL, which counts rows that are alike"
        ));
        let fault = fault.next(format!(
            "write {op}, with row_number() OVER (PARTITION BY …) of all columns as one more column of both queries"
        ));
        return ControlFlow::Break(at(fault, right.span()));
    }
    counts(left)?;
    counts(right)
}

/// What stands first in a term: `2` of `2 + 1`, as `^` binds looser than `+`.
fn first(expr: &Expr) -> &Expr {
    match expr {
        Expr::BinaryOp { left, .. } => first(left),
        other => other,
    }
}

/// What stands last in a term.
fn last(expr: &Expr) -> &Expr {
    match expr {
        Expr::BinaryOp { right, .. } => last(right),
        other => other,
    }
}

/// Whether it is `_000_000`.
fn is_digits(name: &str) -> bool {
    let mut letters = name.chars();
    letters.next() == Some('_')
        && letters.next().is_some_and(|letter| letter.is_ascii_digit())
        && letters.all(|letter| letter == '_' || letter.is_ascii_digit())
}

fn is_number(expr: &Expr) -> bool {
    match expr {
        Expr::Value(value) => matches!(value.value, Value::Number(..)),
        Expr::Nested(expr) => is_number(expr),
        Expr::UnaryOp {
            op: UnaryOperator::Minus,
            expr,
        } => is_number(expr),
        _ => false,
    }
}

/// A fault with its place, where the parser knows it.
fn at(fault: Fault, span: Span) -> Fault {
    match span.start.line {
        0 => fault,
        line => fault.at(format!(
            "line {line}, column {} of the query",
            span.start.column
        )),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use crate::sql::{Limits, context, read_only};

    #[tokio::test]
    async fn what_would_be_read_as_something_else_is_refused() {
        let context = context(Limits::one_partition()).unwrap();
        for (query, said) in [
            (
                "SELECT 1_000_000",
                "user: expected a number without _, found 1_000_000 (at line 1, column 8 of the query); write 1000000",
            ),
            (
                "SELECT x FROM (SELECT 2 * 1_000 FROM (SELECT 1 AS x) AS t) AS u",
                "; write 2 * 1000",
            ),
            (
                "SELECT 2^10",
                "user: expected a power, found 2 ^ 10, which is an exclusive or of bits (at line 1, column 8 of the query); write power(2, 10)",
            ),
            (
                "EXPLAIN SELECT sqrt(x ^ 2 + 1) FROM (SELECT 1 AS x) AS t",
                "write power(x, 2)",
            ),
            (
                "SELECT 1 INTERSECT ALL SELECT 1",
                "user: not supported: INTERSECT ALL, which counts rows that are alike",
            ),
            (
                "SELECT x FROM (SELECT 1 AS x EXCEPT ALL SELECT 2 UNION SELECT 3) AS t",
                "write EXCEPT, with row_number() OVER (PARTITION BY …)",
            ),
        ] {
            let fault = read_only(&context, query).await.err().unwrap().to_string();
            assert!(fault.contains(said), "{query}: {fault}");
        }
        for query in [
            "SELECT 1 _000",
            "SELECT 1 AS _000, 2 AS \"_1\"",
            "SELECT x ^ x AS y FROM (SELECT 1 AS x) AS t",
            "SELECT power(2, 10), (5 | 3) - (5 & 3)",
            "SELECT 1 INTERSECT SELECT 1 EXCEPT DISTINCT SELECT 2 UNION ALL SELECT 1",
        ] {
            read_only(&context, query).await.unwrap();
        }
    }
}
