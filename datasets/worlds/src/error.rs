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
