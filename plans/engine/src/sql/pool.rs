//! The memory that the operators of a query share.

use std::fmt::{Display, Formatter};
use std::sync::{Arc, Mutex, MutexGuard};

use datafusion::common::{Result, resources_datafusion_err};
use datafusion::execution::disk_manager::{DiskManagerBuilder, DiskManagerMode};
use datafusion::execution::memory_pool::{
    MemoryConsumer, MemoryLimit, MemoryPool, MemoryReservation, human_readable_size,
};
use datafusion::execution::runtime_env::{RuntimeEnv, RuntimeEnvBuilder};
use evermap_schemas::Fault;

use crate::error::OrFault;
use crate::locked::locked;
use crate::sql::Limits;
use crate::temporary::Spills;

/// Memory for operators that spill, in equal shares, and for those that do not, first come, first served; as
/// DataFusion's `FairSpillPool`, but for a part that only small reservations may take. A sort needs a little memory that
/// cannot spill, to merge what it spills, and asks for it time and again while rows arrive; by then the shares of other
/// sorts, or one that merges as many files as it finds memory for, may have taken all there is. Nor may that one leave a sort
/// in another partition, where rows still arrive, no room for the next of them.
#[derive(Debug)]
pub struct SharedPool {
    bytes: usize,
    /// Bytes that only small reservations which cannot spill may take.
    held: usize,
    /// Bytes of a small reservation at most.
    small: usize,
    /// Bytes that large reservations which cannot spill leave to operators that spill, as long as there are any.
    left: usize,
    used: Mutex<Used>,
}

#[derive(Debug, Default)]
struct Used {
    spillers: usize,
    spillable: usize,
    unspillable: usize,
}

impl Used {
    fn of(&mut self, consumer: &MemoryConsumer) -> &mut usize {
        match consumer.can_spill() {
            true => &mut self.spillable,
            false => &mut self.unspillable,
        }
    }
}

impl SharedPool {
    /// A pool of so many bytes for operators that work in so many partitions: half of it at most for those that spill,
    /// a quarter for small reservations alone.
    ///
    /// To merge what it has sorted, a sort copies the keys of its share, which may be all of it; the share was counted
    /// twice. So two sorts in a row, in each partition, find what they need.
    pub fn new(bytes: usize, partitions: usize) -> Self {
        Self {
            bytes,
            held: bytes / 4,
            small: bytes / (4 * partitions.max(1)),
            left: bytes / 8,
            used: Mutex::default(),
        }
    }

    fn used(&self) -> MutexGuard<'_, Used> {
        locked(&self.used)
    }

    /// Bytes by which a reservation may grow.
    fn free(&self, used: &Used, reservation: &MemoryReservation) -> usize {
        let size = reservation.size();
        if reservation.consumer().can_spill() {
            // Where others hold much, half of what is held for small reservations is still left to them.
            let others = (used.unspillable + self.held / 2).max(self.bytes / 2);
            let shared = self.bytes.saturating_sub(others);
            return (shared / used.spillers.max(1)).saturating_sub(size);
        }
        let free = self.bytes.saturating_sub(used.spillable + used.unspillable);
        let small = free.min(self.small.saturating_sub(size));
        let left = match used.spillers {
            0 => 0,
            _ => self.left.saturating_sub(used.spillable),
        };
        small.max(free.saturating_sub(self.held + left))
    }
}

impl MemoryPool for SharedPool {
    fn name(&self) -> &str {
        "shared"
    }

    fn register(&self, consumer: &MemoryConsumer) {
        self.used().spillers += usize::from(consumer.can_spill());
    }

    fn unregister(&self, consumer: &MemoryConsumer) {
        self.used().spillers -= usize::from(consumer.can_spill());
    }

    fn grow(&self, reservation: &MemoryReservation, additional: usize) {
        *self.used().of(reservation.consumer()) += additional;
    }

    fn shrink(&self, reservation: &MemoryReservation, shrink: usize) {
        *self.used().of(reservation.consumer()) -= shrink;
    }

    fn try_grow(&self, reservation: &MemoryReservation, additional: usize) -> Result<()> {
        let mut used = self.used();
        let free = self.free(&used, reservation);
        if additional > free {
            return Err(resources_datafusion_err!(
                "{} needs {} more beside its {}, expected at most {} (all operators together: {})",
                reservation.consumer().name(),
                human_readable_size(additional),
                human_readable_size(reservation.size()),
                human_readable_size(free),
                human_readable_size(self.bytes)
            ));
        }
        *used.of(reservation.consumer()) += additional;
        Ok(())
    }

    fn reserved(&self) -> usize {
        let used = self.used();
        used.spillable + used.unspillable
    }

    fn memory_limit(&self) -> MemoryLimit {
        MemoryLimit::Finite(self.bytes)
    }
}

impl Display for SharedPool {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        write!(f, "shared({})", human_readable_size(self.bytes))
    }
}

/// The memory that queries share.
///
/// # Errors
/// A resource fault when the runtime cannot be set up.
pub fn runtime(limits: Limits) -> std::result::Result<Arc<RuntimeEnv>, Fault> {
    let pool = SharedPool::new(limits.memory_bytes, limits.partitions);
    let spills = DiskManagerMode::Custom(Arc::new(Spills::default()));
    RuntimeEnvBuilder::new()
        .with_memory_pool(Arc::new(pool))
        .with_disk_manager_builder(DiskManagerBuilder::default().with_mode(spills))
        .build_arc()
        .or_fault()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use std::sync::Arc;

    use super::*;

    #[test]
    fn a_small_reservation_finds_memory_however_much_the_others_took() {
        let pool: Arc<dyn MemoryPool> = Arc::new(SharedPool::new(80, 2));
        let [first, second] = ["first", "second"].map(|name| {
            let consumer = MemoryConsumer::new(name).with_can_spill(true);
            consumer.register(&pool)
        });
        first.try_grow(20).unwrap();
        first.try_grow(1).unwrap_err();
        second.try_grow(20).unwrap();
        let greedy = MemoryConsumer::new("greedy").register(&pool);
        greedy.try_grow(20).unwrap();
        greedy.try_grow(1).unwrap_err();
        let merge = MemoryConsumer::new("merge").register(&pool);
        merge.try_grow(10).unwrap();
        let refused = merge.try_grow(1).unwrap_err().to_string();
        assert!(refused.contains("merge needs 1.0 B more"), "{refused}");
        drop((first, second));
        greedy.try_grow(30).unwrap();
        greedy.try_grow(1).unwrap_err();
        assert_eq!(pool.reserved(), 60);
        drop((merge, greedy));
        assert_eq!(pool.reserved(), 0);
    }

    /// One partition's rows are all there, and are merged, while another's arrive.
    #[test]
    fn who_merges_all_that_it_can_leaves_room_to_a_sort_beside_it() {
        let pool: Arc<dyn MemoryPool> = Arc::new(SharedPool::new(160, 2));
        let [sort, other] = ["sort", "other"].map(|name| {
            let consumer = MemoryConsumer::new(name).with_can_spill(true);
            consumer.register(&pool)
        });
        let merge = MemoryConsumer::new("merge").register(&pool);
        while merge.try_grow(1).is_ok() {}
        assert_eq!(merge.size(), 100);
        sort.try_grow(20).unwrap();
        drop((sort, other));
        merge.try_grow(20).unwrap();
    }

    #[test]
    fn shares_shrink_by_what_cannot_spill_beyond_its_part() {
        let pool: Arc<dyn MemoryPool> = Arc::new(SharedPool::new(100, 1));
        let build = MemoryConsumer::new("build").register(&pool);
        build.try_grow(50).unwrap();
        let sort = MemoryConsumer::new("sort").with_can_spill(true);
        let sort = sort.register(&pool);
        sort.try_grow(39).unwrap_err();
        sort.try_grow(38).unwrap();
        build.try_grow(1).unwrap_err();
        let merge = MemoryConsumer::new("merge").register(&pool);
        merge.try_grow(12).unwrap();
    }
}
