#![doc = include_str!("views.md")]

use std::collections::BTreeMap;

use evermap_algorithms::geometry::camera::Camera;
use evermap_algorithms::semantic_map::semantic_graph::{Graph, GraphOptions, Labels, MOST_CLASSES};
use evermap_contract::{Emit, Fault, Operator, Pixels, Port, Reach, Reason, Sides, Work};
use evermap_schemas::layers::{LabelImage, View};
use evermap_schemas::roles::Frame;
use evermap_schemas::{ImageRef, Pose, Stamp};
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::inputs::camera_poses::{self, CameraPoses};
use crate::inputs::graphs;
use crate::inputs::lenses::Lenses;
use crate::inputs::pixels::{self, too_many_classes};
use crate::inputs::rig::VehicleFrame;

/// See the module's page.
pub struct Views;

/// How graphs are made.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct ViewsParams {
    /// Areas that cover less of the image than this share are given to a neighbour: by default 341 pixels of 1024 × 333, a
    /// car 25 m away. On a simulated street it leaves 33 of 400 areas; of labels of which 18 % are wrong, 56 of 1800.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub min_area_share: f64,
    /// The vehicle.
    #[serde(flatten)]
    pub vehicle: VehicleFrame,
}

impl Default for ViewsParams {
    fn default() -> Self {
        Self {
            min_area_share: 0.001,
            vehicle: VehicleFrame::default(),
        }
    }
}

impl Operator for Views {
    const NAME: &'static str = "views";
    const VERSION: u32 = 6;
    const PAGE: &'static str = include_str!("views.md");
    type Params = ViewsParams;
    type Output = View;

    fn work() -> Work<Self::Params> {
        let labels = Port::session::<LabelImage>("labels");
        let mut sides = camera_poses::ports(Reach::Session).to_vec();
        sides.push(Port::session::<Frame>("depth_frames").optional());
        Work::batches(labels, sides, Site::new, Site::views)
    }
}

/// A view, and what is amiss with it.
struct DescribedView {
    view: View,
    /// Pixels that have labels that are no class.
    unknown_px: u64,
    /// Why its camera counts as a plain one, though it is calibrated, and why it does not say where its camera was, though
    /// its session has poses and transforms.
    lacks: [Option<Reason>; 2],
}

/// How views are made of a site's images.
struct Site {
    params: ViewsParams,
    lenses: Lenses,
    poses: CameraPoses,
    /// Range images, by session, camera and instant.
    depth: BTreeMap<(String, String, Stamp), ImageRef>,
}

impl Site {
    fn new(params: &ViewsParams, sides: &Sides) -> Result<Self, Fault> {
        let depth = sides.rows::<Frame>("depth_frames")?.into_iter();
        Ok(Self {
            params: params.clone(),
            depth: depth
                .map(|frame| ((frame.session, frame.camera, frame.stamp), frame.image))
                .collect(),
            lenses: Lenses::new(sides)?,
            poses: CameraPoses::new(sides)?,
        })
    }

    fn views(&self, images: Vec<LabelImage>, _: &Pixels, emit: &mut Emit<'_>) -> Result<(), Fault> {
        let images = images.into_par_iter();
        let views: Vec<Result<DescribedView, Reason>> =
            images.map(|image| self.view(image)).collect();
        for described in views.iter().flatten() {
            emit.skip("value of a pixel is not a class", described.unknown_px);
            for reason in described.lacks.iter().flatten() {
                emit.skip(reason, 1);
            }
        }
        let views = views.into_iter().map(|described| Ok([described?.view]));
        emit.made(views.collect())
    }

    fn view(&self, image: LabelImage) -> Result<DescribedView, Reason> {
        let values = pixels::labels(&image)?;
        let (width, height) = (image.width, image.height);
        if image.classes.len() > MOST_CLASSES {
            return Err(too_many_classes());
        }
        let classes = image.classes.len() as u8;
        let labels = Labels {
            width,
            height,
            values: &values,
        };
        let taken = (image.session.as_str(), image.camera.as_str(), image.stamp);
        let (camera, unknown_lens) = match self.lenses.camera(taken, [width, height]) {
            Ok(camera) => (camera, None),
            Err(reason) => (None, Some(reason)),
        };
        let options = GraphOptions {
            classes,
            wraps: camera.as_ref().is_some_and(Camera::wraps),
            min_px: GraphOptions::share_px(self.params.min_area_share, width, height),
        };
        let graph = Graph::from_labels(&labels, &options);
        let mut graph = graph.map_err(|error| graphs::no_graph(&error))?;
        let field_of_view = camera.and_then(|camera| camera.horizontal_field_of_view_rad());
        graph.field_of_view_rad = field_of_view.map(|angle| angle as f32);
        let (map_from_view, unplaced) = match self.poses.at(taken, &self.params.vehicle) {
            Ok(pose) => (pose, None),
            Err(reason) => (None, Some(reason)),
        };
        let key = (image.session, image.camera, image.stamp);
        let view = View {
            map_from_view: map_from_view.map(|pose| Pose::from_array(pose.to_array())),
            depth: self.depth.get(&key).cloned(),
            view: format!("{}/{}/{}", key.0, key.1, key.2.0),
            site: image.site,
            session: key.0,
            stamp: key.2,
            camera: key.1,
            graph: graphs::row(&graph, &image.classes),
        };
        Ok(DescribedView {
            view,
            unknown_px: labels.unknown_px(classes) as u64,
            lacks: [unknown_lens, unplaced],
        })
    }
}
