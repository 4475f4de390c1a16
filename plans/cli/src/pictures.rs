//! Images that are not what the role of their topic says: no pictures, or nothing but.

use evermap_datasets::{Dataset, Session};
use evermap_engine::quoted;
use evermap_engine::sql::{Limits, context};
use evermap_schemas::Fault;
use evermap_schemas::roles::{RawFormat, Role, depth_frames, frames, label_frames};

use crate::coordinate_frames::texts_of;
use crate::odometry_frame::LOOKED_AT;

/// The images of a session are known after so many.
const IMAGES: usize = 64;

/// The raw encoding of range images, in metres, which is of no picture.
const FLOATS: &str = "32FC1";

/// The format of pictures alone: values that are data do not outlive it.
const JPEG: &str = "jpeg";

/// Images of a role that are not what it says.
struct Other {
    role: Role,
    expected: &'static str,
    format: &'static str,
    found: &'static str,
    /// What they may be, and the role of such.
    may_be: (&'static str, Role),
}

const PICTURES: (&str, Role) = ("pictures", frames::ROLE);
const RANGES: (&str, Role) = ("range images", depth_frames::ROLE);
const LABELS: (&str, Role) = ("label images", label_frames::ROLE);

impl Other {
    const fn jpeg((expected, role): (&'static str, Role)) -> Self {
        Self {
            role,
            expected,
            format: JPEG,
            found: "JPEG",
            may_be: PICTURES,
        }
    }
}

const OTHERS: [Other; 3] = [
    Other {
        role: PICTURES.1,
        expected: PICTURES.0,
        format: FLOATS,
        found: "samples of floating point (32FC1)",
        may_be: RANGES,
    },
    Other::jpeg(RANGES),
    Other::jpeg(LABELS),
];

/// What a person is told of the first [`LOOKED_AT`] sessions that have pictures of samples of floating point, as range images
/// are, or range and label images that are JPEG, as pictures are: all that looks at them leaves them out. A topic that no
/// manifest names has its role by its name.
///
/// # Errors
/// A fault of ours.
pub async fn notes(dataset: &Dataset) -> Result<Vec<String>, Fault> {
    let mut notes = Vec::new();
    for other in &OTHERS {
        let role = other.role.name;
        let plays = |session: &&Session| !session.roles.topics(role).is_empty();
        let players = dataset.sessions.iter().filter(plays);
        for session in players.take(LOOKED_AT) {
            let topics = topics_of(dataset, session, other).await?;
            let Other {
                expected, found, ..
            } = other;
            let (may_be, right) = (other.may_be.0, other.may_be.1.name);
            if !topics.is_empty() {
                notes.push(format!(
                    "session {}: expected {expected}, found {found} on {}; if these are {may_be}, give their topics to \
                     `{right}`, and not to `{role}`, by `roles` in a session manifest",
                    session.name,
                    topics.join(", ")
                ));
            }
        }
    }
    Ok(notes)
}

/// The topics of a session's first images of a role that are other ones; none of what cannot be read, which is told where
/// its rows are read.
async fn topics_of(
    dataset: &Dataset,
    session: &Session,
    other: &Other,
) -> Result<Vec<String>, Fault> {
    let context = context(Limits::one_partition())?;
    dataset.of_session(session).register(&context)?;
    let (session, role) = (quoted::text(&session.name), other.role.name);
    let first = format!(
        "SELECT DISTINCT topic, format FROM (SELECT topic, image['format'] AS format FROM {role} \
         WHERE session = {session} LIMIT {IMAGES}) ORDER BY topic, format"
    );
    let found = texts_of::<2>(&context, &first).await.unwrap_or_default();
    let found = found
        .into_iter()
        .filter(|[_, format]| RawFormat::parse(format).encoding == other.format);
    let mut topics: Vec<String> = found.map(|[topic, _]| topic).collect();
    topics.dedup();
    Ok(topics)
}
