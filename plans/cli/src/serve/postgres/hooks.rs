//! What clients of Postgres may say: queries, and what drivers say around them. All else is refused by name.

use std::sync::Arc;

use async_trait::async_trait;
use datafusion::common::ParamValues;
use datafusion::error::DataFusionError;
use datafusion::logical_expr::LogicalPlan;
use datafusion::prelude::{DataFrame, SessionContext};
use datafusion::sql::parser::Statement as Parsed;
use datafusion::sql::sqlparser::ast::{DiscardObject, Set, Statement};
use datafusion::sql::sqlparser::dialect::PostgreSqlDialect;
use datafusion::sql::sqlparser::parser::{Parser, ParserError};
use datafusion_postgres::QueryHook;
use datafusion_postgres::arrow_pg::datatypes::df::encode_dataframe;
use datafusion_postgres::hooks::HookClient;
use datafusion_postgres::hooks::cursor::CursorStatementHook;
use datafusion_postgres::hooks::set_show::SetShowHook;
use datafusion_postgres::hooks::transactions::TransactionStatementHook;
use evermap_engine::error::fault_of;
use evermap_engine::sql::{explained, only_reads, plan_of};
use pgwire::api::ClientInfo;
use pgwire::api::portal::Format;
use pgwire::api::results::{FieldFormat, QueryResponse, Response, Tag};
use pgwire::error::{PgWireError, PgWireResult};
use pgwire::types::format::FormatOptions;

use crate::serve::aside::aside;
use crate::serve::postgres::catalog::{in_its_words, is_of_catalog, no_rows};
use crate::serve::postgres::cursors;
use crate::serve::postgres::functions::{NO_PATH, PATH, SETTINGS, leads_elsewhere};
use crate::serve::postgres::geometry::{as_extended, as_text, told};
use crate::serve::postgres::kept::deallocate;
use crate::serve::postgres::nested::{as_json, as_texts, without_bytes};
use crate::serve::postgres::parameters::with_types;
use crate::serve::postgres::postgis::with_views;
use crate::serve::postgres::spatial::in_our_words;
use crate::serve::postgres::transactions::refused;
use crate::serve::postgres::types::of_types;
use crate::serve::postgres::{error, said};

/// What handles statements, in this order.
pub fn hooks() -> Vec<Arc<dyn QueryHook>> {
    vec![
        Arc::new(Gate),
        Arc::new(CursorStatementHook),
        Arc::new(SetShowHook),
        Arc::new(TransactionStatementHook),
        Arc::new(Reading),
    ]
}

/// What becomes of a statement.
enum Verdict {
    /// The hooks behind the gate have an answer.
    Passes,
    /// It means nothing here, and is done.
    Done(&'static str),
    /// It is not for a server that only reads.
    Refused(PgWireError),
}

/// Lets nothing through but what reads, and answers what is asked of cursors, and `SHOW` of what the server says of itself.
#[derive(Debug)]
struct Gate;

impl Gate {
    /// What becomes of a statement, with its plan where it has one; `None` for what the hooks behind the gate answer.
    async fn answer(
        statement: &Statement,
        plan: Option<&LogicalPlan>,
        context: &SessionContext,
        client: &mut dyn HookClient,
    ) -> Option<PgWireResult<Response>> {
        if let Some(error) = refused(statement, client) {
            return Some(Err(error));
        }
        forget(statement, client);
        if let Some(query) = shown(statement, client) {
            return Reading.handle_simple_query(&query, context, client).await;
        }
        match Self::verdict(statement) {
            Verdict::Passes => cursors::answered(statement, plan, context, client).await,
            Verdict::Done(tag) => Some(Ok(Response::Execution(Tag::new(tag)))),
            Verdict::Refused(error) => Some(Err(error)),
        }
    }

    fn verdict(statement: &Statement) -> Verdict {
        match statement {
            Statement::Query(_)
            | Statement::Explain { .. }
            | Statement::ExplainTable { .. }
            | Statement::ShowTables { .. }
            | Statement::ShowColumns { .. }
            | Statement::ShowVariable { .. }
            | Statement::ShowStatus { .. }
            | Statement::ShowCatalogs { .. }
            | Statement::StartTransaction { .. }
            | Statement::Commit { .. }
            | Statement::Rollback {
                savepoint: None, ..
            }
            // A cursor's query is planned as any other.
            | Statement::Declare { .. }
            | Statement::Fetch { .. }
            | Statement::Close { .. } => Verdict::Passes,
            Statement::Set(set) if sets_other_path(set) => {
                Verdict::Refused(error("ERROR", "0A000", NO_PATH))
            }
            // Instants stay in UTC, and drivers name their zone when they come in.
            Statement::Set(set) if sets_zone(set) => Verdict::Done("SET"),
            Statement::Set(set) if is_of_a_client(set) => Verdict::Passes,
            Statement::Savepoint { .. } => Verdict::Done("SAVEPOINT"),
            Statement::ReleaseSavepoint { .. } => Verdict::Done("RELEASE"),
            // To a savepoint: an aborted transaction goes on by now.
            Statement::Rollback { .. } => Verdict::Done("ROLLBACK"),
            Statement::Discard { .. } => Verdict::Done("DISCARD ALL"),
            Statement::Deallocate { .. } => Verdict::Done("DEALLOCATE"),
            // What pools say when a connection comes back to them.
            Statement::UNLISTEN { .. } => Verdict::Done("UNLISTEN"),
            Statement::Reset(_) => Verdict::Done("RESET"),
            Statement::Set(
                Set::SetRole {
                    role_name: None, ..
                }
                | Set::SetSessionAuthorization(_),
            ) => Verdict::Done("SET"),
            other => {
                let text = other.to_string();
                let verb = text.split_whitespace().next().unwrap_or_default();
                let message = format!("cannot execute {verb}: maps are served to be read");
                Verdict::Refused(error("ERROR", "25006", &message))
            }
        }
    }
}

/// Forgets the statements of a client that it asks to be forgotten.
fn forget(statement: &Statement, client: &dyn HookClient) {
    let forgotten = match statement {
        Statement::Deallocate { name, .. } if name.quote_style.is_some() => {
            Some(name.value.clone())
        }
        Statement::Deallocate { name, .. } => {
            let name = name.value.to_lowercase();
            (name != "all").then_some(name)
        }
        Statement::Discard {
            object_type: DiscardObject::ALL,
        } => None,
        _ => return,
    };
    let (extensions, store) = (client.session_extensions(), client.portal_store());
    deallocate(extensions, store, forgotten.as_deref());
}

/// Whether it asks that tables be looked for elsewhere.
fn sets_other_path(set: &Set) -> bool {
    let Set::SingleAssignment {
        variable, values, ..
    } = set
    else {
        return false;
    };
    let texts: Vec<String> = values.iter().map(ToString::to_string).collect();
    let texts = texts.join(",");
    let is_path = variable.to_string().eq_ignore_ascii_case(PATH);
    is_path && texts != "DEFAULT" && leads_elsewhere(&texts)
}

/// The setting that says in which zone instants are.
const ZONE: &str = "timezone";

fn sets_zone(set: &Set) -> bool {
    match set {
        Set::SetTimeZone { .. } => true,
        Set::SingleAssignment { variable, .. } => variable.to_string().eq_ignore_ascii_case(ZONE),
        _ => false,
    }
}

/// Whether a setting is one that drivers make for themselves, and none of the engine's, which all clients share.
fn is_of_a_client(set: &Set) -> bool {
    match set {
        Set::SingleAssignment { variable, .. } => {
            let name = variable.to_string();
            !name.contains('.')
        }
        Set::SetTransaction { .. }
        | Set::SetSessionParam(_)
        | Set::SetNames { .. }
        | Set::SetNamesDefault {} => true,
        _ => false,
    }
}

#[async_trait]
impl QueryHook for Gate {
    async fn handle_simple_query(
        &self,
        statement: &Statement,
        context: &SessionContext,
        client: &mut dyn HookClient,
    ) -> Option<PgWireResult<Response>> {
        Self::answer(statement, None, context, client).await
    }

    async fn handle_extended_parse_query(
        &self,
        statement: &Statement,
        context: &SessionContext,
        client: &(dyn ClientInfo + Send + Sync),
    ) -> Option<PgWireResult<LogicalPlan>> {
        if let Some(query) = shown(statement, client) {
            return Some(reading(&query, context).await);
        }
        match Self::verdict(statement) {
            Verdict::Passes => cursors::planned(statement, context, client).await,
            // A plan without rows.
            Verdict::Done(_) => Some(Ok(LogicalPlan::default())),
            Verdict::Refused(error) => Some(Err(error)),
        }
    }

    async fn handle_extended_query(
        &self,
        statement: &Statement,
        plan: &LogicalPlan,
        _: &ParamValues,
        context: &SessionContext,
        client: &mut dyn HookClient,
    ) -> Option<PgWireResult<Response>> {
        Self::answer(statement, Some(plan), context, client).await
    }
}

/// The query for what `SHOW` asks, if it is what the server says of itself, and the client has not set it for itself.
fn shown(statement: &Statement, client: &(dyn ClientInfo + Send + Sync)) -> Option<Statement> {
    let Statement::ShowVariable { variable } = statement else {
        return None;
    };
    let words = variable.iter().map(|word| word.value.to_lowercase());
    let name = match words.collect::<Vec<_>>().join(" ") {
        zone if zone == "time zone" => ZONE.to_owned(),
        name => name,
    };
    let mut settings = SETTINGS.iter();
    let (shown, _) = settings.find(|(known, _)| known.eq_ignore_ascii_case(&name))?;
    if name != ZONE && client.metadata().contains_key(&name) {
        return None;
    }
    let query = format!("SELECT current_setting('{shown}') AS \"{shown}\"");
    Parser::parse_sql(&PostgreSqlDialect {}, &query).ok()?.pop()
}

/// Plans queries that only read, structs and the like as JSON.
#[derive(Debug)]
struct Reading;

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

#[async_trait]
impl QueryHook for Reading {
    async fn handle_simple_query(
        &self,
        statement: &Statement,
        context: &SessionContext,
        client: &mut dyn HookClient,
    ) -> Option<PgWireResult<Response>> {
        let answered = async {
            let plan = reading(statement, context).await?;
            rows(plan, context, client, &Format::UnifiedText).await
        };
        Some(answered.await.map(Response::Query))
    }

    async fn handle_extended_parse_query(
        &self,
        statement: &Statement,
        context: &SessionContext,
        _: &(dyn ClientInfo + Send + Sync),
    ) -> Option<PgWireResult<LogicalPlan>> {
        Some(reading(statement, context).await)
    }

    /// The plan is run as it was made, in the format that the client asks for.
    async fn handle_extended_query(
        &self,
        _: &Statement,
        _: &LogicalPlan,
        _: &ParamValues,
        _: &SessionContext,
        _: &mut dyn HookClient,
    ) -> Option<PgWireResult<Response>> {
        None
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

    use super::*;

    #[test]
    fn a_zone_is_taken_and_never_set() {
        for text in [
            "SET TIME ZONE 'Europe/Berlin'",
            "SET LOCAL TIME ZONE 'Europe/Berlin'",
            "SET timezone TO 'Europe/Berlin'",
            "SET SESSION TimeZone = 'Europe/Berlin'",
        ] {
            let said = Parser::parse_sql(&PostgreSqlDialect {}, text).unwrap();
            let verdict = Gate::verdict(&said[0]);
            assert!(matches!(verdict, Verdict::Done("SET")), "{text}");
        }
    }

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
