//! Processes that wait for the next stream.

use std::sync::{Mutex, MutexGuard, PoisonError};

use crate::protocol::{Answer, Request};
use crate::worker::Worker;
use crate::{Codec, Failure};

static IDLE: Mutex<Vec<Worker>> = Mutex::new(Vec::new());

fn idle() -> MutexGuard<'static, Vec<Worker>> {
    IDLE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A process that has begun a stream: one that waits and still lives, or a new one.
pub(crate) fn take(codec: Codec) -> Result<Worker, Failure> {
    loop {
        let waiting = idle().pop();
        let fresh = waiting.is_none();
        let mut worker = match waiting {
            Some(worker) => worker,
            None => Worker::start()?,
        };
        match worker.ask(Request::Begin(codec), &[]) {
            Ok((Answer::Decoded, _)) => return Ok(worker),
            Ok((_, reason)) => {
                let reason = String::from_utf8_lossy(&reason).into_owned();
                return Err(Failure::Process(reason));
            }
            Err(ended) if fresh => return Err(ended),
            Err(_) => {}
        }
    }
}

/// Keeps a process for the next stream. No more wait than there are cores: each holds FFmpeg in memory.
pub(crate) fn put_back(worker: Worker) {
    let most = std::thread::available_parallelism().map_or(1, usize::from);
    let mut idle = idle();
    if idle.len() < most {
        idle.push(worker);
    }
}
