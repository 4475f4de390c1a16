//! The processes of a cluster.

use std::collections::BTreeSet;
use std::convert::Infallible;
use std::fmt;
use std::sync::{Arc, OnceLock};
use std::time::Duration;

use ballista_core::config::TaskSchedulingPolicy;
use ballista_core::extension::SessionConfigExt;
use ballista_core::registry::BallistaFunctionRegistry;
use ballista_core::serde::protobuf::job_status::Status;
use ballista_executor::executor_process::{ExecutorProcessConfig, start_executor_process};
use ballista_scheduler::cluster::{BallistaCluster, ClusterState, JobState};
use ballista_scheduler::config::SchedulerConfig;
use ballista_scheduler::scheduler_process::{create_scheduler, start_grpc_service};
use ballista_scheduler::scheduler_server::SchedulerServer;
use datafusion_proto::protobuf::{LogicalPlanNode, PhysicalPlanNode};
use evermap_contract::Registry;
use evermap_schemas::Fault;

use crate::cluster::job::{session_config, session_state};
use crate::error::{external, remote_fault};

/// How often is looked whether executors are left.
const WATCH: Duration = Duration::from_secs(2);

type Server = SchedulerServer<LogicalPlanNode, PhysicalPlanNode>;

/// Serves as a scheduler until stopped. A job that comes while no executor is connected is refused, and cancelled when
/// the last one has gone: it would wait in silence.
///
/// # Errors
/// A resource fault when the address is taken, a user fault when it is none.
pub async fn scheduler(host: &str, port: u16, registry: Registry) -> Result<(), Fault> {
    let address = format!("{host}:{port}")
        .parse()
        .map_err(|error| Fault::user(format!("{host}:{port}: {error}")))?;
    let executors: Arc<OnceLock<Arc<dyn ClusterState>>> = Arc::default();
    let connected = Arc::clone(&executors);
    let config = SchedulerConfig {
        bind_host: host.to_owned(),
        external_host: host.to_owned(),
        bind_port: port,
        scheduling_policy: TaskSchedulingPolicy::PullStaged,
        override_config_producer: Some(Arc::new(session_config)),
        override_session_builder: Some(Arc::new(move |config| {
            let heartbeats = connected.get().map(|cluster| cluster.executor_heartbeats());
            if heartbeats.is_none_or(|executors| executors.is_empty()) {
                return Err(external(Fault::resource("no executor is connected")));
            }
            Ok(session_state(config.upgrade_for_ballista(), &registry))
        })),
        executor_timeout_seconds: 12,
        expire_dead_executor_interval_seconds: 2,
        ..SchedulerConfig::default()
    };
    let failed = |error: &dyn fmt::Display| remote_fault(error, "the scheduler does not start");
    let cluster = BallistaCluster::new_from_config(&config)
        .await
        .map_err(|error| failed(&error))?;
    let (state, jobs) = (cluster.cluster_state(), cluster.job_state());
    let _ = executors.set(Arc::clone(&state));
    config.validate().map_err(|error| failed(&error))?;
    let server: Server = create_scheduler(cluster, Arc::new(config))
        .await
        .map_err(|error| failed(&error))?;
    tokio::select! {
        ended = start_grpc_service(address, server.clone()) => ended.map_err(|error| failed(&error)),
        never = cancel_abandoned(&server, state.as_ref(), jobs.as_ref()) => match never {},
    }
}

/// Cancels the jobs that are open while no executor is left. Whoever follows one hears of it, and of the reason when it
/// submits anew.
async fn cancel_abandoned(
    server: &Server,
    executors: &dyn ClusterState,
    jobs: &dyn JobState,
) -> Infallible {
    loop {
        tokio::time::sleep(WATCH).await;
        if !executors.executor_heartbeats().is_empty() {
            continue;
        }
        let open = jobs.get_all_jobs().await.unwrap_or_default();
        for job in open.into_iter().collect::<BTreeSet<_>>() {
            let status = jobs.get_job_status(&job).await.ok().flatten();
            let status = status.and_then(|job| job.status);
            if !matches!(status, Some(Status::Queued(_) | Status::Running(_))) {
                continue;
            }
            if let Err(error) = server.cancel_job(job).await {
                tracing::warn!(%error, "a job without executors is not cancelled");
            }
        }
    }
}

/// Where an executor listens, and for whom it works.
#[derive(Debug, Clone)]
pub struct ExecutorOptions {
    /// The scheduler's host and port.
    pub scheduler: (String, u16),
    /// Address to listen on, as the others reach it.
    pub host: String,
    /// Port for results.
    pub port: u16,
    /// Port for calls.
    pub grpc_port: u16,
    /// Units to run side by side.
    pub slots: usize,
    /// Folder for Ballista's own files.
    pub work_dir: String,
}

/// Serves as an executor until stopped.
///
/// # Errors
/// A resource fault when it cannot start or loses its scheduler for good.
pub async fn executor(options: ExecutorOptions, registry: Registry) -> Result<(), Fault> {
    let state = session_state(session_config(), &registry);
    let config = ExecutorProcessConfig {
        bind_host: options.host.clone(),
        external_host: Some(options.host),
        port: options.port,
        grpc_port: options.grpc_port,
        scheduler_host: options.scheduler.0,
        scheduler_port: options.scheduler.1,
        scheduler_connect_timeout_seconds: 60,
        vcores: options.slots.max(1),
        work_dir: Some(options.work_dir),
        task_scheduling_policy: TaskSchedulingPolicy::PullStaged,
        override_function_registry: Some(Arc::new(BallistaFunctionRegistry::from(&state))),
        override_config_producer: Some(Arc::new(session_config)),
        executor_heartbeat_interval_seconds: 3,
        ..ExecutorProcessConfig::default()
    };
    start_executor_process(Arc::new(config))
        .await
        .map_err(|error| remote_fault(&error, "the executor stopped"))
}
