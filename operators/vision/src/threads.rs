//! OpenCV's threads: none, as units are what runs side by side.

use std::sync::OnceLock;

use opencv::core::set_num_threads;

use crate::ImageError;

/// Turns OpenCV's own threads off, once per process.
pub(crate) fn one_thread() -> Result<(), ImageError> {
    static SET: OnceLock<Result<(), ImageError>> = OnceLock::new();
    SET.get_or_init(|| Ok(set_num_threads(1)?)).clone()
}
