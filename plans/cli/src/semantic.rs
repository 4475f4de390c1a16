//! What there is to show of a semantic map: views with their labels and graphs, and how much queries look like them.

use std::collections::{BTreeMap, BTreeSet};

use evermap_schemas::layers::{LabelImage, Relocation, SemanticGraph, View};
use evermap_schemas::{Fault, Stamp};

use crate::reader::MapReader;
use crate::shots::{image, row, spread};
use crate::shown::Shot;

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
    for view in spread(views) {
        let shot = Shot {
            site: view.site,
            session: view.session,
            stamp: view.stamp,
            camera: view.camera,
        };
        found.views.push(PicturedView {
            image: image(&reader.map, &shot).await,
            labels: row::<LabelImage>(reader, &shot).await?,
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
}
