//! Conditions of very many terms. The parser puts `a OR b OR c` into each other, and what plans it reads all that is within
//! each operator: time by the square of their number. Side by side they are `(a OR b) OR (c OR d)`.

use std::convert::Infallible;
use std::ops::ControlFlow;

use datafusion::sql::sqlparser::ast::{
    BinaryOperator, Expr, Select, Statement, VisitMut, VisitorMut,
};

use crate::sql::associated::nothing;

/// As many terms as may stand within each other.
const MOST: usize = 32;

/// Puts terms of conditions side by side, where there are very many. What is selected is called as it is written.
pub fn balanced(statement: &mut Statement) {
    let ControlFlow::Continue(()) = statement.visit(&mut Conditions);
}

struct Conditions;

impl VisitorMut for Conditions {
    type Break = Infallible;

    fn pre_visit_select(&mut self, select: &mut Select) -> ControlFlow<Infallible> {
        let conditions = [&mut select.selection, &mut select.having];
        for condition in conditions.into_iter().flatten() {
            condition.visit(&mut Terms)?;
        }
        ControlFlow::Continue(())
    }
}

struct Terms;

impl VisitorMut for Terms {
    type Break = Infallible;

    fn pre_visit_expr(&mut self, expr: &mut Expr) -> ControlFlow<Infallible> {
        if let Expr::BinaryOp { op, .. } = expr
            && matches!(op, BinaryOperator::And | BinaryOperator::Or)
        {
            let op = op.clone();
            if depth(expr, &op) > MOST {
                let terms = terms(std::mem::replace(expr, nothing()), &op);
                *expr = side_by_side(terms, &op);
            }
        }
        ControlFlow::Continue(())
    }
}

/// How many operators of a kind stand within each other on the left.
fn depth(mut expr: &Expr, wanted: &BinaryOperator) -> usize {
    let mut depth = 0;
    while let Expr::BinaryOp { left, op, .. } = expr
        && op == wanted
    {
        expr = left;
        depth += 1;
    }
    depth
}

/// What such operators stand between.
fn terms(mut expr: Expr, wanted: &BinaryOperator) -> Vec<Expr> {
    let mut terms = Vec::new();
    loop {
        expr = match expr {
            Expr::BinaryOp { left, op, right } if op == *wanted => {
                terms.push(*right);
                *left
            }
            first => {
                terms.push(first);
                break;
            }
        };
    }
    terms.reverse();
    terms
}

/// Terms with an operator between them, in their order.
fn side_by_side(mut terms: Vec<Expr>, op: &BinaryOperator) -> Expr {
    while terms.len() > 1 {
        let mut pairs = Vec::with_capacity(terms.len().div_ceil(2));
        let mut rest = terms.into_iter();
        while let Some(left) = rest.next() {
            pairs.push(match rest.next() {
                Some(right) => Expr::BinaryOp {
                    left: Box::new(left),
                    op: op.clone(),
                    right: Box::new(right),
                },
                None => left,
            });
        }
        terms = pairs;
    }
    terms.pop().unwrap_or_else(nothing)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use datafusion::sql::sqlparser::dialect::GenericDialect;
    use datafusion::sql::sqlparser::parser::Parser;

    use super::*;

    /// How deep operators of a statement stand within each other.
    struct Deepest {
        now: usize,
        most: usize,
    }

    impl VisitorMut for Deepest {
        type Break = Infallible;

        fn pre_visit_expr(&mut self, _: &mut Expr) -> ControlFlow<Infallible> {
            self.now += 1;
            self.most = self.most.max(self.now);
            ControlFlow::Continue(())
        }

        fn post_visit_expr(&mut self, _: &mut Expr) -> ControlFlow<Infallible> {
            self.now -= 1;
            ControlFlow::Continue(())
        }
    }

    /// A query as it is read, and how deep it is.
    fn read(query: &str) -> (String, usize) {
        let mut parsed = Parser::parse_sql(&GenericDialect {}, query).unwrap();
        balanced(&mut parsed[0]);
        let mut deepest = Deepest { now: 0, most: 0 };
        let ControlFlow::Continue(()) = parsed[0].visit(&mut deepest);
        (parsed[0].to_string(), deepest.most)
    }

    #[test]
    fn very_many_terms_stand_side_by_side_in_their_order() {
        for op in ["OR", "AND"] {
            let terms = (0..200).map(|n| format!("x > {n}"));
            let chain = terms.collect::<Vec<_>>().join(&format!(" {op} "));
            let mixed = format!("SELECT 1 FROM t WHERE NOT y AND ({chain}) HAVING {chain}");
            for query in [
                format!("SELECT 1 FROM t WHERE {chain}"),
                format!("SELECT 1 FROM t WHERE y IN (SELECT 2 FROM s WHERE {chain})"),
                mixed,
            ] {
                let (text, depth) = read(&query);
                assert_eq!(text, query);
                assert!(depth < 16, "{depth}");
            }
            // What is selected is called as it is written.
            assert!(read(&format!("SELECT {chain} FROM t")).1 > 200);
        }
        let few = "SELECT 1 FROM t WHERE a OR b OR c AND d AND e";
        assert_eq!(read(few), (few.to_owned(), 4));
    }
}
