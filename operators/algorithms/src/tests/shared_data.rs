//! Where the real recordings and simulated worlds lie, for tests that look at them.

#![allow(clippy::print_stderr)]

use std::path::PathBuf;

/// `relative` under `$EVERMAP_SHARED`, else under `shared` beside the repository. Says loudly
/// that the test is skipped when it is not there.
pub(crate) fn find(relative: &str) -> Option<PathBuf> {
    let beside = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared");
    let root = std::env::var_os("EVERMAP_SHARED").map_or_else(|| beside.into(), PathBuf::from);
    let path = root.join(relative);
    if !path.exists() {
        eprintln!(
            "SKIPPED: {} is not there; set EVERMAP_SHARED",
            path.display()
        );
        return None;
    }
    Some(path)
}
