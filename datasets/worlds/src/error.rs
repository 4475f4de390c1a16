//! What can go wrong when a world is written.

use std::path::{Path, PathBuf};

/// Why a world was not written.
#[derive(Debug, thiserror::Error)]
pub enum WorldError {
    /// Parameters that make no world (the user's to change).
    #[error("these parameters make no world:\n{}", faults.join("\n"))]
    Parameters {
        /// One line for each unusable value.
        faults: Vec<String>,
    },
    /// A file could not be written (a resource is missing).
    #[error("cannot write {}: {source}; check the folder's rights and free space", path.display())]
    Io {
        /// Which file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The MCAP writer refused a message (a bug).
    #[error("cannot write MCAP: {0}")]
    Mcap(#[from] mcap::McapError),
    /// The JPEG encoder refused an image (a bug).
    #[error("cannot encode JPEG: {0}")]
    Jpeg(#[from] jpeg_encoder::EncodingError),
    /// The PNG encoder refused the overhead picture (a bug or a full disk).
    #[error("cannot encode PNG: {0}")]
    Png(#[from] png::EncodingError),
}

impl WorldError {
    pub(crate) fn io(path: &Path, source: std::io::Error) -> Self {
        Self::Io {
            path: path.to_owned(),
            source,
        }
    }
}

/// A parameter: its name and value, and the least and the most that it may be.
pub(crate) type Limits<'a> = (&'a str, f64, f64, f64);

/// Refuses values outside their limits, and says what else is wrong, all at once.
pub(crate) fn check(
    limits: &[Limits<'_>],
    others: impl IntoIterator<Item = String>,
) -> Result<(), WorldError> {
    let outside = limits
        .iter()
        .filter(|(_, value, low, high)| !(low..=high).contains(&value));
    let faults: Vec<String> = outside
        .map(|(name, value, low, high)| {
            format!("{name}: expected {low} to {high}, found {value}; choose a value inside")
        })
        .chain(others)
        .collect();
    if faults.is_empty() {
        Ok(())
    } else {
        Err(WorldError::Parameters { faults })
    }
}
