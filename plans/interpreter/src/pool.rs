//! Workers that wait for the next call of the function that they have loaded.

use std::collections::VecDeque;
use std::sync::{Mutex, MutexGuard, PoisonError};

use evermap_schemas::Fault;

use crate::Function;
use crate::worker::Worker;

/// Workers that wait; the longest waiting first.
static IDLE: Mutex<VecDeque<Worker>> = Mutex::new(VecDeque::new());

fn idle() -> MutexGuard<'static, VecDeque<Worker>> {
    IDLE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A worker that has loaded the function: one that waits, or a new one.
pub(crate) fn take(function: &Function) -> Result<Worker, Fault> {
    let digest = function.digest()?;
    let waiting = {
        let mut idle = idle();
        let found = idle.iter().rposition(|worker| worker.loaded == digest);
        found.and_then(|index| idle.remove(index))
    };
    match waiting {
        Some(worker) => Ok(worker),
        None => Worker::start(function, digest),
    }
}

/// Keeps a worker for the next call. No more wait than there are cores: each has packages in memory.
pub(crate) fn put_back(worker: Worker) {
    let most = std::thread::available_parallelism().map_or(1, usize::from);
    let ended = {
        let mut idle = idle();
        idle.push_back(worker);
        match idle.len() > most {
            true => idle.pop_front(),
            false => None,
        }
    };
    drop(ended);
}
