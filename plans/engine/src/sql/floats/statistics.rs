//! Variances, covariances and regressions. Where a number is infinite or NaN they are NaN. DataFusion has the variance of
//! one infinity for 0, takes sums of squares from each other, which leaves noise of large numbers, and does not say how well
//! a line fits that is level.

use std::sync::Arc;

use arrow::array::{ArrayRef, AsArray, Float64Array, UInt64Array};
use arrow::datatypes::{DataType, Field, FieldRef, Float64Type, UInt64Type};
use datafusion::common::{Result, ScalarValue};
use datafusion::logical_expr::utils::format_state_name;

use crate::sql::floats::percentile::between;
use crate::sql::measures::{Measure, Spread};

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
    /// How much of the dependent number the line tells: the square of [`Self::Correlation`], and all where it is level.
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

    /// `None` where one of the numbers is always the same.
    fn correlation(self) -> Option<f64> {
        let is_open = self.xx == 0.0 || self.yy == 0.0;
        let count = self.count as f64;
        let (off_x, off_y) = ((self.xx / count).sqrt(), (self.yy / count).sqrt());
        (!is_open).then(|| self.xy / count / off_x / off_y)
    }

    /// `None` of a line that stands upright, or is a point.
    fn slope(self) -> Option<f64> {
        (self.xx != 0.0).then(|| self.xy / self.xx)
    }

    fn determination(self) -> Option<f64> {
        let slope = self.slope()?;
        Some(match self.yy == 0.0 {
            true => 1.0,
            false => slope * (self.xy / self.yy),
        })
    }

    /// Numbers of floating point, as they stand in the columns behind [`Self::count`].
    fn numbers(self) -> [f64; 5] {
        [self.mean_x, self.mean_y, self.xx, self.yy, self.xy]
    }
}

/// What columns of partial answers are called.
const COLUMNS: [&str; 5] = ["mean_x", "mean_y", "xx", "yy", "xy"];

/// The columns of partial answers.
pub fn state_fields(name: &str) -> Vec<FieldRef> {
    let field = |column: &str, kind: DataType| -> FieldRef {
        let name = format_state_name(name, column);
        Arc::new(Field::new(name, kind, true))
    };
    let numbers = COLUMNS.map(|column| field(column, DataType::Float64));
    std::iter::once(field("count", DataType::UInt64))
        .chain(numbers)
        .collect()
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
    type Aggregate = Moments;

    /// Of one column each number is its own pair.
    fn parts(&self, values: &[ArrayRef]) -> Vec<Option<Moments>> {
        let (Some(first), Some(last)) = (values.first(), values.last()) else {
            return Vec::new();
        };
        let (y, x) = (
            first.as_primitive::<Float64Type>(),
            last.as_primitive::<Float64Type>(),
        );
        let pairs = y.iter().zip(x).map(|(y, x)| y.zip(x));
        let pairs = pairs.map(|pair| pair.map(|(y, x)| Moments::of(y, x)));
        pairs.collect()
    }

    /// By the formulas of Chan, Golub and LeVeque.
    fn joined(&self, before: Moments, after: Moments) -> Moments {
        let count = before.count + after.count;
        let share = after.count as f64 / count as f64;
        let (x, y) = (after.mean_x - before.mean_x, after.mean_y - before.mean_y);
        let weight = before.count as f64 * share;
        Moments {
            count,
            mean_x: between(before.mean_x, after.mean_x, share),
            mean_y: between(before.mean_y, after.mean_y, share),
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

impl Spread for Statistic {
    fn answers(&self, all: Vec<Option<Moments>>) -> ArrayRef {
        let all = all.into_iter();
        match self {
            Self::Count => Arc::new(UInt64Array::from_iter_values(
                all.map(|all| all.map_or(0, |all| all.count)),
            )),
            _ => {
                let numbers = all.map(|all| all.and_then(|all| self.number(all)));
                Arc::new(numbers.collect::<Float64Array>())
            }
        }
    }

    fn columns(&self, parts: Vec<Option<Moments>>) -> Vec<ArrayRef> {
        let counts = parts.iter().map(|part| part.map_or(0, |part| part.count));
        let counts: ArrayRef = Arc::new(UInt64Array::from_iter_values(counts));
        let column = |at: usize| -> ArrayRef {
            let numbers = parts.iter().map(|part| part.map(|part| part.numbers()[at]));
            Arc::new(numbers.collect::<Float64Array>())
        };
        let numbers = (0..COLUMNS.len()).map(column);
        std::iter::once(counts).chain(numbers).collect()
    }

    fn of_columns(&self, columns: &[ArrayRef]) -> Vec<Option<Moments>> {
        let [counts, mean_x, mean_y, xx, yy, xy] = columns else {
            return Vec::new();
        };
        let number = |column: &ArrayRef, row| column.as_primitive::<Float64Type>().value(row);
        let counts = counts.as_primitive::<UInt64Type>().values().iter();
        let parts = counts.enumerate().map(|(row, &count)| {
            (count > 0).then(|| Moments {
                count,
                mean_x: number(mean_x, row),
                mean_y: number(mean_y, row),
                xx: number(xx, row),
                yy: number(yy, row),
                xy: number(xy, row),
            })
        });
        parts.collect()
    }
}
