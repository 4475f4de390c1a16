//! What there is to show of a semantic map: views with their labels and graphs, and how much queries look like them.

use std::collections::{BTreeMap, BTreeSet};

use evermap_datasets::ImageReader;
use evermap_engine::map::Map;
use evermap_engine::quoted;
use evermap_engine::sql::{Limits, context};
use evermap_schemas::layers::{LabelImage, Relocation, SemanticGraph, View};
use evermap_schemas::{Cell, Fault, ImageRef, Stamp};

use crate::reader::{MapReader, answered, typed};

/// Views that a picture shows.
const VIEWS: usize = 3;

/// One view.
#[derive(Debug, Clone, PartialEq)]
pub struct PicturedView {
    /// The view's name.
    pub view: String,
    /// The encoded image; `None` where its log is gone.
    pub image: Option<Vec<u8>>,
    /// Its labels; `None` where the map has none.
    pub labels: Option<LabelImage>,
    /// Its graph.
    pub graph: SemanticGraph,
}

/// How much each query looks like each view of the map.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Similarities {
    /// Queries, along x, by session, stamp and camera.
    pub queries: usize,
    /// Views of the map, along y, in the same order.
    pub views: usize,
    /// From 0 to 1, view after view; 0 where no relocation was kept.
    pub values: Vec<f64>,
    /// Sessions of the queries.
    pub query_sessions: String,
    /// Sessions of the views of the map.
    pub view_sessions: String,
}

/// The semantic map of one site.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct SemanticMap {
    /// Some views, spread over the map.
    pub views: Vec<PicturedView>,
    /// All classes of those views' graphs, and what colours count by.
    pub classes: Vec<String>,
}

/// Some views of a site; `None` where the map has no views of it.
///
/// # Errors
/// As [`MapReader::rows`].
pub async fn semantic_map(reader: &MapReader, site: &str) -> Result<Option<SemanticMap>, Fault> {
    let mut views: Vec<View> = reader.rows(Some(site)).await?;
    if views.is_empty() {
        return Ok(None);
    }
    views.sort_by(|a, b| (&a.session, a.stamp, &a.camera).cmp(&(&b.session, b.stamp, &b.camera)));
    let mut found = SemanticMap::default();
    for view in spread(views, VIEWS) {
        found.views.push(PicturedView {
            image: image(&reader.map, &view).await,
            labels: labels(reader, &view).await?,
            view: view.view,
            graph: view.graph,
        });
    }
    found.classes = classes(&found.views);
    Ok(Some(found))
}

/// How much the queries of a relocation run look like views of a site; `None` where the map has no relocations in it.
///
/// # Errors
/// As [`MapReader::rows`].
pub async fn similarities(reader: &MapReader, site: &str) -> Result<Option<Similarities>, Fault> {
    Ok(matrix(&reader.rows(Some(site)).await?))
}

/// The label image of a view; `None` where the map has none.
async fn labels(reader: &MapReader, view: &View) -> Result<Option<LabelImage>, Fault> {
    let Some(layer) = reader.layer_of::<LabelImage>() else {
        return Ok(None);
    };
    let query = format!(
        "SELECT * FROM {} WHERE {}",
        quoted::name(&layer),
        of_view(view)
    );
    let found = typed(&reader.ask(&query).await?)?;
    Ok(found.into_iter().next())
}

/// The condition for the rows of a view.
fn of_view(view: &View) -> String {
    let [session, camera] = [&view.session, &view.camera].map(|name| quoted::text(name));
    let stamp = view.stamp.0;
    format!("session = {session} AND camera = {camera} AND CAST(stamp AS BIGINT) = {stamp}")
}

/// At most so many of a list, the same distance apart.
fn spread<T>(list: Vec<T>, most: usize) -> impl Iterator<Item = T> {
    let step = list.len().div_ceil(most.max(1)).max(1);
    list.into_iter().skip(step / 2).step_by(step)
}

/// Classes in the order of the label images, then those that only graphs name.
fn classes(views: &[PicturedView]) -> Vec<String> {
    let listed = views.iter().filter_map(|view| view.labels.as_ref());
    let mut classes: Vec<String> = listed
        .max_by_key(|labels| labels.classes.len())
        .map(|labels| labels.classes.clone())
        .unwrap_or_default();
    let areas = views.iter().flat_map(|view| &view.graph.areas);
    let named: BTreeSet<&String> = areas.map(|area| &area.class).collect();
    for class in named {
        if !classes.contains(class) {
            classes.push(class.clone());
        }
    }
    classes
}

fn matrix(rows: &[Relocation]) -> Option<Similarities> {
    let query = |row: &Relocation| (row.session.clone(), row.stamp, row.camera.clone());
    let view = |row: &Relocation| {
        (
            row.map_session.clone(),
            row.map_stamp,
            row.map_camera.clone(),
        )
    };
    let queries = numbered(rows.iter().map(query));
    let views = numbered(rows.iter().map(view));
    if rows.is_empty() {
        return None;
    }
    let mut values = vec![0.0; queries.len() * views.len()];
    for row in rows {
        values[views[&view(row)] * queries.len() + queries[&query(row)]] = row.similarity;
    }
    Some(Similarities {
        queries: queries.len(),
        views: views.len(),
        values,
        query_sessions: sessions(&queries),
        view_sessions: sessions(&views),
    })
}

/// The names of the sessions, as a person lists them.
fn sessions(numbered: &BTreeMap<ViewKey, usize>) -> String {
    let names: BTreeSet<&str> = numbered
        .keys()
        .map(|(session, ..)| session.as_str())
        .collect();
    names.into_iter().collect::<Vec<_>>().join(", ")
}

/// Session, stamp and camera.
type ViewKey = (String, Stamp, String);

fn numbered(names: impl Iterator<Item = ViewKey>) -> BTreeMap<ViewKey, usize> {
    let names: BTreeSet<ViewKey> = names.collect();
    names.into_iter().zip(0..).collect()
}

/// The view's image from its log, if that is still where it was.
async fn image(map: &Map, view: &View) -> Option<Vec<u8>> {
    match fetched(map, view).await {
        Ok(image) => image,
        Err(fault) => {
            tracing::info!(%fault, view = view.view, "drawn without its image");
            None
        }
    }
}

async fn fetched(map: &Map, view: &View) -> Result<Option<Vec<u8>>, Fault> {
    let context = context(Limits::default())?;
    let Some(dataset) = map.log(&view.session, &context.runtime_env()).await? else {
        return Ok(None);
    };
    dataset.register(&context)?;
    let query = format!("SELECT image FROM frames WHERE {}", of_view(view));
    let batches = answered(&context, &query).await?;
    let Some(batch) = batches.iter().find(|batch| batch.num_rows() > 0) else {
        return Ok(None);
    };
    let images = ImageRef::decode(batch.column(0))?;
    let reader = ImageReader::new(&dataset, ImageReader::CACHE_BYTES);
    let mut bytes = reader.resolve(&images[..1]).await?;
    Ok(bytes.pop().transpose()?.map(|bytes| bytes.to_vec()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn relocation(stamp: i64, map_stamp: i64, similarity: f64) -> Relocation {
        Relocation {
            site: "s".into(),
            session: "b".into(),
            stamp: Stamp(stamp),
            camera: "c".into(),
            view: format!("b/c/{stamp}"),
            rank: 0,
            map_session: "a".into(),
            map_stamp: Stamp(map_stamp),
            map_camera: "c".into(),
            map_view: format!("a/c/{map_stamp}"),
            score: similarity,
            similarity,
            yaw_rad: None,
            certainty: None,
        }
    }

    #[test]
    fn similarities_lie_by_view_and_query() {
        let rows = [relocation(2, 7, 0.5), relocation(1, 9, 0.25)];
        let found = matrix(&rows).unwrap_or_default();
        assert_eq!((found.queries, found.views), (2, 2));
        assert_eq!((&*found.query_sessions, &*found.view_sessions), ("b", "a"));
        assert_eq!(found.values, [0.0, 0.5, 0.25, 0.0]);
        assert_eq!(matrix(&[]), None);
    }

    #[test]
    fn a_few_are_spread_over_all() {
        assert_eq!(spread((0..9).collect(), 3).collect::<Vec<_>>(), [1, 4, 7]);
        assert_eq!(spread(vec![5], 3).collect::<Vec<_>>(), [5]);
    }
}
