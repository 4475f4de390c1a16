//! The scheduler as a run sees it: jobs submitted, followed and cancelled.

use std::error::Error;
use std::fmt::Display;
use std::time::Duration;

use arrow::array::{AsArray, RecordBatch};
use ballista_core::client::BallistaClient;
use ballista_core::config::BallistaConfig;
use ballista_core::serde::BallistaPhysicalExtensionCodec;
use ballista_core::serde::protobuf::execute_query_params::Query;
use ballista_core::serde::protobuf::execute_query_result::Result as Submitted;
use ballista_core::serde::protobuf::job_status::Status;
use ballista_core::serde::protobuf::scheduler_grpc_client::SchedulerGrpcClient;
use ballista_core::serde::protobuf::{
    CancelJobParams, ExecuteQueryParams, GetJobStatusParams, KeyValuePair, PartitionLocation,
};
use ballista_core::utils::{GrpcClientConfig, create_grpc_client_endpoint};
use ballista_core::version::insert_version_header;
use datafusion_proto::physical_plan::AsExecutionPlan;
use datafusion_proto::protobuf::PhysicalPlanNode;
use evermap_contract::Registry;
use evermap_schemas::Fault;
use futures::TryStreamExt;
use tonic::transport::Channel;

use crate::cluster::job::{UnitTexts, session_config, units_plan};
use crate::error::{OrFault, remote_fault};

/// How long a call may take, until the scheduler counts as lost.
const CALL: Duration = Duration::from_secs(10);

/// How long it may take to cancel a job: whoever cancels has been told to end, or waits to submit anew.
const CANCEL: Duration = Duration::from_secs(3);

/// A connection to a scheduler.
pub struct Scheduler {
    url: String,
    client: SchedulerGrpcClient<Channel>,
}

/// A job that was submitted.
pub struct Job {
    id: String,
    /// Numbers of its units.
    pub units: Vec<usize>,
}

/// What a scheduler says of a job.
pub enum JobState {
    /// It waits, or runs.
    Open,
    /// It has ended, and its answer lies there.
    Ended(Vec<PartitionLocation>),
    /// It has failed, as a whole.
    Failed(Fault),
}

fn client_config() -> GrpcClientConfig {
    GrpcClientConfig {
        connect_timeout_seconds: CALL.as_secs(),
        timeout_seconds: CALL.as_secs(),
        ..GrpcClientConfig::from(&BallistaConfig::default())
    }
}

impl Scheduler {
    /// Connects to the scheduler at a URL (`http://host:port`).
    ///
    /// # Errors
    /// A resource fault when nothing answers there.
    pub async fn connect(url: &str) -> Result<Self, Fault> {
        let lost = |error: &dyn Display| lost(error, url);
        let config = client_config();
        let endpoint = create_grpc_client_endpoint(url.to_owned(), Some(&config));
        let endpoint = endpoint.map_err(|error| lost(&error))?;
        let channel = endpoint.connect().await;
        let channel = channel.map_err(|error| lost(&innermost(&error)))?;
        let client = SchedulerGrpcClient::new(channel)
            .max_encoding_message_size(config.max_message_size)
            .max_decoding_message_size(config.max_message_size);
        Ok(Self {
            url: url.to_owned(),
            client,
        })
    }

    /// Asks the scheduler at a URL what every scheduler answers.
    ///
    /// # Errors
    /// A resource fault when nothing answers there, or what is no scheduler.
    pub async fn greet(url: &str) -> Result<(), Fault> {
        let mut scheduler = Self::connect(url).await?;
        let no_job = GetJobStatusParams {
            job_id: String::new(),
        };
        let answer = scheduler.client.get_job_status(no_job).await;
        let answer = answer.map_err(|status| lost(&status.message(), url));
        answer.map(|_| ())
    }

    /// Submits units as one job.
    ///
    /// # Errors
    /// A resource fault when the scheduler does not answer or has no executors.
    pub async fn submit(&mut self, units: UnitTexts, registry: &Registry) -> Result<Job, Fault> {
        let numbers = units.keys().copied().collect();
        let plan = units_plan(units, registry).await?;
        let codec = BallistaPhysicalExtensionCodec::default();
        let node = PhysicalPlanNode::try_from_physical_plan(plan, &codec).or_fault()?;
        let mut bytes = Vec::new();
        node.try_encode(&mut bytes).or_fault()?;
        let settings = session_config().options().entries().into_iter();
        let mut request = tonic::Request::new(ExecuteQueryParams {
            query: Some(Query::PhysicalPlan(bytes)),
            settings: settings
                .map(|entry| KeyValuePair {
                    key: entry.key,
                    value: entry.value,
                })
                .collect(),
            session_id: uuid::Uuid::new_v4().to_string(),
            operation_id: uuid::Uuid::now_v7().to_string(),
        });
        insert_version_header(request.metadata_mut());
        let answer = self.client.execute_query(request).await;
        let answer = answer.map_err(|status| lost(&status.message(), &self.url))?;
        match answer.into_inner().result {
            Some(Submitted::Success(job)) => Ok(Job {
                id: job.job_id,
                units: numbers,
            }),
            refused => Err(lost(&format!("{refused:?}"), &self.url)),
        }
    }

    /// What has become of a job.
    ///
    /// # Errors
    /// A resource fault when the scheduler does not answer, or does not know the job: it was started anew.
    pub async fn state(&mut self, job: &Job) -> Result<JobState, Fault> {
        let params = GetJobStatusParams {
            job_id: job.id.clone(),
        };
        let answer = self.client.get_job_status(params).await;
        let answer = answer.map_err(|status| lost(&status.message(), &self.url))?;
        let status = answer.into_inner().status;
        let status = status.ok_or_else(|| lost(&"it does not know its job", &self.url))?;
        Ok(match status.status {
            None | Some(Status::Queued(_) | Status::Running(_)) => JobState::Open,
            Some(Status::Successful(job)) => JobState::Ended(job.partition_location),
            Some(Status::Failed(job)) => JobState::Failed(lost(&job.error, &self.url)),
        })
    }

    /// Cancels jobs: none of their units begins any more. One that runs ends, and what it leaves is found later. A
    /// scheduler that does not answer for one job is not asked for the others.
    pub async fn cancel(&mut self, jobs: Vec<Job>) {
        for job in jobs {
            let asked = self.client.cancel_job(CancelJobParams { job_id: job.id });
            match tokio::time::timeout(CANCEL, asked).await {
                Ok(Ok(_)) => {}
                Ok(Err(status)) => tracing::debug!(%status, "a job is not cancelled"),
                Err(_) => {
                    tracing::debug!("jobs are not cancelled: the scheduler does not answer");
                    return;
                }
            }
        }
    }
}

/// The reason behind an error, which alone says what happened.
fn innermost(error: &dyn Error) -> String {
    let mut innermost = error;
    while let Some(source) = innermost.source() {
        innermost = source;
    }
    innermost.to_string()
}

fn lost(error: &dyn Display, url: &str) -> Fault {
    remote_fault(error, &format!("the cluster of {url}"))
}

/// The units of an ended job that failed for reasons of their own.
///
/// # Errors
/// A resource fault when an executor does not hand out its part of the answer.
pub async fn failures(answer: Vec<PartitionLocation>) -> Result<Vec<(usize, Fault)>, Fault> {
    let mut failed = Vec::new();
    for location in answer {
        let batches = tokio::time::timeout(CALL, fetch(location)).await;
        let batches = batches.map_err(|_| Fault::resource("an executor does not answer"))??;
        for batch in &batches {
            let column = |index: usize| batch.column(index).as_string::<i32>().iter().flatten();
            for (unit, fault) in column(0).zip(column(1)) {
                if let (Ok(unit), Ok(fault)) = (unit.parse(), serde_json::from_str(fault)) {
                    failed.push((unit, fault));
                }
            }
        }
    }
    Ok(failed)
}

/// A part of an answer, from the executor that has it.
async fn fetch(location: PartitionLocation) -> Result<Vec<RecordBatch>, Fault> {
    let layout = location.layout();
    let (Some(executor), Some(partition)) = (location.executor_meta, location.partition_id) else {
        return Err(Fault::resource("a job's answer does not say where it is"));
    };
    let config = client_config();
    let failed = |error: &dyn Display| lost(error, &format!("{}:{}", executor.host, executor.port));
    let mut client = BallistaClient::try_new(
        &executor.host,
        u16::try_from(executor.port).unwrap_or_default(),
        config.max_message_size,
        config.use_tls,
        None,
        config.io_retries_times,
        config.io_retry_wait_time_ms,
        0,
        0,
    )
    .await
    .map_err(|error| failed(&error))?;
    let partition = partition.into();
    let rows = client
        .fetch_partition(&executor.id, &partition, location.file_id, layout, true)
        .await
        .map_err(|error| failed(&error))?;
    rows.try_collect().await.map_err(|error| failed(&error))
}
