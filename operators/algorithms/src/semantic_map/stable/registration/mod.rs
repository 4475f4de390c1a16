//! Where one panorama was taken, seen from another: dense registration in six degrees of freedom.
//!
//! ```text
//!  two panoramas ──► pyramids ──► starts (headings, places around) ──► coarsest ──► best few ──► … ──► finest
//! ```
//!
//! Paper 3 (map update with an occlusion model), equation 2, which is printed garbled: the photometric error of the
//! reference warped by its range into the other panorama, coarse to fine. What is beyond it: inverse range is compared as
//! well, which light does not change. It leads alone down to the finest size, where brightness, up to a gain and an
//! offset, is asked too: years apart, shadows lie elsewhere, and textures fit anywhere once in a pixel's width. Which of
//! several places is the right one, brightness tells at every size, by its correlation within tiles of the image. How far
//! residuals scatter is measured at every step, so that what is unreliable counts less; the loss is not Huber's but one
//! that lets go of what moved; the covariance takes into account that neighbouring residuals are of one thing, and how much
//! flatter the loss is than derivatives of images say; and a registration says that it failed. What is known to move should have its range taken out: a car parked beside one of the
//! two views fills a quarter of it.

mod alignment;
mod options;
mod pyramid;
mod starts;
mod uncertainty;

use nalgebra::Matrix6;

use crate::geometry::pose::Pose;
use crate::semantic_map::stable::sphere::Sphere;
use alignment::{Aligner, points};
pub use options::Options;
use pyramid::Level;
use starts::Aligned;

/// Where another panorama was taken.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Registration {
    /// The other optical frame in the reference's.
    pub reference_from_other: Pose,
    /// Covariance of that pose along the axes of the other frame: translation (m²), then rotation (rad²). If the place is the
    /// right one: it does not know of others.
    pub covariance: Matrix6<f64>,
    /// Of the reference's points with range, the share that the other sees as well.
    pub overlap: f64,
    /// Of what those tell of the place, the share that is as it should be: walls and trunks tell, the ground does not.
    pub inliers: f64,
    /// Correlation of brightness over those points at the finest size, within tiles of the image; `None` where an image has
    /// no structure.
    pub correlation: Option<f64>,
    /// Brightness there is the first times brightness here, and the second (of 255).
    pub brightness: [f64; 2],
    /// Whether to believe it.
    pub state: State,
}

/// Whether a registration is to be believed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum State {
    /// It rests where range and brightness agree.
    Converged,
    /// Too few of the reference's points are seen by the other.
    FewSeen,
    /// Too few of those are where they should be.
    FewInliers,
    /// What is seen there is not as bright and dark as it should be.
    Unlike,
    /// Another place fits nearly as well.
    Ambiguous,
    /// It does not say well enough where the other was.
    Uncertain,
    /// It did not come to rest.
    Restless,
}

impl State {
    /// In a word or two, as tables have it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Converged => "converged",
            Self::FewSeen => "few seen",
            Self::FewInliers => "few inliers",
            Self::Unlike => "unlike",
            Self::Ambiguous => "ambiguous",
            Self::Uncertain => "uncertain",
            Self::Restless => "restless",
        }
    }
}

/// A panorama at all sizes, ready to be registered with others.
#[derive(Debug, Clone)]
pub struct Pyramid {
    /// The finest first.
    levels: Vec<Level>,
}

/// Steps at each size, at most; at the two coarsest, where they cost little and the way is long, twice as many.
const STEPS: usize = 10;
/// Brightness has a valley of a pixel's width, in which a step is short.
const FINEST_STEPS: usize = 25;
/// The coarsest panoramas are at least this wide (px): 5.6 degrees a pixel.
const COARSEST_PX: usize = 64;

impl Pyramid {
    /// Of a panorama; `None` where its images do not have the size of its lens.
    pub fn new(sphere: &Sphere<'_>, options: &Options) -> Option<Self> {
        if !sphere.is_sound() {
            return None;
        }
        let mut levels = vec![Level::finest(sphere, options.nearest_m)];
        while let Some(last) = levels.last()
            && last.lens.width >= 2 * COARSEST_PX
            && last.lens.height >= 8
            && let Some(half) = last.halved(options.nearest_m)
        {
            levels.push(half);
        }
        Some(Self { levels })
    }
}

/// Registers two panoramas. `guess` is `reference_from_other` as far as it is known; where nothing is, all headings and
/// places around are tried. `None` where one has hardly any range.
pub fn register(
    reference: &Pyramid,
    other: &Pyramid,
    guess: Option<&Pose>,
    options: &Options,
) -> Option<Registration> {
    let sizes = reference.levels.len().min(other.levels.len());
    let levels = reference.levels[..sizes].iter().zip(&other.levels);
    let mut candidates = starts::starts(guess, options);
    let mut last = None;
    for (size, (here, there)) in levels.enumerate().rev() {
        let points = points(here, options.points as usize);
        let mut aligner = Aligner::new(&points, there, size == 0);
        let steps = match size {
            0 => FINEST_STEPS,
            size if sizes - size <= 2 => 2 * STEPS,
            _ => STEPS,
        };
        let starts = candidates.iter();
        let mut aligned: Vec<Aligned> = starts
            .filter_map(|start| aligner.align(*start, steps))
            .collect();
        aligned.sort_by(|a, b| b.1.share().total_cmp(&a.1.share()));
        let places = starts::kept(size, sizes, aligned);
        candidates = places.iter().map(|(estimate, ..)| *estimate).collect();
        if let (0, Some((estimate, best, _))) = (size, places.first()) {
            let second = places.get(1).map_or(0.0, |(_, second, _)| second.share());
            // How well the best other place fits, as a share of how well this one does.
            let runner_up = second / best.share().max(f64::MIN_POSITIVE);
            let (estimate, fit, rests) = aligner.align(*estimate, 1)?;
            let covariance = aligner.covariance(&estimate, &fit)?;
            last = Some((estimate, fit, runner_up, rests, covariance));
        }
    }
    let (estimate, fit, runner_up, rests, covariance) = last?;
    Some(Registration {
        reference_from_other: estimate.other_from_reference.inverse(),
        state: options.state(&fit, runner_up, &covariance, rests),
        covariance,
        overlap: fit.overlap,
        inliers: fit.inliers,
        correlation: fit.correlation,
        brightness: estimate.brightness,
    })
}
