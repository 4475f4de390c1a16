//! The processes of a cluster.

use std::collections::BTreeSet;
use std::convert::Infallible;
use std::fmt;
use std::net::{IpAddr, SocketAddr};
use std::sync::{Arc, OnceLock};
use std::time::Duration;

use ballista_core::config::TaskSchedulingPolicy;
use ballista_core::extension::SessionConfigExt;
use ballista_core::registry::BallistaFunctionRegistry;
use ballista_core::serde::protobuf::job_status::Status;
use ballista_executor::executor_process::{ExecutorProcessConfig, start_executor_process};
use ballista_scheduler::cluster::{BallistaCluster, ClusterState, JobState};
use ballista_scheduler::config::SchedulerConfig;
use ballista_scheduler::scheduler_process::{create_scheduler, start_grpc_service_with_listener};
use ballista_scheduler::scheduler_server::SchedulerServer;
use datafusion_proto::protobuf::{LogicalPlanNode, PhysicalPlanNode};
use evermap_contract::Registry;
use evermap_schemas::Fault;
use tokio::net::{TcpListener, lookup_host};

use crate::cluster::job::{session_config, session_state};
use crate::error::{external, remote_fault};

/// How often is looked whether executors are left.
const WATCH: Duration = Duration::from_secs(2);

type Server = SchedulerServer<LogicalPlanNode, PhysicalPlanNode>;

/// Where a host of this name, or address, listens here.
///
/// # Errors
/// A user fault for a name that has no address.
async fn resolved(host: &str, port: u16) -> Result<SocketAddr, Fault> {
    let unknown = |found: String| {
        Fault::user(format!(
            "expected --bind with a host of this machine, found {host}: {found}"
        ))
        .next("give an address, such as 127.0.0.1, or a name that the others reach it by")
    };
    let found = lookup_host(format!("{host}:{port}")).await;
    let first = found.map_err(|error| unknown(error.to_string()))?.next();
    first.ok_or_else(|| unknown("it has no address".to_owned()))
}

/// Listens at an address, which `host` is the name of.
///
/// # Errors
/// A resource fault when it is taken, or not of this machine.
async fn listen(host: &str, address: SocketAddr) -> Result<TcpListener, Fault> {
    TcpListener::bind(address).await.map_err(|error| {
        let port = address.port();
        Fault::resource(format!(
            "expected to listen on {host}:{port}, found {error}"
        ))
        .next("choose another address with --bind, or end what listens there")
    })
}

/// The address without its port, as it is written before one.
fn before_port(address: SocketAddr) -> String {
    match address.ip() {
        IpAddr::V4(ip) => ip.to_string(),
        IpAddr::V6(ip) => format!("[{ip}]"),
    }
}

/// Serves as a scheduler until stopped. A job that comes while no executor is connected is refused, and cancelled when
/// the last one has gone: it would wait in silence.
///
/// # Errors
/// A resource fault when the address is taken, a user fault for a host that has none.
pub async fn scheduler(host: &str, port: u16, registry: Registry) -> Result<(), Fault> {
    let address = resolved(host, port).await?;
    let listener = listen(host, address).await?;
    let executors: Arc<OnceLock<Arc<dyn ClusterState>>> = Arc::default();
    let connected = Arc::clone(&executors);
    let config = SchedulerConfig {
        bind_host: before_port(address),
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
        ended = start_grpc_service_with_listener(listener, server.clone()) => ended.map_err(|error| failed(&error)),
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
    /// Name or address of the host to listen on, as the others reach it.
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

/// Serves as an executor until it is stopped, which gives it up: by itself it never ends well.
///
/// # Errors
/// A resource fault when its address is taken, when it cannot start or loses its scheduler for good; a user fault for a
/// host that has no address.
pub async fn executor(options: ExecutorOptions, registry: Registry) -> Result<Infallible, Fault> {
    let address = resolved(&options.host, options.port).await?;
    // Ballista listens long after it has begun, and only logs where it cannot.
    drop(listen(&options.host, address).await?);
    let place = format!("{}:{}", options.host, options.port);
    let state = session_state(session_config(), &registry);
    let config = ExecutorProcessConfig {
        bind_host: before_port(address),
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
        .map_err(|error| remote_fault(&error, "the executor stopped"))?;
    // It answers so, too, when its services ended with an error.
    Err(Fault::resource(format!(
        "expected to listen on {place} until stopped, found that the executor has ended"
    ))
    .next("what it logged says why; EVERMAP_LOG=info logs more"))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[tokio::test]
    async fn a_host_is_a_name_or_an_address_of_either_kind() {
        let local = resolved("localhost", 21_300).await.unwrap();
        assert!(local.ip().is_loopback() && local.port() == 21_300);
        let bound =
            |host: &'static str| async move { before_port(resolved(host, 1).await.unwrap()) };
        assert_eq!(bound("127.0.0.1").await, "127.0.0.1");
        assert_eq!(bound("[::1]").await, "[::1]");
        let fault = resolved("no such host", 1).await.unwrap_err();
        assert!(fault.message.contains("found no such host: "), "{fault}");
    }

    #[tokio::test]
    async fn an_executor_whose_address_is_taken_is_a_fault_at_once() {
        let taken = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let port = taken.local_addr().unwrap().port();
        let options = ExecutorOptions {
            // Nobody waits for one.
            scheduler: ("127.0.0.1".to_owned(), 1),
            host: "127.0.0.1".to_owned(),
            port,
            grpc_port: port,
            slots: 1,
            work_dir: String::new(),
        };
        let fault = executor(options, Registry::default()).await.unwrap_err();
        let expected = format!("resource: expected to listen on 127.0.0.1:{port}, found ");
        assert!(fault.to_string().starts_with(&expected), "{fault}");
    }
}
