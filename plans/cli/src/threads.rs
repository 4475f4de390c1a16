//! The threads that a command runs on.

use std::io;
use std::num::NonZero;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{Builder, JoinHandle, available_parallelism, park};

use evermap_engine::sql::STACK_BYTES;
use evermap_schemas::Fault;
use tokio::runtime::{self, Runtime};

use crate::arguments::Command;

/// Threads of a server, beside those that read files. A query that computes for long without a pause keeps its thread;
/// others answer meanwhile.
const SERVING: usize = 16;

/// Threads beside, one to read files and one that sees to the network.
const BESIDE: usize = 2;

/// What runs a command.
///
/// # Errors
/// A resource fault where the system has fewer threads than it takes.
pub fn runtime(command: &Command) -> Result<Runtime, Fault> {
    let mut threads = runtime::Builder::new_multi_thread();
    let mut count = available_parallelism().map_or(1, NonZero::get);
    let mut stack_bytes = None;
    if !matches!(command, Command::Inspect(_)) {
        // Queries are planned as deep as they nest.
        threads.thread_stack_size(STACK_BYTES);
        stack_bytes = Some(STACK_BYTES);
    }
    if matches!(command, Command::Serve(_)) {
        threads.worker_threads(SERVING);
        count = SERVING;
    }
    // The library panics where it gets no thread, and waits for ever for those that it got.
    let there = try_out(count + BESIDE, stack_bytes);
    let refused = |error: io::Error| {
        Fault::resource(format!("cannot start {count} threads: {error}")).next(
            "raise the limits of processes and of memory (ulimit -u, ulimit -v, those of the container)",
        )
    };
    there
        .and_then(|()| threads.enable_all().build())
        .map_err(refused)
}

/// What hears signals and the clock on the thread that waits for them, however long those of [`runtime`] compute without a
/// pause: while all of them do, none of them would.
///
/// # Errors
/// A resource fault where the system lets nobody listen.
pub fn listening() -> Result<Runtime, Fault> {
    let thread = runtime::Builder::new_current_thread().enable_all().build();
    thread.map_err(|error| Fault::resource(format!("cannot listen to signals: {error}")))
}

/// That the system has so many threads more: it starts them, and ends them again.
///
/// # Errors
/// Why it has not.
fn try_out(count: usize, stack_bytes: Option<usize>) -> io::Result<()> {
    let ended = Arc::new(AtomicBool::new(false));
    let begin = || {
        let ended = Arc::clone(&ended);
        let builder =
            stack_bytes.map_or_else(Builder::new, |bytes| Builder::new().stack_size(bytes));
        builder.spawn(move || {
            while !ended.load(Ordering::Acquire) {
                park();
            }
        })
    };
    let mut begun: Vec<JoinHandle<()>> = Vec::new();
    let tried = (0..count).try_for_each(|_| {
        begun.push(begin()?);
        Ok(())
    });
    ended.store(true, Ordering::Release);
    for thread in begun {
        thread.thread().unpark();
        let _ = thread.join();
    }
    tried
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn threads_are_tried_out_and_ended() {
        try_out(3, None).unwrap();
        try_out(3, Some(1 << 20)).unwrap();
        // More than there are addresses.
        assert!(try_out(3, Some(1 << 50)).is_err());
    }
}
