//! Why frames are refused that do not follow those before them.

/// Why a frame is refused that needs another one.
pub(crate) const MISSING: &str = "refers to one that did not come";

/// Why a frame is refused that was there before.
pub(crate) const AGAIN: &str = "came before";
