//! What there is to learn of a kind, and what was learnt.

use std::sync::Arc;
use std::time::{Duration, Instant};

use evermap_algorithms::ground::boxes::mosaic::Mosaic;
use evermap_algorithms::ground::boxes::teaching::{Candidates, TeachingParams};
use evermap_catalog::labels::box_hypotheses::Kind;
use evermap_catalog::labels::box_models::learnt;
use evermap_schemas::Fault;
use evermap_schemas::layers::{BoxHypothesis, Lane, PlacedLabel};

/// What may be of a kind, as all that was said up to a revision teaches.
#[derive(Debug)]
pub struct LearntKind {
    /// What was known.
    pub revision: u64,
    /// The likeliest first.
    pub hypotheses: Vec<BoxHypothesis>,
    /// Whether the image was searched for them: else they are what was found before, weighed again.
    pub is_searched: bool,
    /// How long it took.
    pub took: Duration,
    /// The boxes that were weighed; `None` where nobody has drawn one yet.
    pub(super) candidates: Option<Arc<Candidates>>,
    /// What they were weighed by.
    model: Option<Arc<Kind>>,
}

/// What there is to learn of one kind.
pub(super) struct Lesson {
    pub(super) revision: u64,
    pub(super) mosaic: Arc<Mosaic>,
    pub(super) lanes: Arc<Vec<Lane>>,
    pub(super) labels: Vec<PlacedLabel>,
}

impl Lesson {
    /// Learns from what was said, and weighs candidates; searches for them where none are given.
    pub(super) fn learn(self, candidates: Option<Arc<Candidates>>) -> Result<LearntKind, Fault> {
        let begun = Instant::now();
        let (params, cell_m) = (TeachingParams::default(), self.mosaic.cell_m());
        let mut skip = |_, _| {};
        let models = learnt(&params, &self.mosaic, &self.labels, &mut skip)?;
        let kind = models.into_iter().next();
        let kind = kind.and_then(|model| Kind::new(model, &self.labels, &self.lanes, cell_m));
        Ok(self.weighed(kind.map(Arc::new), candidates, begun))
    }

    /// Searches the image by what is known of a kind; learns first where that was learnt from less than there is.
    pub(super) fn search(self, known: Option<&LearntKind>) -> Result<LearntKind, Fault> {
        let begun = Instant::now();
        let latest = known.filter(|known| known.revision == self.revision);
        match latest.and_then(|known| known.model.clone()) {
            Some(model) => Ok(self.weighed(Some(model), None, begun)),
            None => self.learn(None),
        }
    }

    /// What candidates are worth; the image is searched for them where none are given.
    fn weighed(
        self,
        model: Option<Arc<Kind>>,
        candidates: Option<Arc<Candidates>>,
        begun: Instant,
    ) -> LearntKind {
        let is_searched = candidates.is_none();
        let found = model.as_ref().map(|model| {
            let candidates = match candidates {
                Some(known) => model.look_again(&known),
                None => model.search(&self.mosaic),
            };
            (model.weigh(&candidates), Arc::new(candidates))
        });
        let (hypotheses, candidates) = found.unzip();
        LearntKind {
            revision: self.revision,
            hypotheses: hypotheses.unwrap_or_default(),
            is_searched,
            took: begun.elapsed(),
            candidates,
            model,
        }
    }
}
