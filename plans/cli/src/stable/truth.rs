//! What a view of a simulated street truly shows without what moves: `simulate street` writes that beside the log of each
//! visit, as label images of its panoramas and a table that names them, `panoramas.csv`.

use std::path::{Path, PathBuf};

use evermap_algorithms::semantic_map::semantic_graph::VOID;
use evermap_datasets::{read_bytes, read_text};
use evermap_engine::map::Map;
use evermap_engine::quoted;
use evermap_engine::sql::{Limits, context};
use evermap_schemas::Fault;
use evermap_schemas::roles::LabelClass;
use png::ColorType;

use crate::draw::decoded;
use crate::reader::{answered, typed};
use crate::shown::Shot;

/// The table of a visit's panoramas, in the folder of its log.
const TABLE: &str = "panoramas.csv";
/// Its column of stamps, ns.
const STAMP: &str = "stamp_ns";
/// Its column of paths to labels without what moves, from its folder.
const LABELS: &str = "static_labels";

/// The true class of each pixel, as an index into these classes, or [`VOID`]; `None` where no truth lies beside the log.
pub async fn of(map: &Map, shot: &Shot, classes: &[String]) -> Option<Vec<u8>> {
    match read(map, shot, classes).await {
        Ok(truth) => truth,
        Err(fault) => {
            tracing::info!(%fault, session = shot.session, stamp = shot.stamp.0, "drawn without the truth");
            None
        }
    }
}

async fn read(map: &Map, shot: &Shot, classes: &[String]) -> Result<Option<Vec<u8>>, Fault> {
    let context = context(Limits::default())?;
    let Some(log) = map.log(&shot.session, &context.runtime_env()).await? else {
        return Ok(None);
    };
    let mut parts = log.sessions.iter().flat_map(|session| &session.parts);
    let folder = parts.find_map(|part| Path::new(&part.url).parent());
    let Some(labels) = folder.and_then(|folder| beside(folder, shot.stamp.0)) else {
        return Ok(None);
    };
    log.register(&context)?;
    let query = format!(
        "SELECT * FROM label_classes WHERE session = {}",
        quoted::text(&shot.session)
    );
    let said: Vec<LabelClass> = typed(&answered(&context, &query).await?)?;
    let bytes = read_bytes(&labels).map_err(|error| Fault::resource(error.to_string()))?;
    let (_, _, values) = decoded(&bytes, ColorType::Grayscale)?;
    let indices = indices(&said, classes);
    let truth = values.iter().map(|value| indices[usize::from(*value)]);
    Ok(Some(truth.collect()))
}

/// The file of the true labels at a stamp (ns), if the folder is one of a simulated street. Logs on an object store have
/// none: a world is simulated on this machine.
fn beside(folder: &Path, stamp: i64) -> Option<PathBuf> {
    if !folder.is_absolute() {
        return None;
    }
    let table = read_text(&folder.join(TABLE)).ok()?;
    Some(folder.join(named(&table, stamp)?))
}

/// The path that the table names at a stamp.
fn named(table: &str, stamp: i64) -> Option<&str> {
    let mut lines = table.lines();
    let header = lines.next()?;
    let column = |name: &str| header.split(',').position(|column| column == name);
    let (at, path) = (column(STAMP)?, column(LABELS)?);
    let stamp = stamp.to_string();
    let line = lines.find(|line| line.split(',').nth(at) == Some(&*stamp))?;
    line.split(',').nth(path)
}

/// What each pixel value means, by name among these classes; in their order where the log does not say.
fn indices(said: &[LabelClass], classes: &[String]) -> [u8; 256] {
    let mut indices = [VOID; 256];
    if said.is_empty() {
        for (entry, index) in indices.iter_mut().zip(0..classes.len()) {
            *entry = index as u8;
        }
    }
    for row in said {
        let found = classes.iter().position(|class| *class == row.class);
        indices[usize::from(row.value)] = found.map_or(VOID, |index| index as u8);
    }
    indices
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_are_named_by_stamp() {
        let table = "index,stamp_ns,static_labels\n0,15,a/0.png\n1,7,a/1.png\n";
        assert_eq!(named(table, 7), Some("a/1.png"));
        assert_eq!(named(table, 1), None);
        assert_eq!(named("index,stamp_ns\n0,15\n", 15), None);
        assert_eq!(named("", 15), None);
    }

    #[test]
    fn values_mean_what_the_log_says() {
        let classes = ["sky", "road"].map(str::to_owned);
        let said = [(0, "road"), (4, "sky"), (5, "moon")].map(|(value, class)| LabelClass {
            site: "s".into(),
            session: "a".into(),
            value,
            class: class.into(),
        });
        let found = indices(&said, &classes);
        assert_eq!([found[0], found[4], found[5], found[1]], [1, 0, VOID, VOID]);
        let found = indices(&[], &classes);
        assert_eq!([found[0], found[1], found[2]], [0, 1, VOID]);
    }
}
