//! `evermap scheduler` and `evermap executor`.

mod folder;

use evermap_engine::cluster::{self, ExecutorOptions};
use evermap_engine::sql::Limits;

use self::folder::WorkFolder;
use crate::arguments::{ExecutorArgs, SchedulerArgs};
use crate::ending::{DONE, Ending};
use crate::operators;
use crate::progress::line;

/// Serves as a scheduler until stopped.
///
/// # Errors
/// A resource fault when the address is taken, a user fault for a host that has none.
pub async fn scheduler(args: &SchedulerArgs) -> Ending {
    let (host, port) = &args.bind;
    line(&format!("scheduler on {host}:{port}"));
    cluster::scheduler(host, *port, operators::registry()).await?;
    DONE
}

/// Serves as an executor until stopped.
///
/// # Errors
/// A resource fault when its address is taken, when it cannot start or loses its scheduler for good; a user fault for a
/// host that has no address.
pub async fn executor(args: &ExecutorArgs) -> Ending {
    let work = WorkFolder::new_in(&std::env::temp_dir())?;
    let slots = args
        .jobs
        .map_or_else(|| Limits::default().partitions, |jobs| jobs as usize);
    let (host, port) = args.bind.clone();
    line(&format!(
        "executor on {host}:{port} for {}:{}, {slots} units side by side",
        args.scheduler.0, args.scheduler.1
    ));
    let options = ExecutorOptions {
        scheduler: args.scheduler.clone(),
        host,
        port,
        grpc_port: port + 1,
        slots,
        work_dir: work.path().display().to_string(),
    };
    match cluster::executor(options, operators::registry()).await? {}
}
