#![doc = include_str!("views.md")]

use evermap_algorithms::semantic_map::semantic_graph::{
    Graph, GraphError, GraphOptions, Labels, VOID,
};
use evermap_contract::{Emit, Fault, Operator, Pixels, Port, Reason, Work};
use evermap_schemas::layers::{LabelImage, View};
use evermap_vision::decode_labels;
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::inputs::graphs;

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
    /// Whether images are full panoramas, whose last column is next to the first.
    pub panorama: bool,
}

impl Default for ViewsParams {
    fn default() -> Self {
        Self {
            min_area_share: 0.001,
            panorama: true,
        }
    }
}

impl Operator for Views {
    const NAME: &'static str = "views";
    const VERSION: u32 = 1;
    const PAGE: &'static str = include_str!("views.md");
    type Params = ViewsParams;
    type Output = View;

    fn work() -> Work<Self::Params> {
        let labels = Port::session::<LabelImage>("labels");
        Work::batches(labels, vec![], |params, _| Ok(params.clone()), views)
    }
}

fn views(
    params: &ViewsParams,
    images: Vec<LabelImage>,
    _: &Pixels,
    emit: &mut Emit<'_>,
) -> Result<(), Fault> {
    let images = images.into_par_iter();
    let views: Vec<Result<(View, usize), Reason>> =
        images.map(|image| params.view(image)).collect();
    let mut found = Vec::with_capacity(views.len());
    for view in views {
        match view {
            Ok((view, unknown)) => {
                if unknown > 0 {
                    emit.skip("value of a pixel is not a class", unknown as u64);
                }
                found.push(view);
            }
            Err(reason) => emit.skip(reason, 1),
        }
    }
    emit.rows(found)
}

impl ViewsParams {
    /// The view, and how many pixels have labels that are no class.
    fn view(&self, image: LabelImage) -> Result<(View, usize), Reason> {
        let labels = decode_labels(&image.png.0).map_err(|_| "label image does not decode")?;
        let (width, height) = (labels.width, labels.height);
        if (width, height) != (image.width, image.height) {
            return Err("label image has another size than its row says");
        }
        let classes = u8::try_from(image.classes.len())
            .ok()
            .filter(|classes| *classes < VOID)
            .ok_or("label image has more than 254 classes")?;
        let labels = Labels {
            width,
            height,
            values: &labels.data,
        };
        let options = GraphOptions {
            classes,
            wraps: self.panorama,
            min_px: GraphOptions::share_px(self.min_area_share, width, height),
        };
        let graph = Graph::from_labels(&labels, &options).map_err(|error| match error {
            GraphError::Size { .. } => "label image does not decode",
            GraphError::TooLarge { .. } => "label image is too large for a graph",
            GraphError::TooManyAreas(_) => "label image has too many areas for a graph",
        })?;
        let view = View {
            view: format!("{}/{}/{}", image.session, image.camera, image.stamp.0),
            site: image.site,
            session: image.session,
            stamp: image.stamp,
            camera: image.camera,
            graph: graphs::row(&graph, &image.classes),
        };
        Ok((view, labels.unknown_px(classes)))
    }
}
