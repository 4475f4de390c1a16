//! Recall and discriminative power of a matrix of distances, whichever method made it.
//!
//! The measures of paper 2 (metric-topological-semantic map), section V-B. The paper says that distances are
//! normalised to [0, 1] without saying over what: here each query's distances are, from its nearest view (0) to its
//! farthest (1), as every query is a question of its own and methods spread their distances differently. With one
//! scale for the whole matrix, which [`Evaluation::power_of_matrix`] has, a method whose best distances differ from
//! query to query looks worse than it answers.

use nalgebra::Vector3;
use rayon::prelude::*;

/// Distances from queries to the views of a map: small where a method thinks that they show the same place.
#[derive(Debug, Clone, PartialEq)]
pub struct Distances {
    views: usize,
    /// A row for each query.
    values: Vec<f64>,
}

impl Distances {
    /// Asks for each query's distances to all views, in the order of the views; what is missing or no number counts as
    /// the largest distance there is.
    pub fn new(queries: usize, views: usize, row: impl Fn(usize) -> Vec<f64> + Sync) -> Self {
        let rows: Vec<Vec<f64>> = (0..queries)
            .into_par_iter()
            .map(|query| {
                let mut row = row(query);
                row.resize(views, f64::NAN);
                row
            })
            .collect();
        let mut values = rows.concat();
        let finite = values.iter().copied().filter(|value| value.is_finite());
        let largest = finite.fold(f64::NEG_INFINITY, f64::max);
        let largest = if largest.is_finite() { largest } else { 0.0 };
        let unknown = values.iter_mut().filter(|value| !value.is_finite());
        unknown.for_each(|value| *value = largest);
        Self { views, values }
    }

    /// How many queries there are.
    pub fn queries(&self) -> usize {
        self.values.len().checked_div(self.views).unwrap_or(0)
    }

    /// How many views the map has.
    pub fn views(&self) -> usize {
        self.views
    }

    /// The distances from a query to all views; none for a query that there is not.
    pub fn row(&self, query: usize) -> &[f64] {
        let row = self.values.chunks_exact(self.views.max(1)).nth(query);
        row.unwrap_or_default()
    }

    /// Row by row, in [0, 1]: the picture that paper 2 shows in figure 4. A query that is equally far from all views
    /// is at distance 1 from all: it was told nothing.
    pub fn normalised(&self) -> Vec<f64> {
        let rows =
            (0..self.queries()).flat_map(|query| normalised(self.row(query), self.row(query)));
        rows.collect()
    }
}

/// What counts as right.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EvaluationOptions {
    /// A view as near to the query as this is the right place, metres.
    pub within_m: f64,
    /// So many views, the nearest to where a query was taken, correspond to it.
    pub corresponding: usize,
}

impl Default for EvaluationOptions {
    /// Three views correspond, as in paper 2.
    fn default() -> Self {
        Self {
            within_m: 5.0,
            corresponding: 3,
        }
    }
}

/// How well places were told apart.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Evaluation {
    /// Recall@1: the share of queries whose nearest view by distance was taken within reach of the query. Where
    /// several are equally near, the share of them that were.
    pub recall: f64,
    /// The share of queries with any view within reach: what recall could be.
    pub possible: f64,
    /// Mean distance to the views that correspond, each query's distances from 0 to 1.
    pub d_true: f64,
    /// Mean distance to those that do not.
    pub d_false: f64,
    /// Discriminative power: `d_false / d_true`; infinite where every query is nearest to all that correspond.
    pub power: f64,
    /// The same with one scale from 0 to 1 for the whole matrix.
    pub power_of_matrix: f64,
}

/// Compares distances with where queries and views were taken (metres, any common frame).
///
/// `None` where there is nothing to compare: without queries, without a view that does not correspond, or where
/// positions and distances do not belong together.
pub fn evaluate(
    distances: &Distances,
    queries: &[Vector3<f64>],
    views: &[Vector3<f64>],
    options: &EvaluationOptions,
) -> Option<Evaluation> {
    let fits = distances.queries() == queries.len() && distances.views() == views.len();
    let tells =
        !queries.is_empty() && options.corresponding > 0 && views.len() > options.corresponding;
    if !fits || !tells {
        return None;
    }
    let mut found = Sums::default();
    for (query, position) in queries.iter().enumerate() {
        let apart: Vec<f64> = views.iter().map(|view| (view - position).norm()).collect();
        found.add(distances.row(query), &distances.values, &apart, options);
    }
    Some(found.mean(queries.len() as f64))
}

#[derive(Default)]
struct Sums {
    recall: f64,
    possible: f64,
    /// To corresponding views and to others.
    by_query: [f64; 2],
    by_matrix: [f64; 2],
}

impl Sums {
    fn add(&mut self, row: &[f64], all: &[f64], apart: &[f64], options: &EvaluationOptions) {
        let near = |view: usize| apart[view] <= options.within_m;
        self.recall += share(&nearest(row), near);
        self.possible += f64::from(u8::from((0..row.len()).any(near)));
        let mut order: Vec<usize> = (0..row.len()).collect();
        order.sort_by(|a, b| apart[*a].total_cmp(&apart[*b]).then(a.cmp(b)));
        let parts = order.split_at(options.corresponding.min(order.len()));
        for (sums, scale) in [(&mut self.by_query, row), (&mut self.by_matrix, all)] {
            let scaled = normalised(row, scale);
            for (sum, part) in sums.iter_mut().zip([parts.0, parts.1]) {
                let total: f64 = part.iter().map(|view| scaled[*view]).sum();
                *sum += total / part.len() as f64;
            }
        }
    }

    fn mean(&self, queries: f64) -> Evaluation {
        let [d_true, d_false] = self.by_query.map(|sum| sum / queries);
        Evaluation {
            recall: self.recall / queries,
            possible: self.possible / queries,
            d_true,
            d_false,
            power: d_false / d_true,
            power_of_matrix: self.by_matrix[1] / self.by_matrix[0],
        }
    }
}

/// A query's distances on the scale from the smallest to the largest of `scale`.
fn normalised(row: &[f64], scale: &[f64]) -> Vec<f64> {
    let least = scale.iter().copied().fold(f64::INFINITY, f64::min);
    let most = scale.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let span = most - least;
    let one = |value: &f64| {
        if span > 0.0 {
            (value - least) / span
        } else {
            1.0
        }
    };
    row.iter().map(one).collect()
}

/// The views at the smallest distance.
fn nearest(row: &[f64]) -> Vec<usize> {
    let least = row.iter().copied().fold(f64::INFINITY, f64::min);
    let same = row.iter().enumerate().filter(|(_, value)| **value <= least);
    same.map(|(view, _)| view).collect()
}

fn share(views: &[usize], is: impl Fn(usize) -> bool) -> f64 {
    let right = views.iter().filter(|view| is(**view)).count();
    right as f64 / views.len().max(1) as f64
}
