#![doc = include_str!("relocations.md")]

use std::collections::BTreeMap;
use std::f64::consts::{PI, TAU};

use arrow::array::RecordBatch;
use evermap_algorithms::semantic_map::relocation::{ClassIndex, Hit, Options, Scales, ViewMap};
use evermap_algorithms::semantic_map::semantic_graph::{Graph, VOID};
use evermap_contract::{Emit, Fault, Grain, Kernel, MapKernel, Mapper, Operator, Port, Sides};
use evermap_schemas::layers::{Relocation, View};
use evermap_schemas::rows;
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::inputs::graphs::ClassNames;
use crate::inputs::rig::Reason;

/// See the module's page.
pub struct Relocations;

/// How views are compared.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct RelocationsParams {
    /// Views of the map that are given for each query, at most.
    pub top: u32,
    /// Classes that are left out, such as cars.
    pub ignore: Vec<String>,
    /// Whether only the views are compared that are most alike in the number of areas of each class.
    pub use_index: bool,
    /// Views that are compared then.
    pub index_views: u32,
    /// Whether views may be found in their own session.
    pub own_session: bool,
    /// Headings that are tried, at equal steps of the full turn: 1 expects views to look the same way, 2 also the
    /// opposite one.
    pub headings: u32,
    /// Two areas may be the same while the sum of their differences, in scales, is below this.
    pub limit: f64,
    /// And while their bearings differ by no more than this (rad).
    pub max_bearing_rad: f64,
    /// Scale of differences of bearing (rad); 0 to leave it out.
    pub bearing_rad: f64,
    /// Scale of differences of elevation (rad); 0 to leave it out.
    pub elevation_rad: f64,
    /// Scale of differences of the logarithm of the size; 0 to leave it out.
    pub log_size: f64,
    /// Scale of differences of eccentricity; 0 to leave it out.
    pub eccentricity: f64,
    /// Scale of differences of orientation (rad); 0 to leave it out.
    pub orientation_rad: f64,
    /// The lengths of the boundaries of matched areas that touch differ by no more than this factor.
    pub boundary_factor: f64,
    /// Directions between matched areas differ by no more than so many eighths of a turn; 4 accepts any.
    pub direction_steps: u8,
    /// An area counts as much as its size to this power; 0 makes all equal.
    pub size_power: f64,
    /// Areas that cover less of the image than this share take no part.
    pub min_area_share: f64,
    /// Views with fewer matched areas are not given.
    pub min_matched: u32,
    /// Horizontal field of view of images that are no full panorama (rad).
    pub field_of_view_rad: f64,
}

impl Default for RelocationsParams {
    fn default() -> Self {
        let options = Options::default();
        Self {
            top: 3,
            ignore: Vec::new(),
            use_index: false,
            index_views: 8,
            own_session: false,
            headings: 1,
            limit: options.limit,
            max_bearing_rad: options.max_bearing_rad,
            bearing_rad: options.scales.bearing_rad,
            elevation_rad: options.scales.elevation_rad,
            log_size: options.scales.log_size,
            eccentricity: options.scales.eccentricity,
            orientation_rad: options.scales.orientation_rad,
            boundary_factor: options.boundary_factor,
            direction_steps: options.direction_steps,
            size_power: options.size_power,
            min_area_share: options.min_area_share,
            min_matched: options.min_matched,
            field_of_view_rad: options.field_of_view_rad,
        }
    }
}

impl Operator for Relocations {
    const NAME: &'static str = "relocations";
    const VERSION: u32 = 1;
    const PAGE: &'static str = include_str!("relocations.md");
    type Params = RelocationsParams;
    type Output = Relocation;

    fn ports() -> Vec<Port> {
        vec![
            Port::of::<View>("views", Grain::Row),
            Port::of::<View>("map", Grain::Whole),
        ]
    }

    fn kernel(params: RelocationsParams) -> Result<Kernel, Fault> {
        params.check()?;
        Ok(Kernel::Map(Box::new(Opener { params })))
    }
}

impl RelocationsParams {
    fn check(&self) -> Result<(), Fault> {
        let values = [
            ("limit", self.limit, 100.0),
            ("max_bearing_rad", self.max_bearing_rad, TAU),
            ("bearing_rad", self.bearing_rad, f64::MAX),
            ("elevation_rad", self.elevation_rad, f64::MAX),
            ("log_size", self.log_size, f64::MAX),
            ("eccentricity", self.eccentricity, f64::MAX),
            ("orientation_rad", self.orientation_rad, f64::MAX),
            ("boundary_factor", self.boundary_factor, f64::MAX),
            ("size_power", self.size_power, 2.0),
            ("min_area_share", self.min_area_share, 1.0),
            ("field_of_view_rad", self.field_of_view_rad, TAU),
        ];
        for (name, value, most) in values {
            if !(0.0..=most).contains(&value) {
                let range = if most < f64::MAX {
                    format!("from 0 to {most}")
                } else {
                    "of at least 0".to_owned()
                };
                return Err(Fault::user(format!(
                    "expected {name} {range}, found {value}"
                )));
            }
        }
        if !(1..=360).contains(&self.headings) {
            return Err(Fault::user(format!(
                "expected headings from 1 to 360, found {}",
                self.headings
            )));
        }
        Ok(())
    }

    fn options(&self, classes: &ClassNames) -> Options {
        let scale = |value: f64| if value > 0.0 { value } else { f64::INFINITY };
        let step = TAU / f64::from(self.headings);
        let heading = |number: u32| {
            let turn = f64::from(number) * step;
            if turn > PI { turn - TAU } else { turn }
        };
        let ignored = self.ignore.iter().filter_map(|name| classes.number(name));
        Options {
            scales: Scales {
                bearing_rad: scale(self.bearing_rad),
                elevation_rad: scale(self.elevation_rad),
                log_size: scale(self.log_size),
                eccentricity: scale(self.eccentricity),
                orientation_rad: scale(self.orientation_rad),
            },
            limit: self.limit,
            max_bearing_rad: self.max_bearing_rad,
            boundary_factor: self.boundary_factor,
            direction_steps: self.direction_steps,
            size_power: self.size_power,
            turns_rad: (0..self.headings).map(heading).collect(),
            field_of_view_rad: self.field_of_view_rad,
            ignored: ignored.collect(),
            min_area_share: self.min_area_share,
            min_matched: self.min_matched,
        }
    }
}

struct Opener {
    params: RelocationsParams,
}

impl MapKernel for Opener {
    fn open(&self, sides: &Sides) -> Result<Box<dyn Mapper>, Fault> {
        let mut sites: BTreeMap<String, Vec<View>> = BTreeMap::new();
        for view in sides.rows::<View>("map")? {
            sites.entry(view.site.clone()).or_default().push(view);
        }
        let place = |(site, views)| (site, Place::new(views, &self.params));
        Ok(Box::new(Relocator {
            places: sites.into_iter().map(place).collect(),
            params: self.params.clone(),
        }))
    }
}

/// The map of one site.
struct Place {
    classes: ClassNames,
    /// What the views are called; in the order of the map.
    views: Vec<View>,
    map: ViewMap,
    index: Option<ClassIndex>,
    ignored: Vec<u8>,
}

impl Place {
    /// Views without a graph are as good as absent: `views` has none.
    fn new(mut views: Vec<View>, params: &RelocationsParams) -> Self {
        views.sort_by(|a, b| a.view.cmp(&b.view));
        let classes = ClassNames::of(&views);
        let mut graphs: Vec<Graph> = Vec::with_capacity(views.len());
        views.retain(|view| {
            classes
                .graph(&view.graph)
                .map(|graph| graphs.push(graph))
                .is_ok()
        });
        let options = params.options(&classes);
        let map = ViewMap::new(graphs.iter(), options.clone());
        let index = params.use_index.then(|| {
            graphs
                .iter_mut()
                .for_each(|graph| forget(graph, &options.ignored));
            ClassIndex::new(graphs.iter(), classes.len())
        });
        Self {
            index,
            map,
            ignored: options.ignored,
            classes,
            views,
        }
    }

    fn hits(&self, query: &View, params: &RelocationsParams) -> Result<Vec<Hit>, Reason> {
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
        forget(&mut counted, &self.ignored);
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
}

/// Areas of these classes become areas of no class.
fn forget(graph: &mut Graph, classes: &[u8]) {
    for area in &mut graph.areas {
        if classes.contains(&area.class) {
            area.class = VOID;
        }
    }
}

struct Relocator {
    places: BTreeMap<String, Place>,
    params: RelocationsParams,
}

impl Mapper for Relocator {
    fn map(&self, batch: &RecordBatch, emit: &mut Emit<'_>) -> Result<(), Fault> {
        let queries = rows::<View>(batch)?;
        let found: Vec<Result<Vec<Relocation>, Reason>> = queries
            .into_par_iter()
            .map(|query| self.relocate(&query))
            .collect();
        let mut relocations = Vec::new();
        for of_query in found {
            match of_query {
                Ok(mut rows) => relocations.append(&mut rows),
                Err(reason) => emit.skip(reason, 1),
            }
        }
        emit.rows(relocations)
    }
}

impl Relocator {
    fn relocate(&self, query: &View) -> Result<Vec<Relocation>, Reason> {
        let Some(place) = self.places.get(&query.site) else {
            return Ok(Vec::new());
        };
        let hits = place.hits(query, &self.params)?;
        let row = |(hit, rank): (&Hit, u32)| {
            let view = &place.views[hit.view as usize];
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
            }
        };
        Ok(hits.iter().zip(0..).map(row).collect())
    }
}
