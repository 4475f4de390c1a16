//! What localisation can be told, with the reasons for its defaults.

/// How a drive is localised. The operator's page gives the same reasons at more length.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LocalisationParams {
    /// Standard deviation of a feature's place in the image, pixels: quantisation of a corner to a pixel (0.3) and
    /// what the descriptor's neighbourhood shifts between two views. Covariances are scaled by the residuals found;
    /// this only weighs features against landmarks' own uncertainty and odometry.
    pub feature_px: f64,
    /// Descriptors farther apart than this many of 512 bits are not of one landmark.
    pub match_bits: u32,
    /// A landmark's descriptor distance, over that of the next landmark that could be meant, is below this.
    pub match_ratio: f64,
    /// Radius in which a pose is verified, pixels: several times the noise, so that chance fills it evenly.
    pub verify_px: f64,
    /// Largest radius of a search, pixels.
    pub search_px: f64,
    /// Fewest inliers of a fix.
    pub min_inliers: usize,
    /// Smallest share of inliers among the matches within `verify_px`.
    pub min_inlier_share: f64,
    /// Fewest directions, of 24 equal parts of the sphere around the vehicle, that inliers lie in.
    pub min_directions: usize,
    /// Largest standard deviation of a localised position in any direction, metres.
    pub max_sigma_m: f64,
    /// Largest standard deviation of a localised orientation about any axis, radians.
    pub max_sigma_rad: f64,
    /// What the map's landmarks around a keyframe are off by together, along each axis, metres: no number of them
    /// averages it out. Added to every pose's uncertainty.
    pub map_m: f64,
    /// What they are turned by together, about each axis, radians.
    pub map_rad: f64,
    /// Odometry: standard deviation of driven distance over distance.
    pub odometry_scale: f64,
    /// Odometry: standard deviation of heading per distance, radians per metre.
    pub odometry_yaw_rad_per_m: f64,
    /// Standard deviation of roll and pitch per distance, which planar odometry does not measure, radians per metre.
    pub tilt_rad_per_m: f64,
    /// A guess whose position is less certain than this in any direction is given up, metres.
    pub give_up_m: f64,
    /// Keyframes beside a recovered one that must confirm it.
    pub confirmations: usize,
    /// Largest distance of landmarks that are looked for, metres.
    pub reach_m: f64,
    /// How far outside the cone that it was seen from a landmark is still looked for, radians.
    pub view_slack_rad: f64,
    /// How far outside the ranges that it was seen at a landmark is still looked for, as a factor.
    pub range_slack: f64,
}

impl Default for LocalisationParams {
    fn default() -> Self {
        Self {
            feature_px: 0.7,
            match_bits: 90,
            match_ratio: 0.85,
            verify_px: 12.0,
            search_px: 40.0,
            min_inliers: 15,
            min_inlier_share: 0.4,
            min_directions: 4,
            max_sigma_m: 0.1,
            max_sigma_rad: 0.02,
            map_m: 0.015,
            map_rad: 0.001,
            odometry_scale: 0.05,
            odometry_yaw_rad_per_m: 0.02,
            tilt_rad_per_m: 0.03,
            give_up_m: 0.5,
            confirmations: 4,
            reach_m: 40.0,
            view_slack_rad: 0.35,
            range_slack: 1.5,
        }
    }
}

/// A parameter that makes no sense.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("expected {name} {expected}, found {found}")]
pub struct LocalisationParamsError {
    /// Its name.
    pub name: &'static str,
    /// What would do.
    pub expected: &'static str,
    /// What was given.
    pub found: f64,
}

impl LocalisationParams {
    /// Checks every parameter.
    ///
    /// # Errors
    /// [`LocalisationParamsError`] names the first that makes no sense.
    pub fn check(&self) -> Result<(), LocalisationParamsError> {
        let positive = [
            ("feature_px", self.feature_px),
            ("search_px", self.search_px),
            ("max_sigma_m", self.max_sigma_m),
            ("max_sigma_rad", self.max_sigma_rad),
            ("odometry_scale", self.odometry_scale),
            ("odometry_yaw_rad_per_m", self.odometry_yaw_rad_per_m),
            ("tilt_rad_per_m", self.tilt_rad_per_m),
            ("give_up_m", self.give_up_m),
            ("reach_m", self.reach_m),
        ];
        for (name, found) in positive {
            need(name, "> 0", found, found > 0.0 && found.is_finite())?;
        }
        let share = self.min_inlier_share;
        need(
            "min_inlier_share",
            "of 0 to 1",
            share,
            (0.0..=1.0).contains(&share),
        )?;
        let ratio = self.match_ratio;
        need(
            "match_ratio",
            "above 0, at most 1",
            ratio,
            ratio > 0.0 && ratio <= 1.0,
        )?;
        for (name, found) in [("map_m", self.map_m), ("map_rad", self.map_rad)] {
            need(name, ">= 0", found, found >= 0.0 && found.is_finite())?;
        }
        let wide = self.verify_px >= 4.0 * self.feature_px && self.verify_px.is_finite();
        need("verify_px", ">= 4 feature_px", self.verify_px, wide)?;
        let slack = self.view_slack_rad;
        need("view_slack_rad", ">= 0", slack, slack >= 0.0)?;
        let slack = self.range_slack;
        need(
            "range_slack",
            ">= 1",
            slack,
            slack >= 1.0 && slack.is_finite(),
        )?;
        let inliers = self.min_inliers;
        need("min_inliers", ">= 6", inliers as f64, inliers >= 6)?;
        let confirmations = self.confirmations;
        need(
            "confirmations",
            ">= 1",
            confirmations as f64,
            confirmations >= 1,
        )
    }
}

fn need(
    name: &'static str,
    expected: &'static str,
    found: f64,
    sound: bool,
) -> Result<(), LocalisationParamsError> {
    if sound {
        Ok(())
    } else {
        Err(LocalisationParamsError {
            name,
            expected,
            found,
        })
    }
}
