#![doc = include_str!("crf_settings.md")]

use std::sync::Arc;

use arrow::array::{Array, RecordBatch};
use evermap_algorithms::semantic_map::class_scores::ScoresView;
use evermap_algorithms::learning::dense_crf::{
    ColourView, Example, ITERATIONS, Kernels, MOST_CLASSES, SearchOptions, Trial, Unary, search,
};
use evermap_contract::{Emit, Fault, Grain, Group, GroupKernel, Kernel, Operator, Port, Sides};
use evermap_schemas::layers::{ClassScores, CrfSetting, LabelledScores};
use evermap_schemas::{Bytes, record, rows};
use evermap_vision::{Decoder, Rgb, decode_labels};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::inputs::images::images;
use crate::inputs::rig::Reason;

/// See the module's page.
pub struct CrfSettings;

/// How kernels are searched.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct CrfSettingsParams {
    /// The most kernels that are tried.
    pub trials: u32,
    /// The most images that they are tried on, evenly from all.
    pub images: u32,
    /// Rounds of mean field.
    pub iterations: u32,
    /// Whether the last column of an image is next to its first one, as in a full panorama.
    pub wraps: bool,
}

impl Default for CrfSettingsParams {
    fn default() -> Self {
        Self {
            trials: SearchOptions::default().trials as u32,
            images: 24,
            iterations: ITERATIONS,
            wraps: false,
        }
    }
}

impl Operator for CrfSettings {
    const NAME: &'static str = "crf_settings";
    const VERSION: u32 = 1;
    const PAGE: &'static str = include_str!("crf_settings.md");
    type Params = CrfSettingsParams;
    type Output = CrfSetting;

    fn ports() -> Vec<Port> {
        vec![Port::of::<LabelledScores>("labelled", Grain::Whole).with_pixels("image")]
    }

    fn kernel(params: CrfSettingsParams) -> Result<Kernel, Fault> {
        if params.trials == 0 || params.images == 0 {
            return Err(Fault::user(
                "expected at least one of trials and images, found 0",
            ));
        }
        if params.iterations > 1000 {
            return Err(Fault::user(format!(
                "expected iterations up to 1000, found {}",
                params.iterations
            )));
        }
        Ok(Kernel::Group(Box::new(Opener {
            params: Arc::new(params),
        })))
    }
}

struct Opener {
    params: Arc<CrfSettingsParams>,
}

impl GroupKernel for Opener {
    fn open(&self, _: &Sides) -> Result<Box<dyn Group>, Fault> {
        Ok(Box::new(Collector {
            params: Arc::clone(&self.params),
            images: Vec::new(),
        }))
    }
}

record! {
    /// The true labels of a row.
    pub struct Truth {
        /// The labels.
        png: Bytes,
    }
}

/// A labelled image, still encoded.
struct Encoded {
    scores: ClassScores,
    truth: Bytes,
    image: Option<Vec<u8>>,
}

/// The same, decoded.
struct Decoded {
    rgb: Rgb,
    unary: Unary,
    truth: Vec<u8>,
}

struct Collector {
    params: Arc<CrfSettingsParams>,
    images: Vec<Encoded>,
}

impl Group for Collector {
    fn push(&mut self, batch: &RecordBatch, _: &mut Emit<'_>) -> Result<(), Fault> {
        let images = images(batch, "labelled")?;
        let truths = rows::<Truth>(batch)?;
        let both = rows::<ClassScores>(batch)?.into_iter().zip(truths);
        for (index, (scores, truth)) in both.enumerate() {
            self.images.push(Encoded {
                scores,
                truth: truth.png,
                image: images.is_valid(index).then(|| images.value(index).to_vec()),
            });
        }
        Ok(())
    }

    fn close(&mut self, emit: &mut Emit<'_>) -> Result<(), Fault> {
        let Some(first) = self.images.first() else {
            return Ok(());
        };
        let (site, classes) = (first.scores.site.clone(), first.scores.classes.clone());
        let step = self.images.len().div_ceil(self.params.images as usize);
        let mut decoded = Vec::new();
        for image in self.images.iter().step_by(step.max(1)) {
            match image.decode(&classes, self.params.wraps) {
                Ok(image) => decoded.push(image),
                Err(reason) => emit.skip(reason, 1),
            }
        }
        let examples: Vec<Example<'_>> = decoded.iter().filter_map(Decoded::example).collect();
        if examples.is_empty() {
            return Ok(());
        }
        let options = SearchOptions {
            start: Kernels::default(),
            iterations: self.params.iterations,
            wraps: self.params.wraps,
            trials: self.params.trials as usize,
        };
        let trials = search(&examples, &options).map_err(|error| Fault::data(error.to_string()))?;
        let ranked = trials.into_iter().zip(0..);
        emit.rows(
            ranked
                .map(|(trial, rank)| row(&site, rank, &trial))
                .collect(),
        )
    }
}

impl Encoded {
    fn decode(&self, classes: &[String], wraps: bool) -> Result<Decoded, Reason> {
        let scores = &self.scores;
        if scores.classes != classes || classes.len() > MOST_CLASSES {
            return Err("image has other classes than the first one");
        }
        let size = [scores.width, scores.height];
        let bytes = &scores.probabilities.0;
        let view = ScoresView::new(size, scores.stride_px, classes.len(), bytes)
            .ok_or("scores do not have the size that they claim")?;
        let image = self.image.as_ref().ok_or("image is missing")?;
        let rgb = Decoder::new()
            .decode_colour(image)
            .map_err(|_| "image does not decode")?;
        let truth = decode_labels(&self.truth.0).map_err(|_| "labels do not decode")?;
        if [rgb.width, rgb.height] != size || [truth.width, truth.height] != size {
            return Err("image, labels and scores are not of one size");
        }
        let unary = Unary::from_scores(&view, wraps)
            .map_err(|_| "scores do not have the size that they claim")?;
        Ok(Decoded {
            rgb,
            unary,
            truth: truth.data,
        })
    }
}

impl Decoded {
    fn example(&self) -> Option<Example<'_>> {
        Some(Example {
            image: ColourView::new(self.rgb.width, self.rgb.height, &self.rgb.data)?,
            unary: self.unary.clone(),
            truth: &self.truth,
        })
    }
}

fn row(site: &str, rank: u32, trial: &Trial) -> CrfSetting {
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
    }
}
