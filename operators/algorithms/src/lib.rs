//! The mathematics of evermap, without Arrow, OpenCV, files or clocks.
//!
//! Pure functions and plain types: everything here is `Send + Sync`, gives the same answer on
//! every run and any number of threads, and can be tested with numbers alone.
//!
//! | module | what it knows |
//! |---|---|
//! | [`pose`] | rigid transforms, checked at the door |
//! | [`camera`] | lens models: rays from pixels and pixels from rays |
//! | [`rig`] | cameras fixed to one vehicle |
//! | [`class_scores`] | probabilities of classes over an image |
//! | [`dense_crf`] | labels that follow an image's edges: the fully connected random field |
//! | [`features`] | key points with binary descriptors |
//! | [`association`] | which features of which keyframes show the same landmark |
//! | [`bundle_adjustment`] | poses and landmarks from all observations at once |
//! | [`least_squares`] | factors, robust losses, trust regions, sparse Cholesky |
//! | [`lie`] | rotations and rigid motions with their Jacobians |
//! | [`localisation`] | a drive's poses in a map it did not make |
//! | [`mapping`] | association, triangulation and adjustment in turns, until a map is accurate |
//! | [`matching`] | descriptors to descriptors |
//! | [`permutohedral`] | Gaussian filters in many dimensions |
//! | [`pixel_classifier`] | scores of classes over an image, by a random forest |
//! | [`pixel_features`] | what a classifier of pixels sees: dense SIFT, colour, context |
//! | [`places`] | a binary vocabulary, and keyframes that look alike |
//! | [`pose_graph`] | odometry and loops relaxed into consistent poses |
//! | [`relocation`] | where in a map a view was taken, by the graph of what it shows, and how well a method tells |
//! | [`random_forest`] | decision trees over bytes, learnt and read fast |
//! | [`resection`] | a rig's pose from points and rays, with outliers |
//! | [`temporal_votes`] | what neighbouring views say about a view's pixels |
//! | [`tracking`] | features followed through a camera's keyframes |
//! | [`trajectory`] | alignment and errors of trajectories |
//! | [`drive`] | keyframes at equal steps of driven path |
//! | [`semantic_graph`] | label images as areas that touch, and where they lie of one another |
//! | [`road_network`] | lanes and intersections from driven positions |
//! | [`ground`] | images projected to cells of the ground plane |
//! | [`tiles`] | tile addressing and exact integer sums |

pub mod association;
pub mod bundle_adjustment;
pub mod camera;
pub mod class_scores;
pub mod dense_crf;
pub mod drive;
pub mod features;
pub mod ground;
pub mod least_squares;
pub mod lie;
pub mod localisation;
pub mod mapping;
pub mod matching;
pub mod permutohedral;
pub mod pixel_classifier;
pub mod pixel_features;
pub mod places;
pub mod pose;
pub mod pose_graph;
pub mod random_forest;
pub mod relocation;
pub mod resection;
pub mod rig;
pub mod road_network;
pub mod semantic_graph;
pub mod temporal_votes;
pub mod tiles;
pub mod tracking;
pub mod trajectory;

mod random;
#[cfg(test)]
mod shared_data;
