//! Which units of a file a scan must read: those in its byte range, of its channels, that no filter excludes.

use std::collections::HashSet;
use std::sync::Arc;

use arrow::array::{ArrayRef, BooleanArray, StringArray, TimestampNanosecondArray};
use datafusion::common::pruning::PruningStatistics;
use datafusion::common::{Column, ScalarValue};
use datafusion::physical_expr::PhysicalExpr;
use datafusion::physical_optimizer::pruning::PruningPredicateBuilder;

use arrow::datatypes::SchemaRef;

use crate::log::index::Unit;
use crate::session::LogPart;

/// A unit to read, and the channels of it that may matter: `None` for all.
#[derive(Debug, Clone)]
pub(crate) struct PlannedUnit {
    pub unit: Unit,
    pub channels: Option<Vec<u16>>,
}

/// What a scan wants from a file.
pub(crate) struct ScanRequest<'a> {
    pub part: &'a LogPart,
    /// Bytes of the file whose units are to be read.
    pub range: (u64, u64),
    /// Channels whose messages are rows.
    pub channels: Vec<u16>,
    /// Filters, in terms of `schema`.
    pub predicate: Option<&'a Arc<dyn PhysicalExpr>>,
    pub schema: &'a SchemaRef,
    /// Columns of it of which the index knows something.
    pub indexed: &'static [&'static str],
}

impl ScanRequest<'_> {
    /// The units with messages.
    pub fn units(&self) -> Vec<PlannedUnit> {
        let candidates: Vec<(usize, Option<u16>)> = self.candidates();
        let kept = self.prune(&candidates);
        let mut planned: Vec<PlannedUnit> = Vec::new();
        let mut last = None;
        for ((index, channel), _) in candidates.iter().zip(kept).filter(|(_, kept)| *kept) {
            if last != Some(*index) {
                planned.push(PlannedUnit {
                    unit: self.part.index.units[*index].clone(),
                    channels: channel.map(|_| Vec::new()),
                });
                last = Some(*index);
            }
            if let (Some(channel), Some(unit)) = (channel, planned.last_mut()) {
                unit.channels.get_or_insert_default().push(*channel);
            }
        }
        planned
    }

    /// Pairs of a unit and one of its channels; `None` where the index does not list the unit's channels.
    fn candidates(&self) -> Vec<(usize, Option<u16>)> {
        let (start, end) = self.range;
        let mut candidates = Vec::new();
        for (index, unit) in self.part.index.units.iter().enumerate() {
            if unit.offset < start || unit.offset >= end {
                continue;
            }
            match &unit.channels {
                None if self.channels.is_empty() => {}
                None => candidates.push((index, None)),
                Some(_) => {
                    let wanted = self.channels.iter().filter(|id| unit.may_hold(**id));
                    candidates.extend(wanted.map(|channel| (index, Some(*channel))));
                }
            }
        }
        candidates
    }

    fn prune(&self, candidates: &[(usize, Option<u16>)]) -> Vec<bool> {
        let all = vec![true; candidates.len()];
        let Some(predicate) = self.predicate.filter(|_| !candidates.is_empty()) else {
            return all;
        };
        let pruning = PruningPredicateBuilder::new()
            .with_file_schema(self.schema.clone())
            .try_build(predicate.clone());
        let statistics = CandidateStatistics {
            part: self.part,
            candidates,
            indexed: self.indexed,
        };
        pruning
            .and_then(|pruning| pruning.prune(&statistics))
            .unwrap_or(all)
    }
}

/// What the index says about the rows of each candidate.
struct CandidateStatistics<'a> {
    part: &'a LogPart,
    candidates: &'a [(usize, Option<u16>)],
    indexed: &'static [&'static str],
}

impl CandidateStatistics<'_> {
    fn times(&self, time: impl Fn(&Unit) -> i64) -> ArrayRef {
        let times = self
            .candidates
            .iter()
            .map(|(index, _)| time(&self.part.index.units[*index]));
        Arc::new(TimestampNanosecondArray::from_iter_values(times).with_timezone("UTC"))
    }

    fn texts(&self, text: impl Fn(Option<u16>) -> Option<String>) -> ArrayRef {
        let texts = self.candidates.iter().map(|(_, channel)| text(*channel));
        Arc::new(texts.collect::<StringArray>())
    }

    /// Of the log time this bound; of other columns their value, where it is one for all rows of a candidate.
    fn bound(&self, column: &str, time: impl Fn(&Unit) -> i64) -> Option<ArrayRef> {
        if !self.indexed.contains(&column) {
            return None;
        }
        match column {
            "log_time" => Some(self.times(time)),
            "session" => Some(self.texts(|_| Some(self.part.session.to_string()))),
            "site" => Some(self.texts(|_| Some(self.part.site.to_string()))),
            "topic" => Some(self.texts(|channel| {
                let channel = self.part.index.channels.get(&channel?)?;
                Some(channel.topic.clone())
            })),
            _ => None,
        }
    }
}

impl PruningStatistics for CandidateStatistics<'_> {
    fn min_values(&self, column: &Column) -> Option<ArrayRef> {
        self.bound(&column.name, |unit| unit.start_time)
    }

    fn max_values(&self, column: &Column) -> Option<ArrayRef> {
        self.bound(&column.name, |unit| unit.end_time)
    }

    fn num_containers(&self) -> usize {
        self.candidates.len()
    }

    fn null_counts(&self, _: &Column) -> Option<ArrayRef> {
        None
    }

    fn row_counts(&self) -> Option<ArrayRef> {
        None
    }

    fn contained(&self, _: &Column, _: &HashSet<ScalarValue>) -> Option<BooleanArray> {
        None
    }
}
