//! The role tables `frames`, `depth_frames`, `label_frames`, `odometry`, `calibration`, `transforms`, `label_classes`:
//! whatever a log's messages are called, these have the schemas of [`evermap_schemas::roles`].
//!
//! They are scans like any other (splits, pruning by session and log time, projection), only with a builder that turns
//! decoded messages into typed rows. Their order is that of the log; sort by stamp where order matters.

mod calibration;
mod cameras;
mod columns;
mod frames;
mod labels;
mod motion;
mod rows;

use std::collections::BTreeMap;
use std::sync::Arc;

use arrow::datatypes::SchemaRef;
use async_trait::async_trait;
use datafusion::catalog::{Session, TableProvider};
use datafusion::datasource::ViewTable;
use datafusion::error::Result;
use datafusion::logical_expr::{Expr, TableType};
use datafusion::physical_plan::ExecutionPlan;
use datafusion::prelude::SessionContext;
use evermap_schemas::roles::{Calibration, Frame, LabelClass, OdometryPose, Transform};
use evermap_schemas::{Fault, Layer, LayerRow};
use futures::FutureExt;

pub(crate) use cameras::{CameraNames, Cameras};

use crate::dataset::Dataset;
use crate::losses::LossLedger;
use crate::scan::{LogTable, RowBuilder, external, fault_of, scan_parts};
use crate::session::LogPart;
use rows::RoleRows;

/// A role that topics play.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Role {
    /// Images, by reference.
    Frames,
    /// Range images, by reference.
    Depth,
    /// Images of class labels, by reference.
    Labels,
    /// The vehicle in the odometry frame.
    Odometry,
    /// Intrinsic calibrations.
    Calibration,
    /// Transforms between frames.
    Transforms,
}

impl Role {
    /// All of them.
    pub const ALL: [Role; 6] = [
        Role::Frames,
        Role::Depth,
        Role::Labels,
        Role::Odometry,
        Role::Calibration,
        Role::Transforms,
    ];

    /// The table's declaration.
    pub fn layer(self) -> Layer {
        match self {
            Role::Frames => Frame::layer(),
            Role::Depth => Frame::depth_layer(),
            Role::Labels => Frame::label_layer(),
            Role::Odometry => OdometryPose::layer(),
            Role::Calibration => Calibration::layer(),
            Role::Transforms => Transform::layer(),
        }
    }

    /// The table's name.
    pub fn name(self) -> &'static str {
        self.layer().name
    }

    /// Whether its rows refer to images.
    fn is_images(self) -> bool {
        matches!(self, Role::Frames | Role::Depth | Role::Labels)
    }
}

/// A role, with what is needed to read it: the topics that play it in each session, and the names of cameras.
#[derive(Debug, Clone)]
pub struct RoleScan {
    /// Which role.
    pub(crate) role: Role,
    /// Topics by session.
    pub(crate) topics: Arc<BTreeMap<Arc<str>, Vec<String>>>,
    /// Names of cameras by session; only images need them.
    pub(crate) cameras: Arc<Cameras>,
}

impl RoleScan {
    /// Topics that play the role in a session.
    pub(crate) fn topics(&self, session: &str) -> &[String] {
        self.topics.get(session).map_or(&[], Vec::as_slice)
    }

    /// The builder of the role's rows from one file.
    pub(crate) fn rows(
        &self,
        part: &Arc<LogPart>,
        projection: &[usize],
    ) -> Result<Box<dyn RowBuilder>, Fault> {
        Ok(match self.role {
            Role::Frames | Role::Depth | Role::Labels => {
                Box::new(RoleRows::<Frame>::new(self, part, projection)?)
            }
            Role::Odometry => Box::new(RoleRows::<OdometryPose>::new(self, part, projection)?),
            Role::Calibration => Box::new(RoleRows::<Calibration>::new(self, part, projection)?),
            Role::Transforms => Box::new(RoleRows::<Transform>::new(self, part, projection)?),
        })
    }
}

type Provider = Arc<dyn TableProvider>;

/// A query over tables at hand, as a table.
fn view<const N: usize>(query: &str, tables: [(&str, Provider); N]) -> Result<Provider, Fault> {
    let bug = |error| fault_of(&error).at("a view of the log's tables");
    let context = SessionContext::new();
    for (name, table) in tables {
        context.register_table(name, table).map_err(bug)?;
    }
    // Nothing in the making of this plan waits: the tables are at hand.
    let frame = context.sql(query).now_or_never();
    let frame = frame.ok_or_else(|| Fault::bug("planning a view had to wait"))?;
    let plan = frame.map_err(bug)?.into_unoptimized_plan();
    Ok(Arc::new(ViewTable::new(plan, None)))
}

/// The role tables of a dataset.
pub(crate) fn tables(dataset: &Dataset) -> Result<Vec<(&'static str, Provider)>, Fault> {
    let mut tables = Vec::new();
    for role in Role::ALL {
        let table: Arc<dyn TableProvider> = Arc::new(RoleTable::new(role, dataset));
        let table = match role {
            Role::Calibration => calibration::without_repeats(table)?,
            _ => table,
        };
        tables.push((role.name(), table));
    }
    tables.push((LabelClass::NAME, labels::classes(dataset)?));
    Ok(tables)
}

/// A role over the files of a dataset.
#[derive(Debug)]
struct RoleTable {
    scan: RoleScan,
    calibration: RoleScan,
    parts: Vec<Arc<LogPart>>,
    schema: SchemaRef,
    losses: LossLedger,
    cameras: tokio::sync::OnceCell<Arc<Cameras>>,
}

impl RoleTable {
    fn new(role: Role, dataset: &Dataset) -> Self {
        let scan = |role: Role| {
            let topics = dataset
                .sessions
                .iter()
                .map(|s| (s.name.clone(), s.roles.topics(role.name()).to_vec()));
            RoleScan {
                role,
                topics: Arc::new(topics.collect()),
                cameras: Arc::default(),
            }
        };
        let chosen = scan(role);
        let plays = |part: &Arc<LogPart>| {
            let mut topics = chosen.topics(&part.session).iter();
            topics.any(|topic| part.index.channels_of(topic).next().is_some())
        };
        let parts = match role {
            // Calibrations may lie in other parts than the frames they name.
            role if role.is_images() => dataset.parts(),
            _ => dataset.parts().into_iter().filter(plays).collect(),
        };
        Self {
            scan: chosen,
            calibration: scan(Role::Calibration),
            parts,
            schema: role.layer().schema(),
            losses: dataset.losses.clone(),
            cameras: tokio::sync::OnceCell::new(),
        }
    }

    async fn cameras(&self) -> Result<Arc<Cameras>, Fault> {
        let read = || async {
            let cameras = cameras::read(&self.calibration, &self.parts).await?;
            Ok(Arc::new(cameras))
        };
        self.cameras.get_or_try_init(read).await.cloned()
    }
}

#[async_trait]
impl TableProvider for RoleTable {
    fn schema(&self) -> SchemaRef {
        self.schema.clone()
    }

    fn table_type(&self) -> TableType {
        TableType::Base
    }

    async fn scan(
        &self,
        state: &dyn Session,
        projection: Option<&Vec<usize>>,
        _filters: &[Expr],
        limit: Option<usize>,
    ) -> Result<Arc<dyn ExecutionPlan>> {
        let mut scan = self.scan.clone();
        if scan.role.is_images() {
            scan.cameras = self.cameras().await.map_err(external)?;
        }
        let table = LogTable::Role(scan);
        let losses = self.losses.clone();
        scan_parts(
            table,
            &self.schema,
            &self.parts,
            losses,
            state,
            projection,
            limit,
        )
    }
}
