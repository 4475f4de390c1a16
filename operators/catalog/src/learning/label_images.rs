#![doc = include_str!("label_images.md")]

use evermap_algorithms::learning::dense_crf::{
    Kernels, MOST_CLASSES, MeanField, RandomField, Unary,
};
use evermap_contract::{Fault, Operator, Port, Reason, Sides, Work};
use evermap_schemas::Bytes;
use evermap_schemas::layers::{ClassScores, CrfSetting, LabelImage, ScoredFrame};
use evermap_vision::{Grey, Rgb, encode_png};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::inputs::pixels::{colours, scores};

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
    const VERSION: u32 = 1;
    const PAGE: &'static str = include_str!("label_images.md");
    type Params = LabelImagesParams;
    type Output = LabelImage;

    fn work() -> Work<Self::Params> {
        let scored = Port::session::<ScoredFrame>("scores").pixels("image");
        let settings = Port::site::<CrfSetting>("settings").optional();
        Work::each_image(scored, vec![settings], learnt, labels)
    }
}

/// The parameters, with the site's best kernels where any were learnt.
fn learnt(params: &LabelImagesParams, sides: &Sides) -> Result<LabelImagesParams, Fault> {
    let settings = sides.rows::<CrfSetting>("settings")?;
    let best = settings.into_iter().find(|setting| setting.rank == 0);
    let kernels = best.map(|setting| Kernels {
        appearance_px: setting.appearance_px,
        appearance_colour: setting.appearance_colour,
        appearance_weight: setting.appearance_weight,
        smoothness_px: setting.smoothness_px,
        smoothness_weight: setting.smoothness_weight,
    });
    Ok(LabelImagesParams {
        kernels: kernels.unwrap_or(params.kernels),
        mean_field: params.mean_field,
    })
}

fn labels(
    params: &LabelImagesParams,
    scored: ClassScores,
    bytes: &[u8],
    rgb: &mut Rgb,
) -> Result<Option<LabelImage>, Reason> {
    if scored.classes.len() > MOST_CLASSES {
        return Err("more classes than labels");
    }
    let scores = scores(&scored)?;
    let image = colours(bytes, rgb)?;
    if [image.width(), image.height()] != [scored.width, scored.height].map(|side| side as usize) {
        return Err("image has another size than its scores");
    }
    let MeanField { iterations, wraps } = params.mean_field;
    let unusable = |_| "kernels do not fit the image";
    let field = RandomField::new(&image, &params.kernels, wraps).map_err(unusable)?;
    let unary = Unary::from_scores(&scores, wraps).map_err(unusable)?;
    let found = field.infer(&unary, iterations).map_err(unusable)?;
    let labels = Grey {
        width: scored.width,
        height: scored.height,
        data: found.labels(),
    };
    let png = encode_png(&labels).map_err(|_| "labels do not encode")?;
    Ok(Some(LabelImage {
        site: scored.site,
        session: scored.session,
        stamp: scored.stamp,
        camera: scored.camera,
        width: scored.width,
        height: scored.height,
        classes: scored.classes,
        png: Bytes(png),
    }))
}
