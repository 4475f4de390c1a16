//! How long something takes.

use std::time::Instant;

/// The shortest of several runs in seconds, each from the same start, and what it gave.
pub fn shortest<T>(repeat: usize, mut run: impl FnMut() -> T) -> (f64, T) {
    let mut timed = || {
        let start = Instant::now();
        let result = run();
        (start.elapsed().as_secs_f64(), result)
    };
    let mut best = timed();
    for _ in 1..repeat {
        let next = timed();
        if next.0 < best.0 {
            best = next;
        }
    }
    best
}

/// Seconds that this process's threads have been on a core: on a busy machine, a clock would measure the neighbours.
/// Linux only; it resolves some milliseconds.
///
/// # Errors
/// Where the kernel does not tell.
pub fn processor_seconds() -> Result<f64, crate::Failure> {
    let mut nanoseconds = 0.0;
    for task in std::fs::read_dir("/proc/self/task")? {
        let text = std::fs::read_to_string(task?.path().join("schedstat"))?;
        nanoseconds += text.split(' ').next().unwrap_or_default().parse::<f64>()?;
    }
    Ok(1e-9 * nanoseconds)
}
