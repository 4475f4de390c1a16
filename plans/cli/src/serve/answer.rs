//! Answers to queries, within bounds.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use arrow::array::RecordBatch;
use arrow::datatypes::SchemaRef;
use datafusion::execution::memory_pool::{MemoryConsumer, MemoryPool, MemoryReservation};
use evermap_engine::error::{OrFault, fault_of};
use evermap_engine::map::columns::of_answer;
use evermap_engine::nodes::weight::weight;
use evermap_engine::sql::{Term, read_only};
use evermap_schemas::Fault;
use futures::future::ready;
use futures::stream::{self, BoxStream};
use futures::{Stream, StreamExt};
use tokio::sync::{OwnedSemaphorePermit, Semaphore, mpsc, oneshot};
use tokio::time::{Instant, timeout_at};

use crate::serve::aside::aside;
use crate::serve::maps::Opened;

/// What a query may take.
#[derive(Clone)]
pub struct Bounds {
    /// Until its answer is read.
    pub timeout: Duration,
    /// Rows of its answer.
    pub rows: u64,
    /// Queries side by side.
    pub queries: Arc<Semaphore>,
    /// The memory that queries share, with what of their answers waits for who reads it.
    pub memory: Arc<dyn MemoryPool>,
}

/// What an item of an answer counts for.
#[derive(Debug, Clone, Copy)]
pub struct Size {
    /// Its rows.
    pub rows: usize,
    /// Bytes of memory.
    pub bytes: usize,
}

impl Size {
    /// That of a batch.
    pub fn of(batch: &RecordBatch) -> Self {
        Self {
            rows: batch.num_rows(),
            bytes: weight(batch),
        }
    }

    /// That of all items together.
    fn of_all<T, E>(items: &[Result<T, E>], size: fn(&T) -> Self) -> Self {
        let sizes = items.iter().flatten().map(size);
        sizes.fold(Self { rows: 0, bytes: 0 }, |all, one| Self {
            rows: all.rows + one.rows,
            bytes: all.bytes + one.bytes,
        })
    }
}

/// The time that a query has, and its place among those that run.
pub struct Turn {
    deadline: Instant,
    timeout: Duration,
    /// Of what computes for it: until the deadline, or until nobody reads its answers any more.
    term: Term,
    /// Answers that somebody reads.
    read: Arc<AtomicUsize>,
    rows: u64,
    memory: Arc<dyn MemoryPool>,
    _place: OwnedSemaphorePermit,
}

impl Bounds {
    /// Waits for a place among the queries that run.
    ///
    /// # Errors
    /// A resource fault when none is free before the query's time is over.
    pub async fn turn(&self) -> Result<Arc<Turn>, Fault> {
        let deadline = Instant::now() + self.timeout;
        let place = timeout_at(deadline, Arc::clone(&self.queries).acquire_owned()).await;
        let busy = || Fault::resource("too many queries run").next("try again later");
        let place = place.map_err(|_| busy())?.map_err(|_| busy())?;
        Ok(Arc::new(Turn {
            deadline,
            timeout: self.timeout,
            term: Term::until(deadline.into_std(), too_long(self.timeout)),
            read: Arc::default(),
            rows: self.rows,
            memory: Arc::clone(&self.memory),
            _place: place,
        }))
    }

    /// What planning alone says, if it ends in time: it needs no place among the queries that run.
    ///
    /// # Errors
    /// A resource fault when the time is over.
    pub async fn planning<T>(&self, work: impl Future<Output = T>) -> Result<T, Fault> {
        let deadline = Instant::now() + self.timeout;
        let term = Term::until(deadline.into_std(), too_long(self.timeout));
        let done = timeout_at(deadline, term.of(work)).await;
        done.map_err(|_| too_long(self.timeout))
    }
}

impl Turn {
    /// What work says, if it ends in time.
    ///
    /// # Errors
    /// What it says, or a resource fault when the time is over.
    pub async fn within<T>(&self, work: impl Future<Output = T>) -> Result<T, Fault> {
        let done = timeout_at(self.deadline, self.term.of(work)).await;
        done.map_err(|_| too_long(self.timeout))
    }

    fn too_many(&self) -> Fault {
        Fault::user(format!("the answer has more than {} rows", self.rows))
            .next("add a LIMIT, or start the server with a larger --rows")
    }

    /// Items of an answer, until time, rows or memory are used up, which is an error in the stream: so many `at_once` as are
    /// ready. `size` measures an item, `error` says a fault as the stream does. Time goes on, and the place is left, whether
    /// somebody reads or not; when all answers of a turn are dropped, what computes for them ends. Items count in the memory
    /// until the next are asked for: who reads them has made something else of them by then, and sent it.
    pub fn bounded<T, E>(
        self: Arc<Self>,
        items: impl Stream<Item = Result<T, E>> + Send + 'static,
        at_once: usize,
        size: fn(&T) -> Size,
        error: fn(Fault) -> E,
    ) -> BoxStream<'static, Result<T, E>>
    where
        T: Send + 'static,
        E: Send + 'static,
    {
        let (send, given) = mpsc::channel(1);
        let (end, ended) = oneshot::channel();
        let items = items.ready_chunks(at_once).boxed();
        let (last, late) = (self.deadline + GRACE, too_long(self.timeout));
        let reader = Reader::of(&self);
        tokio::spawn(async move {
            let done = self.hand_on(items, size, &send).await;
            // The place is free before the reader learns that this is the end.
            drop(self);
            if let Err(fault) = done {
                // Nobody may be left to hear it.
                let _ = end.send(error(fault));
            }
        });
        let next = move |state: Option<(HandedItems<T, E>, Reader, Fault, LastMemory)>| async move {
            let (mut given, reader, late, read) = state?;
            drop(read);
            match timeout_at(last, given.recv()).await {
                Ok(handed) => {
                    let Handed { items, memory } = handed?;
                    Some((items, Some((given, reader, late, Some(memory)))))
                }
                // A computation hears late that its time is over, or not at all.
                Err(_) => Some((vec![Err(error(late))], None)),
            }
        };
        let state = Some((given, reader, late, None));
        let items = stream::unfold(state, next).flat_map(stream::iter);
        let end = stream::once(ended).filter_map(|end| ready(end.ok().map(Err)));
        items.chain(end).boxed()
    }

    /// Hands items on until there are no more, one is an error, or nobody wants them any longer.
    async fn hand_on<T, E>(
        &self,
        mut items: BoxStream<'static, Vec<Result<T, E>>>,
        size: fn(&T) -> Size,
        send: &mpsc::Sender<Handed<T, E>>,
    ) -> Result<(), Fault> {
        let mut count = 0;
        loop {
            let next = tokio::select! {
                next = self.within(items.next()) => next?,
                () = send.closed() => None,
            };
            let Some(some) = next else {
                return Ok(());
            };
            let all = Size::of_all(&some, size);
            count += all.rows as u64;
            if count > self.rows {
                return Err(self.too_many());
            }
            let memory = ReservedMemory::of(&self.memory);
            memory.takes(all.bytes)?;
            let is_end = some.iter().any(Result::is_err);
            let handed = Handed {
                items: some,
                memory,
            };
            if self.within(send.send(handed)).await?.is_err() || is_end {
                return Ok(());
            }
        }
    }
}

fn too_long(timeout: Duration) -> Fault {
    Fault::resource(format!("the query took longer than {timeout:?}"))
        .next("ask for less, or start the server with a larger --timeout-s")
}

/// Somebody who reads an answer of a turn. With the last one goes what computes for it.
struct Reader {
    term: Term,
    read: Arc<AtomicUsize>,
}

impl Reader {
    fn of(turn: &Turn) -> Self {
        turn.read.fetch_add(1, Ordering::AcqRel);
        Self {
            term: turn.term.clone(),
            read: Arc::clone(&turn.read),
        }
    }
}

impl Drop for Reader {
    fn drop(&mut self) {
        if self.read.fetch_sub(1, Ordering::AcqRel) == 1 {
            self.term.end();
        }
    }
}

/// How long who reads waits beyond the deadline for a query that ends by itself, and says why.
const GRACE: Duration = Duration::from_secs(1);

/// Items on their way to who reads them, and the memory that they take.
struct Handed<T, E> {
    items: Vec<Result<T, E>>,
    memory: ReservedMemory,
}

/// The memory that is taken by what an answer is made of, or made into, until it is sent.
pub struct ReservedMemory(MemoryReservation);

impl ReservedMemory {
    /// That of one answer among others, which takes nothing yet.
    pub fn of(memory: &Arc<dyn MemoryPool>) -> Self {
        Self(MemoryConsumer::new("an answer that is being read").register(memory))
    }

    /// Takes so many bytes in place of those that it took.
    ///
    /// # Errors
    /// A resource fault where there are not as many.
    pub fn takes(&self, bytes: usize) -> Result<(), Fault> {
        let full = |fault: Fault| {
            fault.next(
                "read answers as they come, ask for fewer at once, or start the server with a larger --memory",
            )
        };
        self.0.try_resize(bytes).or_fault().map_err(full)
    }
}

/// The memory of the items that were asked for last.
type LastMemory = Option<ReservedMemory>;

/// Where items come from.
type HandedItems<T, E> = mpsc::Receiver<Handed<T, E>>;

/// The rows of a query on a version.
pub struct Answer {
    /// Their columns, with units and frames: batches may say other things of theirs.
    pub schema: SchemaRef,
    /// They, within bounds.
    pub rows: BoxStream<'static, Result<RecordBatch, Fault>>,
    /// For what is made of them and kept, beside those that were asked for last.
    pub memory: ReservedMemory,
}

/// Answers a query that only reads.
///
/// # Errors
/// What is wrong with the query; a resource fault when it has to wait too long.
pub async fn answer(opened: &Opened, query: &str, bounds: &Bounds) -> Result<Answer, Fault> {
    let turn = bounds.turn().await?;
    let (context, query) = (opened.context.clone(), query.to_owned());
    let planned = aside(async move {
        let frame = read_only(&context, &query).await?;
        let plan = frame.logical_plan().clone();
        let stream = frame.execute_stream().await.or_fault()?;
        let schema = of_answer(&context, &plan, &stream.schema()).await;
        Ok::<_, Fault>((schema, stream))
    });
    let (schema, stream) = turn.within(planned).await???;
    let rows = stream.map(|batch| batch.map_err(|error| fault_of(&error)));
    Ok(Answer {
        schema,
        memory: ReservedMemory::of(&bounds.memory),
        rows: turn.bounded(rows, 1, Size::of, |fault| fault),
    })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use datafusion::execution::memory_pool::GreedyMemoryPool;
    use evermap_engine::sql::{Limits, context};
    use evermap_schemas::Kind;

    use super::*;

    fn of_rows(rows: usize) -> Size {
        Size { rows, bytes: 0 }
    }

    fn bounds(timeout: Duration, rows: u64) -> Bounds {
        Bounds {
            timeout,
            rows,
            queries: Arc::new(Semaphore::new(1)),
            memory: Arc::new(GreedyMemoryPool::new(1000)),
        }
    }

    /// Waits, for a minute at most.
    async fn until(is_so: impl Fn() -> bool) {
        let soon = async {
            while !is_so() {
                tokio::time::sleep(Duration::from_millis(1)).await;
            }
        };
        let soon = tokio::time::timeout(Duration::from_secs(60), soon).await;
        soon.unwrap();
    }

    #[tokio::test]
    async fn items_that_wait_for_who_reads_them_count_until_the_next_are_asked_for() {
        let bounds = Bounds {
            memory: Arc::new(GreedyMemoryPool::new(120)),
            queries: Arc::new(Semaphore::new(2)),
            ..bounds(Duration::from_secs(100), 100)
        };
        let answer = async || {
            let numbers = futures::stream::iter((0..9).map(Ok::<usize, Fault>));
            let turn = bounds.turn().await.unwrap();
            turn.bounded(numbers, 1, |_| Size { rows: 1, bytes: 40 }, |fault| fault)
        };
        // All of them together would not fit.
        let read: Vec<_> = answer().await.collect().await;
        assert!(read.len() == 9 && read.iter().all(Result::is_ok));
        assert_eq!(bounds.memory.reserved(), 0);

        let mut unread = answer().await;
        assert!(unread.next().await.unwrap().is_ok());
        // What is read, what comes next, and what waits behind it.
        until(|| bounds.memory.reserved() == 120).await;
        let refused: Vec<_> = answer().await.collect().await;
        let fault = refused.last().unwrap().as_ref().unwrap_err();
        assert!(
            refused.len() == 1 && fault.kind == Kind::Resource,
            "{fault}"
        );
        assert!(fault.next.contains("--memory"), "{fault}");
        drop(unread);
        until(|| bounds.memory.reserved() == 0).await;
    }

    #[tokio::test]
    async fn an_answer_ends_with_what_it_used_up_and_leaves_its_place() {
        let long = Duration::from_secs(100);
        let numbers = || futures::stream::iter((0..5).map(Ok::<usize, Fault>));
        let all = async |rows: u64| {
            let bounds = bounds(long, rows);
            let turn = bounds.turn().await.unwrap();
            let found = turn.bounded(numbers(), 1, |_| of_rows(2), |fault| fault);
            let found: Vec<_> = found.collect().await;
            assert_eq!(bounds.queries.available_permits(), 1);
            found
        };
        assert!(all(10).await.iter().all(Result::is_ok));
        let found = all(9).await;
        let fault = found.last().unwrap().as_ref().unwrap_err().to_string();
        assert!(
            found.len() == 5 && fault.contains("more than 9 rows"),
            "{fault}"
        );
    }

    #[tokio::test]
    async fn an_answer_that_nobody_reads_leaves_its_place_and_is_not_taken_for_whole() {
        let bounds = bounds(Duration::from_millis(20), 100);
        let turn = bounds.turn().await.unwrap();
        let numbers = futures::stream::iter((0..50).map(Ok::<usize, Fault>));
        let unread = turn.bounded(numbers, 4, |_| of_rows(1), |fault| fault);
        let next = tokio::time::timeout(Duration::from_secs(60), bounds.queries.acquire()).await;
        assert!(next.unwrap().is_ok());
        let found: Vec<_> = unread.collect().await;
        let fault = found.last().unwrap().as_ref().unwrap_err().to_string();
        assert!(
            found.len() < 50 && fault.contains("longer than 20ms"),
            "{fault}"
        );
    }

    #[tokio::test(flavor = "multi_thread", worker_threads = 2)]
    async fn what_computes_for_answers_ends_when_nobody_reads_the_last_of_them() {
        let bounds = bounds(Duration::from_secs(10_000), 10);
        let turn = bounds.turn().await.unwrap();
        let context = context(Limits::one_partition()).unwrap();
        // One batch, of which nobody sees the end.
        let slow = "SELECT max(levenshtein(repeat(CAST(value % 10 AS TEXT), 4000), repeat(CAST(value % 7 AS TEXT), 4000))) FROM generate_series(1, 8192)";
        let slow = turn.within(async {
            let slow = read_only(&context, slow).await.unwrap();
            slow.execute_stream().await.unwrap()
        });
        let slow = slow.await.unwrap();
        let slow = slow.map(|batch| batch.map_err(|error| fault_of(&error)));
        let numbers = futures::stream::iter((0..5).map(Ok::<usize, Fault>));
        let quick = Arc::clone(&turn).bounded(numbers, 1, |_| of_rows(1), |fault| fault);
        let slow = turn.bounded(slow, 1, Size::of, |fault| fault);
        assert_eq!(quick.count().await, 5);
        tokio::time::sleep(Duration::from_secs(1)).await;
        assert_eq!(bounds.queries.available_permits(), 0);
        drop(slow);
        let next = tokio::time::timeout(Duration::from_secs(60), bounds.queries.acquire()).await;
        assert!(next.unwrap().is_ok());
    }

    #[tokio::test]
    async fn time_goes_on_while_a_query_waits_and_while_it_is_read() {
        let bounds = bounds(Duration::from_millis(20), 10);
        let turn = bounds.turn().await.unwrap();
        let busy = bounds.turn().await.err().unwrap().to_string();
        assert!(busy.contains("too many queries"), "{busy}");
        let late = turn.within(std::future::pending::<()>()).await;
        let late = late.unwrap_err().to_string();
        assert!(late.contains("longer than 20ms"), "{late}");
    }
}
