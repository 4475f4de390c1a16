//! Pixels told apart by classifiers that are learnt, and labels that follow the edges of images.
//!
//! | module | what it knows |
//! |---|---|
//! | [`calibration`] | what a score is worth: a probability, from answers |
//! | [`dense_crf`] | labels that follow an image's edges: the fully connected random field |
//! | [`gaussian_process`] | a linear function and how surely it is known, from a few answers |
//! | [`perceptron`] | networks of one hidden layer over bytes, several of which vote |
//! | [`permutohedral`] | Gaussian filters in many dimensions |
//! | [`pixel_classifier`] | scores of classes over an image, by a forest or a network |
//! | [`pixel_features`] | what a classifier of pixels sees: dense SIFT, colour, context, and what a taught network sees |
//! | [`random_forest`] | decision trees over bytes, learnt and read fast |
//! | [`samples`] | what they learn from, and which models may score it |

pub mod calibration;
pub mod dense_crf;
pub mod gaussian_process;
pub mod perceptron;
pub mod permutohedral;
pub mod pixel_classifier;
pub mod pixel_features;
pub mod random_forest;
pub mod samples;
