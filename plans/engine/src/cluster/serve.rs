//! The processes of a cluster.

use std::collections::BTreeSet;
use std::convert::Infallible;
use std::fmt;
use std::net::{IpAddr, SocketAddr};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::Duration;

use arrow_flight::flight_service_server::FlightServiceServer;
use ballista_core::config::TaskSchedulingPolicy;
use ballista_core::error::BallistaError;
use ballista_core::extension::SessionConfigExt;
use ballista_core::registry::BallistaFunctionRegistry;
use ballista_core::serde::protobuf::job_status::Status;
use ballista_core::utils::create_grpc_server;
use ballista_executor::ArrowFlightServerProvider;
use ballista_executor::executor_process::{ExecutorProcessConfig, start_executor_process};
use ballista_executor::flight_service::BallistaFlightService;
use ballista_scheduler::cluster::{BallistaCluster, ClusterState, JobState};
use ballista_scheduler::config::SchedulerConfig;
use ballista_scheduler::scheduler_process::{create_scheduler, start_grpc_service_with_listener};
use ballista_scheduler::scheduler_server::SchedulerServer;
use datafusion_proto::protobuf::{LogicalPlanNode, PhysicalPlanNode};
use evermap_contract::Registry;
use evermap_schemas::Fault;
use tokio::net::{TcpListener, lookup_host};
use tonic::transport::server::TcpIncoming;

use crate::cluster::job::{session_config, session_state};
use crate::cluster::scheduler::Scheduler;
use crate::error::{external, remote_fault};

/// How often is looked whether executors are left.
const WATCH: Duration = Duration::from_secs(2);

/// How often is looked whether a scheduler is there.
const LOOK: Duration = Duration::from_millis(500);

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
    /// Units to run side by side.
    pub slots: usize,
    /// Folder for Ballista's own files.
    pub work_dir: String,
}

/// Serves as an executor until it is stopped, which gives it up: by itself it never ends well. So long is waited for the
/// scheduler to answer at first; one that goes after that may come back when it likes.
///
/// # Errors
/// A resource fault when its address is taken, when no scheduler answers in time or when it cannot start; a user fault for
/// a host that has no address.
pub async fn executor(
    options: ExecutorOptions,
    wait: Duration,
    registry: Registry,
) -> Result<Infallible, Fault> {
    let address = resolved(&options.host, options.port).await?;
    let listener = listen(&options.host, address).await?;
    until_answered(&options.scheduler, wait).await?;
    serve_units(listener, address, options, &registry).await
}

/// Serves as an executor at a listener, whose address it is. Its scheduler is there.
///
/// # Errors
/// A resource fault when it ends.
pub(super) async fn serve_units(
    listener: TcpListener,
    address: SocketAddr,
    options: ExecutorOptions,
    registry: &Registry,
) -> Result<Infallible, Fault> {
    let place = format!("{}:{}", options.host, options.port);
    let state = session_state(session_config(), registry);
    let config = ExecutorProcessConfig {
        bind_host: before_port(address),
        external_host: Some(options.host),
        port: options.port,
        // Executors ask for work and are not called: of calls that come anyhow, those who hand out results say so.
        grpc_port: options.port,
        scheduler_host: options.scheduler.0,
        scheduler_port: options.scheduler.1,
        // Ballista would never cease to wait: it takes the time that has passed from a clock that it has just begun.
        scheduler_connect_timeout_seconds: 0,
        vcores: options.slots.max(1),
        work_dir: Some(options.work_dir),
        task_scheduling_policy: TaskSchedulingPolicy::PullStaged,
        override_function_registry: Some(Arc::new(BallistaFunctionRegistry::from(&state))),
        override_config_producer: Some(Arc::new(session_config)),
        override_arrow_flight_service: Some(results_at(listener)),
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

/// Ends when a scheduler answers.
///
/// # Errors
/// A resource fault that names its address, when none has for so long.
async fn until_answered((host, port): &(String, u16), wait: Duration) -> Result<(), Fault> {
    let url = format!("http://{host}:{port}");
    let mut found = None;
    let answered = tokio::time::timeout(wait, async {
        while let Err(fault) = Scheduler::greet(&url).await {
            if found.is_none() {
                tracing::warn!("no scheduler answers yet: {fault}");
            }
            found = Some(fault.message);
            tokio::time::sleep(LOOK).await;
        }
    })
    .await;
    answered.map_err(|_| {
        let seconds = wait.as_secs();
        let found = found.unwrap_or_else(|| "no answer".to_owned());
        Fault::resource(format!(
            "expected a scheduler that answers at {host}:{port} within {seconds} s, found {found}"
        ))
        .next("look whether `evermap scheduler` runs there, whether --scheduler names it, and whether a firewall is between; --wait-s allows more time")
    })
}

/// What hands out results at a listener. (Ballista's own would listen long after it has begun, and only log where it
/// cannot.)
fn results_at(listener: TcpListener) -> Arc<ArrowFlightServerProvider> {
    const MESSAGE_BYTES: usize = 16 << 20;
    let listener = Mutex::new(Some(listener));
    Arc::new(move |work_dir, _, mut shutdown, config| {
        let mut listener = listener.lock().unwrap_or_else(PoisonError::into_inner);
        let listener = listener.take();
        tokio::spawn(async move {
            let asked_twice = || BallistaError::Internal("results are handed out once".to_owned());
            let listener = listener.ok_or_else(asked_twice)?;
            let results = FlightServiceServer::new(BallistaFlightService::new(work_dir))
                .max_decoding_message_size(MESSAGE_BYTES)
                .max_encoding_message_size(MESSAGE_BYTES);
            let connections = TcpIncoming::from(listener).with_nodelay(Some(true));
            create_grpc_server(&config)
                .add_service(results)
                .serve_with_incoming_shutdown(connections, shutdown.recv())
                .await
                .map_err(BallistaError::TonicError)
        })
    })
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
            slots: 1,
            work_dir: String::new(),
        };
        let executor = executor(options, Duration::from_secs(600), Registry::default());
        let fault = executor.await.unwrap_err();
        let expected = format!("resource: expected to listen on 127.0.0.1:{port}, found ");
        assert!(fault.to_string().starts_with(&expected), "{fault}");
    }

    #[tokio::test]
    async fn a_scheduler_that_does_not_answer_is_waited_for_so_long() {
        let wait = Duration::from_secs(1);
        let told = |port: u16| async move {
            let place = ("127.0.0.1".to_owned(), port);
            let waited = until_answered(&place, wait);
            let waited = tokio::time::timeout(Duration::from_secs(30), waited).await;
            waited.unwrap().unwrap_err()
        };
        // One that takes connections and says nothing, and nobody.
        let silent = TcpListener::bind("127.0.0.1:0").await.unwrap();
        for port in [silent.local_addr().unwrap().port(), 1] {
            let fault = told(port).await;
            let expected = format!(
                "resource: expected a scheduler that answers at 127.0.0.1:{port} within 1 s, found "
            );
            assert!(fault.to_string().starts_with(&expected), "{fault}");
        }
    }
}
