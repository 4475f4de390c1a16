//! Rows of a map by what they are, whichever layer holds them.

use std::collections::BTreeSet;

use arrow::array::{Array, AsArray, BooleanArray, RecordBatch};
use arrow::compute::filter_record_batch;
use arrow::datatypes::{DataType, SchemaRef};
use datafusion::common::TableReference;
use datafusion::prelude::SessionContext;
use evermap_catalog::VehicleFrame;
use evermap_contract::Registry;
use evermap_datasets::manifest::Vehicle;
use evermap_engine::conform::conform;
use evermap_engine::error::OrFault;
use evermap_engine::map::Map;
use evermap_engine::map::columns::of_table;
use evermap_engine::map::tables::declaration;
use evermap_engine::sql::{Limits, context, in_utc};
use evermap_schemas::{Fault, Layer, LayerRow, rows};
use serde_json::Value;
use tokio::sync::OnceCell;

use crate::operators;

/// A map with the operators that may have made its layers.
pub struct MapReader {
    /// The map.
    pub map: Map,
    registry: Registry,
    /// Its layers as tables, once a query was asked.
    tables: OnceCell<SessionContext>,
}

impl MapReader {
    /// Opens a map at the version asked for.
    ///
    /// # Errors
    /// A user fault where there is no such map or version.
    pub async fn open(address: &str, version: Option<u64>) -> Result<Self, Fault> {
        Ok(Self {
            map: Map::open(address, version).await?,
            registry: operators::registry(),
            tables: OnceCell::new(),
        })
    }

    /// A new context, in which the map's layers are tables.
    ///
    /// # Errors
    /// As [`Map::context`].
    pub fn context(&self, context: SessionContext) -> Result<SessionContext, Fault> {
        in_utc(&context);
        self.map.context(context, &self.registry)
    }

    /// The answer to a query on the map's layers.
    ///
    /// # Errors
    /// As [`Map::context`] and [`answered`].
    pub async fn ask(&self, query: &str) -> Result<Vec<RecordBatch>, Fault> {
        answered(self.tables().await?, query).await
    }

    /// The columns of a layer, with units and frames.
    ///
    /// # Errors
    /// As [`Map::context`] and [`of_table`].
    pub async fn described(&self, layer: &str) -> Result<SchemaRef, Fault> {
        of_table(self.tables().await?, TableReference::bare(layer)).await
    }

    async fn tables(&self) -> Result<&SessionContext, Fault> {
        let open = async || self.context(context(Limits::default())?);
        self.tables.get_or_try_init(open).await
    }

    /// The vehicle of a site's poses, as the steps that made its layers were told; the usual one where nothing is known of
    /// that.
    ///
    /// # Errors
    /// As [`Map::parameter`].
    pub async fn vehicle(&self, site: &str) -> Result<VehicleFrame, Fault> {
        let told = self.map.parameter(Vehicle::PARAMETER, site).await?;
        let named = told.as_ref().and_then(Value::as_str);
        Ok(
            named.map_or_else(VehicleFrame::default, |frame| VehicleFrame {
                vehicle_frame: frame.to_owned(),
            }),
        )
    }

    /// The declaration of a table's columns, where there is one: of the operator that made it, else by name.
    pub fn declaration(&self, table: &str) -> Option<Layer> {
        declaration(&self.map, &self.registry, table)
    }

    /// The published layer that holds rows of this kind: the one of its name, else one that such an operator made.
    pub fn layer_of<T: LayerRow>(&self) -> Option<String> {
        if self.map.has(T::NAME) {
            return Some(T::NAME.to_owned());
        }
        let mut names = self.map.version.layers.keys();
        let makes = |name: &&String| {
            let made = self.declaration(name);
            self.map.has(name) && made.is_some_and(|layer| layer.name == T::NAME)
        };
        names.find(makes).cloned()
    }

    /// All rows of this kind, of one site where it is named; none where no layer holds them, or where it has other
    /// columns.
    ///
    /// # Errors
    /// As [`Map::batches`].
    pub async fn rows<T: LayerRow>(&self, site: Option<&str>) -> Result<Vec<T>, Fault> {
        let Some(layer) = self.layer_of::<T>() else {
            return Ok(Vec::new());
        };
        let batches = match conformed::<T>(&self.map.batches(&layer).await?) {
            Ok(batches) => batches,
            Err(fault) => {
                tracing::warn!(%layer, %fault, "not drawn: it has other columns");
                return Ok(Vec::new());
            }
        };
        let batches = match site {
            Some(site) => only(&batches, "site", site)?,
            None => batches,
        };
        typed(&batches).map_err(|fault| fault.at(format!("layer {layer}")))
    }

    /// As [`MapReader::rows`], of a kind that must be there.
    ///
    /// # Errors
    /// A user fault that says which layer the plan must write.
    pub async fn needed<T: LayerRow>(&self, site: Option<&str>) -> Result<Vec<T>, Fault> {
        if self.layer_of::<T>().is_none() {
            return Err(Fault::user(format!("the map has no layer {}", T::NAME))
                .next("list it under `write:` in the plan, as lifelong does"));
        }
        self.rows(site).await
    }

    /// All rows of the layer of this name that are of a site; none where the map has no such layer.
    ///
    /// # Errors
    /// As [`MapReader::needed_in`].
    pub async fn rows_in<T: LayerRow>(&self, layer: &str, site: &str) -> Result<Vec<T>, Fault> {
        match self.map.has(layer) {
            true => self.needed_in(layer, site).await,
            false => Ok(Vec::new()),
        }
    }

    /// As [`MapReader::rows_in`], of a layer that must be there.
    ///
    /// # Errors
    /// As [`Map::batches`], and for a layer that has other columns.
    pub async fn needed_in<T: LayerRow>(&self, layer: &str, site: &str) -> Result<Vec<T>, Fault> {
        let batches = only(&self.map.batches(layer).await?, "site", site)?;
        typed(&batches).map_err(|fault| fault.at(format!("layer {layer}")))
    }
}

/// The answer to a query.
///
/// # Errors
/// What is wrong with the query, or what reading says.
pub async fn answered(context: &SessionContext, query: &str) -> Result<Vec<RecordBatch>, Fault> {
    let frame = context.sql(query).await.or_fault()?;
    frame.collect().await.or_fault()
}

/// Batches with just the columns of these rows.
///
/// # Errors
/// A data fault for a column that is missing or of another type.
fn conformed<T: LayerRow>(batches: &[RecordBatch]) -> Result<Vec<RecordBatch>, Fault> {
    let layer = T::layer();
    batches.iter().map(|batch| conform(batch, &layer)).collect()
}

/// The rows of batches that may have more columns than these.
///
/// # Errors
/// When a column of the layer is missing or of another type.
pub fn typed<T: LayerRow>(batches: &[RecordBatch]) -> Result<Vec<T>, Fault> {
    let mut found = Vec::new();
    for batch in conformed::<T>(batches)? {
        found.extend(rows::<T>(&batch)?);
    }
    Ok(found)
}

/// Just the rows that have this text in a column.
///
/// # Errors
/// A user fault where there is no such column.
pub fn only(batches: &[RecordBatch], column: &str, value: &str) -> Result<Vec<RecordBatch>, Fault> {
    let kept = |batch: &RecordBatch| -> Result<RecordBatch, Fault> {
        let texts = texts(batch, column)
            .ok_or_else(|| Fault::user(format!("it has no column {column}")))?;
        let keep: BooleanArray = texts.map(|text| Some(text == Some(value))).collect();
        Ok(filter_record_batch(batch, &keep)?)
    };
    batches.iter().map(kept).collect()
}

/// The texts of a column; `None` where it is none of text.
pub fn texts<'b>(
    batch: &'b RecordBatch,
    column: &str,
) -> Option<impl Iterator<Item = Option<&'b str>> + use<'b>> {
    let found = batch.column_by_name(column)?;
    (*found.data_type() == DataType::Utf8).then(|| found.as_string::<i32>().iter())
}

/// That a layer has no rows.
pub fn nothing() -> Fault {
    Fault::user("there is nothing to export").next(COUNTED)
}

/// What tells which layers have rows.
pub const COUNTED: &str = "evermap layers --map MAP says how many rows each layer has";

/// The site that is exported: the one asked for, or the only one.
///
/// # Errors
/// A user fault that names the sites.
pub fn one_site<'n>(
    sites: impl IntoIterator<Item = &'n str>,
    asked: Option<&str>,
) -> Result<String, Fault> {
    let sites: BTreeSet<&str> = sites.into_iter().collect();
    match asked {
        _ if sites.is_empty() => Err(nothing()),
        Some(asked) if sites.contains(asked) => Ok(asked.to_owned()),
        // By HTTP too, which has no options.
        Some(asked) => {
            let sites: Vec<&str> = sites.into_iter().collect();
            let fault = Fault::user(format!("no site {asked:?} in this map"));
            Err(fault.next(format!("its sites: {}", sites.join(", "))))
        }
        None if sites.len() == 1 => Ok(sites.into_iter().collect()),
        None => Err(choose("frames differ from site to site", "site", &sites)),
    }
}

/// That there is no more than one session.
///
/// # Errors
/// A user fault that names the sessions.
pub fn one_session<'n>(sessions: impl IntoIterator<Item = &'n str>) -> Result<(), Fault> {
    let sessions: BTreeSet<&str> = sessions.into_iter().collect();
    match sessions.len() {
        0 | 1 => Ok(()),
        _ => Err(choose(
            "a trajectory is of one session",
            "session",
            &sessions,
        )),
    }
}

fn choose(why: impl Into<String>, option: &str, names: &BTreeSet<&str>) -> Fault {
    let names: Vec<&str> = names.iter().copied().collect();
    Fault::user(why).next(format!("choose one with --{option}: {}", names.join(", ")))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use evermap_schemas::layers::VehiclePose;
    use evermap_schemas::{Pose, Stamp, batch};

    fn poses(sites: &[&str]) -> RecordBatch {
        let row = |site: &&str| VehiclePose {
            site: (*site).to_owned(),
            session: "a".into(),
            stamp: Stamp(0),
            map_from_vehicle: Pose::IDENTITY,
        };
        batch(sites.iter().map(row).collect::<Vec<_>>()).unwrap()
    }

    #[test]
    fn rows_of_one_site_are_left() {
        let kept = only(&[poses(&["a", "b", "a"]), poses(&[])], "site", "a").unwrap();
        assert_eq!(typed::<VehiclePose>(&kept).unwrap().len(), 2);
        let fault = only(&[poses(&["a"])], "planet", "a").unwrap_err();
        assert!(fault.to_string().contains("no column planet"), "{fault}");
    }

    #[test]
    fn the_site_is_the_one_asked_for_or_the_only_one() {
        assert_eq!(one_site(["b", "a"], Some("a")).unwrap(), "a");
        assert_eq!(one_site(["a", "a"], None).unwrap(), "a");
        for (asked, said) in [
            (None, "--site: a, b"),
            (Some("c"), "no site \"c\" in this map; its sites: a, b"),
        ] {
            let fault = one_site(["a", "b"], asked).unwrap_err();
            assert!(fault.to_string().contains(said), "{fault}");
        }
        assert!(one_site([], None).is_err());
    }
}
