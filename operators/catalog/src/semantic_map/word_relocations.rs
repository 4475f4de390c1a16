#![doc = include_str!("word_relocations.md")]

use evermap_algorithms::metric_map::features::Descriptor;
use evermap_algorithms::metric_map::places::{Hit, PlaceIndex, Vocabulary, VocabularyOptions};
use evermap_contract::{Fault, Operator, Port, Reason, Sides, Work};
use evermap_schemas::layers::{Features, Relocation};
use evermap_schemas::{Bytes, Stamp, record};
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::inputs::drive::descriptors;

/// See the module's page.
pub struct WordRelocations;

/// How views are looked for.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct WordRelocationsParams {
    /// Views of the map that are given for each query, at most.
    #[schemars(range(min = 1, max = 100_000))]
    pub top: u32,
    /// Branches at each node of the vocabulary (K).
    #[schemars(range(min = 2, max = 1000))]
    pub branching: u32,
    /// Levels of the vocabulary (L): at most `branching` to the power of `depth` words. Paper 2 compares with 10 and 5, and
    /// with 8 and 4.
    #[schemars(range(min = 1, max = 16))]
    pub depth: u32,
    /// Descriptors of the map that the vocabulary is trained with, at most; of more, every second, third … is taken.
    #[schemars(range(min = 1))]
    pub max_training: u32,
    /// Whether a view may be found in its own session, where its neighbours in time would win. It is never found as itself.
    pub within_session: bool,
}

impl Default for WordRelocationsParams {
    fn default() -> Self {
        Self {
            top: 10,
            branching: 10,
            depth: 5,
            max_training: 1_000_000,
            within_session: false,
        }
    }
}

impl WordRelocationsParams {
    fn vocabulary(&self) -> VocabularyOptions {
        VocabularyOptions {
            branching: self.branching as usize,
            // Split down to the last level, as long as there is anything to split.
            leaf: 1,
            max_depth: self.depth as usize,
            max_training: self.max_training as usize,
            ..Default::default()
        }
    }
}

impl Operator for WordRelocations {
    const NAME: &'static str = "word_relocations";
    const VERSION: u32 = 2;
    const PAGE: &'static str = include_str!("word_relocations.md");
    type Params = WordRelocationsParams;
    type Output = Relocation;

    fn work() -> Work<Self::Params> {
        let queries = Port::session::<Features>("queries");
        let map = Port::site::<Features>("map");
        Work::each_row(queries, vec![map], Finder::new, Finder::relocations)
    }
}

record! {
    /// What an image looks like, without where its features are.
    pub struct Described {
        /// Site.
        site: String,
        /// Session.
        session: String,
        /// Exposure instant.
        stamp: Stamp,
        /// Camera.
        camera: String,
        /// Binary descriptors, one after the other.
        descriptors: Bytes,
    }
}

impl Described {
    fn view(&self) -> ViewName {
        ViewName {
            session: self.session.clone(),
            stamp: self.stamp,
            camera: self.camera.clone(),
        }
    }

    fn descriptors(&self) -> Vec<Descriptor> {
        descriptors(&self.descriptors).collect()
    }
}

/// An image, by what names it within a site.
#[derive(Debug, PartialEq, Eq)]
struct ViewName {
    session: String,
    stamp: Stamp,
    camera: String,
}

impl ViewName {
    fn name(&self) -> String {
        format!("{}/{}/{}", self.session, self.camera, self.stamp.0)
    }
}

/// A site's map: its words, and which views show them.
struct Finder {
    params: WordRelocationsParams,
    vocabulary: Vocabulary,
    index: PlaceIndex,
    views: Vec<ViewName>,
}

impl Finder {
    fn new(params: &WordRelocationsParams, sides: &Sides) -> Result<Self, Fault> {
        let map = sides.rows::<Described>("map")?;
        let views = map.iter().map(Described::view).collect();
        let descriptors: Vec<_> = map.iter().map(Described::descriptors).collect();
        drop(map);
        let all: Vec<_> = descriptors.iter().flatten().collect();
        let vocabulary = Vocabulary::train(all.into_iter(), &params.vocabulary());
        let bags: Vec<_> = descriptors
            .par_iter()
            .map(|descriptors| vocabulary.bag(descriptors))
            .collect();
        Ok(Self {
            params: params.clone(),
            index: PlaceIndex::new(vocabulary.words(), &bags),
            vocabulary,
            views,
        })
    }

    fn relocations(&self, described: Described) -> Result<Vec<Relocation>, Reason> {
        let descriptors = described.descriptors();
        if descriptors.is_empty() {
            return Err("view has no features".into());
        }
        if self.views.is_empty() {
            return Err("site has no map".into());
        }
        let query = described.view();
        let bag = self.vocabulary.bag(&descriptors);
        let hits = self.index.best(&bag, self.params.top as usize, |document| {
            let view = &self.views[document];
            view.session != query.session || (self.params.within_session && *view != query)
        });
        let relocation = |(rank, hit): (u32, Hit)| {
            let view = &self.views[hit.document];
            let score = f64::from(hit.score.min(1.0));
            Relocation {
                site: described.site.clone(),
                session: described.session.clone(),
                stamp: described.stamp,
                camera: described.camera.clone(),
                view: query.name(),
                rank,
                map_session: view.session.clone(),
                map_stamp: view.stamp,
                map_camera: view.camera.clone(),
                map_view: view.name(),
                score,
                similarity: score,
                yaw_rad: None,
                certainty: None,
            }
        };
        Ok((0..).zip(hits).map(relocation).collect())
    }
}
