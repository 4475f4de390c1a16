//! A hook of `datafusion-postgres`, whose futures are boxed once (`evermap_engine::erased`).

use datafusion::common::ParamValues;
use datafusion::logical_expr::LogicalPlan;
use datafusion::prelude::SessionContext;
use datafusion::sql::sqlparser::ast::Statement;
use datafusion_postgres::QueryHook;
use datafusion_postgres::hooks::HookClient;
use futures::future::BoxFuture;
use pgwire::api::ClientInfo;
use pgwire::api::results::Response;
use pgwire::error::PgWireResult;

/// What a hook answers; `None` for what those behind it answer.
pub(super) type Answer<'a, T = Response> = BoxFuture<'a, Option<PgWireResult<T>>>;

/// What is done with statements.
pub(super) trait Hook: Send + Sync {
    /// Answers a statement, with its plan where it was planned before.
    fn answer<'a>(
        &'a self,
        statement: &'a Statement,
        plan: Option<&'a LogicalPlan>,
        context: &'a SessionContext,
        client: &'a mut dyn HookClient,
    ) -> Answer<'a>;

    /// Plans a statement.
    fn planned<'a>(
        &'a self,
        statement: &'a Statement,
        context: &'a SessionContext,
        client: &'a (dyn ClientInfo + Send + Sync),
    ) -> Answer<'a, LogicalPlan>;
}

/// A [`Hook`], as the library asks it.
#[derive(Debug)]
pub(super) struct Hooked<T>(pub(super) T);

impl<T: Hook> QueryHook for Hooked<T> {
    fn handle_simple_query<'a, 'b, 'c, 'd, 'all>(
        &'a self,
        statement: &'b Statement,
        context: &'c SessionContext,
        client: &'d mut dyn HookClient,
    ) -> Answer<'all>
    where
        'a: 'all,
        'b: 'all,
        'c: 'all,
        'd: 'all,
        Self: 'all,
    {
        self.0.answer(statement, None, context, client)
    }

    fn handle_extended_parse_query<'a, 'b, 'c, 'd, 'all>(
        &'a self,
        statement: &'b Statement,
        context: &'c SessionContext,
        client: &'d (dyn ClientInfo + Send + Sync),
    ) -> Answer<'all, LogicalPlan>
    where
        'a: 'all,
        'b: 'all,
        'c: 'all,
        'd: 'all,
        Self: 'all,
    {
        self.0.planned(statement, context, client)
    }

    fn handle_extended_query<'a, 'b, 'c, 'd, 'e, 'f, 'all>(
        &'a self,
        statement: &'b Statement,
        plan: &'c LogicalPlan,
        _: &'d ParamValues,
        context: &'e SessionContext,
        client: &'f mut dyn HookClient,
    ) -> Answer<'all>
    where
        'a: 'all,
        'b: 'all,
        'c: 'all,
        'd: 'all,
        'e: 'all,
        'f: 'all,
        Self: 'all,
    {
        self.0.answer(statement, Some(plan), context, client)
    }
}
