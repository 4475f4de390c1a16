#![doc = include_str!("word_relocations.md")]

use std::collections::BTreeMap;

use arrow::array::RecordBatch;
use evermap_algorithms::metric_map::features::{DESCRIPTOR_BYTES, Descriptor};
use evermap_algorithms::metric_map::places::{Hit, PlaceIndex, Vocabulary, VocabularyOptions};
use evermap_contract::{Emit, Fault, Grain, Kernel, MapKernel, Mapper, Operator, Port, Sides};
use evermap_schemas::layers::{Features, Relocation};
use evermap_schemas::{Bytes, Stamp, record, rows};
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::inputs::rig::Reason;

/// See the module's page.
pub struct WordRelocations;

/// How views are looked for.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct WordRelocationsParams {
    /// Views of the map that are given for each query, at most.
    pub top: u32,
    /// Branches at each node of the vocabulary (K).
    pub branching: u32,
    /// Levels of the vocabulary, at most (L).
    pub depth: u32,
    /// Descriptors that the vocabulary is trained with, at most.
    pub max_training: u32,
    /// Whether a view may be found in its own session; never as itself.
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
    fn refuse_senseless(&self) -> Result<(), Fault> {
        let ranges = [
            ("top", self.top, 1..=100_000),
            ("branching", self.branching, 2..=1000),
            ("depth", self.depth, 1..=16),
            ("max_training", self.max_training, 1..=u32::MAX),
        ];
        for (name, value, range) in ranges {
            if !range.contains(&value) {
                let (least, most) = range.into_inner();
                return Err(Fault::user(format!(
                    "expected {name} from {least} to {most}, found {value}"
                )));
            }
        }
        Ok(())
    }

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
    const VERSION: u32 = 1;
    const PAGE: &'static str = include_str!("word_relocations.md");
    type Params = WordRelocationsParams;
    type Output = Relocation;

    fn ports() -> Vec<Port> {
        vec![
            Port::of::<Features>("queries", Grain::Row),
            Port::of::<Features>("map", Grain::Whole),
        ]
    }

    fn kernel(params: WordRelocationsParams) -> Result<Kernel, Fault> {
        params.refuse_senseless()?;
        Ok(Kernel::Map(Box::new(Opener { params })))
    }
}

record! {
    /// What an image looks like, without where its features are.
    pub struct Look {
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

impl Look {
    fn view(&self) -> View {
        View {
            session: self.session.clone(),
            stamp: self.stamp,
            camera: self.camera.clone(),
        }
    }

    /// As many as there are; a torn one at the end is none.
    fn descriptors(&self) -> Vec<Descriptor> {
        let (all, _) = self.descriptors.0.as_chunks::<DESCRIPTOR_BYTES>();
        all.iter().copied().map(Descriptor).collect()
    }
}

struct Opener {
    params: WordRelocationsParams,
}

impl MapKernel for Opener {
    fn open(&self, sides: &Sides) -> Result<Box<dyn Mapper>, Fault> {
        let mut by_site: BTreeMap<String, Vec<Look>> = BTreeMap::new();
        for look in sides.rows::<Look>("map")? {
            by_site.entry(look.site.clone()).or_default().push(look);
        }
        let sites = by_site
            .into_iter()
            .map(|(site, looks)| (site, Site::new(looks, &self.params.vocabulary())));
        Ok(Box::new(Finder {
            params: self.params.clone(),
            sites: sites.collect(),
        }))
    }
}

/// An image, by what names it within a site.
#[derive(Debug, PartialEq, Eq)]
struct View {
    session: String,
    stamp: Stamp,
    camera: String,
}

impl View {
    fn name(&self) -> String {
        format!("{}/{}/{}", self.session, self.camera, self.stamp.0)
    }
}

/// A site's map: its words, and which views show them.
struct Site {
    vocabulary: Vocabulary,
    index: PlaceIndex,
    views: Vec<View>,
}

impl Site {
    fn new(looks: Vec<Look>, options: &VocabularyOptions) -> Self {
        let views = looks.iter().map(Look::view).collect();
        let descriptors: Vec<_> = looks.iter().map(Look::descriptors).collect();
        drop(looks);
        let all: Vec<_> = descriptors.iter().flatten().collect();
        let vocabulary = Vocabulary::train(all.into_iter(), options);
        let bags: Vec<_> = descriptors
            .par_iter()
            .map(|descriptors| vocabulary.bag(descriptors))
            .collect();
        Self {
            index: PlaceIndex::new(vocabulary.words(), &bags),
            vocabulary,
            views,
        }
    }
}

struct Finder {
    params: WordRelocationsParams,
    sites: BTreeMap<String, Site>,
}

impl Mapper for Finder {
    fn map(&self, batch: &RecordBatch, emit: &mut Emit<'_>) -> Result<(), Fault> {
        let looks = rows::<Look>(batch)?;
        let found: Vec<_> = looks.par_iter().map(|look| self.found(look)).collect();
        let mut all = Vec::new();
        for relocations in found {
            match relocations {
                Ok(relocations) => all.extend(relocations),
                Err(reason) => emit.skip(reason, 1),
            }
        }
        emit.rows(all)
    }
}

impl Finder {
    fn found(&self, look: &Look) -> Result<Vec<Relocation>, Reason> {
        let descriptors = look.descriptors();
        if descriptors.is_empty() {
            return Err("view has no features");
        }
        let site = self.sites.get(&look.site).ok_or("site has no map")?;
        let query = look.view();
        let hits = site.index.best(
            &site.vocabulary.bag(&descriptors),
            self.params.top as usize,
            |document| {
                let view = &site.views[document];
                view.session != query.session || (self.params.within_session && *view != query)
            },
        );
        let relocation = |(rank, hit): (u32, Hit)| {
            let view = &site.views[hit.document];
            let score = f64::from(hit.score.min(1.0));
            Relocation {
                site: look.site.clone(),
                session: look.session.clone(),
                stamp: look.stamp,
                camera: look.camera.clone(),
                view: query.name(),
                rank,
                map_session: view.session.clone(),
                map_stamp: view.stamp,
                map_camera: view.camera.clone(),
                map_view: view.name(),
                score,
                similarity: score,
            }
        };
        Ok((0..).zip(hits).map(relocation).collect())
    }
}
