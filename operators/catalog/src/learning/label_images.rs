#![doc = include_str!("label_images.md")]

use evermap_algorithms::learning::dense_crf::{Kernels, MeanField, RandomField, Unary};
use evermap_algorithms::semantic_map::semantic_graph::MOST_CLASSES;
use evermap_contract::{Fault, Operator, Port, Reach, Reason, Sides, Work};
use evermap_schemas::layers::{ClassScores, CrfSetting, LabelImage, ScoredFrame};
use evermap_vision::Rgb;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::inputs::lenses::{self, Lenses};
use crate::inputs::pixels::{colours, label_image, scores, undecoded};

/// See the module's page.
pub struct LabelImages;

/// How pixels are joined.
#[derive(Debug, Clone, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct LabelImagesParams {
    /// Where nothing was learnt.
    #[serde(flatten)]
    pub kernels: Kernels,
    /// How labels are found.
    #[serde(flatten)]
    pub mean_field: MeanField,
}

impl Operator for LabelImages {
    const NAME: &'static str = "label_images";
    const VERSION: u32 = 3;
    const PAGE: &'static str = include_str!("label_images.md");
    type Params = LabelImagesParams;
    type Output = LabelImage;

    fn work() -> Work<Self::Params> {
        let scored = Port::session::<ScoredFrame>("scores").pixels("image");
        let settings = Port::site::<CrfSetting>("settings").optional();
        let sides = vec![settings, lenses::port(Reach::Session)];
        Work::each_image(scored, sides, Labeller::new, Labeller::labels)
    }
}

/// How a site's images are labelled.
struct Labeller {
    kernels: Kernels,
    mean_field: MeanField,
    lenses: Lenses,
}

impl Labeller {
    /// By the parameters, with the site's best kernels where any were learnt.
    fn new(params: &LabelImagesParams, sides: &Sides) -> Result<Self, Fault> {
        let settings = sides.rows::<CrfSetting>("settings")?;
        let best = settings.into_iter().find(|setting| setting.rank == 0);
        let kernels = best.map(|setting| Kernels {
            appearance_px: setting.appearance_px,
            appearance_colour: setting.appearance_colour,
            appearance_weight: setting.appearance_weight,
            smoothness_px: setting.smoothness_px,
            smoothness_weight: setting.smoothness_weight,
        });
        Ok(Self {
            kernels: kernels.unwrap_or(params.kernels),
            mean_field: params.mean_field,
            lenses: Lenses::new(sides)?,
        })
    }

    fn labels(
        &self,
        scored: ClassScores,
        bytes: &[u8],
        rgb: &mut Rgb,
    ) -> Result<Option<LabelImage>, Reason> {
        if scored.classes.len() > MOST_CLASSES {
            return Err("more classes than labels".into());
        }
        let scores = scores(&scored)?;
        let image = colours(bytes, rgb, || undecoded(&scored.camera, ""))?;
        if [image.width(), image.height()]
            != [scored.width, scored.height].map(|side| side as usize)
        {
            return Err("image has another size than its scores".into());
        }
        let taken = (
            scored.session.as_str(),
            scored.camera.as_str(),
            scored.stamp,
        );
        let wraps = self.lenses.wraps(taken, [scored.width, scored.height]);
        let unusable = |_| "kernels do not fit the image";
        let field = RandomField::new(&image, &self.kernels, wraps).map_err(unusable)?;
        let unary = Unary::from_scores(&scores, wraps).map_err(unusable)?;
        let found = field
            .infer(&unary, self.mean_field.iterations)
            .map_err(unusable)?;
        let png = label_image([scored.width, scored.height], found.labels())?;
        Ok(Some(LabelImage {
            site: scored.site,
            session: scored.session,
            stamp: scored.stamp,
            camera: scored.camera,
            width: scored.width,
            height: scored.height,
            classes: scored.classes,
            png,
        }))
    }
}
