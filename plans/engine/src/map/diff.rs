//! What changed between two versions: row by row, as the table function `diff`, and added up.
//!
//! Rows are matched by the key of their layer. Of rows that are in both, a geometry or else a pose says how far they
//! moved. One query does it, so that layers larger than memory are compared from disk.

mod function;
mod row_digest;
mod shared;

use std::collections::BTreeSet;
use std::sync::Arc;

use arrow::datatypes::{DataType, Field, Schema};
use datafusion::catalog::{SchemaProvider, TableProvider};
use datafusion::datasource::empty::EmptyTable;
use datafusion::logical_expr::ScalarUDF;
use datafusion::prelude::{DataFrame, SessionContext};
use evermap_contract::Registry;
use evermap_schemas::{Cell, Fault, Layer, LayerRow, Pose, geoparquet, record, rows};

use crate::conform::conform;
use crate::error::OrFault;
use crate::map::Map;
use crate::map::diff::row_digest::RowDigest;
use crate::map::diff::shared::Unshared;
use crate::map::tables::Tables;
use crate::quoted;
use crate::sql::beside;

pub use function::{DiffFunction, documentation};

record! {
    /// What became of one layer between two versions.
    #[derive(Default)]
    #[layer("changes", key(layer))]
    pub struct LayerDiff {
        /// Layer.
        layer: String,
        /// Rows whose key is new.
        added: u64,
        /// Rows whose key is gone.
        removed: u64,
        /// Rows whose key is in both, with other content.
        changed: u64,
        /// Rows that are the same.
        same: u64,
        /// How far changed rows moved, the median; null where none has, or where they have neither geometry nor pose.
        median_moved_m: Option<f64> ["m"],
        /// How far changed rows moved at most; null as above.
        max_moved_m: Option<f64> ["m"],
        /// How far the poses of changed rows turned at most; null where there are none.
        max_moved_rad: Option<f64> ["rad"],
    }
}

/// Two versions of a map beside each other.
pub struct Comparison {
    before: Tables,
    after: Tables,
    context: SessionContext,
}

impl Comparison {
    /// Of versions of a map, read with the settings and limits of a context.
    ///
    /// # Errors
    /// A user fault that names the versions there are.
    pub async fn open(
        map: &Map,
        [before, after]: [u64; 2],
        registry: &Registry,
        reading: &SessionContext,
    ) -> Result<Self, Fault> {
        let context = beside(reading);
        context.register_object_store(map.store.url(), map.store.objects());
        evermap_functions::register(&context);
        context.register_udf(ScalarUDF::from(RowDigest::default()));
        let before = Map::at(map.store.clone(), Some(before)).await?;
        let after = Map::at(map.store.clone(), Some(after)).await?;
        Ok(Self {
            before: Tables::new(before, &context, registry),
            after: Tables::new(after, &context, registry),
            context,
        })
    }

    /// The layers of either version, ascending.
    pub fn layers(&self) -> BTreeSet<String> {
        let both = [&self.before, &self.after].into_iter();
        let published = both.flat_map(|tables| tables.map.version.published());
        published.map(|(name, _)| name.clone()).collect()
    }

    /// The rows of a layer in either version: their key, all columns where the layer has none; `change`: `added`,
    /// `removed`, `changed` or `same`; `moved_m` and `moved_rad`, null where a row is in one version only or has nothing
    /// that tells it; of rows that have a geometry or a pose, `geometry`: where they are, or were, and `geometry_before`:
    /// where they were before, null where they are new. Columns of the layer that have one of these names give way.
    ///
    /// # Errors
    /// A user fault for a layer that neither version has; what reading says.
    pub async fn rows(&self, layer: &str) -> Result<DataFrame, Fault> {
        let (before, after) = (self.before.table(layer), self.after.table(layer));
        let sides = [before.await.or_fault()?, after.await.or_fault()?];
        self.compared(layer, sides).await
    }

    /// As [`Comparison::rows`], of these rows of either version.
    async fn compared(
        &self,
        layer: &str,
        sides: [Option<Arc<dyn TableProvider>>; 2],
    ) -> Result<DataFrame, Fault> {
        let [before, after] = &sides;
        let Some(one) = after.as_ref().or(before.as_ref()) else {
            let known: Vec<_> = self.layers().into_iter().collect();
            let known = known.join(", ");
            return Err(Fault::user(format!("no layer {layer} in either version"))
                .next(format!("there are {known}")));
        };
        let schemas = [before, after].map(|side| side.as_ref().unwrap_or(one).schema());
        let declared = self.declaration(layer);
        let columns = ComparedColumns::of(declared.as_ref(), [&schemas[0], &schemas[1]]);
        let sides = [("before", before), ("after", after)];
        for ((name, table), schema) in sides.into_iter().zip(&schemas) {
            let empty = || EmptyTable::new(schema.clone());
            let table = table.clone().unwrap_or_else(|| Arc::new(empty()));
            self.context.deregister_table(name).or_fault()?;
            self.context.register_table(name, table).or_fault()?;
        }
        self.context.sql(&columns.query(&schemas)).await.or_fault()
    }

    /// The declaration of a layer's columns, where either version knows one.
    fn declaration(&self, layer: &str) -> Option<Layer> {
        let after = self.after.declaration(layer);
        after.or_else(|| self.before.declaration(layer))
    }

    /// As [`Comparison::rows`], without the rows of files that need not be read, as both versions have them, and how many
    /// those are; `None` where no file need be read.
    async fn unshared(&self, layer: &str) -> Result<(Option<DataFrame>, u64), Fault> {
        let stored = [&self.before, &self.after].map(|tables| tables.map.published(layer));
        let [Some(before), Some(after)] = stored else {
            return Ok((Some(self.rows(layer).await?), 0));
        };
        let declared = self.declaration(layer);
        let key = declared.as_ref().map_or(&[][..], |layer| layer.key);
        let unshared = Unshared::of([&before.artifacts, &after.artifacts], key);
        let [before, after] = &unshared.sides;
        let before = self.before.rows_of(layer, before).await?;
        let sides = [before, self.after.rows_of(layer, after).await?];
        let rows = match sides.iter().any(Option::is_some) {
            true => Some(self.compared(layer, sides).await?),
            false => None,
        };
        Ok((rows, unshared.same))
    }

    /// What became of a layer. Files that both versions have are not read where their rows can match no others.
    ///
    /// # Errors
    /// As [`Comparison::rows`].
    pub async fn summary(&self, layer: &str) -> Result<LayerDiff, Fault> {
        let (rows_of_layer, same) = self.unshared(layer).await?;
        let Some(rows_of_layer) = rows_of_layer else {
            return Ok(LayerDiff {
                layer: layer.to_owned(),
                same,
                ..LayerDiff::default()
            });
        };
        let rows_of_layer = rows_of_layer.into_view();
        self.context.deregister_table("rows").or_fault()?;
        self.context
            .register_table("rows", rows_of_layer)
            .or_fault()?;
        let query = format!(
            "SELECT {} AS layer,
                    count(*) FILTER (WHERE change = 'added') AS added,
                    count(*) FILTER (WHERE change = 'removed') AS removed,
                    count(*) FILTER (WHERE change = 'changed') AS changed,
                    count(*) FILTER (WHERE change = 'same') AS same,
                    median(moved_m) FILTER (WHERE change = 'changed') AS median_moved_m,
                    max(moved_m) FILTER (WHERE change = 'changed') AS max_moved_m,
                    max(moved_rad) FILTER (WHERE change = 'changed') AS max_moved_rad
             FROM rows",
            quoted::text(layer)
        );
        let found = self.context.sql(&query).await.or_fault()?;
        let found = found.collect().await.or_fault()?;
        let mut found = found.iter().flat_map(|batch| {
            let batch = conform(batch, &LayerDiff::layer());
            batch.and_then(|batch| rows::<LayerDiff>(&batch))
        });
        let summary = found.next().and_then(|rows| rows.into_iter().next());
        let missing = || Fault::bug("a query without groups has no row");
        let mut summary = summary.ok_or_else(missing)?;
        summary.same += same;
        Ok(summary)
    }
}

/// Names of what is said of each row, and of those that are somewhere.
const SAID: [&str; 3] = ["change", "moved_m", "moved_rad"];
const PLACES: [&str; 2] = [geoparquet::COLUMN, "geometry_before"];

/// What two versions of a layer are compared by.
struct ComparedColumns {
    /// Columns that match rows; none where the whole row does.
    key: Vec<String>,
    /// A column of geometries.
    geometry: Option<String>,
    /// A column of poses, of those in the map's frame where there is one.
    pose: Option<String>,
}

impl ComparedColumns {
    /// By the layer's declaration, where there is one, and the columns of either version.
    fn of(declared: Option<&Layer>, schemas: [&Schema; 2]) -> Self {
        let both = |name: &str| schemas.iter().all(|schema| schema.index_of(name).is_ok());
        let key = declared.map_or(&[][..], |layer| layer.key);
        let key = key.iter().filter(|_| key.iter().all(|name| both(name)));
        let named = Some(geoparquet::COLUMN);
        let geometry = declared.map_or(named, |layer| layer.geometry);
        let is_bytes = |name: &str| {
            schemas.iter().all(|schema| {
                let field = schema.field_with_name(name);
                field.is_ok_and(|field| field.data_type() == &DataType::Binary)
            })
        };
        let frame = |name: &str| {
            let column = declared.and_then(|layer| layer.column(name));
            column.map(|column| column.frame)
        };
        let poses: Vec<_> = schemas[1]
            .fields()
            .iter()
            .filter(|field| is_pose(field) && both(field.name()))
            .map(|field| field.name().clone())
            .collect();
        let in_map = poses.iter().find(|name| frame(name) == Some("map"));
        Self {
            key: key.map(|name| (*name).to_owned()).collect(),
            geometry: geometry.filter(|name| is_bytes(name)).map(str::to_owned),
            pose: in_map.or(poses.first()).cloned(),
        }
    }

    fn query(&self, schemas: &[arrow::datatypes::SchemaRef; 2]) -> String {
        let shown = self.shown(&schemas[1]);
        let keys = || (0..shown.len()).map(|index| format!("k{index}"));
        let columns = shown.iter().zip(keys());
        let columns = columns
            .map(|(name, key)| format!("coalesce(b.{key}, a.{key}) AS {}", quoted::name(name)));
        let matched = match self.key.as_slice() {
            [] => vec!["b.content = a.content".to_owned()],
            _ => keys()
                .map(|key| format!("(b.{key} IS NOT DISTINCT FROM a.{key})"))
                .collect(),
        };
        let same = "CASE WHEN b.content = a.content THEN 0.0 ELSE";
        let moved_m = match (&self.geometry, &self.pose) {
            (Some(_), _) => {
                format!("{same} st_hausdorffdistance(b.shape, a.shape) END")
            }
            (None, Some(_)) => format!("{same} pose_distance(b.pose, a.pose) END"),
            (None, None) => "CAST(NULL AS DOUBLE)".to_owned(),
        };
        let moved_rad = match &self.pose {
            Some(_) => format!("{same} pose_angle(b.pose, a.pose) END"),
            None => "CAST(NULL AS DOUBLE)".to_owned(),
        };
        let shape = match self.shape() {
            Some(_) => {
                let [now, before] = PLACES;
                format!(", coalesce(a.shape, b.shape) AS {now}, b.shape AS {before}")
            }
            None => String::new(),
        };
        let columns = columns.map(|column| column + ", ").collect::<String>();
        format!(
            "SELECT {columns}CASE WHEN b.content IS NULL THEN 'added' WHEN a.content IS NULL THEN 'removed'
                    WHEN a.content = b.content THEN 'same' ELSE 'changed' END AS change,
                    {moved_m} AS moved_m, {moved_rad} AS moved_rad{shape}
             FROM ({}) b FULL JOIN ({}) a ON {} AND b.nth = a.nth",
            self.side("before", &schemas[0], &shown),
            self.side("after", &schemas[1], &shown),
            matched.join(" AND ")
        )
    }

    /// The columns that say which row it is: the key, or all but those whose names the comparison needs.
    fn shown(&self, schema: &Schema) -> Vec<String> {
        if !self.key.is_empty() {
            return self.key.clone();
        }
        let is_place = |name: &str| self.shape().is_some() && PLACES.contains(&name);
        let names = schema.fields().iter().map(|field| field.name());
        let shown = names.filter(|name| !SAID.contains(&name.as_str()) && !is_place(name.as_str()));
        shown.cloned().collect()
    }

    /// Where a row is: its geometry, else the point of its pose.
    fn shape(&self) -> Option<String> {
        let point = |pose: &String| {
            let [x, y, z] = ["x", "y", "z"].map(|axis| format!("{}['{axis}']", quoted::name(pose)));
            format!("st_point({x}, {y}, {z})")
        };
        let geometry = self.geometry.as_deref().map(quoted::name);
        geometry.or_else(|| self.pose.as_ref().map(point))
    }

    /// The columns of one version; `nth` tells rows of one key apart.
    fn side(&self, table: &str, schema: &Schema, shown: &[String]) -> String {
        let keys = shown.iter().enumerate().map(|(index, name)| {
            let column = match schema.index_of(name) {
                Ok(_) => quoted::name(name),
                Err(_) => "NULL".to_owned(),
            };
            format!("{column} AS k{index}")
        });
        let pose = self.pose.as_deref().map(quoted::name);
        let named = [("shape", self.shape()), ("pose", pose)];
        let named = named.into_iter();
        let named = named.filter_map(|(alias, value)| Some(format!("{} AS {alias}", value?)));
        let all = schema
            .fields()
            .iter()
            .map(|field| quoted::name(field.name()));
        let content = format!(
            "row_digest({}) AS content",
            all.collect::<Vec<_>>().join(", ")
        );
        let columns = keys.chain(named).chain([content]);
        let columns = columns.collect::<Vec<_>>().join(", ");
        let groups = match self.key.as_slice() {
            [] => "content".to_owned(),
            key => (0..key.len())
                .map(|index| format!("k{index}"))
                .collect::<Vec<_>>()
                .join(", "),
        };
        format!(
            "SELECT *, row_number() OVER (PARTITION BY {groups} ORDER BY content
                 ROWS BETWEEN UNBOUNDED PRECEDING AND CURRENT ROW) AS nth
             FROM (SELECT {columns} FROM {table})"
        )
    }
}

fn is_pose(field: &Field) -> bool {
    DataType::equals_datatype(field.data_type(), &Pose::data_type())
}

#[cfg(test)]
mod tests;
