//! What the exports of the metric map share.

use std::collections::BTreeSet;

use evermap_contract::Registry;
use evermap_engine::map::Map;
use evermap_schemas::{Fault, LayerRow};

use crate::scene::layer_of;

/// The rows of the layer that holds this kind.
///
/// # Errors
/// A user fault that says which layer the plan must write.
pub async fn found<T: LayerRow>(map: &Map, registry: &Registry) -> Result<Vec<T>, Fault> {
    let layer = layer_of::<T>(map, registry).ok_or_else(|| {
        Fault::user(format!("the map has no layer {}", T::NAME))
            .next("list it under `write:` in the plan, as lifelong does")
    })?;
    map.rows(&layer).await
}

/// The site that is exported: the one asked for, or the only one.
///
/// # Errors
/// A user fault that names the sites.
pub fn one_site<'a>(
    sites: impl Iterator<Item = &'a str>,
    asked: Option<&str>,
) -> Result<String, Fault> {
    let sites: BTreeSet<&str> = sites.collect();
    match (asked, sites.len()) {
        (Some(asked), _) if sites.contains(asked) => Ok(asked.to_owned()),
        (None, 1) => Ok(sites.into_iter().collect()),
        (_, 0) => Err(Fault::user("there is nothing to export")),
        (asked, _) => {
            let names: Vec<_> = sites.into_iter().collect();
            let what = asked.map_or_else(
                || "frames differ from site to site".to_owned(),
                |asked| format!("no site {asked}"),
            );
            Err(Fault::user(what).next(format!("choose one with --site: {}", names.join(", "))))
        }
    }
}
