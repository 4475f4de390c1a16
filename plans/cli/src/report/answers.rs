//! Tables of a report: each is the answer to a query that the page shows, so that it can be asked again, and asked more.

use arrow::array::RecordBatch;
use arrow::util::display::{ArrayFormatter, FormatOptions};
use evermap_engine::error::fault_of;
use evermap_engine::map::Map;
use evermap_engine::sql::Limits;
use evermap_schemas::Fault;

/// What is asked.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Question {
    /// The layer that it needs.
    pub layer: &'static str,
    /// What it is about.
    pub title: &'static str,
    /// The query.
    pub query: &'static str,
}

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

/// The answers to those questions whose layers the map has, and that have any rows.
///
/// # Errors
/// As [`Map::context`], or what a query says.
pub async fn answers(map: &Map, questions: &[Question]) -> Result<Vec<Answer>, Fault> {
    let context = map.context(Limits::default()).await?;
    let mut answers = Vec::new();
    for Question {
        layer,
        title,
        query,
    } in questions.iter().copied()
    {
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
