//! Calls into a library that panics where it should return an error: of a polygon whose border crosses itself, `geo` cannot
//! always tell inside from outside.

use std::cell::Cell;
use std::panic::{self, AssertUnwindSafe, catch_unwind};

use datafusion::common::{DataFusionError, Result};

thread_local! {
    static GUARDED: Cell<bool> = const { Cell::new(false) };
}

/// Has panics that become errors not be told beside them: the hook that there is hears of all others.
pub fn keep_guarded_panics_quiet() {
    let tell = panic::take_hook();
    panic::set_hook(Box::new(move |panic| {
        if !GUARDED.get() {
            tell(panic);
        }
    }));
}

/// What a computation gives; `None` where it panics, which nobody else is told.
pub fn caught<T>(of: impl FnOnce() -> T) -> Option<T> {
    let outer = GUARDED.replace(true);
    let given = catch_unwind(AssertUnwindSafe(of));
    GUARDED.set(outer);
    given.ok()
}

/// What a computation on geometries gives.
///
/// # Errors
/// Where it panics.
pub(crate) fn guarded<T>(of: impl FnOnce() -> T) -> Result<T> {
    caught(of).ok_or_else(|| {
        DataFusionError::Execution(
            "expected valid geometries, found one that nothing can be computed of, such as a polygon whose border crosses itself".to_owned(),
        )
    })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::panic)]
    use super::*;

    #[test]
    fn a_panic_is_an_error_and_the_next_call_is_guarded_anew() {
        assert_eq!(guarded(|| guarded(|| 1).ok()).ok(), Some(Some(1)));
        let error = guarded(|| panic!("no side")).map(|(): ()| ());
        assert!(error.is_err_and(|error| error.to_string().contains("expected valid geometries")));
        assert!(!GUARDED.get());
    }
}
