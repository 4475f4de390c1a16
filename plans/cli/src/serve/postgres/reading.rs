//! How queries that only read are planned and answered.

use std::sync::Arc;

use datafusion::error::DataFusionError;
use datafusion::logical_expr::LogicalPlan;
use datafusion::prelude::{DataFrame, SessionContext};
use datafusion::sql::parser::Statement as Parsed;
use datafusion::sql::sqlparser::ast::Statement;
use datafusion::sql::sqlparser::parser::ParserError;
use datafusion_postgres::arrow_pg::datatypes::df::encode_dataframe;
use datafusion_postgres::hooks::HookClient;
use evermap_engine::error::fault_of;
use evermap_engine::sql::{explained, only_reads, plan_of};
use futures::FutureExt;
use futures::future::ready;
use pgwire::api::ClientInfo;
use pgwire::api::portal::Format;
use pgwire::api::results::{FieldFormat, QueryResponse, Response};
use pgwire::error::{PgWireError, PgWireResult};
use pgwire::types::format::FormatOptions;

use crate::serve::aside::aside;
use crate::serve::postgres::catalog::{in_its_words, is_of_catalog, no_rows};
use crate::serve::postgres::geometry::{as_extended, as_text, told};
use crate::serve::postgres::hook::{Answer, Hook};
use crate::serve::postgres::nested::{as_json, as_texts, without_bytes};
use crate::serve::postgres::parameters::with_types;
use crate::serve::postgres::postgis::with_views;
use crate::serve::postgres::said;
use crate::serve::postgres::spatial::in_our_words;
use crate::serve::postgres::types::of_types;

/// Plans queries that only read, structs and the like as JSON.
#[derive(Debug)]
pub(super) struct Reading;

pub(super) async fn reading(
    statement: &Statement,
    context: &SessionContext,
) -> PgWireResult<LogicalPlan> {
    let statement = &with_views(in_our_words(of_types(statement.clone())));
    if !is_of_catalog(statement) {
        return planned(statement.clone(), context).await;
    }
    let plan = planned(in_its_words(statement.clone()), context).await;
    let runs = |plan: LogicalPlan| {
        let made = context.state().optimize(&plan);
        made.map_or_else(|error| Err(said(&fault_of(&error))), |_| Ok(plan))
    };
    plan.and_then(runs).or_else(|error| {
        tracing::debug!("not planned: {error}: {statement}");
        no_rows(statement).ok_or(error)
    })
}

async fn planned(statement: Statement, context: &SessionContext) -> PgWireResult<LogicalPlan> {
    let parsed = Parsed::Statement(Box::new(statement));
    let state = context.state();
    let plan = aside(async move {
        let plan = plan_of(&state, parsed).await?;
        only_reads(&plan)?;
        without_bytes(as_extended(as_json(as_texts(with_types(plan)?)?)?)?)
    });
    let plan = plan.await.map_err(|fault| said(&fault))?;
    plan.map_err(|error| said(&explained(context, fault_of(&error))))
}

/// The rows of a query that [`reading`] planned.
pub(super) async fn rows(
    plan: LogicalPlan,
    context: &SessionContext,
    client: &dyn HookClient,
    format: &Format,
) -> PgWireResult<QueryResponse> {
    let is_text = |column| format.format_for(column) == FieldFormat::Text;
    let plan = as_text(plan, is_text).map_err(|error| said(&fault_of(&error)))?;
    let frame = DataFrame::new(context.state(), plan.clone());
    let options = Arc::new(FormatOptions::from_client_metadata(client.metadata()));
    let format = format.clone();
    let rows = aside(async move { encode_dataframe(frame, &format, Some(options)).await });
    let rows = rows.await.map_err(|fault| said(&fault))?;
    let rows = rows.map_err(fault_in_our_words)?;
    let columns = told(&plan, rows.row_schema().to_vec());
    let QueryResponse { data_rows, .. } = rows;
    Ok(QueryResponse::new(Arc::new(columns), data_rows))
}

impl Hook for Reading {
    /// A plan is run as it was made, in the format that the client asks for.
    fn answer<'a>(
        &'a self,
        statement: &'a Statement,
        plan: Option<&'a LogicalPlan>,
        context: &'a SessionContext,
        client: &'a mut dyn HookClient,
    ) -> Answer<'a> {
        if plan.is_some() {
            return ready(None).boxed();
        }
        let answered = async move {
            let plan = reading(statement, context).await?;
            rows(plan, context, client, &Format::UnifiedText).await
        };
        let answer = answered.map(|rows| Some(rows.map(Response::Query)));
        answer.boxed()
    }

    fn planned<'a>(
        &'a self,
        statement: &'a Statement,
        context: &'a SessionContext,
        _: &'a (dyn ClientInfo + Send + Sync),
    ) -> Answer<'a, LogicalPlan> {
        reading(statement, context).map(Some).boxed()
    }
}

/// An error of the engine, or of the parser, which the library passes on as they are, as a fault with its number.
pub(super) fn fault_in_our_words(error: PgWireError) -> PgWireError {
    let inner = match error {
        PgWireError::ApiError(inner) => inner,
        other => return other,
    };
    let found = match inner.downcast::<ParserError>() {
        Ok(error) => Ok(Box::new(DataFusionError::from(*error))),
        Err(inner) => inner.downcast::<DataFusionError>(),
    };
    match found {
        Ok(error) => said(&fault_of(&error)),
        Err(inner) => PgWireError::ApiError(inner),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::panic)]
    use arrow::error::ArrowError;
    use datafusion::sql::sqlparser::dialect::PostgreSqlDialect;
    use datafusion::sql::sqlparser::parser::Parser;

    use super::*;

    #[test]
    fn what_the_parser_and_the_engine_say_has_the_number_that_postgres_has() {
        let mistyped = Parser::parse_sql(&PostgreSqlDialect {}, "SELEC 1").unwrap_err();
        let no_uuid = "expected a value of the type uuid, found `7`";
        let no_uuid = DataFusionError::Execution(no_uuid.to_owned());
        let by_nothing = DataFusionError::from(ArrowError::DivideByZero);
        for (error, code, says) in [
            (
                PgWireError::ApiError(Box::new(mistyped)),
                "42601",
                "found: SELEC",
            ),
            (
                PgWireError::ApiError(Box::new(by_nothing)),
                "22012",
                "Divide by zero",
            ),
            (
                PgWireError::ApiError(Box::new(no_uuid)),
                "22P02",
                "found `7`",
            ),
        ] {
            let PgWireError::UserError(told) = fault_in_our_words(error) else {
                panic!("{says} is no fault");
            };
            assert_eq!(told.code, code, "{told:?}");
            assert!(told.message.contains(says), "{told:?}");
        }
        let other = PgWireError::ApiError("another error".into());
        let kept = fault_in_our_words(other).to_string();
        assert!(kept.contains("another error"), "{kept}");
    }
}
