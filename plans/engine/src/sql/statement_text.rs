//! What a statement says that planning passes over, or takes for something else than who wrote it.

use std::collections::HashMap;
use std::convert::Infallible;
use std::ops::ControlFlow;

use datafusion::common::{Diagnostic, SchemaError, Span};
use datafusion::error::DataFusionError;
use datafusion::sql::sqlparser::ast::{
    Expr, Query, Statement, Value, ValueWithSpan, Visit, Visitor,
};
use evermap_schemas::Fault;

use crate::error::{external, fault_of};

/// What stands in a statement.
#[derive(Default)]
pub struct StatementText {
    /// What stands in double quotes where a column may stand.
    quoted: Vec<String>,
    /// Whether a query says in which format its rows are wanted.
    has_format: bool,
    /// Where each text in single quotes stands; `None` where it stands several times.
    texts: HashMap<String, Option<Span>>,
}

/// An error with its place in the query.
pub fn placed(error: DataFusionError, place: Option<Span>) -> DataFusionError {
    match place {
        Some(_) => {
            let said = error.strip_backtrace();
            error.with_diagnostic(Diagnostic::new_error(said, place))
        }
        None => error,
    }
}

impl StatementText {
    /// Reads a statement.
    ///
    /// # Errors
    /// A user fault for what would be passed over.
    pub fn of(statement: &Statement) -> Result<Self, Fault> {
        let mut written = Self::default();
        let ControlFlow::Continue(()) = statement.visit(&mut written);
        match written.has_format {
            true => Err(Fault::user("expected a query, found FORMAT behind it")
                .next("choose the format with --format, by HTTP with format=")),
            false => Ok(written),
        }
    }

    /// An error of a text in single quotes, with its place where it stands once.
    pub fn placed(&self, error: DataFusionError, text: &str) -> DataFusionError {
        placed(error, self.texts.get(text).copied().flatten())
    }

    /// An error of planning the statement, with what may be meant where a column that is not there stands in double quotes.
    pub fn explained(&self, error: DataFusionError) -> DataFusionError {
        let DataFusionError::SchemaError(missing, _) = error.find_root() else {
            return error;
        };
        let SchemaError::FieldNotFound { field, .. } = &**missing else {
            return error;
        };
        if field.relation.is_some() || !self.quoted.contains(&field.name) {
            return error;
        }
        let text = field.name.replace('\'', "''");
        let fault = fault_of(&error).next(format!("texts stand in single quotes: '{text}'"));
        match error.diagnostic().cloned() {
            Some(place) => external(fault).with_diagnostic(place),
            None => external(fault),
        }
    }
}

impl Visitor for StatementText {
    type Break = Infallible;

    fn pre_visit_query(&mut self, query: &Query) -> ControlFlow<Infallible> {
        self.has_format |= query.format_clause.is_some();
        ControlFlow::Continue(())
    }

    fn pre_visit_expr(&mut self, expr: &Expr) -> ControlFlow<Infallible> {
        if let Expr::Identifier(name) = expr
            && name.quote_style == Some('"')
        {
            self.quoted.push(name.value.clone());
        }
        ControlFlow::Continue(())
    }

    fn pre_visit_value(&mut self, value: &ValueWithSpan) -> ControlFlow<Infallible> {
        if let Value::SingleQuotedString(text) = &value.value {
            let place = Span::try_from_sqlparser_span(value.span);
            let known = self.texts.entry(text.clone());
            known.and_modify(|place| *place = None).or_insert(place);
        }
        ControlFlow::Continue(())
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use crate::sql::{Limits, context, read_only};

    #[tokio::test]
    async fn texts_in_double_quotes_and_formats_behind_queries_are_told() {
        let context = context(Limits::one_partition()).unwrap();
        let lanes = "FROM (SELECT 'forward' AS direction, 1 AS forward_passes) AS lanes";
        for (query, said) in [
            (
                format!("SELECT 1 {lanes} WHERE direction = \"forward\""),
                "texts stand in single quotes: 'forward'",
            ),
            (
                format!("EXPLAIN SELECT direction = \"it's\" {lanes}"),
                "texts stand in single quotes: 'it''s'",
            ),
            (
                format!("SELECT 1 {lanes} LIMIT 1 FORMAT csv"),
                "user: expected a query, found FORMAT behind it; choose the format with --format",
            ),
        ] {
            let fault = read_only(&context, &query).await.err().unwrap().to_string();
            assert!(fault.contains(said), "{query}: {fault}");
        }
        let bare = format!("SELECT forwad {lanes}");
        let fault = read_only(&context, &bare).await.err().unwrap();
        assert!(fault.next.is_empty(), "{fault}");
        let quoted = format!("SELECT \"direction\" {lanes}");
        assert!(read_only(&context, &quoted).await.is_ok());
    }
}
