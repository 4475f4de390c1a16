//! Tables of a report: each is the answer to a query that the page shows, so that it can be asked again, and asked more.

use arrow::array::RecordBatch;
use arrow::util::display::{ArrayFormatter, FormatOptions};
use evermap_schemas::Fault;

use crate::reader::MapReader;

/// What is asked: the layers that it needs, what it is about, the query.
pub type Question = (&'static [&'static str], &'static str, &'static str);

/// What a person who doubts a metric map asks.
pub const OF_METRIC_MAPS: [Question; 6] = [
    (
        &["adjusted_poses"],
        "Residuals",
        include_str!("queries/residuals.sql"),
    ),
    (
        &["adjusted_poses"],
        "Landmarks in view",
        include_str!("queries/inliers.sql"),
    ),
    (
        &["adjusted_poses", "frame_poses"],
        "What holds the map up",
        include_str!("queries/holding.sql"),
    ),
    (
        &["graph_poses"],
        "Loop closures",
        include_str!("queries/loops.sql"),
    ),
    (
        &["localisations"],
        "Localisation",
        include_str!("queries/localisations.sql"),
    ),
    (
        &["landmarks"],
        "Landmarks",
        include_str!("queries/landmarks.sql"),
    ),
];

/// What a person who doubts a semantic map asks.
pub const OF_SEMANTIC_MAPS: [Question; 3] = [
    (
        &["views"],
        "What the views show",
        include_str!("queries/content.sql"),
    ),
    (
        &["relations"],
        "How classes relate",
        include_str!("queries/relations.sql"),
    ),
    (
        &["relocations"],
        "Relocation",
        include_str!("queries/relocations.sql"),
    ),
];

/// What a person who doubts a stable map asks.
pub const OF_STABLE_MAPS: [Question; 3] = [
    (
        &["warped_labels"],
        "Seen behind what moves",
        include_str!("queries/seen_behind.sql"),
    ),
    (
        &["occlusion_model"],
        "What hides behind what moves",
        include_str!("queries/occlusions.sql"),
    ),
    (
        &["inferred_labels"],
        "Inferred areas",
        include_str!("queries/inferred.sql"),
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

impl Answer {
    /// The cells of a row, and whether they are numbers.
    pub fn cells<'r>(&self, row: &'r [String]) -> impl Iterator<Item = (&'r String, bool)> {
        let numeric = self.columns.iter().map(|(_, numeric)| *numeric);
        row.iter().zip(numeric)
    }
}

/// The answers to those questions whose layers the map has, and that have any rows.
///
/// # Errors
/// As [`MapReader::ask`].
pub async fn answers(reader: &MapReader, questions: &[Question]) -> Result<Vec<Answer>, Fault> {
    let map = &reader.map;
    let mut answers = Vec::new();
    for &(layers, title, query) in questions {
        // Nothing comes before the first version: there, everything is lost.
        let first = layers == ["localisations"] && map.version.previous.version == 0;
        if first || !layers.iter().all(|layer| map.has(layer)) {
            continue;
        }
        let batches = reader
            .ask(query)
            .await
            .map_err(|fault| fault.at(format!("report: {title}")))?;
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
