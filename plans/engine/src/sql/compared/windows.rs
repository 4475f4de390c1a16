//! Windows of values that are compared.

use std::sync::Arc;

use datafusion::common::tree_node::{Transformed, TreeNode};
use datafusion::common::{DFSchema, Result};
use datafusion::logical_expr::expr_rewriter::NamePreserver;
use datafusion::logical_expr::{Expr, LogicalPlan, Window};

use crate::sql::compared::plain::{Keys, compare};
use crate::sql::lengths::is_length;

/// What windows go by become columns below them: windows of one node have the same keys, and each is rewritten by itself.
pub fn of_window(mut window: Window) -> Result<LogicalPlan> {
    let schema = Arc::clone(window.input.schema());
    let mut keys = Keys::beside(&schema);
    let names = NamePreserver::new_for_projection();
    let terms = std::mem::take(&mut window.window_expr).into_iter();
    let terms = terms.map(|term| {
        let name = names.save(&term);
        let term = term.transform_up(|part| Ok(by_columns(part, &schema, &mut keys)))?;
        Ok(name.restore(term.data))
    });
    window.window_expr = terms.collect::<Result<_>>()?;
    // The columns of a window below are among those of this one.
    let input = keys.added(window.input)?;
    Ok(LogicalPlan::Window(Window::try_new(
        window.window_expr,
        input,
    )?))
}

/// A window that goes by columns where it went by values, which are added to those that are there.
fn by_columns(mut term: Expr, schema: &DFSchema, keys: &mut Keys) -> Transformed<Expr> {
    let Expr::WindowFunction(call) = &mut term else {
        return Transformed::no(term);
    };
    let params = &mut call.params;
    let by = params.partition_by.iter_mut();
    let by = by.chain(params.order_by.iter_mut().map(|sort| &mut sort.expr));
    let mut is_changed = false;
    for key in by {
        if compare(key, schema) || is_length(key) {
            let value = std::mem::take(key);
            (*key, is_changed) = (keys.column(value), true);
        }
    }
    match is_changed {
        true => Transformed::yes(term),
        false => Transformed::no(term),
    }
}
