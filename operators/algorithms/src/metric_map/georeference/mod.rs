//! Where a map lies on earth, from GNSS fixes on its poses.
//!
//! The map stays rigid: its origin's place and the direction of its x axis are found, no more. Its z axis is taken to be
//! up. Least squares over errors that drift (`noise`), started from the two fixes that most others agree with
//! (Rousseeuw, *Least median of squares regression*, 1984), so that a receiver that was far off for up to half of the time
//! does no harm.

mod noise;
#[cfg(test)]
mod tests;

use std::collections::BTreeSet;

use nalgebra::{DVector, Matrix3, Rotation2, Vector2, Vector3};

use crate::geometry::geodesy::{Geodetic, Tangent};
use crate::solving::median::median;
use crate::solving::random::SplitMix64;
use noise::{Fit, Linear, OUTLIER, Sample, fit, fitted, misfits};

/// A GNSS fix whose antenna has a place in the map.
#[derive(Debug, Clone, Copy)]
pub struct AntennaFix {
    /// Number of the session; fixes are given by session and time.
    pub session: usize,
    /// When it was made.
    pub seconds: f64,
    /// The antenna in the map, metres.
    pub map: Vector3<f64>,
    /// The antenna on earth; height 0 where it is not known.
    pub earth: Geodetic,
    /// Whether the height is known.
    pub has_height: bool,
    /// The receiver's own standard deviations, along the ground and of the height, metres.
    pub sd_m: [Option<f64>; 2],
}

/// Where a map lies.
#[derive(Debug, Clone, PartialEq)]
pub struct Placement {
    /// The map's origin; height 0 where no fix has one.
    pub origin: Geodetic,
    /// Direction of the map's x axis, counter-clockwise from east, in (-π, π].
    pub heading_rad: f64,
    /// Of the origin's east and north (m) and the heading (rad).
    pub covariance: Matrix3<f64>,
    /// Standard deviation of the height; `None` where no fix has one.
    pub height_sd_m: Option<f64>,
    /// Fixes that are off by more than five standard deviations.
    pub outliers: usize,
    /// White noise of a fix along east and along north, metres.
    pub noise_m: f64,
    /// Standard deviation of the drift beside it, metres, and the time in which it forgets itself, seconds.
    pub drift: Option<[f64; 2]>,
}

/// Why fixes place nothing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PlacementError {
    /// Fewer than three.
    TooFew,
    /// They say where the map is, and not how it is turned: the drive was too short for their noise.
    NoHeading,
}

/// A heading that is less sure than this says nothing, radians: 6°.
const MOST_HEADING_SD: f64 = 0.1;
/// Fixes this far from the middle one are of no receiver beside it, metres.
const FARTHEST_M: f64 = 100_000.0;
/// Fixes that a guess is scored by, and guesses.
const SCORED: usize = 500;
const GUESSES: usize = 500;

/// Places a map by its fixes.
///
/// # Errors
/// [`PlacementError`] where they do not say where it is.
pub fn placement(fixes: &[AntennaFix]) -> Result<Placement, PlacementError> {
    let middle = middle(fixes).ok_or(PlacementError::TooFew)?;
    let earth = middle.to_earth();
    let near = |fix: &&AntennaFix| (fix.earth.to_earth() - earth).norm() < FARTHEST_M;
    let near: Vec<AntennaFix> = fixes.iter().filter(near).copied().collect();
    let (kept, start) = believed(&near, middle)?;
    let samples = samples(&kept, 0);
    let ground = Ground::new(&kept, Tangent::at(middle));
    let found = fitted(&samples, start, &|state| ground.linear(state));
    let mut fit_now = found.ok_or(PlacementError::NoHeading)?;
    let mut up = height(&kept, middle);
    let mut origin = origin(middle, &fit_now, up.as_ref());
    // East and north turn from place to place, so the plane must touch the earth where the map begins.
    for _ in 0..3 {
        let ground = Ground::new(&kept, Tangent::at(origin));
        let start = DVector::from_vec(vec![fit_now.state[0], 0.0, 0.0]);
        let again = fit(
            &samples,
            start,
            fit_now.drift,
            &|state| ground.linear(state),
            5,
        );
        fit_now = again.ok_or(PlacementError::NoHeading)?;
        up = height(&kept, origin);
        origin = self::origin(origin, &fit_now, up.as_ref());
    }
    let mut found = placed(&fit_now, origin, up.as_ref(), fixes.len() - kept.len())?;
    let [ground_m2, height_m2] = [
        hidden_m2(&kept, 0, Some(&fit_now)),
        hidden_m2(&kept, 1, up.as_ref()),
    ];
    found.covariance[(0, 0)] += ground_m2;
    found.covariance[(1, 1)] += ground_m2;
    found.height_sd_m = found.height_sd_m.map(|sd| sd.hypot(height_m2.sqrt()));
    Ok(found)
}

/// Variance of an error that fixes do not show among themselves, as it stays the same for a whole drive: what the receiver
/// says of its errors beyond what was found, averaged over the drives.
fn hidden_m2(fixes: &[AntennaFix], kind: usize, found: Option<&Fit>) -> f64 {
    let said: Option<Vec<f64>> = fixes.iter().map(|fix| fix.sd_m[kind]).collect();
    let (Some(said), Some(found)) = (said, found) else {
        return 0.0;
    };
    let said = median(said).unwrap_or_default();
    let shown = found.noise_m.powi(2) * (1.0 + found.drift.sd.powi(2));
    let drives: BTreeSet<usize> = fixes.iter().map(|fix| fix.session).collect();
    (said * said - shown).max(0.0) / drives.len().max(1) as f64
}

/// The fixes that lie where most others say, before anything is known of drifts, and a state to begin with.
fn believed(
    near: &[AntennaFix],
    middle: Geodetic,
) -> Result<(Vec<AntennaFix>, DVector<f64>), PlacementError> {
    if near.len() < 3 {
        return Err(PlacementError::TooFew);
    }
    let ground = Ground::new(near, Tangent::at(middle));
    let start = ground.guess().ok_or(PlacementError::NoHeading)?;
    let off = misfits(&samples(near, 0), start.clone(), &|state| {
        ground.linear(state)
    });
    let off = off.ok_or(PlacementError::NoHeading)?;
    let fine = near.iter().zip(off).filter(|(_, off)| *off <= OUTLIER);
    let kept: Vec<AntennaFix> = fine.map(|(fix, _)| *fix).collect();
    match kept.len() < 3 {
        true => Err(PlacementError::TooFew),
        false => Ok((kept, start)),
    }
}

fn placed(
    found: &Fit,
    origin: Geodetic,
    up: Option<&Fit>,
    far: usize,
) -> Result<Placement, PlacementError> {
    let of = |i: usize, j: usize| found.covariance[(i, j)];
    if of(0, 0).sqrt() > MOST_HEADING_SD {
        return Err(PlacementError::NoHeading);
    }
    #[rustfmt::skip]
    let covariance = Matrix3::new(
        of(1, 1), of(1, 2), of(1, 0),
        of(2, 1), of(2, 2), of(2, 0),
        of(0, 1), of(0, 2), of(0, 0),
    );
    let drift =
        (found.drift.sd > 0.0).then_some([found.drift.sd * found.noise_m, found.drift.seconds]);
    let off = found.misfits.iter().filter(|misfit| **misfit > OUTLIER);
    Ok(Placement {
        origin,
        heading_rad: Rotation2::new(found.state[0]).angle(),
        covariance,
        height_sd_m: up.map(|up| up.covariance[(0, 0)].sqrt()),
        outliers: far + off.count(),
        noise_m: found.noise_m,
        drift,
    })
}

/// The place whose coordinates are the medians of all; `None` where there are none.
fn middle(fixes: &[AntennaFix]) -> Option<Geodetic> {
    let earth: Vec<Vector3<f64>> = fixes.iter().map(|fix| fix.earth.to_earth()).collect();
    let along = |axis: usize| median(earth.iter().map(|point| point[axis]).collect());
    let point = Vector3::new(along(0)?, along(1)?, along(2)?);
    Some(Geodetic::from_earth(&point))
}

/// Where the map's origin is by what was found on a plane that touches the earth at `tangent`.
fn origin(tangent: Geodetic, ground: &Fit, up: Option<&Fit>) -> Geodetic {
    let height_m = up.map_or(0.0, |up| up.state[0]);
    let [east, north] = [ground.state[1], ground.state[2]];
    Tangent::at(Geodetic {
        height_m: 0.0,
        ..tangent
    })
    .geodetic(&Vector3::new(east, north, 0.0))
    .with_height(height_m)
}

impl Geodetic {
    fn with_height(self, height_m: f64) -> Self {
        Self { height_m, ..self }
    }
}

/// The samples of fixes: their receiver's standard deviations count beside those of the others, as receivers differ in
/// what they call one. Where one of them does not know it, all count alike.
fn samples(fixes: &[AntennaFix], kind: usize) -> Vec<Sample> {
    let known: Option<Vec<f64>> = fixes.iter().map(|fix| fix.sd_m[kind]).collect();
    let sds = known.unwrap_or_else(|| vec![1.0; fixes.len()]);
    let middle = median(sds.clone()).unwrap_or(1.0);
    let sample = |(fix, sd): (&AntennaFix, &f64)| Sample {
        session: fix.session,
        seconds: fix.seconds,
        // Ten times as sure as the others is nobody who shares their sky.
        variance: (sd / middle).clamp(0.1, 100.0).powi(2),
    };
    fixes.iter().zip(&sds).map(sample).collect()
}

/// Height of the map's origin above the ellipsoid, on a plane that touches the earth at `tangent`.
fn height(fixes: &[AntennaFix], tangent: Geodetic) -> Option<Fit> {
    let known: Vec<AntennaFix> = fixes.iter().filter(|fix| fix.has_height).copied().collect();
    let plane = Tangent::at(tangent.with_height(0.0));
    let rises: Vec<f64> = known
        .iter()
        .map(|fix| plane.enu(fix.earth).z - fix.map.z)
        .collect();
    let start = median(rises.clone())?;
    let model = |state: &DVector<f64>| Linear {
        axes: 1,
        width: 2,
        rows: rises
            .iter()
            .flat_map(|rise| [rise - state[0], 1.0])
            .collect(),
    };
    fitted(&samples(&known, 1), DVector::from_vec(vec![start]), &model)
}

/// Antennas on the map and on a plane that touches the earth. A state is a heading, then east and north of the map's
/// origin.
struct Ground {
    map: Vec<Vector2<f64>>,
    earth: Vec<Vector2<f64>>,
}

impl Ground {
    fn new(fixes: &[AntennaFix], plane: Tangent) -> Self {
        Self {
            map: fixes.iter().map(|fix| fix.map.xy()).collect(),
            earth: fixes.iter().map(|fix| plane.enu(fix.earth).xy()).collect(),
        }
    }

    fn linear(&self, state: &DVector<f64>) -> Linear {
        let turn = Rotation2::new(state[0]);
        let shift = Vector2::new(state[1], state[2]);
        let mut rows = Vec::with_capacity(8 * self.map.len());
        for (map, earth) in self.map.iter().zip(&self.earth) {
            let turned = turn * map;
            let off = earth - turned - shift;
            rows.extend([off.x, -turned.y, 1.0, 0.0]);
            rows.extend([off.y, turned.x, 0.0, 1.0]);
        }
        Linear {
            axes: 2,
            width: 4,
            rows,
        }
    }

    /// The state that two fixes give and most others agree with; `None` where no two lie apart.
    fn guess(&self) -> Option<DVector<f64>> {
        let count = self.map.len();
        let step = count.div_ceil(SCORED);
        let scored: Vec<usize> = (0..count).step_by(step).collect();
        let mut random = SplitMix64(1);
        let mut best: Option<(f64, DVector<f64>)> = None;
        for _ in 0..GUESSES {
            let pair = [random.below(count), random.below(count)];
            let Some(state) = self.of_pair(pair) else {
                continue;
            };
            let turn = Rotation2::new(state[0]);
            let shift = Vector2::new(state[1], state[2]);
            let off = |at: &usize| (self.earth[*at] - turn * self.map[*at] - shift).norm();
            let error = median(scored.iter().map(off).collect())?;
            if best.as_ref().is_none_or(|(known, _)| error < *known) {
                best = Some((error, state));
            }
        }
        best.map(|(_, state)| state)
    }

    fn of_pair(&self, [a, b]: [usize; 2]) -> Option<DVector<f64>> {
        let [on_map, on_earth] = [&self.map, &self.earth].map(|points| points[b] - points[a]);
        if on_map.norm() < 1.0 || on_earth.norm() < 0.1 {
            return None;
        }
        let heading = on_earth.y.atan2(on_earth.x) - on_map.y.atan2(on_map.x);
        let turn = Rotation2::new(heading);
        let middle = |points: &[Vector2<f64>]| (points[a] + points[b]) / 2.0;
        let shift = middle(&self.earth) - turn * middle(&self.map);
        Some(DVector::from_vec(vec![heading, shift.x, shift.y]))
    }
}
