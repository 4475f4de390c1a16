//! "Bundle adjustment in the large": the field's benchmark, its text format and its camera.
//!
//! Source: Agarwal, Snavely, Seitz, Szeliski, *Bundle Adjustment in the Large* (ECCV 2010). A
//! camera is nine numbers: rotation vector, translation (both `camera_from_world`), focal length in
//! pixels, k1, k2. It looks along *minus* z:
//!
//! ```text
//! P = R X + t      p = -(Px, Py) / Pz      pixel = f (1 + k1 |p|² + k2 |p|⁴) p
//! ```
//!
//! Rotation vectors are moved by adding to them, as the benchmark's other solvers do.

use std::fmt::Write as _;

use evermap_algorithms::geometry::lie::so3;
use evermap_algorithms::metric_map::bundle_adjustment::schur::{
    Bundle, Linear, LinearSolver, Schur, Sight, Terms,
};
use evermap_algorithms::solving::least_squares::{Options, Summary, SystemError, minimise};
use nalgebra::{Matrix3, Vector3};

/// A point in an image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Observation {
    /// Index of the camera.
    pub camera: usize,
    /// Index of the point.
    pub point: usize,
    /// Where it was seen, pixels from the image's centre.
    pub pixel: [f64; 2],
}

/// A problem of the benchmark.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Problem {
    /// Rotation vector, translation, focal length, k1, k2 of each camera.
    pub cameras: Vec<[f64; 9]>,
    /// Points in the world.
    pub points: Vec<[f64; 3]>,
    /// Points in images.
    pub observations: Vec<Observation>,
}

/// Why a text is no problem.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum BalError {
    /// The text ends early.
    #[error("expected {what}, found the end of the text after {after} numbers")]
    End {
        /// What should come.
        what: &'static str,
        /// Numbers read before.
        after: usize,
    },
    /// A word is not the number expected.
    #[error("number {position}: expected {what}, found \"{found}\"")]
    Number {
        /// Which of the numbers, from 1.
        position: usize,
        /// What should be there.
        what: &'static str,
        /// The word.
        found: String,
    },
}

struct Words<'a> {
    words: std::str::SplitAsciiWhitespace<'a>,
    read: usize,
}

impl Words<'_> {
    fn next<T: std::str::FromStr>(
        &mut self,
        what: &'static str,
        good: impl Fn(&T) -> bool,
    ) -> Result<T, BalError> {
        let after = self.read;
        let word = self.words.next().ok_or(BalError::End { what, after })?;
        self.read += 1;
        let number = word.parse().ok().filter(good);
        number.ok_or_else(|| BalError::Number {
            position: self.read,
            what,
            found: word.chars().take(40).collect(),
        })
    }

    fn finite<const N: usize>(&mut self, what: &'static str) -> Result<[f64; N], BalError> {
        let mut numbers = [0.0; N];
        for number in &mut numbers {
            *number = self.next(what, |x: &f64| x.is_finite())?;
        }
        Ok(numbers)
    }
}

/// Reads the benchmark's text: counts of cameras, points and observations, the observations
/// (camera, point, x, y), the cameras, the points.
///
/// # Errors
/// [`BalError`] says which number was not as expected. Counts that promise more than the text
/// has are found out by its end, not believed.
pub fn read(text: &str) -> Result<Problem, BalError> {
    let mut words = Words {
        words: text.split_ascii_whitespace(),
        read: 0,
    };
    let fits = |count: &u32| *count < u32::MAX;
    let cameras: u32 = words.next("a number of cameras", fits)?;
    let points: u32 = words.next("a number of points", fits)?;
    let observations: u32 = words.next("a number of observations", fits)?;
    let mut problem = Problem::default();
    for _ in 0..observations {
        let camera: u32 = words.next("the index of a camera", |index| *index < cameras)?;
        let point: u32 = words.next("the index of a point", |index| *index < points)?;
        problem.observations.push(Observation {
            camera: camera as usize,
            point: point as usize,
            pixel: words.finite("a coordinate")?,
        });
    }
    for _ in 0..cameras {
        let camera = words.finite("a camera's parameter")?;
        problem.cameras.push(camera);
    }
    for _ in 0..points {
        let point = words.finite("a point's coordinate")?;
        problem.points.push(point);
    }
    Ok(problem)
}

/// Writes the benchmark's text, with all digits.
pub fn write(problem: &Problem) -> String {
    let mut text = String::new();
    let counts = [
        problem.cameras.len(),
        problem.points.len(),
        problem.observations.len(),
    ];
    // Writing to a string cannot fail.
    let _ = writeln!(text, "{} {} {}", counts[0], counts[1], counts[2]);
    for seen in &problem.observations {
        let [x, y] = seen.pixel;
        let _ = writeln!(text, "{} {} {x:e} {y:e}", seen.camera, seen.point);
    }
    let cameras = problem.cameras.as_flattened().iter();
    for number in cameras.chain(problem.points.as_flattened()) {
        let _ = writeln!(text, "{number:e}");
    }
    text
}

/// Adjusts cameras and points in place, without a robust loss, as the benchmark has it.
/// Observations of cameras or points that do not exist are left out.
///
/// # Errors
/// [`SystemError`] when it does not fit.
pub fn solve(
    problem: &mut Problem,
    options: &Options,
    solver: LinearSolver,
) -> Result<Summary, SystemError> {
    let (cameras, points) = (problem.cameras.len(), problem.points.len());
    let exists = |seen: &&Observation| seen.camera < cameras && seen.point < points;
    let seen: Vec<Observation> = problem
        .observations
        .iter()
        .filter(exists)
        .copied()
        .collect();
    let sights = seen.iter().enumerate().map(|(index, seen)| Sight {
        landmark: seen.point as u32,
        block: seen.camera as u32,
        observation: index as u32,
    });
    let sights = sights.collect();
    let poses: Vec<Posed> = problem.cameras.iter().map(Posed::new).collect();
    let bundle = Cameras {
        trial: poses.clone(),
        estimate: poses,
        seen: &seen,
    };
    let points = problem.points.clone();
    let mut schur = Schur::new(bundle, cameras, points, sights, &[], solver)?;
    let summary = minimise(&mut schur, options);
    let (bundle, points) = schur.into_estimate();
    let estimate = bundle.estimate.iter();
    problem.cameras = estimate.map(|posed| posed.parameters).collect();
    problem.points = points;
    Ok(summary)
}

/// A camera's parameters and what follows from them.
#[derive(Clone)]
struct Posed {
    parameters: [f64; 9],
    rotation: Matrix3<f64>,
    /// How `R X` turns with the rotation vector: `d(R X) = -[R X]× J d`.
    turn: Matrix3<f64>,
}

struct Cameras<'a> {
    estimate: Vec<Posed>,
    trial: Vec<Posed>,
    seen: &'a [Observation],
}

impl Posed {
    fn new(parameters: &[f64; 9]) -> Self {
        let angle = Vector3::new(parameters[0], parameters[1], parameters[2]);
        Self {
            parameters: *parameters,
            rotation: so3::exp(&angle).to_rotation_matrix().into_inner(),
            turn: so3::left_jacobian(&angle),
        }
    }

    /// `R X`, `p` and 1/Pz.
    #[inline(always)]
    fn image(&self, point: &[f64; 3]) -> (Vector3<f64>, [f64; 2], f64) {
        let turned = self.rotation * Vector3::from(*point);
        let [_, _, _, tx, ty, tz, ..] = self.parameters;
        let near = 1.0 / (turned.z + tz);
        let p = [-(turned.x + tx) * near, -(turned.y + ty) * near];
        (turned, p, near)
    }

    /// The pixel of a point.
    fn project(&self, point: &[f64; 3]) -> [f64; 2] {
        let (_, p, _) = self.image(point);
        let [.., focal, k1, k2] = self.parameters;
        let n = p[0] * p[0] + p[1] * p[1];
        let scale = focal * (1.0 + n * (k1 + k2 * n));
        [scale * p[0], scale * p[1]]
    }

    /// Residual and derivatives of an observation.
    fn linearise(&self, point: &[f64; 3], pixel: [f64; 2]) -> Linear<9> {
        let (turned, p, near) = self.image(point);
        let [.., focal, k1, k2] = self.parameters;
        let n = p[0] * p[0] + p[1] * p[1];
        let bend = 1.0 + n * (k1 + k2 * n);
        let slope = 2.0 * (k1 + 2.0 * k2 * n);
        let mut linear = Linear::ZERO;
        for row in 0..2 {
            linear.residual[row] = focal * bend * p[row] - pixel[row];
            let mut by_p = [focal * slope * p[row] * p[0], focal * slope * p[row] * p[1]];
            by_p[row] += focal * bend;
            let towards = by_p[0] * p[0] + by_p[1] * p[1];
            let by_point = Vector3::new(by_p[0], by_p[1], towards) * -near;
            let by_angle = self.turn.tr_mul(&turned.cross(&by_point));
            let by_world = self.rotation.tr_mul(&by_point);
            linear.camera[row] = [
                by_angle.x,
                by_angle.y,
                by_angle.z,
                by_point.x,
                by_point.y,
                by_point.z,
                bend * p[row],
                focal * n * p[row],
                focal * n * n * p[row],
            ];
            linear.landmark[row] = by_world.into();
        }
        linear
    }
}

fn half_square([x, y]: [f64; 2]) -> f64 {
    0.5 * (x * x + y * y)
}

impl Bundle<9> for Cameras<'_> {
    fn linearise(&self, observation: usize, landmark: &[f64; 3]) -> (f64, Linear<9>) {
        let seen = &self.seen[observation];
        let linear = self.estimate[seen.camera].linearise(landmark, seen.pixel);
        (half_square(linear.residual), linear)
    }

    fn trial_cost(&self, observation: usize, landmark: &[f64; 3]) -> f64 {
        let seen = &self.seen[observation];
        let [x, y] = self.trial[seen.camera].project(landmark);
        half_square([x - seen.pixel[0], y - seen.pixel[1]])
    }

    fn add_terms(&self, _: &mut Terms<'_, 9>) -> f64 {
        0.0
    }

    fn trial_terms_cost(&self) -> f64 {
        0.0
    }

    fn step(&mut self, steps: &[[f64; 9]]) {
        for ((trial, before), step) in self.trial.iter_mut().zip(&self.estimate).zip(steps) {
            let moved = std::array::from_fn(|c| before.parameters[c] + step[c]);
            *trial = Posed::new(&moved);
        }
    }

    fn accept(&mut self) {
        self.estimate.clone_from(&self.trial);
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn jacobians_are_derivatives(
            angle in prop::array::uniform3(-2.0..2.0f64), shift in prop::array::uniform3(-1.0..1.0f64),
            lens in prop::array::uniform2(-0.1..0.1f64), point in prop::array::uniform3(-1.0..1.0f64)
        ) {
            let [a, b, c] = angle;
            let parameters = [a, b, c, shift[0], shift[1], shift[2] - 5.0, 700.0, lens[0], lens[1]];
            let linear = Posed::new(&parameters).linearise(&point, [3.0, 4.0]);
            let at = |parameters: &[f64; 9], point: &[f64; 3]| {
                Posed::new(parameters).project(point)
            };
            for axis in 0..12 {
                let moved = |h: f64| {
                    let (mut camera, mut world) = (parameters, point);
                    if axis < 9 { camera[axis] += h } else { world[axis - 9] += h }
                    at(&camera, &world)
                };
                let (after, before) = (moved(1e-6), moved(-1e-6));
                for row in 0..2 {
                    let numeric = (after[row] - before[row]) / 2e-6;
                    let exact = if axis < 9 {
                        linear.camera[row][axis]
                    } else {
                        linear.landmark[row][axis - 9]
                    };
                    prop_assert!((numeric - exact).abs() < 1e-4 * (1.0 + exact.abs()), "{axis}");
                }
            }
        }

        #[test]
        fn no_text_panics(text in "[0-9 .e-]{0,60}") {
            if let Ok(problem) = read(&text) {
                prop_assert_eq!(read(&write(&problem)).unwrap(), problem);
            }
        }
    }

    #[test]
    fn faults_are_named() {
        let fault = |text: &str| read(text).unwrap_err().to_string();
        assert!(fault("1 1").contains("observations"));
        assert!(fault("1 1 1 1 0 2 3").contains("number 4"));
        assert!(fault("1 1 1 0 0 2 nan").contains("nan"));
        assert!(fault("4000000000 1 0 1 2").contains("the end"));
    }

    /// The optimum that Ceres and others report for this problem.
    #[test]
    fn the_benchmarks_smallest_problem_is_solved() {
        let Some(path) =
            evermap_test_data::shared("data/bundle_adjustment/bal/problem-49-7776-pre.txt")
        else {
            return;
        };
        let initial = read(&std::fs::read_to_string(path).unwrap()).unwrap();
        let options = Options {
            max_iterations: 10,
            ..Options::default()
        };
        for solver in [LinearSolver::Factorised, LinearSolver::Iterative] {
            let summary = solve(&mut initial.clone(), &options, solver).unwrap();
            assert!(
                (summary.initial_cost - 8.509_125e5).abs() < 1.0,
                "{summary:?}"
            );
            assert!(summary.final_cost < 1.45e4, "{solver:?}: {summary:?}");
        }
    }
}
