//! What clients of Postgres may say: queries, and what drivers say around them. All else is refused by name.

use std::sync::Arc;

use datafusion::logical_expr::LogicalPlan;
use datafusion::prelude::SessionContext;
use datafusion::sql::sqlparser::ast::{DiscardObject, Set, Statement};
use datafusion::sql::sqlparser::dialect::PostgreSqlDialect;
use datafusion::sql::sqlparser::parser::Parser;
use datafusion_postgres::QueryHook;
use datafusion_postgres::hooks::HookClient;
use datafusion_postgres::hooks::cursor::CursorStatementHook;
use datafusion_postgres::hooks::set_show::SetShowHook;
use datafusion_postgres::hooks::transactions::TransactionStatementHook;
use futures::FutureExt;
use pgwire::api::ClientInfo;
use pgwire::api::results::{Response, Tag};
use pgwire::error::PgWireError;

use crate::serve::postgres::cursors;
use crate::serve::postgres::error;
use crate::serve::postgres::functions::{NO_PATH, PATH, SETTINGS, leads_elsewhere};
use crate::serve::postgres::hook::{Answer, Hook, Hooked};
use crate::serve::postgres::kept::deallocate;
use crate::serve::postgres::reading::{Reading, reading};
use crate::serve::postgres::transactions::refused;

/// What handles statements, in this order.
pub fn hooks() -> Vec<Arc<dyn QueryHook>> {
    vec![
        Arc::new(Hooked(Gate)),
        Arc::new(CursorStatementHook),
        Arc::new(SetShowHook),
        Arc::new(TransactionStatementHook),
        Arc::new(Hooked(Reading)),
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

impl Hook for Gate {
    /// What becomes of a statement, with its plan where it has one; `None` for what the hooks behind the gate answer.
    fn answer<'a>(
        &'a self,
        statement: &'a Statement,
        plan: Option<&'a LogicalPlan>,
        context: &'a SessionContext,
        client: &'a mut dyn HookClient,
    ) -> Answer<'a> {
        let answer = async move {
            if let Some(error) = refused(statement, client) {
                return Some(Err(error));
            }
            forget(statement, client);
            if let Some(query) = shown(statement, client) {
                return Reading.answer(&query, None, context, client).await;
            }
            match Self::verdict(statement) {
                Verdict::Passes => cursors::answered(statement, plan, context, client).await,
                Verdict::Done(tag) => Some(Ok(Response::Execution(Tag::new(tag)))),
                Verdict::Refused(error) => Some(Err(error)),
            }
        };
        answer.boxed()
    }

    fn planned<'a>(
        &'a self,
        statement: &'a Statement,
        context: &'a SessionContext,
        client: &'a (dyn ClientInfo + Send + Sync),
    ) -> Answer<'a, LogicalPlan> {
        let planned = async move {
            if let Some(query) = shown(statement, client) {
                return Some(reading(&query, context).await);
            }
            match Self::verdict(statement) {
                Verdict::Passes => cursors::planned(statement, context, client).await,
                // A plan without rows.
                Verdict::Done(_) => Some(Ok(LogicalPlan::default())),
                Verdict::Refused(error) => Some(Err(error)),
            }
        };
        planned.boxed()
    }
}

impl Gate {
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

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
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
}
