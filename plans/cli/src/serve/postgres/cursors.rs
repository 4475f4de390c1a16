//! Cursors: a query whose rows are fetched by and by, with `DECLARE … CURSOR`. Its rows are those of the query itself,
//! nested columns and geometries included, as they are asked for; the library closes cursors.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use datafusion::logical_expr::LogicalPlan;
use datafusion::prelude::SessionContext;
use datafusion::sql::sqlparser::ast::{
    CloseCursor, Declare, DeclareType, FetchDirection, Statement, Value,
};
use datafusion_postgres::hooks::HookClient;
use futures::{StreamExt, TryStreamExt, stream};
use pgwire::api::ClientInfo;
use pgwire::api::portal::{Format, Portal, PortalExecutionState};
use pgwire::api::results::{QueryResponse, Response, Tag};
use pgwire::api::stmt::StoredStatement;
use pgwire::api::store::PortalStore;
use pgwire::error::{PgWireError, PgWireResult};

use crate::serve::postgres::answering::ROWS_AT_ONCE;
use crate::serve::postgres::reading::{reading, rows};
use crate::serve::postgres::{Prepared, error};

/// Cursors that one client has open at most: each holds a query that runs.
const MOST: usize = 64;

/// An open cursor.
struct Cursor {
    /// The query, as it is planned.
    plan: LogicalPlan,
    /// How its rows are written.
    format: Format,
    /// Whether it runs.
    runs: bool,
}

/// The cursors of a connection: what fetches from one is described by it.
#[derive(Default)]
pub struct OpenCursors(Mutex<BTreeMap<String, Cursor>>);

impl OpenCursors {
    fn of(client: &(impl ClientInfo + ?Sized)) -> Arc<Self> {
        client
            .session_extensions()
            .get_or_insert_with(Self::default)
    }

    fn held(&self) -> MutexGuard<'_, BTreeMap<String, Cursor>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Notes the format that a client who fetches binds, which goes before the one that the cursor was declared with.
///
/// # Errors
/// For another format than that of rows that were fetched before: they are written by then.
pub fn bound(client: &(impl ClientInfo + ?Sized), portal: &Portal<Prepared>) -> PgWireResult<()> {
    let (_, prepared) = &portal.statement.statement;
    let Some((Statement::Fetch { name, .. }, _)) = prepared else {
        return Ok(());
    };
    let open_ones = OpenCursors::of(client);
    let mut held = open_ones.held();
    let Some(cursor) = held.get_mut(&name.value) else {
        return Ok(());
    };
    let format = &portal.result_column_format;
    let mut columns = 0..cursor.plan.schema().fields().len();
    if cursor.runs && columns.any(|at| format.format_for(at) != cursor.format.format_for(at)) {
        let message = "expected the format of the rows that were fetched before, found another";
        return Err(error("ERROR", "0A000", message));
    }
    cursor.format = format.clone();
    Ok(())
}

/// Opens cursors and fetches from them, and forgets those that are closed, or whose transaction ends; `None` for what the
/// library has an answer to. A cursor that is declared with parameters has the plan of its query, with their values.
pub async fn answered(
    statement: &Statement,
    plan: Option<&LogicalPlan>,
    context: &SessionContext,
    client: &mut dyn HookClient,
) -> Option<PgWireResult<Response>> {
    let open_ones = OpenCursors::of(client);
    match statement {
        Statement::Declare { stmts } => {
            for declared in stmts {
                if let Err(error) = open(declared, plan, context, client).await {
                    return Some(Err(error));
                }
            }
            Some(Ok(Response::Execution(Tag::new("DECLARE CURSOR"))))
        }
        Statement::Fetch {
            name, direction, ..
        } => {
            if let Err(error) = start(&name.value, context, client).await {
                return Some(Err(error));
            }
            fetched(&name.value, direction, client).await.map(Ok)
        }
        Statement::Close {
            cursor: CloseCursor::Specific { name },
        } => {
            open_ones.held().remove(&name.value);
            None
        }
        Statement::Close {
            cursor: CloseCursor::All,
        } => {
            open_ones.held().clear();
            None
        }
        Statement::Commit { .. }
        | Statement::Rollback {
            savepoint: None, ..
        } => {
            for name in std::mem::take(&mut *open_ones.held()).into_keys() {
                client.portal_store().rm_portal(&name);
            }
            None
        }
        _ => None,
    }
}

/// The plan of what fetches from a cursor that is open, or of the query that one is declared for.
pub async fn planned(
    statement: &Statement,
    context: &SessionContext,
    client: &(dyn ClientInfo + Send + Sync),
) -> Option<PgWireResult<LogicalPlan>> {
    match statement {
        Statement::Fetch { name, .. } => {
            let open_ones = OpenCursors::of(client);
            let held = open_ones.held();
            held.get(&name.value).map(|cursor| Ok(cursor.plan.clone()))
        }
        Statement::Declare { stmts } => {
            let query = stmts.first()?.for_query.clone()?;
            Some(reading(&Statement::Query(query), context).await)
        }
        _ => None,
    }
}

async fn open(
    declared: &Declare,
    plan: Option<&LogicalPlan>,
    context: &SessionContext,
    client: &dyn HookClient,
) -> PgWireResult<()> {
    let (Some(DeclareType::Cursor), Some(name), Some(query)) = (
        &declared.declare_type,
        declared.names.first(),
        &declared.for_query,
    ) else {
        let message = "expected DECLARE name CURSOR FOR a query";
        return Err(error("ERROR", "42601", message));
    };
    let open_ones = OpenCursors::of(client);
    if open_ones.held().len() >= MOST {
        let message = format!("expected at most {MOST} open cursors; CLOSE one first");
        return Err(error("ERROR", "53000", &message));
    }
    let format = match declared.binary {
        Some(true) => Format::UnifiedBinary,
        _ => Format::UnifiedText,
    };
    let statement = Statement::Query(query.clone());
    let plan = match plan {
        Some(plan) => plan.clone(),
        None => reading(&statement, context).await?,
    };
    // Clients ask for the columns of the cursor, too.
    let prepared = (query.to_string(), Some((statement, plan.clone())));
    let stored = StoredStatement::new(name.value.clone(), prepared, vec![]);
    let mut portal = Portal::new_cursor(name.value.clone(), Arc::new(stored));
    portal.result_column_format = format.clone();
    client.portal_store().put_portal(Arc::new(portal));
    let cursor = Cursor {
        plan,
        format,
        runs: false,
    };
    open_ones.held().insert(name.value.clone(), cursor);
    Ok(())
}

/// Runs the query of a cursor from which nothing was fetched before.
async fn start(name: &str, context: &SessionContext, client: &dyn HookClient) -> PgWireResult<()> {
    let first = match OpenCursors::of(client).held().get_mut(name) {
        Some(cursor) if !cursor.runs => {
            cursor.runs = true;
            Some((cursor.plan.clone(), cursor.format.clone()))
        }
        _ => None,
    };
    let portal = client.portal_store().get_portal(name);
    let portal = portal.and_then(|portal| portal.value().cloned());
    if let (Some((plan, format)), Some(portal)) = (first, portal) {
        portal
            .start(rows(plan, context, client, &format).await?)
            .await;
    }
    Ok(())
}

/// The next rows of a cursor, as they are asked for; `None` for what the library has an answer to: it would hold all of
/// them before it sends the first.
async fn fetched(
    name: &str,
    direction: &FetchDirection,
    client: &dyn HookClient,
) -> Option<Response> {
    let wanted = match direction {
        FetchDirection::Next | FetchDirection::Forward { limit: None } => 1,
        FetchDirection::Count { limit } | FetchDirection::Forward { limit: Some(limit) } => {
            match &limit.value {
                // What is no number of rows is more than there are.
                Value::Number(digits, _) => digits.parse().unwrap_or(usize::MAX),
                _ => return None,
            }
        }
        FetchDirection::All | FetchDirection::ForwardAll => usize::MAX,
        _ => return None,
    };
    let portal = client.portal_store().get_portal(name)?.value().cloned()?;
    let columns = match &*portal.state.lock().await {
        PortalExecutionState::Suspended(rows) => rows.row_schema(),
        _ => return None,
    };
    let some = |(portal, wanted): (Arc<Portal<Prepared>>, usize)| async move {
        let count = wanted.min(ROWS_AT_ONCE);
        if count == 0 {
            return Ok(None);
        }
        let QueryResponse { data_rows, .. } = portal.fetch(count).await?.response;
        let rows: Vec<_> = data_rows.collect().await;
        let is_end = rows.is_empty();
        let more = (stream::iter(rows), (portal, wanted - count));
        Ok::<_, PgWireError>((!is_end).then_some(more))
    };
    let rows = stream::try_unfold((portal, wanted), some).try_flatten();
    Some(Response::Query(QueryResponse::new(columns, rows)))
}
