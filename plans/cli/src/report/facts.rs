//! What a report says. As text it is the page: HTML with its style and pictures inside, nothing is fetched from elsewhere.
//! A link leads to the served page.

use std::collections::BTreeMap;

use askama::Template;
use evermap_engine::map::{LayerInfo, RunRow, VersionInfo, versions};
use evermap_schemas::Fault;

use crate::arguments::HTTP;
use crate::draw::{Canvas, Picture, draw, matrix, stable, views};
use crate::metric::{Drift, metric_map};
use crate::quantity;
use crate::reader::{MapReader, typed};
use crate::report::answers::{Answer, OF_METRIC_MAPS, OF_SEMANTIC_MAPS, OF_STABLE_MAPS, answers};
use crate::scene::{drawn, scene, trajectories};
use crate::semantic::{semantic_map, similarities};
use crate::stable::stable_map;

/// Width of the picture in a report, pixels.
const WIDTH_PX: u32 = 1400;
/// Width of the matrix of similarities, at most, pixels.
const MATRIX_PX: u32 = 700;
/// Units that are shown before the rest is folded away.
const SHOWN_UNITS: usize = 15;
/// Length of the bar of the slowest unit, pixels.
const LONGEST_BAR_PX: f64 = 120.0;

/// What a report says.
#[derive(Debug, Clone, Template)]
#[template(path = "report.html")]
pub struct Facts {
    /// Version of the map.
    pub version: u64,
    /// Plan that made it.
    pub plan: String,
    /// When it was published, RFC 3339.
    pub published: String,
    /// The program that made it.
    pub evermap: String,
    /// The map, drawn; or why there is nothing to draw.
    pub picture: Result<Picture, String>,
    /// The metric map of the site that is drawn; `None` where there is none.
    pub metric: Option<MetricFacts>,
    /// The semantic map of that site; `None` where there is none.
    pub semantic: Option<SemanticFacts>,
    /// The stable map of that site; `None` where there is none.
    pub stable: Option<StableFacts>,
    /// The site that is drawn.
    pub site: String,
    /// Sites of the map.
    pub sites: Vec<String>,
    /// Layers.
    pub layers: Vec<LayerInfo>,
    /// Sessions.
    pub sessions: Vec<SessionFact>,
    /// Units of the run that published the version, slowest first.
    pub units: Vec<RunRow>,
    /// What was skipped or lost, by reason.
    pub losses: BTreeMap<String, u64>,
    /// All versions of the map.
    pub versions: Vec<VersionInfo>,
}

/// A session of the map.
#[derive(Debug, Clone, PartialEq)]
pub struct SessionFact {
    /// Its name.
    pub session: String,
    /// Its site.
    pub site: String,
    /// Length of its trajectory, m; null where the map has no poses of it.
    pub driven_m: Option<f64>,
    /// Digest of its log.
    pub content: String,
}

/// What a person who doubts the poses wants to see: drift removed, residuals, loops, localisations, landmarks.
#[derive(Debug, Clone)]
pub struct MetricFacts {
    /// Trajectories before and after, landmarks and loops from above.
    pub picture: Option<Picture>,
    /// How far the map moved the poses of each session.
    pub drifts: Vec<Drift>,
    /// The answers.
    pub answers: Vec<Answer>,
}

/// What a person who doubts the places wants to see: labels over images, graphs, and the matrix of relocation.
#[derive(Debug, Clone)]
pub struct SemanticFacts {
    /// Labels over images, graphs over images.
    pub views: Option<Picture>,
    /// Similarity of each query with each view of the map.
    pub matrix: Option<Picture>,
    /// The answers.
    pub answers: Vec<Answer>,
}

/// What a person who doubts a stable map wants to see: what was put in the place of what moves, and how surely.
#[derive(Debug, Clone)]
pub struct StableFacts {
    /// Labels before, warped, inferred and stable, beside images.
    pub picture: Option<Picture>,
    /// Whether the truth of a simulated street is beside them.
    pub is_compared: bool,
    /// The answers.
    pub answers: Vec<Answer>,
}

impl Facts {
    fn driven_m(&self) -> f64 {
        let driven = self.sessions.iter().filter_map(|session| session.driven_m);
        // The sum of no numbers is -0.
        driven.fold(0.0, std::ops::Add::add)
    }

    fn bytes(&self) -> u64 {
        self.layers.iter().map(|layer| layer.bytes).sum()
    }

    fn lost(&self) -> u64 {
        self.losses.values().sum()
    }

    fn computed(&self) -> impl Iterator<Item = &RunRow> {
        self.units.iter().filter(|unit| !unit.cached)
    }

    fn seconds(&self) -> f64 {
        self.computed().map(|unit| unit.seconds).sum()
    }

    fn first_units(&self) -> &[RunRow] {
        &self.units[..self.units.len().min(SHOWN_UNITS)]
    }

    fn other_units(&self) -> &[RunRow] {
        &self.units[self.first_units().len()..]
    }

    fn more(&self) -> String {
        quantity::of(self.other_units().len() as u64, "more unit")
    }

    fn scope<'u>(&self, unit: &'u RunRow) -> &'u str {
        let named = unit.session.as_ref().or(unit.site.as_ref());
        named.map_or("the map", String::as_str)
    }

    fn bar_px(&self, unit: &RunRow) -> f64 {
        let longest = self.computed().map(|unit| unit.seconds);
        LONGEST_BAR_PX * unit.seconds / longest.fold(1e-9, f64::max)
    }
}

/// Why there is no picture, as a part of a sentence.
fn why(fault: Fault) -> String {
    match fault.next.as_str() {
        "" => fault.message,
        next => format!("{}; {next}", fault.message),
    }
}

/// Gathers what a report says.
///
/// # Errors
/// As [`MapReader::rows`], or a user fault for a site that is not in the map.
pub async fn gather(reader: &MapReader, site: Option<&str>) -> Result<Facts, Fault> {
    let (scene, sites) = scene(reader, site).await?;
    let canvas = Canvas {
        width_px: WIDTH_PX,
        zoom: None,
    };
    let site = site.or(sites.first().map(String::as_str));
    let site = site.unwrap_or_default();
    let layers = reader.map.layers();
    let picture = drawn(reader, &scene, canvas).map_err(why);
    let version = &reader.map.version;
    Ok(Facts {
        version: version.version,
        plan: version.plan.clone(),
        published: version.published.clone(),
        evermap: version.evermap.clone(),
        picture,
        metric: metric_facts(reader, site, canvas).await?,
        semantic: semantic_facts(reader, site).await?,
        stable: stable_facts(reader, site).await?,
        layers,
        sessions: sessions(reader).await?,
        units: units(reader).await?,
        losses: version.losses.clone(),
        versions: versions(&reader.map.store).await?,
        site: site.to_owned(),
        sites,
    })
}

async fn metric_facts(
    reader: &MapReader,
    site: &str,
    canvas: Canvas,
) -> Result<Option<MetricFacts>, Fault> {
    let Some(found) = metric_map(reader, site).await? else {
        return Ok(None);
    };
    Ok(Some(MetricFacts {
        picture: draw(&found.scene, canvas).ok(),
        drifts: found.drifts,
        answers: answers(reader, &OF_METRIC_MAPS).await?,
    }))
}

async fn semantic_facts(reader: &MapReader, site: &str) -> Result<Option<SemanticFacts>, Fault> {
    let Some(found) = semantic_map(reader, site).await? else {
        return Ok(None);
    };
    let similarities = similarities(reader, site).await?;
    Ok(Some(SemanticFacts {
        views: views(&found).ok(),
        matrix: similarities.and_then(|found| matrix(&found, MATRIX_PX).ok()),
        answers: answers(reader, &OF_SEMANTIC_MAPS).await?,
    }))
}

async fn stable_facts(reader: &MapReader, site: &str) -> Result<Option<StableFacts>, Fault> {
    let Some(found) = stable_map(reader, site).await? else {
        return Ok(None);
    };
    Ok(Some(StableFacts {
        picture: stable(&found, WIDTH_PX).ok(),
        is_compared: found.views.iter().any(|view| view.truth.is_some()),
        answers: answers(reader, &OF_STABLE_MAPS).await?,
    }))
}

async fn sessions(reader: &MapReader) -> Result<Vec<SessionFact>, Fault> {
    let driven = trajectories(reader).await?;
    let lengths: BTreeMap<&str, f64> = driven
        .iter()
        .map(|driven| (driven.session.as_str(), driven.length_m()))
        .collect();
    let mapped = reader.map.version.sessions.iter().map(|mapped| &mapped.log);
    let facts = mapped.map(|log| SessionFact {
        session: log.session.clone(),
        site: log.site.clone(),
        driven_m: lengths.get(log.session.as_str()).copied(),
        content: log.content.clone(),
    });
    Ok(facts.collect())
}

/// The units of the run that published the version: of its runs the one that computed most.
async fn units(reader: &MapReader) -> Result<Vec<RunRow>, Fault> {
    let version = reader.map.version.version;
    let query = format!("SELECT * FROM runs WHERE version = {version}");
    let mut runs: BTreeMap<String, Vec<RunRow>> = BTreeMap::new();
    for row in typed::<RunRow>(&reader.ask(&query).await?)? {
        runs.entry(row.run.clone()).or_default().push(row);
    }
    let computed = |units: &Vec<RunRow>| units.iter().filter(|unit| !unit.cached).count();
    let mut units = runs.into_values().max_by_key(computed).unwrap_or_default();
    units.sort_by(|a, b| {
        let name = |unit: &RunRow| (unit.step.clone(), unit.session.clone(), unit.site.clone());
        a.cached
            .cmp(&b.cached)
            .then(b.seconds.total_cmp(&a.seconds))
            .then_with(|| name(a).cmp(&name(b)))
    });
    Ok(units)
}
