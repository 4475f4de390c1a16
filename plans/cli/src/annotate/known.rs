//! The labels that there are, found by name and by place.

use std::collections::{BTreeMap, BTreeSet};

use evermap_algorithms::labels::points::PointIndex;
use evermap_schemas::layers::PlacedLabel;

/// Labels of one site.
#[derive(Debug, Clone, Default)]
pub struct KnownLabels {
    /// By name.
    rows: Vec<PlacedLabel>,
    kinds: BTreeSet<String>,
    /// Points where an outline that is one of these may begin.
    beginnings: PointIndex,
    /// Index of the row that has each of them.
    of: Vec<usize>,
}

impl FromIterator<PlacedLabel> for KnownLabels {
    /// Of two of one name the last.
    fn from_iter<I: IntoIterator<Item = PlacedLabel>>(rows: I) -> Self {
        let named = rows.into_iter().map(|row| (row.label.clone(), row));
        let named: BTreeMap<String, PlacedLabel> = named.collect();
        let rows: Vec<PlacedLabel> = named.into_values().collect();
        let points = rows.iter().enumerate().flat_map(|(index, row)| {
            let points = beginnings(row).iter();
            points.map(move |[x, y, _]| (index, [*x, *y]))
        });
        let (of, points): (Vec<usize>, Vec<[f64; 2]>) = points.unzip();
        Self {
            kinds: rows.iter().map(|row| row.kind.clone()).collect(),
            beginnings: PointIndex::new(points),
            of,
            rows,
        }
    }
}

impl KnownLabels {
    /// All of them, in the order of their names.
    pub fn rows(&self) -> &[PlacedLabel] {
        &self.rows
    }

    /// All of them, in the order of their names.
    pub fn into_rows(self) -> Vec<PlacedLabel> {
        self.rows
    }

    /// The label of a name.
    pub fn get(&self, name: &str) -> Option<&PlacedLabel> {
        let by_name = |row: &PlacedLabel| row.label.as_str().cmp(name);
        let index = self.rows.binary_search_by(by_name);
        self.rows.get(index.ok()?)
    }

    /// Whether there are labels of a kind.
    pub fn has_kind(&self, kind: &str) -> bool {
        self.kinds.contains(kind)
    }

    /// Those that an outline may be that begins at `first` (x and y, m), where its points lie within `within_m` of theirs;
    /// in the order of their names. Whether it is one of them, its other points say.
    pub fn beginning_near(
        &self,
        first: [f64; 2],
        within_m: f64,
    ) -> impl Iterator<Item = &PlacedLabel> {
        let points = self.beginnings.within(first, within_m);
        let rows: BTreeSet<usize> = points.map(|point| self.of[point]).collect();
        rows.into_iter().map(move |index| &self.rows[index])
    }
}

/// The points of a label where an outline that is the same may begin: a box may be written from any corner.
fn beginnings(label: &PlacedLabel) -> &[[f64; 3]] {
    match label.shape.as_str() {
        "box" => &label.points,
        _ => label.points.get(..1).unwrap_or_default(),
    }
}
