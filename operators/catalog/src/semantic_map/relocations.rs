#![doc = include_str!("relocations.md")]

use std::collections::BTreeMap;

use evermap_algorithms::learning::calibration::Calibration;
use evermap_algorithms::semantic_map::relocation::{
    ClassIndex, Hit, Query, ViewMap, are_apart, distinctness,
};
use evermap_algorithms::semantic_map::semantic_graph::{Graph, VOID};
use evermap_contract::{Fault, Operator, Port, Reason, Sides, Work};
use evermap_schemas::layers::{Relocation, RelocationCalibration, View};
use nalgebra::Vector3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::inputs::graphs::{ClassNames, Comparison, position};

/// See the module's page.
pub struct Relocations;

/// What is looked for, and how views are compared.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct RelocationsParams {
    /// Views of the map that are given for each query, at most.
    pub top: u32,
    /// Whether only the views are compared that are most alike in the number of areas of each class.
    pub use_index: bool,
    /// Views that are compared then. More where leaves of the index hold more.
    pub index_views: u32,
    /// Whether views may be found in their own session.
    pub own_session: bool,
    /// How two views are compared.
    #[serde(flatten)]
    pub comparison: Comparison,
}

impl Default for RelocationsParams {
    fn default() -> Self {
        Self {
            top: 3,
            use_index: false,
            index_views: 8,
            own_session: false,
            comparison: Comparison::default(),
        }
    }
}

impl Operator for Relocations {
    const NAME: &'static str = "relocations";
    const VERSION: u32 = 4;
    const PAGE: &'static str = include_str!("relocations.md");
    type Params = RelocationsParams;
    type Output = Relocation;

    fn work() -> Work<Self::Params> {
        let views = Port::session::<View>("views");
        let map = Port::site::<View>("map");
        let calibrations = Port::site::<RelocationCalibration>("calibrations").optional();
        Work::each_row(
            views,
            vec![map, calibrations],
            SiteMap::new,
            SiteMap::relocations,
        )
    }
}

/// The map of a site.
struct SiteMap {
    params: RelocationsParams,
    classes: ClassNames,
    /// What the views are called; in the order of the map.
    views: Vec<View>,
    map: ViewMap,
    index: Option<ClassIndex>,
    /// Where they were taken (m), each drive in its own frame.
    positions: Vec<Option<Vector3<f64>>>,
    /// What a hit is worth, by session and camera of the map.
    calibrations: BTreeMap<(String, String), Worth>,
    /// Numbers of the classes that are left out.
    ignored: Vec<u8>,
}

/// What a hit in a drive is worth.
struct Worth {
    within_m: f64,
    calibration: Calibration,
}

fn calibrations(rows: Vec<RelocationCalibration>) -> BTreeMap<(String, String), Worth> {
    let learnt = |row: RelocationCalibration| {
        let (middle, slope) = (row.middle?, row.slope?);
        let worth = Worth {
            within_m: row.within_m,
            calibration: Calibration { middle, slope },
        };
        Some(((row.session, row.camera), worth))
    };
    rows.into_iter().filter_map(learnt).collect()
}

impl SiteMap {
    /// Views without a graph are as good as absent: `views` has none.
    fn new(params: &RelocationsParams, sides: &Sides) -> Result<Self, Fault> {
        let mut views = sides.rows::<View>("map")?;
        views.sort_by(|a, b| a.view.cmp(&b.view));
        let classes = ClassNames::of(&views);
        let mut graphs: Vec<Graph> = Vec::with_capacity(views.len());
        views.retain(|view| {
            classes
                .graph(&view.graph)
                .map(|graph| graphs.push(graph))
                .is_ok()
        });
        let options = params.comparison.options(&classes);
        let ignored = options.ignored.clone();
        let map = ViewMap::new(graphs.iter(), options);
        let index = params.use_index.then(|| {
            graphs.iter_mut().for_each(|graph| forget(graph, &ignored));
            ClassIndex::new(graphs.iter(), classes.len())
        });
        Ok(Self {
            params: params.clone(),
            classes,
            positions: views.iter().map(position).collect(),
            calibrations: calibrations(sides.rows("calibrations")?),
            views,
            map,
            index,
            ignored,
        })
    }

    /// The best views of those that are allowed.
    fn best(
        &self,
        graph: &Graph,
        asked: &Query,
        top: usize,
        allowed: impl Fn(u32) -> bool,
    ) -> Vec<Hit> {
        let Some(index) = &self.index else {
            return self.map.search(asked, top, allowed);
        };
        let mut counted = graph.clone();
        forget(&mut counted, &self.ignored);
        let counts: Vec<u16> = (0..self.classes.len())
            .map(|class| counted.count(class).min(usize::from(u16::MAX)) as u16)
            .collect();
        let views = self.params.index_views.max(self.params.top) as usize;
        let near = index.near(&counts, views, allowed);
        self.map.among(asked, &near, top)
    }

    /// Probability that a hit is right, by how much better it is than the best view of its drive that shows another place.
    fn certainty(&self, graph: &Graph, asked: &Query, hit: &Hit) -> Option<f64> {
        let view = &self.views[hit.view as usize];
        let of_drive = |other: &View| view.session == other.session && view.camera == other.camera;
        let worth = self
            .calibrations
            .get(&(view.session.clone(), view.camera.clone()))?;
        let here = self.positions[hit.view as usize]?;
        let is_elsewhere = |other: u32| {
            let there = self.positions[other as usize];
            of_drive(&self.views[other as usize])
                && there.is_some_and(|there| are_apart(&here, &there, worth.within_m))
        };
        let views = 0..self.views.len() as u32;
        let best = |allowed: &dyn Fn(u32) -> bool| self.best(graph, asked, 1, allowed);
        let distinctness = distinctness(hit, views, is_elsewhere, best)?;
        Some(worth.calibration.probability(distinctness))
    }

    fn relocations(&self, query: View) -> Result<Vec<Relocation>, Reason> {
        if self.views.is_empty() {
            return Ok(Vec::new());
        }
        let graph = self.classes.graph(&query.graph)?;
        let asked = self.map.query(&graph);
        if asked.areas() == 0 {
            return Err("query shows no area that could be found".into());
        }
        let allowed = |view: u32| {
            self.params.own_session || self.views[view as usize].session != query.session
        };
        let hits = self.best(&graph, &asked, self.params.top as usize, allowed);
        let best = hits.first();
        let certainty = best.and_then(|best| self.certainty(&graph, &asked, best));
        let row = |(hit, rank): (&Hit, u32)| {
            let view = &self.views[hit.view as usize];
            Relocation {
                site: query.site.clone(),
                session: query.session.clone(),
                stamp: query.stamp,
                camera: query.camera.clone(),
                view: query.view.clone(),
                rank,
                map_session: view.session.clone(),
                map_stamp: view.stamp,
                map_camera: view.camera.clone(),
                map_view: view.view.clone(),
                score: hit.score,
                similarity: hit.similarity,
                yaw_rad: Some(0.0 - hit.turn_rad),
                certainty: certainty.filter(|_| rank == 0),
            }
        };
        Ok(hits.iter().zip(0..).map(row).collect())
    }
}

/// Areas of these classes become areas of no class.
fn forget(graph: &mut Graph, classes: &[u8]) {
    for area in &mut graph.areas {
        if classes.contains(&area.class) {
            area.class = VOID;
        }
    }
}
