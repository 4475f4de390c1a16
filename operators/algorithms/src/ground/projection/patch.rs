//! The cells that one image shows, as a rectangle.

use std::ops::Range;

use super::{GroundLut, ImageView};
use crate::geometry::pose::Pose;
use crate::ground::channels::{Channels, plainest};
use crate::ground::floor::Floor;
use crate::ground::patch::Patch;

impl GroundLut {
    /// What an image shows of the map's ground, cropped to what is seen; `None` where nothing is. See [`Self::splat`]. Of an
    /// image in colour that shows none there the patch is grey.
    pub fn patch<'a>(
        &self,
        image: impl Into<ImageView<'a>>,
        map_from_vehicle: &Pose,
        floor: Option<&Floor>,
        cell_m: f64,
    ) -> Option<Patch> {
        let image = image.into();
        let mut cells = Cells::default();
        self.splat(image, map_from_vehicle, floor, cell_m, |run| {
            let from = cells.weights.len();
            cells.values.extend_from_slice(run.values);
            cells.weights.extend_from_slice(run.weights);
            cells.runs.push((run.i, run.j, from..cells.weights.len()));
        });
        let patch = cells.rectangle(image.channels)?;
        Some(match image.channels {
            Channels::Grey => patch,
            Channels::Colour => Patch {
                values: plainest(patch.values),
                ..patch
            },
        })
    }
}

/// Runs of cells as they come: first column, row, and where their weights begin and end.
#[derive(Default)]
struct Cells {
    runs: Vec<(i64, i64, Range<usize>)>,
    values: Vec<u8>,
    weights: Vec<u8>,
}

impl Cells {
    fn rectangle(&self, channels: Channels) -> Option<Patch> {
        let count = channels.count();
        let end = |(i, _, run): &(i64, i64, Range<usize>)| i + run.len() as i64;
        let column = self.runs.iter().map(|(i, _, _)| *i).min()?;
        let width = (self.runs.iter().map(end).max()? - column) as usize;
        let row = self.runs.iter().map(|(_, j, _)| *j).min()?;
        let height = (self.runs.iter().map(|(_, j, _)| *j).max()? + 1 - row) as usize;
        let mut patch = Patch {
            column,
            row,
            width,
            height,
            values: vec![0; count * width * height],
            weights: vec![0; width * height],
        };
        for (i, j, run) in &self.runs {
            let at = (j - row) as usize * width + (i - column) as usize;
            let values = &self.values[count * run.start..count * run.end];
            patch.values[count * at..][..values.len()].copy_from_slice(values);
            patch.weights[at..at + run.len()].copy_from_slice(&self.weights[run.clone()]);
        }
        Some(patch)
    }
}
