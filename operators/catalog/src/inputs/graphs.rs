//! Graphs of views between rows and algorithms.

use std::collections::BTreeSet;

use evermap_algorithms::semantic_map::relocation::Options;
use evermap_algorithms::semantic_map::semantic_graph::{
    Area, Edge, Graph, GraphError, MOST_CLASSES, VOID,
};
use evermap_contract::{Emit, Reason};
use evermap_schemas::layers::{SemanticArea, SemanticEdge, SemanticGraph, View};
use nalgebra::Vector3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Names of classes with their numbers.
#[derive(Default)]
pub(crate) struct ClassNames {
    /// In the order of the alphabet.
    names: Vec<String>,
}

impl ClassNames {
    /// The classes of views, in the order of the alphabet; of more than [`MOST_CLASSES`] the first.
    pub(crate) fn of(views: &[View]) -> Self {
        let areas = views.iter().flat_map(|view| &view.graph.areas);
        let names: BTreeSet<&String> = areas.map(|area| &area.class).collect();
        let names = names.into_iter().take(MOST_CLASSES).cloned();
        Self {
            names: names.collect(),
        }
    }

    /// Number of classes.
    pub(crate) fn len(&self) -> u8 {
        self.names.len() as u8
    }

    /// The number of a class.
    pub(crate) fn number(&self, name: &str) -> Option<u8> {
        let found = self
            .names
            .binary_search_by(|known| known.as_str().cmp(name));
        found.ok().map(|number| number as u8)
    }

    /// The name of a class; empty for a number that there is not.
    pub(crate) fn name(&self, number: usize) -> &str {
        self.names.get(number).map_or("", String::as_str)
    }

    /// A view's graph. Areas of classes without a number are of class [`VOID`]: nothing is like them.
    ///
    /// # Errors
    /// When the row describes no graph.
    pub(crate) fn graph(&self, row: &SemanticGraph) -> Result<Graph, Reason> {
        let number = row.areas.len();
        let known = |edge: &SemanticEdge| usize::from(edge.a.max(edge.b)) < number;
        if !row.edges.iter().all(known) {
            return Err("graph has edges to areas that it does not have".into());
        }
        if number > 0 && (row.width == 0 || row.height == 0) {
            return Err("graph of a view without pixels has areas".into());
        }
        let area = |area: &SemanticArea| Area {
            class: self.number(&area.class).unwrap_or(VOID),
            pixels: area.pixels,
            u: area.u,
            v: area.v,
            major_px: area.major_px,
            minor_px: area.minor_px,
            orientation_rad: area.orientation_rad,
            eccentricity: area.eccentricity,
        };
        let edge = |edge: &SemanticEdge| Edge {
            a: edge.a,
            b: edge.b,
            boundary_px: edge.boundary_px,
        };
        Ok(Graph {
            width: row.width,
            height: row.height,
            wraps: row.wraps,
            field_of_view_rad: row.field_of_view_rad.filter(|angle| *angle > 0.0),
            areas: row.areas.iter().map(area).collect(),
            edges: row.edges.iter().map(edge).collect(),
        })
    }
}

/// How two views are compared, by whatever compares them.
#[derive(Debug, Clone, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct Comparison {
    /// Classes that are left out, such as cars, which drive away.
    pub ignore: Vec<String>,
    /// How two views are compared.
    #[serde(flatten)]
    pub options: Options,
}

impl Comparison {
    /// For graphs whose classes are numbered so.
    pub(crate) fn options(&self, classes: &ClassNames) -> Options {
        let ignored = self.ignore.iter();
        Options {
            ignored: ignored.filter_map(|name| classes.number(name)).collect(),
            ..self.options.clone()
        }
    }
}

/// Where a view was taken, in the frame of its drive (m); `None` where that is not known, or no place.
pub(crate) fn position(view: &View) -> Option<Vector3<f64>> {
    let pose = view.map_from_view.as_ref()?;
    let position = Vector3::new(pose.x, pose.y, pose.z);
    position
        .iter()
        .all(|value| value.is_finite())
        .then_some(position)
}

/// Views of a site as an index numbers them.
pub(crate) struct NumberedViews {
    /// What the numbers of classes in the graphs mean.
    pub(crate) classes: ClassNames,
    /// Names of the views, in the order of the alphabet.
    pub(crate) names: Vec<String>,
    /// What each shows.
    pub(crate) graphs: Vec<Graph>,
}

impl NumberedViews {
    /// Of rows; those that describe no graph are skipped, and where there are more classes than numbers, all: an index
    /// that knows no class would say that it is nowhere.
    pub(crate) fn of(mut views: Vec<View>, emit: &mut Emit<'_>) -> Option<Self> {
        views.sort_by(|a, b| a.view.cmp(&b.view));
        let mut numbered = Self {
            classes: ClassNames::of(&views),
            names: Vec::with_capacity(views.len()),
            graphs: Vec::with_capacity(views.len()),
        };
        for view in views {
            match numbered.classes.graph(&view.graph) {
                Ok(graph) => {
                    numbered.graphs.push(graph);
                    numbered.names.push(view.view);
                }
                Err(reason) => emit.skip(reason, 1),
            }
        }
        let mut areas = numbered.graphs.iter().flat_map(|graph| &graph.areas);
        if areas.any(|area| area.class == VOID) {
            emit.skip(
                format!("site has more than {MOST_CLASSES} classes"),
                numbered.graphs.len() as u64,
            );
            return None;
        }
        Some(numbered)
    }
}

/// Why a label image has no graph.
pub(crate) fn no_graph(error: &GraphError) -> Reason {
    match error {
        GraphError::Size { .. } => "label image does not decode",
        GraphError::TooLarge { .. } => "label image is too large for a graph",
        GraphError::TooManyAreas(_) => "label image has too many areas for a graph",
    }
    .into()
}

/// The row of a graph whose classes are indices into a list.
pub(crate) fn row(graph: &Graph, classes: &[String]) -> SemanticGraph {
    let area = |area: &Area| SemanticArea {
        class: classes
            .get(usize::from(area.class))
            .cloned()
            .unwrap_or_default(),
        pixels: area.pixels,
        u: area.u,
        v: area.v,
        major_px: area.major_px,
        minor_px: area.minor_px,
        orientation_rad: area.orientation_rad,
        eccentricity: area.eccentricity,
    };
    let edge = |edge: &Edge| SemanticEdge {
        a: edge.a,
        b: edge.b,
        boundary_px: edge.boundary_px,
    };
    SemanticGraph {
        width: graph.width,
        height: graph.height,
        wraps: graph.wraps,
        field_of_view_rad: graph.field_of_view_rad,
        areas: graph.areas.iter().map(area).collect(),
        edges: graph.edges.iter().map(edge).collect(),
    }
}
