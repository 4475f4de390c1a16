//! Transactions as clients know them, though all that they do here is to end, and to be aborted by an error: then nothing is
//! answered but what ends one, or goes back to a savepoint.

use datafusion::sql::sqlparser::ast::Statement;
use datafusion::sql::sqlparser::dialect::PostgreSqlDialect;
use datafusion::sql::sqlparser::keywords::Keyword;
use datafusion::sql::sqlparser::parser::Parser;
use pgwire::api::store::PortalStore;
use pgwire::api::{ClientInfo, ClientPortalStore, DEFAULT_NAME};
use pgwire::error::PgWireError;
use pgwire::messages::extendedquery::Execute;
use pgwire::messages::response::TransactionStatus;

use crate::serve::postgres::{Prepared, error};

/// Lets a client go back whose text begins with `ROLLBACK`. The library keeps the state that it finds before it has a text
/// answered, so this comes first.
pub fn before_query<C: ClientInfo>(client: &mut C, text: &str) {
    if is_aborted(client) && goes_back(text) {
        client.set_transaction_status(TransactionStatus::Transaction);
    }
}

/// As [`before_query`], of what was prepared and bound.
pub fn before_execute<C>(client: &mut C, message: &Execute)
where
    C: ClientInfo + ClientPortalStore,
    C::PortalStore: PortalStore<Statement = Prepared>,
{
    if !is_aborted(client) {
        return;
    }
    let name = message.name.as_deref().unwrap_or(DEFAULT_NAME);
    let portal = client.portal_store().get_portal(name);
    let portal = portal.and_then(|portal| portal.value().cloned());
    let goes_back = portal.is_some_and(|portal| {
        let (_, prepared) = &portal.statement.statement;
        matches!(prepared, Some((Statement::Rollback { .. }, _)))
    });
    if goes_back {
        client.set_transaction_status(TransactionStatus::Transaction);
    }
}

/// What a client is told that says something else in a transaction that an error has aborted.
pub fn refused(
    statement: &Statement,
    client: &(dyn ClientInfo + Send + Sync),
) -> Option<PgWireError> {
    let ends = matches!(
        statement,
        Statement::Commit { .. }
            | Statement::Rollback {
                savepoint: None,
                ..
            }
    );
    let message = "current transaction is aborted, commands ignored until end of transaction block";
    (is_aborted(client) && !ends).then(|| error("ERROR", "25P02", message))
}

fn is_aborted<C: ClientInfo + ?Sized>(client: &C) -> bool {
    client.transaction_status() == TransactionStatus::Error
}

fn goes_back(text: &str) -> bool {
    let parser = Parser::new(&PostgreSqlDialect {}).try_with_sql(text);
    parser.is_ok_and(|mut parser| parser.parse_keyword(Keyword::ROLLBACK))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_text_goes_back_that_begins_so() {
        for text in [
            "ROLLBACK TO SAVEPOINT mine",
            "rollback to \"_pg3_1\"; RELEASE \"_pg3_1\"",
            "/* after an error */ ROLLBACK TO mine",
            "ROLLBACK; SELECT 1",
        ] {
            assert!(goes_back(text), "{text}");
        }
        for text in [
            "SELECT 1; ROLLBACK TO mine",
            "'ROLLBACK",
            "",
            "\"ROLLBACK\"",
        ] {
            assert!(!goes_back(text), "{text}");
        }
    }
}
