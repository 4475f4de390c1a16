//! Images that are no pictures, of topics that are read as if they had some.

use evermap_datasets::{Dataset, Session};
use evermap_engine::quoted;
use evermap_engine::sql::{Limits, context};
use evermap_schemas::Fault;
use evermap_schemas::roles::{RawFormat, frames};

use crate::coordinate_frames::texts_of;
use crate::odometry_frame::LOOKED_AT;

/// The images of a session are known after so many.
const IMAGES: usize = 64;

/// The raw encoding of range images, in metres, which is of no picture.
const FLOATS: &str = "32FC1";

/// What a person is told of the first [`LOOKED_AT`] sessions whose frames are samples of floating point, as range images
/// are: all that looks at pictures leaves them out.
///
/// # Errors
/// A fault of ours.
pub async fn notes(dataset: &Dataset) -> Result<Vec<String>, Fault> {
    let mut notes = Vec::new();
    let pictured = |session: &&Session| !session.roles.topics(frames::ROLE.name).is_empty();
    let pictured = dataset.sessions.iter().filter(pictured);
    for session in pictured.take(LOOKED_AT) {
        let topics = float_topics(dataset, session).await?;
        if !topics.is_empty() {
            notes.push(format!(
                "session {}: expected pictures, found samples of floating point ({FLOATS}) on {}; if these are range \
                 images, give their topics to `depth_frames`, and not to `frames`, by `roles` in a session manifest",
                session.name,
                topics.join(", ")
            ));
        }
    }
    Ok(notes)
}

/// The topics of a session's first frames that have such samples; none of what cannot be read, which is told where its rows
/// are read.
async fn float_topics(dataset: &Dataset, session: &Session) -> Result<Vec<String>, Fault> {
    let context = context(Limits::one_partition())?;
    dataset.of_session(session).register(&context)?;
    let session = quoted::text(&session.name);
    let first = format!(
        "SELECT DISTINCT topic, format FROM (SELECT topic, image['format'] AS format FROM frames \
         WHERE session = {session} LIMIT {IMAGES}) ORDER BY topic, format"
    );
    let found = texts_of::<2>(&context, &first).await.unwrap_or_default();
    let floats = found
        .into_iter()
        .filter(|[_, format]| RawFormat::parse(format).encoding == FLOATS);
    let mut topics: Vec<String> = floats.map(|[topic, _]| topic).collect();
    topics.dedup();
    Ok(topics)
}
