//! What a report says.

use std::collections::BTreeMap;

use evermap_contract::Registry;
use evermap_engine::map::{LayerInfo, Map, RunRow, VersionInfo, versions};
use evermap_engine::sql::Limits;
use evermap_engine::{conform::conform, error::fault_of};
use evermap_schemas::{Fault, LayerRow, rows};

use crate::draw::{Look, Picture, draw};
use crate::report::metric::{self, MetricFacts};
use crate::report::semantic::{self, SemanticFacts};
use crate::scene::{drives, scene};

/// Width of the picture in a report, pixels.
const WIDTH_PX: u32 = 1400;

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

/// What a report says.
#[derive(Debug, Clone)]
pub struct Facts {
    /// Version of the map.
    pub version: u64,
    /// Plan that made it.
    pub plan: String,
    /// When it was published, RFC 3339.
    pub published: String,
    /// The program that made it.
    pub evermap: String,
    /// The map, drawn; `None` where there is nothing to draw.
    pub picture: Option<Picture>,
    /// The metric map of the site that is drawn; `None` where there is none.
    pub metric: Option<MetricFacts>,
    /// The semantic map of that site; `None` where there is none.
    pub semantic: Option<SemanticFacts>,
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

/// Gathers what a report says.
///
/// # Errors
/// As [`Map::batches`], or a user fault for a site that is not in the map.
pub async fn gather(map: &Map, registry: &Registry, site: Option<&str>) -> Result<Facts, Fault> {
    let (scene, sites) = scene(map, registry, site).await?;
    let look = Look {
        width_px: WIDTH_PX,
        zoom: None,
    };
    let drawn = site
        .or(sites.first().map(String::as_str))
        .unwrap_or_default();
    let metric = metric::gather(map, registry, drawn, look).await?;
    let semantic = semantic::gather(map, registry, drawn).await?;
    let picture = match draw(&scene, look) {
        Ok(picture) => Some(picture),
        Err(fault) => {
            tracing::info!(%fault, "no picture");
            None
        }
    };
    let lengths: BTreeMap<String, f64> = drives(map, registry)
        .await?
        .into_iter()
        .map(|(_, drive)| (drive.session.clone(), drive.length_m()))
        .collect();
    let version = &map.version;
    let sessions = version.sessions.iter().map(|session| SessionFact {
        session: session.log.session.clone(),
        site: session.log.site.clone(),
        driven_m: lengths.get(&session.log.session).copied(),
        content: session.log.content.clone(),
    });
    Ok(Facts {
        version: version.version,
        plan: version.plan.clone(),
        published: version.published.clone(),
        evermap: version.evermap.clone(),
        picture,
        metric,
        semantic,
        sites,
        layers: map.layers(),
        sessions: sessions.collect(),
        units: units(map).await?,
        losses: version.losses.clone(),
        versions: versions(&map.store).await?,
    })
}

/// The units of the run that published the version: of its runs the one that computed most.
async fn units(map: &Map) -> Result<Vec<RunRow>, Fault> {
    let context = map.context(Limits::default()).await?;
    let query = format!("SELECT * FROM runs WHERE version = {}", map.version.version);
    let frame = context
        .sql(&query)
        .await
        .map_err(|error| fault_of(&error))?;
    let mut runs: BTreeMap<String, Vec<RunRow>> = BTreeMap::new();
    for batch in frame.collect().await.map_err(|error| fault_of(&error))? {
        for row in rows::<RunRow>(&conform(&batch, &RunRow::layer())?)? {
            runs.entry(row.run.clone()).or_default().push(row);
        }
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
