//! What a person who doubts a semantic map wants to see: labels over images, graphs, and the matrix of relocation.

use evermap_contract::Registry;
use evermap_engine::map::Map;
use evermap_schemas::Fault;

use crate::draw::{Picture, matrix, views};
use crate::report::answers::{Answer, Question, answers};
use crate::semantic::{semantic, similarities};

/// Views that are shown.
const VIEWS: usize = 3;
/// Width of the matrix, at most, px.
const MATRIX_PX: u32 = 700;

/// The questions.
pub const QUESTIONS: [Question; 3] = [
    Question {
        layer: "views",
        title: "What the views show",
        query: include_str!("queries/content.sql"),
    },
    Question {
        layer: "relations",
        title: "How classes relate",
        query: include_str!("queries/relations.sql"),
    },
    Question {
        layer: "relocations",
        title: "Relocation",
        query: include_str!("queries/relocations.sql"),
    },
];

/// What a report says of the semantic map.
#[derive(Debug, Clone)]
pub struct SemanticFacts {
    /// Labels over images, graphs over images.
    pub views: Option<Picture>,
    /// Similarity of each query with each view of the map.
    pub matrix: Option<Picture>,
    /// The answers.
    pub answers: Vec<Answer>,
}

/// Gathers it; `None` where the map has no views of the site.
///
/// # Errors
/// As [`Map::batches`].
pub async fn gather(
    map: &Map,
    registry: &Registry,
    site: &str,
) -> Result<Option<SemanticFacts>, Fault> {
    let Some(found) = semantic(map, registry, site, VIEWS).await? else {
        return Ok(None);
    };
    let similarities = similarities(map, registry, site).await?;
    Ok(Some(SemanticFacts {
        views: views(&found).ok(),
        matrix: similarities.and_then(|found| matrix(&found, MATRIX_PX).ok()),
        answers: answers(map, &QUESTIONS).await?,
    }))
}
