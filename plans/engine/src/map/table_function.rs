//! What the table functions of maps share.

use datafusion::common::{Result, ScalarValue, plan_datafusion_err};
use datafusion::logical_expr::Expr;
use evermap_schemas::Fault;
use tokio::runtime::{Handle, RuntimeFlavor};

use crate::error::external;

/// An argument that is a text: what it names, such as `the name of a layer, such as 'lanes'`.
pub fn text(function: &str, named: &str, argument: &Expr) -> Result<String> {
    match argument {
        Expr::Literal(ScalarValue::Utf8(Some(text)), _) => Ok(text.clone()),
        other => Err(plan_datafusion_err!(
            "{function} expects {named}, found {other}"
        )),
    }
}

/// Waits for what is read while a query is planned, which DataFusion does without waiting.
pub fn waited<T>(function: &str, future: impl Future<Output = Result<T, Fault>>) -> Result<T> {
    match Handle::try_current() {
        Ok(handle) if handle.runtime_flavor() == RuntimeFlavor::MultiThread => {
            tokio::task::block_in_place(|| handle.block_on(future)).map_err(external)
        }
        _ => Err(plan_datafusion_err!(
            "{function} expects a runtime of several threads"
        )),
    }
}
