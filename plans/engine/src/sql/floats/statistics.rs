//! Variances, covariances and regressions of a window that moves.

use arrow::array::{ArrayRef, AsArray};
use arrow::datatypes::Float64Type;
use datafusion::common::{Result, ScalarValue};

use crate::sql::floats::moving::Measure;

/// What is told of numbers, or of pairs of them, the dependent one first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Statistic {
    /// The variance of a sample.
    Variance,
    /// The variance of all that there is.
    VariancePopulation,
    /// The root of [`Self::Variance`].
    Deviation,
    /// The root of [`Self::VariancePopulation`].
    DeviationPopulation,
    /// The covariance of a sample.
    Covariance,
    /// The covariance of all that there is.
    CovariancePopulation,
    /// How well one number follows from the other.
    Correlation,
    /// The slope of the line through the pairs.
    Slope,
    /// Where that line is at zero.
    Intercept,
    /// How many pairs there are.
    Count,
    /// The square of [`Self::Correlation`].
    Determination,
    /// The mean of the independent number.
    MeanX,
    /// The mean of the dependent number.
    MeanY,
    /// The sum of the squares of what the independent number is off its mean.
    SquaresX,
    /// The sum of the squares of what the dependent number is off its mean.
    SquaresY,
    /// The sum of the products of both.
    Products,
}

/// What they are called in SQL.
pub const STATISTICS: [(&str, Statistic); 16] = [
    ("var", Statistic::Variance),
    ("var_pop", Statistic::VariancePopulation),
    ("stddev", Statistic::Deviation),
    ("stddev_pop", Statistic::DeviationPopulation),
    ("covar_samp", Statistic::Covariance),
    ("covar_pop", Statistic::CovariancePopulation),
    ("corr", Statistic::Correlation),
    ("regr_slope", Statistic::Slope),
    ("regr_intercept", Statistic::Intercept),
    ("regr_count", Statistic::Count),
    ("regr_r2", Statistic::Determination),
    ("regr_avgx", Statistic::MeanX),
    ("regr_avgy", Statistic::MeanY),
    ("regr_sxx", Statistic::SquaresX),
    ("regr_syy", Statistic::SquaresY),
    ("regr_sxy", Statistic::Products),
];

/// Means of pairs of numbers, and sums of the products of what they are off them.
#[derive(Debug, Clone, Copy)]
pub struct Moments {
    count: u64,
    mean_x: f64,
    mean_y: f64,
    xx: f64,
    yy: f64,
    xy: f64,
}

impl Moments {
    fn of(y: f64, x: f64) -> Self {
        // Nothing is off its own mean, but infinity and NaN by what is no number.
        let (off_x, off_y) = ((x * 0.0).abs(), (y * 0.0).abs());
        Self {
            count: 1,
            mean_x: x,
            mean_y: y,
            xx: off_x,
            yy: off_y,
            xy: off_x + off_y,
        }
    }

    /// Divided by how many there are, and one less for a sample; `None` of too few.
    fn spread(self, sum: f64, is_sample: bool) -> Option<f64> {
        let by = self.count - u64::from(is_sample);
        (by > 0).then(|| sum / by as f64)
    }

    /// As `corr` tells it of rows that are no window.
    fn correlation(self) -> Option<f64> {
        if self.mean_x.is_nan() && self.mean_y.is_nan() {
            return Some(f64::NAN);
        }
        let is_open = self.count < 2 || self.mean_x.is_nan() || self.mean_y.is_nan();
        let count = self.count as f64;
        let (off_x, off_y) = ((self.xx / count).sqrt(), (self.yy / count).sqrt());
        (!is_open && off_x != 0.0 && off_y != 0.0).then(|| self.xy / count / off_x / off_y)
    }

    fn slope(self) -> Option<f64> {
        (self.count > 1 && self.xx != 0.0).then(|| self.xy / self.xx)
    }

    fn determination(self) -> Option<f64> {
        let is_line = self.count > 1 && self.xx != 0.0 && self.yy != 0.0;
        is_line.then(|| (self.xy / self.xx) * (self.xy / self.yy))
    }
}

impl Statistic {
    fn number(self, of: Moments) -> Option<f64> {
        match self {
            Self::Variance => of.spread(of.xx, true),
            Self::VariancePopulation => of.spread(of.xx, false),
            Self::Deviation => of.spread(of.xx, true).map(f64::sqrt),
            Self::DeviationPopulation => of.spread(of.xx, false).map(f64::sqrt),
            Self::Covariance => of.spread(of.xy, true),
            Self::CovariancePopulation => of.spread(of.xy, false),
            Self::Correlation => of.correlation(),
            Self::Slope => of.slope(),
            Self::Intercept => of.slope().map(|slope| of.mean_y - slope * of.mean_x),
            Self::Count => Some(of.count as f64),
            Self::Determination => of.determination(),
            Self::MeanX => Some(of.mean_x),
            Self::MeanY => Some(of.mean_y),
            Self::SquaresX => Some(of.xx),
            Self::SquaresY => Some(of.yy),
            Self::Products => Some(of.xy),
        }
    }
}

impl Measure for Statistic {
    type Part = Moments;

    /// Of one column each number is its own pair.
    fn parts(&self, values: &[ArrayRef]) -> Vec<Moments> {
        let (Some(first), Some(last)) = (values.first(), values.last()) else {
            return Vec::new();
        };
        let (y, x) = (
            first.as_primitive::<Float64Type>(),
            last.as_primitive::<Float64Type>(),
        );
        let pairs = y.iter().zip(x).filter_map(|(y, x)| y.zip(x));
        pairs.map(|(y, x)| Moments::of(y, x)).collect()
    }

    /// By the formulas of Chan, Golub and LeVeque.
    fn joined(&self, before: Moments, after: Moments) -> Moments {
        let count = before.count + after.count;
        let share = after.count as f64 / count as f64;
        let (x, y) = (after.mean_x - before.mean_x, after.mean_y - before.mean_y);
        let weight = before.count as f64 * share;
        Moments {
            count,
            mean_x: before.mean_x + x * share,
            mean_y: before.mean_y + y * share,
            xx: before.xx + after.xx + x * x * weight,
            yy: before.yy + after.yy + y * y * weight,
            xy: before.xy + after.xy + x * y * weight,
        }
    }

    fn answer(&self, all: Option<Moments>) -> Result<ScalarValue> {
        Ok(match self {
            Self::Count => ScalarValue::UInt64(Some(all.map_or(0, |all| all.count))),
            _ => ScalarValue::Float64(all.and_then(|all| self.number(all))),
        })
    }
}
