//! What can go wrong when a world is written.

use evermap_recording::RecordingError;
use schemars::JsonSchema;
use serde::Serialize;
use serde_json::Value;
use std::path::Path;

/// Why a world was not written.
#[derive(Debug, thiserror::Error)]
pub enum WorldError {
    /// Parameters that make no world (the user's to change).
    #[error("invalid parameters:\n{}", faults.join("\n"))]
    Parameters {
        /// One line for each unusable value.
        faults: Vec<String>,
    },
    /// A file could not be written.
    #[error(transparent)]
    File(#[from] RecordingError),
    /// Nobody wants it any more (the user's decision).
    #[error("stopped")]
    Stopped,
    /// The JPEG encoder refused an image (a bug).
    #[error("cannot encode JPEG: {0}")]
    Jpeg(#[from] jpeg_encoder::EncodingError),
    /// The PNG encoder refused the overhead picture (a bug or a full disk).
    #[error("cannot encode PNG: {0}")]
    Png(#[from] png::EncodingError),
}

impl WorldError {
    pub(crate) fn io(path: &Path, source: std::io::Error) -> Self {
        let path = path.to_owned();
        Self::File(RecordingError::Io { path, source })
    }
}

/// Refuses values outside what their fields declare (`range`, and `enum` for a text), and says what else is wrong, all
/// at once.
pub(crate) fn check<W: Serialize + JsonSchema>(
    world: &W,
    others: impl IntoIterator<Item = Option<String>>,
) -> Result<(), WorldError> {
    let schema = schemars::schema_for!(W).to_value();
    let values = serde_json::to_value(world).unwrap_or_default();
    let fields = schema["properties"].as_object().into_iter().flatten();
    let misfits = fields.map(|(name, declared)| {
        let expected = misfit(declared, &values[name])?;
        let found = &values[name];
        Some(format!(
            "{name}: expected {expected}, found {found}; choose another value"
        ))
    });
    let faults: Vec<String> = misfits.chain(others).flatten().collect();
    if faults.is_empty() {
        Ok(())
    } else {
        Err(WorldError::Parameters { faults })
    }
}

/// What was expected of a value that is not as its field declares.
fn misfit(declared: &Value, value: &Value) -> Option<String> {
    let bound = |key: &str| declared[key].as_f64();
    if let (Some(least), Some(most)) = (bound("minimum"), bound("maximum")) {
        let inside = value
            .as_f64()
            .is_some_and(|value| (least..=most).contains(&value));
        return (!inside).then(|| format!("{least} to {most}"));
    }
    let known = declared["enum"].as_array()?;
    (!value.is_null() && !known.contains(value)).then(|| format!("one of {}", declared["enum"]))
}
