#![doc = include_str!("relocations.md")]

use evermap_algorithms::semantic_map::relocation::{ClassIndex, Hit, Options, ViewMap};
use evermap_algorithms::semantic_map::semantic_graph::{Graph, VOID};
use evermap_contract::{Fault, Operator, Port, Reason, Sides, Work};
use evermap_schemas::layers::{Relocation, View};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::inputs::graphs::ClassNames;

/// See the module's page.
pub struct Relocations;

/// What is looked for, and how views are compared.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct RelocationsParams {
    /// Views of the map that are given for each query, at most.
    pub top: u32,
    /// Classes that are left out, such as cars, which drive away.
    pub ignore: Vec<String>,
    /// Whether only the views are compared that are most alike in the number of areas of each class.
    pub use_index: bool,
    /// Views that are compared then. More where leaves of the index hold more.
    pub index_views: u32,
    /// Whether views may be found in their own session.
    pub own_session: bool,
    /// How two views are compared.
    #[serde(flatten)]
    pub options: Options,
}

impl Default for RelocationsParams {
    fn default() -> Self {
        Self {
            top: 3,
            ignore: Vec::new(),
            use_index: false,
            index_views: 8,
            own_session: false,
            options: Options::default(),
        }
    }
}

impl Operator for Relocations {
    const NAME: &'static str = "relocations";
    const VERSION: u32 = 3;
    const PAGE: &'static str = include_str!("relocations.md");
    type Params = RelocationsParams;
    type Output = Relocation;

    fn work() -> Work<Self::Params> {
        let views = Port::session::<View>("views");
        let map = Port::site::<View>("map");
        Work::each_row(views, vec![map], Place::new, Place::relocations)
    }
}

/// The map of a site.
struct Place {
    params: RelocationsParams,
    classes: ClassNames,
    /// What the views are called; in the order of the map.
    views: Vec<View>,
    map: ViewMap,
    index: Option<ClassIndex>,
}

impl Place {
    /// Views without a graph are as good as absent: `views` has none.
    fn new(params: &RelocationsParams, sides: &Sides) -> Result<Self, Fault> {
        let mut params = params.clone();
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
        let ignored = params.ignore.iter();
        params.options.ignored = ignored.filter_map(|name| classes.number(name)).collect();
        let map = ViewMap::new(graphs.iter(), params.options.clone());
        let index = params.use_index.then(|| {
            graphs
                .iter_mut()
                .for_each(|graph| forget(graph, &params.options.ignored));
            ClassIndex::new(graphs.iter(), classes.len())
        });
        Ok(Self {
            params,
            classes,
            views,
            map,
            index,
        })
    }

    fn hits(&self, query: &View) -> Result<Vec<Hit>, Reason> {
        let params = &self.params;
        let graph = self.classes.graph(&query.graph)?;
        let asked = self.map.query(&graph);
        if asked.areas() == 0 {
            return Err("query shows no area that could be found");
        }
        let allowed =
            |view: u32| params.own_session || self.views[view as usize].session != query.session;
        let top = params.top as usize;
        let Some(index) = &self.index else {
            return Ok(self.map.search(&asked, top, allowed));
        };
        let mut counted = graph;
        forget(&mut counted, &params.options.ignored);
        let counts: Vec<u16> = (0..self.classes.len())
            .map(|class| counted.count(class).min(usize::from(u16::MAX)) as u16)
            .collect();
        let near = index.near(
            &counts,
            params.index_views.max(params.top) as usize,
            allowed,
        );
        Ok(self.map.among(&asked, &near, top))
    }

    fn relocations(&self, query: View) -> Result<Vec<Relocation>, Reason> {
        if self.views.is_empty() {
            return Ok(Vec::new());
        }
        let hits = self.hits(&query)?;
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
