#![doc = include_str!("crf_settings.md")]

use evermap_algorithms::learning::dense_crf::{
    ColourView, Example, SearchOptions, Trial, Unary, search,
};
use evermap_algorithms::semantic_map::class_scores::ScoresView;
use evermap_algorithms::semantic_map::semantic_graph::{MOST_CLASSES, VOID};
use evermap_contract::{
    Emit, Fault, Key, Operator, Pixels, Port, Reach, Reason, Sides, Stream, Work,
};
use evermap_schemas::layers::{CrfSetting, LabelledScores};
use evermap_vision::Rgb;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::inputs::lenses::{self, Lenses};
use crate::inputs::pixels::{colours, undecoded, values};

/// See the module's page.
pub struct CrfSettings;

/// How kernels are searched.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct CrfSettingsParams {
    /// The most images that they are tried on, evenly from all.
    #[schemars(range(min = 1))]
    pub images: u32,
    /// How they are tried.
    #[serde(flatten)]
    pub search: SearchOptions,
}

impl Default for CrfSettingsParams {
    fn default() -> Self {
        Self {
            images: 24,
            search: SearchOptions::default(),
        }
    }
}

impl Operator for CrfSettings {
    const NAME: &'static str = "crf_settings";
    const VERSION: u32 = 6;
    const PAGE: &'static str = include_str!("crf_settings.md");
    type Params = CrfSettingsParams;
    type Output = CrfSetting;

    fn work() -> Work<Self::Params> {
        let labelled = Port::site::<LabelledScores>("labelled").pixels("image");
        Work::stream::<Collector>(labelled, Key::SITE, vec![lenses::port(Reach::Site)])
    }
}

const MISSIZED: &str = "scores do not have the size that they claim";

/// A labelled image, still encoded.
struct Encoded {
    scores: LabelledScores,
    image: Option<Vec<u8>>,
}

struct Collector {
    params: CrfSettingsParams,
    lenses: Lenses,
    images: Vec<Encoded>,
}

impl Stream for Collector {
    type Params = CrfSettingsParams;
    type Row = LabelledScores;

    fn open(params: &CrfSettingsParams, sides: &Sides) -> Result<Self, Fault> {
        Ok(Self {
            params: params.clone(),
            lenses: Lenses::new(sides)?,
            images: Vec::new(),
        })
    }

    fn push(
        &mut self,
        rows: Vec<LabelledScores>,
        pixels: &Pixels,
        _: &mut Emit<'_>,
    ) -> Result<(), Fault> {
        let encoded = rows.into_iter().enumerate();
        self.images.extend(encoded.map(|(row, scores)| Encoded {
            scores,
            image: pixels.get(row).map(<[u8]>::to_vec),
        }));
        Ok(())
    }

    fn close(self, emit: &mut Emit<'_>) -> Result<(), Fault> {
        let Some(Encoded { scores: first, .. }) = self.images.first() else {
            return Ok(());
        };
        let step = self.images.len().div_ceil(self.params.images as usize);
        let mut examples = Vec::new();
        for image in self.images.iter().step_by(step.max(1)) {
            let Some(bytes) = &image.image else {
                continue;
            };
            match image.decode(bytes, &first.classes, &self.lenses) {
                Ok(example) => examples.push(example),
                Err(reason) => emit.skip(reason, 1),
            }
        }
        if examples.is_empty() {
            return Ok(());
        }
        let trials = search(&examples, &self.params.search, |share| emit.progress(share));
        let trials = trials.map_err(|error| Fault::data(error.to_string()))?;
        let ranked = trials.iter().zip(0..);
        emit.rows(
            ranked
                .map(|(trial, rank)| setting(&first.site, rank, trial))
                .collect(),
        )
    }
}

impl Encoded {
    fn decode(&self, bytes: &[u8], classes: &[String], lenses: &Lenses) -> Result<Example, Reason> {
        let scores = &self.scores;
        if scores.classes != classes || classes.len() > MOST_CLASSES {
            return Err("image has other classes than the first one".into());
        }
        let size = [scores.width, scores.height];
        let probabilities = &scores.probabilities.0;
        let view = ScoresView::new(size, scores.stride_px, classes.len(), probabilities)
            .ok_or(MISSIZED)?;
        let mut rgb = Rgb::default();
        colours(bytes, &mut rgb, || {
            undecoded(&scores.camera, &scores.image.format)
        })?;
        let mut truth = values(&scores.png.0, size)?;
        let table = renumbered(&scores.label_classes, classes);
        for value in &mut truth {
            *value = table[usize::from(*value)];
        }
        if [rgb.width, rgb.height] != size {
            return Err("image has another size than its scores".into());
        }
        let taken = (
            scores.session.as_str(),
            scores.camera.as_str(),
            scores.stamp,
        );
        let wraps = lenses.wraps(taken, size);
        let image = ColourView::new(rgb.width, rgb.height, &rgb.data).ok_or(MISSIZED)?;
        let example = Unary::of_cells(&view)
            .and_then(|unary| Example::new(&image, scores.stride_px, unary, wraps, truth));
        example.map_err(|_| MISSIZED.into())
    }
}

/// What values of one list of classes are in another; [`VOID`] for those that it does not have.
fn renumbered(from: &[String], to: &[String]) -> [u8; 256] {
    let mut table = [VOID; 256];
    for (entry, name) in table.iter_mut().zip(from) {
        let found = to.iter().position(|class| class == name);
        let found = found.and_then(|index| u8::try_from(index).ok());
        *entry = found.unwrap_or(VOID);
    }
    table
}

fn setting(site: &str, rank: u32, trial: &Trial) -> CrfSetting {
    let kernels = &trial.kernels;
    CrfSetting {
        site: site.to_owned(),
        rank,
        appearance_px: kernels.appearance_px,
        appearance_colour: kernels.appearance_colour,
        appearance_weight: kernels.appearance_weight,
        smoothness_px: kernels.smoothness_px,
        smoothness_weight: kernels.smoothness_weight,
        pixel_accuracy: trial.confusion.pixel_accuracy(),
        class_accuracy: trial.confusion.class_accuracy(),
        images: trial.examples as u32,
    }
}
