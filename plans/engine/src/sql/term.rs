//! How long somebody waits for a query, and how what computes for it learns that nobody does any more.
//!
//! Who waits leaves at a deadline, or goes. A task is told by being dropped, and one that computes is dropped when it pauses.
//! So the term of a query is with the task that polls it, and with those that DataFusion spawns for it, and functions ask
//! whether it is over ([`go_on`]). It could be in the settings that functions are called with (`ConfigOptions`), but those
//! belong to a context, which all queries on a version share, and to plans that were made before.

use std::any::Any;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Once};
use std::time::Instant;

use datafusion::common::Result;
use datafusion::common::runtime::{JoinSetTracer, set_join_set_tracer};
use evermap_schemas::Fault;
use futures::FutureExt;
use futures::future::BoxFuture;
use tokio::task::futures::TaskLocalFuture;

use crate::error::external;

tokio::task_local! {
    /// The term of what a task works on.
    static TERM: Term;
}

/// The term of a query: until an instant, or until somebody ends it. By default it has no end.
#[derive(Debug, Clone, Default)]
pub struct Term(Arc<End>);

#[derive(Debug, Default)]
struct End {
    deadline: Option<(Instant, Fault)>,
    has_come: AtomicBool,
}

impl Term {
    /// The term until an instant, and what is told of work that is not done by then.
    pub fn until(instant: Instant, told: Fault) -> Self {
        Self(Arc::new(End {
            deadline: Some((instant, told)),
            has_come: AtomicBool::new(false),
        }))
    }

    /// Ends it before.
    pub fn end(&self) {
        self.0.has_come.store(true, Ordering::Relaxed);
    }

    /// Work in this term, in whatever tasks DataFusion spawns for it. Of terms within each other the inner one holds.
    pub fn of<F: Future>(&self, work: F) -> TaskLocalFuture<Self, F> {
        pass_on();
        TERM.scope(self.clone(), work)
    }

    /// The term of what this task works on; one that has no end, where it has none.
    pub fn of_task() -> Self {
        TERM.try_with(Self::clone).unwrap_or_default()
    }

    /// Whether it is over.
    pub fn is_over(&self) -> bool {
        self.told().is_some()
    }

    /// What is told, where it is over.
    fn told(&self) -> Option<Fault> {
        if self.0.has_come.load(Ordering::Relaxed) {
            return Some(Fault::user("stopped"));
        }
        let (instant, told) = self.0.deadline.as_ref()?;
        (Instant::now() >= *instant).then(|| told.clone())
    }
}

/// Says whether to go on with what this task works on.
///
/// # Errors
/// Where its term is over.
pub(crate) fn go_on() -> Result<()> {
    match TERM.try_with(Term::told) {
        Ok(Some(told)) => Err(external(told)),
        // What has no term goes on, as units of a run.
        Ok(None) | Err(_) => Ok(()),
    }
}

/// Has the tasks that DataFusion spawns take over the term of the task that spawns them.
fn pass_on() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        if set_join_set_tracer(&PassedOn).is_err() {
            tracing::warn!(
                "another library looks after the tasks of queries: those that compute end late"
            );
        }
    });
}

struct PassedOn;

impl JoinSetTracer for PassedOn {
    fn trace_future(
        &self,
        work: BoxFuture<'static, Box<dyn Any + Send>>,
    ) -> BoxFuture<'static, Box<dyn Any + Send>> {
        match TERM.try_with(Term::clone) {
            Ok(term) => TERM.scope(term, work).boxed(),
            Err(_) => work,
        }
    }

    fn trace_block(
        &self,
        work: Box<dyn FnOnce() -> Box<dyn Any + Send> + Send>,
    ) -> Box<dyn FnOnce() -> Box<dyn Any + Send> + Send> {
        match TERM.try_with(Term::clone) {
            Ok(term) => Box::new(move || TERM.sync_scope(term, work)),
            Err(_) => work,
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use std::time::Duration;

    use datafusion::common::runtime::SpawnedTask;

    use super::*;

    #[tokio::test]
    async fn work_and_the_tasks_of_it_hear_that_its_term_is_over_and_no_others() {
        let term = Term::default();
        let spawned = async || {
            let task = SpawnedTask::spawn(async { go_on().is_ok() });
            let blocking = SpawnedTask::spawn_blocking(|| go_on().is_ok());
            [task.join().await.unwrap(), blocking.join().await.unwrap()]
        };
        assert_eq!(term.of(spawned()).await, [true, true]);
        term.end();
        assert_eq!(term.of(spawned()).await, [false, false]);
        assert_eq!(spawned().await, [true, true]);
    }

    #[tokio::test]
    async fn what_computes_without_a_pause_asks_the_term_of_its_task() {
        let term = Term::default();
        let own = term.of(async { Term::of_task() }).await;
        assert!(!own.is_over());
        term.end();
        assert!(own.is_over());
        assert!(!Term::of_task().is_over());
    }

    #[tokio::test]
    async fn a_deadline_is_told_as_who_set_it_says() {
        let now = Term::until(Instant::now(), Fault::resource("it took too long"));
        let told = now.of(async { go_on() }).await.unwrap_err().to_string();
        assert!(told.contains("it took too long"), "{told}");
        let later = Instant::now() + Duration::from_secs(3600);
        let later = Term::until(later, Fault::resource("never"));
        // The inner one holds.
        assert!(now.of(later.of(async { go_on() })).await.is_ok());
    }
}
