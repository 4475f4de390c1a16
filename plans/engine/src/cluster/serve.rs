//! The processes of a cluster.

use std::fmt;
use std::sync::{Arc, OnceLock};

use ballista_core::config::TaskSchedulingPolicy;
use ballista_core::extension::SessionConfigExt;
use ballista_core::registry::BallistaFunctionRegistry;
use ballista_executor::executor_process::{ExecutorProcessConfig, start_executor_process};
use ballista_scheduler::cluster::{BallistaCluster, ClusterState};
use ballista_scheduler::config::SchedulerConfig;
use ballista_scheduler::scheduler_process::start_server;
use evermap_contract::Registry;
use evermap_schemas::Fault;

use crate::cluster::job::{session_config, session_state};
use crate::error::{external, remote_fault};

/// Serves as a scheduler until stopped. A job that comes while no executor is connected is refused: it would wait in
/// silence.
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
    let _ = executors.set(cluster.cluster_state());
    start_server(cluster, address, Arc::new(config))
        .await
        .map_err(|error| failed(&error))
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
