//! Values whose type the compiler does not look into, which threads share.
//!
//! An async method of a trait is a future that threads may pass on. So the compiler looks at all that it holds, down to the
//! last part, anew in each method: of a session of DataFusion these are thousands. What is held as [`Erased`], or comes from
//! a function that boxes its future, was looked at once, where it was made. `docs/decisions/0024-futures-hold-erased-values.md`
//! tells what that saves.

use std::ops::Deref;
use std::sync::Arc;

/// A value that threads share.
pub type Erased<T> = Arc<dyn Deref<Target = T> + Send + Sync>;

/// Shares a value.
pub fn erased<T: Send + Sync + 'static>(value: T) -> Erased<T> {
    Arc::new(Box::new(value))
}
