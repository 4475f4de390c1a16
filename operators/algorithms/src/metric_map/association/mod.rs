//! Which features of which keyframes show the same landmark.
//!
//! Tracks follow a point through the images of one camera until it leaves the view. The same point is tracked again
//! by the next camera, on the next loop and in the next session. Two keyframes at one place do not pull each other
//! into line until somebody says that these tracks are *one* landmark: that is done here, and it is where the
//! accuracy of a map is won.
//!
//! ```text
//! tracks ──triangulate──▶ landmarks ──project into every keyframe that may see them──▶ predicted pixels
//!                            ▲                                                            │ features nearby in the
//!                            │                                                            │ image, alike by descriptor,
//!                            │                                                            ▼ of fitting size, unrivalled
//!                   merged landmarks ◀──union-find, consistent──  hits that agree with one rigid move of the keyframe
//! ```
//!
//! **Agreement.** A car park repeats itself: pillars and markings look alike and stand at equal distances. A hit
//! counts only if the keyframe as a whole, all of its cameras together, can be moved by one small rigid motion so
//! that most hits fit (`resight.rs`). Hits on landmarks of the keyframe's own surroundings in time and hits on those
//! of other visits are treated apart, as only the latter are off by the drift that is to be removed. The motion found
//! is also used to look again, in a smaller circle: that finds near landmarks, which are off by most pixels.
//!
//! **Merging.** Two landmarks become one if at least two images say so, if no image shows them as two different
//! features, and if one point explains the features of both. Decisions are taken in the order of votes, so the
//! result depends on nothing but the input.
//!
//! The projection-and-descriptor search is that of paper 1 (IV-C) and of map points in ORB-SLAM (Mur-Artal, Montiel &
//! Tardós 2015, V-D and VI-B); the ratio test is Lowe's (2004, 7.1).

mod appearance;
mod description;
mod descriptor_source;
mod merge;
mod point;
mod resight;
mod scene;
mod search;
mod target;

pub use description::{Description, describe};
pub use descriptor_source::{DescriptorSource, descriptors_of};
pub use merge::associate;
pub use point::{LandmarkPoint, Sight, triangulate};
pub use scene::{FeatureRef, Scene, SceneFeature, SceneImage, SceneKeyframe};
pub use search::Hit;

use nalgebra::Vector3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::metric_map::matching::MatchLimits;

/// A point of the world and the features that show it.
#[derive(Debug, Clone, PartialEq)]
pub struct Landmark {
    /// Its name. Where two become one, the name of the earlier one in the list stays.
    pub id: u32,
    /// Where it is, metres in the map.
    pub point: Vector3<f64>,
    /// The features, at most one of each image, sorted.
    pub features: Vec<FeatureRef>,
}

/// How features are sought and landmarks merged.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct AssociationParams {
    /// Radius around the predicted pixel that is searched, pixels. About what poses are off by, as seen from the
    /// landmark: smaller from round to round.
    #[serde(skip)]
    pub radius_px: f64,
    /// Which descriptors are alike; the next best one is that of another spot in the circle.
    #[serde(flatten)]
    pub limits: MatchLimits,
    /// Features sought may be seen under an angle so much larger than the landmark was seen under so far, radians.
    #[serde(skip)]
    pub view_margin_rad: f64,
    /// Range and size of the feature may differ by this factor from what was seen so far.
    #[serde(skip)]
    pub scale_factor: f64,
    /// Hits that agree with a keyframe's motion lie nearer than this, pixels.
    #[serde(skip)]
    pub agree_px: f64,
    /// Hits of one keyframe on landmarks of other visits that must agree before any of them counts.
    #[serde(skip)]
    pub min_agreeing: usize,
    /// Keyframes before and after that are the same visit.
    #[serde(skip)]
    pub visit_keyframes: u32,
    /// Images that must say that two landmarks are one.
    #[serde(skip)]
    pub min_votes: u32,
}

impl Default for AssociationParams {
    fn default() -> Self {
        Self {
            radius_px: 8.0,
            limits: MatchLimits::default(),
            view_margin_rad: 0.5,
            scale_factor: 1.6,
            agree_px: 3.0,
            min_agreeing: 15,
            visit_keyframes: 20,
            min_votes: 2,
        }
    }
}
