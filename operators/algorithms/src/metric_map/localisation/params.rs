//! What localisation can be told, with the reasons for its defaults.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::metric_map::features::FeatureNoise;
use crate::metric_map::matching::MatchLimits;
use crate::metric_map::odometry::OdometryScale;

/// How a drive is localised.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct LocalisationParams {
    /// How exactly features lie. Covariances are scaled by the residuals found; this weighs features against landmarks'
    /// own uncertainty and odometry.
    #[serde(flatten)]
    pub features: FeatureNoise,
    /// Which descriptors are of one landmark; the next best one is that of the next landmark or feature of another
    /// spot.
    #[serde(flatten)]
    pub limits: MatchLimits,
    /// Radius in which a pose is verified (px), at least four times `sigma_px`: four radii of inliers, so that chance
    /// gives one match in sixteen as inlier.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub verify_px: f64,
    /// Largest radius of a search (px): a quarter of a radian at 127 px/rad.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub search_px: f64,
    /// Fewest inliers of a fix: 30 equations for 6 unknowns.
    #[schemars(range(min = 6))]
    pub min_inliers: usize,
    /// Smallest share of inliers among the matches within `verify_px`; by chance it is 0.06.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub min_inlier_share: f64,
    /// Fewest of 24 directions that inliers lie in: 12 sectors around the vehicle, above and below the cameras' horizon
    /// apart. One parked car that moved fills two or three.
    pub min_directions: usize,
    /// Largest standard deviation of a localised position in any direction (m): five of them are the half metre that
    /// must never be missed.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub max_sigma_m: f64,
    /// Largest standard deviation of a localised orientation about any axis (rad).
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub max_sigma_rad: f64,
    /// What the map's landmarks around a keyframe are off by together, along each axis (m); no number of inliers
    /// averages it out, and nothing in a session shows it. 1.5 cm along each of three axes is a map with an error of
    /// 2.6 cm RMSE, as two loops of a car park give. 0: covariances relative to the landmarks nearby.
    #[schemars(range(min = 0.0))]
    pub map_m: f64,
    /// What they are turned by together, about each axis (rad): `map_m` over some fifteen metres.
    #[schemars(range(min = 0.0))]
    pub map_rad: f64,
    /// Odometry's distance, of which a guess allows for five standard deviations. Scale and yaw drift are learned along
    /// the drive; this is not reduced.
    #[serde(flatten)]
    pub odometry: OdometryScale,
    /// Standard deviation of odometry's heading by distance (rad/m), as guesses of the next pose allow for.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub odometry_yaw_rad_per_m: f64,
    /// Standard deviation of roll and pitch by distance (rad/m), and of height by distance: planar odometry says nothing
    /// about a floor's slope of up to 3 % between two halves.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub tilt_rad_per_m: f64,
    /// A guess with a larger standard deviation of position is given up, and the place recognised anew (m).
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub give_up_m: f64,
    /// Keyframes, of the next six or the six before, that must be localised from a recovered one before it counts.
    #[schemars(range(min = 1))]
    pub confirmations: usize,
    /// By how many places, 2 m apart, those of a stretch that are for the map must outnumber those against it: a place is
    /// for it where more of what is recognised lies here than elsewhere. Each is worth a factor of 3: seven are odds of
    /// 1000 to 1, and the shortest stretch that is believed is 12 m long. 0: another place of the same layout is taken
    /// for this one.
    pub evidence_places: usize,
    /// Landmarks farther than this are not looked for (m): at 127 px/rad a metre is three pixels.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub reach_m: f64,
    /// How far outside the cone that it was seen from a landmark is looked for (rad): binary descriptors bear some 20°
    /// of change of view.
    #[schemars(range(min = 0.0))]
    pub view_slack_rad: f64,
    /// How far outside the ranges that it was seen at a landmark is looked for, as a factor: about an octave of scale
    /// from end to end.
    #[schemars(range(min = 1.0))]
    pub range_slack: f64,
}

impl Default for LocalisationParams {
    fn default() -> Self {
        Self {
            features: FeatureNoise::default(),
            limits: MatchLimits::default(),
            verify_px: 12.0,
            search_px: 40.0,
            min_inliers: 15,
            min_inlier_share: 0.4,
            min_directions: 4,
            max_sigma_m: 0.1,
            max_sigma_rad: 0.02,
            map_m: 0.015,
            map_rad: 0.001,
            odometry: OdometryScale::default(),
            odometry_yaw_rad_per_m: 0.02,
            tilt_rad_per_m: 0.03,
            give_up_m: 0.5,
            confirmations: 4,
            evidence_places: 7,
            reach_m: 40.0,
            view_slack_rad: 0.35,
            range_slack: 1.5,
        }
    }
}

/// A verification so narrow that chance would not fill it evenly.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[error("expected verify_px of at least 4 times sigma_px ({sigma_px} px), found {verify_px}")]
pub struct NarrowVerification {
    /// The radius.
    pub verify_px: f64,
    /// The features' standard deviation.
    pub sigma_px: f64,
}

impl LocalisationParams {
    /// Whether the parameters go together.
    ///
    /// # Errors
    /// [`NarrowVerification`].
    pub fn check(&self) -> Result<(), NarrowVerification> {
        let Self {
            verify_px,
            features: FeatureNoise { sigma_px },
            ..
        } = *self;
        if verify_px >= 4.0 * sigma_px {
            return Ok(());
        }
        Err(NarrowVerification {
            verify_px,
            sigma_px,
        })
    }
}
