//! The role tables: whatever a log's messages are called, these have the schemas of [`evermap_schemas::roles`].
//!
//! They are scans like any other (splits, pruning by session and log time, projection), only with a builder that turns
//! decoded messages into the rows of a [`Role`]. No role is known here by name, but for the calibrations that name
//! cameras; whether its rows are of one robot, a role says itself. The rows' order is that of the log; sort by stamp
//! where order matters.

mod ahead;
mod cameras;
pub(crate) mod delays;
mod mounts;
pub(crate) mod robots;
mod rows;
mod still;
pub(crate) mod vehicle;

use std::collections::BTreeMap;
use std::sync::Arc;

use arrow::array::{Array, ArrayRef};
use arrow::compute::concat;
use arrow::datatypes::{DataType, FieldRef, SchemaRef};
use async_trait::async_trait;
use datafusion::catalog::TableProvider;
use datafusion::datasource::ViewTable;
use datafusion::prelude::SessionContext;
use evermap_schemas::roles::{CameraMount, CameraNames, Messages, Role, Source};
use evermap_schemas::{Column, Fault, Kind, Layer};
use futures::FutureExt;
use tokio::sync::OnceCell;

use crate::fault::fault_of;
use crate::losses::{Loss, Reason};
use crate::manifest::TopicBits;
use crate::scan::{LogTable, McapTable, RecordTable, RowBuilder};
use crate::session::{LogPart, Session};
use cameras::Cameras;
use mounts::Mounts;
use robots::RobotOf;
use rows::{Meant, RoleRows, SessionFacts};
use still::StillOf;

/// Topics that play a role, by session.
type Topics = BTreeMap<Arc<str>, Vec<String>>;

/// The table of a role over some sessions.
pub(crate) fn table(role: &Role, sessions: &[Session]) -> Result<Arc<dyn TableProvider>, Fault> {
    let parts: Vec<Arc<LogPart>> = sessions.iter().flat_map(|s| s.parts.clone()).collect();
    let layer = role.layer();
    let table: Arc<dyn LogTable> = match role.source {
        Source::Messages(messages) => Arc::new(MessageRole {
            name: role.name,
            schema: layer.schema(),
            messages,
            topics: topics(role.name, sessions),
            mounts: mounts(&messages, sessions),
            bits: bits(&messages, sessions),
            names: CameraTopics {
                topics: topics(cameras::ROLE.name, sessions),
                parts: parts.clone(),
                images: cameras::images(sessions),
                names: OnceCell::new(),
            },
            robots: messages
                .robots
                .map(|robots| RobotOf::new(*robots, messages.vehicle, role.name, sessions)),
            still: messages
                .still
                .map(|sent| StillOf::new(*sent, role.name, sessions)),
        }),
        Source::Metadata(played) => Arc::new(RecordTable::of_metadata(
            role.name,
            layer.schema(),
            move |part, records| {
                let records = records.filter(|(_, found)| found.name == played.record);
                let rows = records.map(|(offset, found)| {
                    let read = (played.read)(&part.site, &part.session, &found.metadata)?;
                    lose_entries(part, offset, &read.senseless);
                    Ok(read.columns)
                });
                joined(&rows.collect::<Result<Vec<_>, Fault>>()?)
            },
        )),
    };
    let table = Arc::new(McapTable::new(table, &parts));
    match role.messages() {
        Some(messages) if messages.drop_repeats => without_repeats(&layer, table),
        _ => Ok(table),
    }
}

/// Counts the entries of a metadata record that gave no rows.
fn lose_entries(part: &LogPart, offset: u64, senseless: &[(usize, String)]) {
    if let Some((_, detail)) = senseless.first() {
        let (count, bytes) = (senseless.len() as u64, 0);
        let loss = Loss { count, bytes };
        let losses = &part.losses;
        losses.note(Reason::BadEntry, offset, loss, detail.as_str());
    }
}

/// What each session says of fixed frames, where a role does.
fn mounts(role: &Messages, sessions: &[Session]) -> BTreeMap<Arc<str>, Arc<Mounts>> {
    let of_session = |session: &Session| {
        let first = session.parts.first()?;
        let mounts = Mounts::new(first.losses.clone());
        Some((session.name.clone(), Arc::new(mounts)))
    };
    let sessions = sessions.iter().filter(|_| role.mounts.is_some());
    sessions.filter_map(of_session).collect()
}

/// What is said of the samples of each session's pictures, where a role has pictures.
fn bits(role: &Messages, sessions: &[Session]) -> BTreeMap<Arc<str>, TopicBits> {
    let sessions = sessions.iter().filter(|_| role.pictures);
    let of_session = |session: &Session| (session.name.clone(), session.bits.clone());
    sessions.map(of_session).collect()
}

fn topics(role: &str, sessions: &[Session]) -> Topics {
    let played = sessions.iter();
    played
        .map(|session| (session.name.clone(), session.roles.topics(role).to_vec()))
        .collect()
}

/// The table without rows that repeat, in all but their stamp, the row of the same key before them in time.
fn without_repeats(
    layer: &Layer,
    table: Arc<dyn TableProvider>,
) -> Result<Arc<dyn TableProvider>, Fault> {
    let list = |columns: &mut dyn Iterator<Item = String>| columns.collect::<Vec<_>>().join(", ");
    let key = layer.key.iter().filter(|name| **name != "stamp");
    let columns = layer.columns.iter();
    let said = columns.filter(|column| !layer.key.contains(&column.name));
    let mut said = said.map(|column: &Column| as_text(column.name.to_owned(), &column.data_type));
    let query = format!(
        "SELECT {columns} FROM (
            SELECT *, lag(said) OVER (PARTITION BY {key} ORDER BY stamp, said) AS said_before
            FROM (SELECT *, concat_ws(' ', {said}) AS said FROM rows)
        )
        WHERE said_before IS NULL OR said_before <> said",
        columns = list(&mut layer.columns.iter().map(|column| column.name.to_owned())),
        key = list(&mut key.map(ToString::to_string)),
        said = list(&mut said),
    );
    let bug = |error| fault_of(&error).at(format!("the table {}", layer.name));
    let context = SessionContext::new();
    context.register_table("rows", table).map_err(bug)?;
    // Nothing in the making of this plan waits: the table is at hand.
    let frame = context.sql(&query).now_or_never();
    let frame = frame.ok_or_else(|| Fault::bug("planning a view had to wait"))?;
    let plan = frame.map_err(bug)?.into_unoptimized_plan();
    Ok(Arc::new(ViewTable::new(plan, None)))
}

/// What a column says, as arguments of `concat_ws`.
fn as_text(column: String, data_type: &DataType) -> String {
    match data_type {
        DataType::List(_) => format!("'/', array_to_string({column}, ',')"),
        DataType::Struct(fields) => {
            let within = |field: &FieldRef| {
                let path = format!("{column}['{}']", field.name());
                as_text(path, field.data_type())
            };
            let within: Vec<String> = fields.iter().map(within).collect();
            format!("'/', {}", within.join(", "))
        }
        _ => column,
    }
}

/// Where the cameras of a session are mounted by their first calibrations, by name; those that are not at the frame of their
/// name.
///
/// # Errors
/// A data fault for calibrations that cannot be decoded, a resource fault for a file that cannot be read.
pub(crate) async fn camera_mounts(
    session: &Session,
) -> Result<BTreeMap<String, CameraMount>, Fault> {
    let sessions = std::slice::from_ref(session);
    let (topics, images) = (
        topics(cameras::ROLE.name, sessions),
        cameras::images(sessions),
    );
    let names = cameras::read(&topics, &session.parts, &images).await?;
    let of_session = names.get(&session.name);
    Ok(of_session.map(CameraNames::mounts).unwrap_or_default())
}

/// A role that messages play.
#[derive(Debug)]
struct MessageRole {
    name: &'static str,
    schema: SchemaRef,
    messages: Messages,
    topics: Topics,
    mounts: BTreeMap<Arc<str>, Arc<Mounts>>,
    /// For a role of pictures.
    bits: BTreeMap<Arc<str>, TopicBits>,
    names: CameraTopics,
    /// For a role whose rows are of one robot.
    robots: Option<RobotOf>,
    /// For a role of transforms.
    still: Option<StillOf>,
}

/// What cameras are called, read when it is first asked. Calibrations may lie in other files than the frames they name.
#[derive(Debug)]
struct CameraTopics {
    topics: Topics,
    parts: Vec<Arc<LogPart>>,
    /// Which images of their cameras are read.
    images: Cameras,
    names: OnceCell<Cameras>,
}

impl CameraTopics {
    async fn of(&self, session: &str) -> Result<CameraNames, Fault> {
        let read = || cameras::read(&self.topics, &self.parts, &self.images);
        let names = self.names.get_or_try_init(read).await?;
        Ok(names.get(session).cloned().unwrap_or_default())
    }

    /// For the calibrations themselves: a topic that cannot be decoded is lost alone where its rows are read.
    async fn of_readable(&self, session: &str) -> Result<CameraNames, Fault> {
        match self.of(session).await {
            Err(fault) if fault.kind != Kind::Resource => Ok(self.unnamed(session)),
            found => found,
        }
    }

    /// Without names, for roles that have neither images nor calibrations.
    fn unnamed(&self, session: &str) -> CameraNames {
        self.images.get(session).cloned().unwrap_or_default()
    }
}

impl MessageRole {
    fn topics(&self, part: &LogPart) -> &[String] {
        self.topics.get(&part.session).map_or(&[], Vec::as_slice)
    }
}

#[async_trait]
impl LogTable for MessageRole {
    fn name(&self) -> &str {
        self.name
    }

    fn schema(&self) -> SchemaRef {
        self.schema.clone()
    }

    fn is_in(&self, part: &LogPart) -> bool {
        part.has_any(self.topics(part))
    }

    async fn rows(
        &self,
        part: &Arc<LogPart>,
        projection: &[usize],
    ) -> Result<Box<dyn RowBuilder>, Fault> {
        let known = SessionFacts {
            cameras: match self.messages.image {
                Some(_) => self.names.of(&part.session).await?,
                None if self.name == cameras::ROLE.name => {
                    self.names.of_readable(&part.session).await?
                }
                None => self.names.unnamed(&part.session),
            },
            robot: match &self.robots {
                Some(robots) => robots.of(&part.session).await?,
                None => Meant::default(),
            },
            still: match &self.still {
                Some(still) => Some(still.of(&part.session).await?),
                None => None,
            },
            mounts: self.mounts.get(&part.session).cloned(),
            bits: self.bits.get(&part.session).cloned().unwrap_or_default(),
        };
        let topics = self.topics(part);
        let rows = RoleRows::new(self.messages, topics, known, part, &self.schema, projection)?;
        Ok(Box::new(rows))
    }
}

/// Batches of the same columns, one below the other.
fn joined(batches: &[Vec<ArrayRef>]) -> Result<Vec<ArrayRef>, Fault> {
    let width = batches.first().map_or(0, Vec::len);
    let column = |index: usize| {
        let pieces: Vec<&dyn Array> = batches.iter().map(|b| b[index].as_ref()).collect();
        Ok(concat(&pieces)?)
    };
    (0..width).map(column).collect()
}
