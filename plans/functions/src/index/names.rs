//! The names of a map's views: what an index must be of, to be used.

use std::collections::BTreeMap;

use arrow::array::AsArray;
use arrow::compute::cast;
use arrow::datatypes::DataType;
use datafusion::common::{DataFusionError, Result};
use datafusion::prelude::SessionContext;
use evermap_algorithms::semantic_map::relation_index::names_digest;

/// Names of views by site, in their order.
pub(super) type Names = BTreeMap<String, Vec<String>>;

/// The names that a query gives: site, view.
pub(super) async fn names(context: &SessionContext, query: &str) -> Result<Names> {
    let mut names = Names::new();
    for [site, view] in texts(context, query).await? {
        names.entry(site).or_default().push(view);
    }
    names.values_mut().for_each(|views| views.sort_unstable());
    Ok(names)
}

/// The digest of each site's names, as `relation_index` has it.
pub(super) fn digests(names: &Names) -> BTreeMap<String, String> {
    let digest = |views: &Vec<String>| names_digest(views.iter().map(String::as_str));
    let sites = names.iter();
    sites
        .map(|(site, views)| (site.clone(), digest(views)))
        .collect()
}

/// The rows of a query of two texts.
pub(super) async fn texts(context: &SessionContext, query: &str) -> Result<Vec<[String; 2]>> {
    let mut rows = Vec::new();
    for batch in context.sql(query).await?.collect().await? {
        let columns: Vec<_> = batch
            .columns()
            .iter()
            .map(|column| cast(column, &DataType::Utf8))
            .collect::<Result<_, _>>()?;
        let [one, other] = columns.as_slice() else {
            return Err(DataFusionError::Internal(format!(
                "expected two columns, found {}",
                columns.len()
            )));
        };
        let pairs = one.as_string::<i32>().iter().zip(other.as_string::<i32>());
        rows.extend(pairs.filter_map(|(one, other)| Some([one?.to_owned(), other?.to_owned()])));
    }
    Ok(rows)
}
