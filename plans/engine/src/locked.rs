//! What threads share, each in its turn.

use std::sync::{Mutex, MutexGuard, PoisonError};

/// What a mutex holds, also where a thread that held it has panicked.
pub fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
