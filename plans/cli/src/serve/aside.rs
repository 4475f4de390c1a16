//! Work on a thread that can be left behind: what is planned, and folded meanwhile, may compute for long without a pause, and
//! who waits for it is told in time that it took too long.

use datafusion::common::runtime::SpawnedTask;
use evermap_schemas::Fault;

/// What work says. It is in the term of who asks, by which planning ends soon after it is left.
///
/// # Errors
/// A fault of ours, where the work panics.
pub async fn aside<T: Send + 'static>(
    work: impl Future<Output = T> + Send + 'static,
) -> Result<T, Fault> {
    let done = SpawnedTask::spawn(work).join().await;
    done.map_err(|error| Fault::bug(format!("planning ended: {error}")))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use std::sync::mpsc::channel;
    use std::time::Duration;

    use tokio::time::timeout;

    use super::*;

    #[tokio::test(flavor = "multi_thread", worker_threads = 2)]
    async fn who_waits_leaves_in_time_what_computes_without_a_pause() {
        assert_eq!(aside(async { 7 }).await.unwrap(), 7);
        let (end, ended) = channel::<()>();
        let busy = aside(async move { ended.recv().is_ok() });
        let left = timeout(Duration::from_millis(20), busy).await;
        assert!(left.is_err());
        end.send(()).ok();
    }
}
