//! Sessions whose GNSS receiver had no fix: each message says so, none makes a row, and nothing else is said of it.

use std::cell::OnceCell;

use arrow::array::StructArray;
use datafusion::prelude::SessionContext;
use evermap_datasets::Dataset;
use evermap_engine::error::OrFault;
use evermap_engine::program::Program;
use evermap_engine::quoted;
use evermap_engine::sql::{Limits, context};
use evermap_schemas::roles::{
    CameraNames, Fields, FromMessage, GnssFix, Message, OdometryOf, gnss_fixes,
};
use evermap_schemas::{Fault, Stamp};
use futures::TryStreamExt;

use crate::odometry_frame::LOOKED_AT;
use crate::quantity::of;

/// The role that is looked at.
const FIXES: &str = gnss_fixes::ROLE.name;

/// What a person is told of the first [`LOOKED_AT`] sessions that have a GNSS receiver all of whose messages say that there
/// is no fix, where a program reads fixes. A session is read as far as its first message that says another thing; what is
/// wrong with that is told where its rows are read.
///
/// # Errors
/// A fault of ours.
pub async fn notes(dataset: &Dataset, program: &Program) -> Result<Vec<String>, Fault> {
    let mut notes = Vec::new();
    if !program.reads_source(FIXES) {
        return Ok(notes);
    }
    let receivers = dataset.sessions.iter().filter_map(|session| {
        let topic = session.roles.topics(FIXES).first()?;
        Some((session, topic))
    });
    for (session, topic) in receivers.take(LOOKED_AT) {
        // A table of all sessions looks at the files of all.
        let context = context(Limits::one_partition())?;
        dataset.of_session(session).register(&context)?;
        let blank = blank(&context, topic).await.unwrap_or_default();
        notes.extend(blank.map(|messages| {
            let messages = of(messages, "message");
            format!(
                "session {}: {messages} on {topic}, and none is a fix: nothing of it says where on earth the map lies",
                session.name
            )
        }));
    }
    Ok(notes)
}

/// How many messages a topic has, where all of them say that there is no fix.
async fn blank(context: &SessionContext, topic: &str) -> Result<Option<u64>, Fault> {
    let query = format!("SELECT * FROM {}", quoted::name(topic));
    let frame = context.sql(&query).await.or_fault()?;
    let mut batches = frame.execute_stream().await.or_fault()?;
    let mut messages = 0;
    while let Some(batch) = batches.try_next().await.or_fault()? {
        messages += batch.num_rows() as u64;
        let members = StructArray::from(batch);
        if !Fields::all(&members).all(is_no_fix) {
            return Ok(None);
        }
    }
    Ok((messages > 0).then_some(messages))
}

fn is_no_fix(fields: Fields<'_>) -> bool {
    let message = Message {
        site: "",
        session: "",
        topic: "",
        log_time: Stamp(0),
        fields,
        zero: &OnceCell::new(),
        image: None,
        cameras: &CameraNames::default(),
        bits: None,
        robot: &OdometryOf::default(),
        still: None,
    };
    GnssFix::from_message(&message).is_ok_and(|rows| rows.is_empty())
}
