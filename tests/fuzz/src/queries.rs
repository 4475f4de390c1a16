//! SQL, as plans and people write it.

use std::sync::{Arc, OnceLock};

use datafusion::datasource::empty::EmptyTable;
use datafusion::prelude::SessionContext;
use evermap_engine::sql::{Limits, STACK_BYTES, context, read_only, tables};
use evermap_schemas::layers;
use tokio::runtime::{Builder, Runtime};

/// Plans a query on layers without rows; what has been planned is not run.
pub fn queries(bytes: &[u8]) {
    let Ok(query) = std::str::from_utf8(bytes) else {
        return;
    };
    // As deep as the program's own threads.
    std::thread::scope(|scope| {
        let planned = std::thread::Builder::new()
            .stack_size(STACK_BYTES)
            .spawn_scoped(scope, || plan(query));
        #[allow(clippy::expect_used)]
        let planned = planned.expect("a thread starts").join();
        assert!(planned.is_ok(), "{query}");
    });
}

fn plan(query: &str) {
    static SHARED: OnceLock<(Runtime, SessionContext)> = OnceLock::new();
    let (runtime, context) = SHARED.get_or_init(shared);
    let named = tables(query).is_ok();
    let planned = runtime.block_on(async {
        let frame = read_only(context, query).await.ok()?;
        Some(frame.into_optimized_plan().is_ok())
    });
    // What is planned has been parsed.
    assert!(planned.is_none() || named, "{query}");
}

#[allow(clippy::expect_used)]
fn shared() -> (Runtime, SessionContext) {
    let limits = Limits {
        memory_bytes: 64 << 20,
        partitions: 1,
    };
    let context = context(limits).expect("a context");
    for layer in layers::all() {
        let rows = EmptyTable::new(layer.schema());
        context
            .register_table(layer.name, Arc::new(rows))
            .expect("names of layers differ");
    }
    let runtime = Builder::new_multi_thread().worker_threads(1).build();
    (runtime.expect("a runtime starts"), context)
}
