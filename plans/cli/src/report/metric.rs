//! What a person who doubts a metric map wants to see: drift removed, residuals, loops, localisations, landmarks. Each
//! table is the answer to a query that the page shows, so that it can be asked again, and asked more.

use arrow::array::RecordBatch;
use arrow::util::display::{ArrayFormatter, FormatOptions};
use evermap_contract::Registry;
use evermap_engine::error::fault_of;
use evermap_engine::map::Map;
use evermap_engine::sql::Limits;
use evermap_schemas::Fault;

use crate::draw::{Look, Picture, Scene, draw};
use crate::metric::{Drift, Metric, metric};

/// The questions: the layer that they need, a title, the query.
pub const QUESTIONS: [(&str, &str, &str); 5] = [
    (
        "adjusted_poses",
        "Residuals",
        include_str!("queries/residuals.sql"),
    ),
    (
        "adjusted_poses",
        "Landmarks in view",
        include_str!("queries/inliers.sql"),
    ),
    (
        "graph_poses",
        "Loop closures",
        include_str!("queries/loops.sql"),
    ),
    (
        "localisations",
        "Localisation",
        include_str!("queries/localisations.sql"),
    ),
    (
        "landmarks",
        "Landmarks",
        include_str!("queries/landmarks.sql"),
    ),
];

/// The answer to a question.
#[derive(Debug, Clone, PartialEq)]
pub struct Answer {
    /// What it is about.
    pub title: String,
    /// The query, with a comment that says what it shows.
    pub query: String,
    /// Names of the columns, and whether they hold numbers.
    pub columns: Vec<(String, bool)>,
    /// The rows as text.
    pub rows: Vec<Vec<String>>,
}

/// What a report says of the metric map.
#[derive(Debug, Clone)]
pub struct MetricFacts {
    /// Trajectories before and after, landmarks and loops from above.
    pub picture: Option<Picture>,
    /// How far the map moved the poses of each session.
    pub drifts: Vec<Drift>,
    /// The answers.
    pub answers: Vec<Answer>,
}

/// Gathers it; `None` where the map has no adjusted poses of the site.
///
/// # Errors
/// As [`Map::batches`].
pub async fn gather(
    map: &Map,
    registry: &Registry,
    site: &str,
    look: Look,
) -> Result<Option<MetricFacts>, Fault> {
    let Some(found) = metric(map, registry, site).await? else {
        return Ok(None);
    };
    let drifts = found.drifts.clone();
    Ok(Some(MetricFacts {
        picture: draw(&scene(found), look).ok(),
        drifts,
        answers: answers(map).await?,
    }))
}

/// The scene of a metric map.
pub fn scene(metric: Metric) -> Scene {
    Scene {
        drives: metric.after,
        before: metric.before,
        landmarks: metric.landmarks,
        loops: metric.loops,
        ..Scene::default()
    }
}

async fn answers(map: &Map) -> Result<Vec<Answer>, Fault> {
    let context = map.context(Limits::default()).await?;
    let mut answers = Vec::new();
    for (layer, title, query) in QUESTIONS {
        // Nothing comes before the first version: there, everything is lost.
        let first = layer == "localisations" && map.version.previous.version == 0;
        if first || !map.has(layer) {
            continue;
        }
        let found = async { context.sql(query).await?.collect().await }.await;
        let batches = found.map_err(|error| fault_of(&error).at(format!("report: {title}")))?;
        if batches.iter().any(|batch| batch.num_rows() > 0) {
            answers.push(answer(title, query, &batches)?);
        }
    }
    Ok(answers)
}

fn answer(title: &str, query: &str, batches: &[RecordBatch]) -> Result<Answer, Fault> {
    let options = FormatOptions::default().with_null("");
    let mut answer = Answer {
        title: title.to_owned(),
        query: query.trim().to_owned(),
        columns: Vec::new(),
        rows: Vec::new(),
    };
    for batch in batches {
        let fields = batch.schema_ref().fields().iter();
        answer.columns = fields
            .map(|field| (field.name().clone(), field.data_type().is_numeric()))
            .collect();
        let columns = batch
            .columns()
            .iter()
            .map(|column| ArrayFormatter::try_new(column, &options))
            .collect::<Result<Vec<_>, _>>()?;
        let rows = (0..batch.num_rows()).map(|row| {
            let cells = columns.iter().map(|column| column.value(row).to_string());
            cells.collect()
        });
        answer.rows.extend(rows);
    }
    Ok(answer)
}
