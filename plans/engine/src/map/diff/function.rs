//! `diff(layer, before, after)`.

use std::sync::Arc;

use datafusion::catalog::{TableFunctionArgs, TableFunctionImpl, TableProvider};
use datafusion::common::{Result, ScalarValue, plan_err};
use datafusion::logical_expr::{DocSection, Documentation, Expr};
use datafusion::prelude::SessionContext;
use evermap_contract::Registry;

use crate::map::Map;
use crate::map::diff::Comparison;
use crate::map::table_function::{text, waited};

/// The table function.
pub struct DiffFunction {
    /// The map.
    pub map: Map,
    /// The operators that may have made its layers.
    pub registry: Registry,
    /// Its settings and limits.
    pub reading: SessionContext,
}

impl std::fmt::Debug for DiffFunction {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("DiffFunction")
            .field("map", &self.map)
            .finish()
    }
}

impl TableFunctionImpl for DiffFunction {
    fn call_with_args(&self, args: TableFunctionArgs) -> Result<Arc<dyn TableProvider>> {
        let [layer, before, after] = args.exprs() else {
            return plan_err!("diff expects (layer, before, after), such as diff('lanes', 1, 2)");
        };
        let layer = text("diff", "the name of a layer, such as 'lanes'", layer)?;
        let versions = [version(before)?, version(after)?];
        let rows = async {
            let compared = Comparison::open(&self.map, versions, &self.registry, &self.reading);
            compared.await?.rows(&layer).await
        };
        Ok(waited("diff", rows)?.into_view())
    }
}

/// What the function is.
pub fn documentation() -> Documentation {
    let about = "The rows of a layer in either of two versions of the map → a table: the layer's key, change (added, \
                 removed, changed or same), moved_m (m, between poses or geometries; null where there are none, or one), \
                 moved_rad (rad, between poses), geometry (where the row is, or was) and geometry_before";
    Documentation::builder(DocSection::default(), about, "diff(layer, before, after)")
        .with_argument("layer", "name of the layer")
        .with_argument("before", "the earlier version")
        .with_argument("after", "the later version")
        .with_sql_example("SELECT change, count(*) FROM diff('lanes', 1, 2) GROUP BY change")
        .build()
}

fn version(argument: &Expr) -> Result<u64> {
    let number = match argument {
        Expr::Literal(ScalarValue::Int64(Some(number)), _) => u64::try_from(*number).ok(),
        _ => None,
    };
    number.map_or_else(
        || plan_err!("diff expects the number of a version, such as 1, found {argument}"),
        Ok,
    )
}
