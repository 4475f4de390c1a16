//! What a person who doubts a metric map wants to see: drift removed, residuals, loops, localisations, landmarks.

use evermap_contract::Registry;
use evermap_engine::map::Map;
use evermap_schemas::Fault;

use crate::draw::{Look, Picture, Scene, draw};
use crate::metric::{Drift, Metric, metric};
use crate::report::answers::{Answer, Question, answers};

/// The questions.
pub const QUESTIONS: [Question; 5] = [
    Question {
        layer: "adjusted_poses",
        title: "Residuals",
        query: include_str!("queries/residuals.sql"),
    },
    Question {
        layer: "adjusted_poses",
        title: "Landmarks in view",
        query: include_str!("queries/inliers.sql"),
    },
    Question {
        layer: "graph_poses",
        title: "Loop closures",
        query: include_str!("queries/loops.sql"),
    },
    Question {
        layer: "localisations",
        title: "Localisation",
        query: include_str!("queries/localisations.sql"),
    },
    Question {
        layer: "landmarks",
        title: "Landmarks",
        query: include_str!("queries/landmarks.sql"),
    },
];

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
        answers: answers(map, &QUESTIONS).await?,
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
