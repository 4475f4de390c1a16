//! A role is one descriptor: one that is made up here has a key in manifests, inference and a table like any other.
#![allow(clippy::unwrap_used, clippy::panic)]

use crate::common::by_hand::{channel, file, schema};
use crate::common::{Log, context, in_memory, rows, text};
use crate::hostile::{messages, opened};
use datafusion::prelude::SessionContext;
use evermap_datasets::{Dataset, Manifest, Reason, Recordings};
use evermap_schemas::roles::{self, FromMessage, Message, Messages, Role};
use evermap_schemas::{Fault, Stamp, record, rows as typed};
use url::Url;

record! {
    /// What somebody said on the way.
    #[layer("remarks", key(site, session, stamp))]
    pub struct Remark {
        /// Site that the session belongs to.
        site: String,
        /// Session that it was said in.
        session: String,
        /// When it was said.
        stamp: Stamp ["ns"],
        /// The words.
        words: String,
    }
}
impl FromMessage for Remark {
    const MEMBERS: &'static [&'static str] = &["data"];

    fn from_message(message: &Message<'_>) -> Result<Vec<Self>, String> {
        let words = message.fields.text(&["data"]).ok_or("expected words")?;
        if words.ends_with('8') {
            return Err("expected a remark without an 8 at its end".to_owned());
        }
        Ok(vec![Self {
            site: message.site.to_owned(),
            session: message.session.to_owned(),
            stamp: message.stamp(),
            words,
        }])
    }
}

const REMARKS: Role = Role::of::<Remark>(Messages::of::<Remark>(&["std_msgs/String"]));
const ROLES: [Role; 2] = [roles::frames::ROLE, REMARKS];

async fn open(manifest: &str) -> Result<(SessionContext, Dataset), Fault> {
    let log = Log {
        messages: 20,
        ..Log::default()
    };
    let context = context(2);
    let runtime = context.runtime_env();
    let url = Url::parse("memory://logs").unwrap();
    runtime.register_object_store(&url, in_memory(&log.write()).await);
    let paths = ["memory://logs/log.mcap".to_owned()];
    let manifest = Manifest::parse(manifest)?;
    let mut found = Recordings::find(&runtime, &paths, Some(&manifest)).await?;
    found.roles = &ROLES;
    let dataset = found.open().await?;
    dataset.register(&context)?;
    Ok((context, dataset))
}

#[tokio::test]
async fn a_made_up_role_is_inferred_and_read() {
    let (context, dataset) = open("site: here").await.unwrap();
    assert_eq!(dataset.sessions[0].roles.topics("remarks"), ["/text"]);
    let batches = rows(&context, "SELECT * FROM remarks ORDER BY stamp").await;
    let remarks: Vec<Remark> = batches
        .iter()
        .flat_map(|batch| typed(batch).unwrap())
        .collect();
    // Of messages 0, 2, …, 18, two end with an 8.
    assert_eq!(remarks.len(), 8);
    assert_eq!(remarks[1].words, "message 000002");
    assert_eq!((&*remarks[1].site, &*remarks[1].session), ("here", "log"));
    assert_eq!(remarks[1].stamp, Stamp(2_000_000_000));
    let lost = dataset.losses.entries();
    assert!(
        lost.iter()
            .all(|lost| lost.reason == Reason::Senseless && lost.topic == "/text")
    );
    assert_eq!(lost.len(), 2);
    let projected = rows(&context, "SELECT words FROM remarks WHERE words LIKE '%4'").await;
    let shown = text(&projected);
    assert!(
        shown.contains("000004") && shown.contains("000014"),
        "{shown}"
    );
}

#[tokio::test]
async fn a_manifest_gives_topics_to_roles_that_there_are() {
    let (_, dataset) = open("roles: {remarks: /te*}").await.unwrap();
    assert_eq!(dataset.sessions[0].roles.topics("remarks"), ["/text"]);
    let fault = open("roles: {remark: /text}")
        .await
        .err()
        .unwrap()
        .to_string();
    assert!(
        fault.contains("expected one of the roles frames, remarks, found remark"),
        "{fault}"
    );
    let fault = open("roles: {remarks: /none}")
        .await
        .err()
        .unwrap()
        .to_string();
    assert!(
        fault.contains("expected a topic for the role remarks"),
        "{fault}"
    );
}

/// Recorders list topics on which nobody spoke.
#[tokio::test]
async fn a_topic_without_messages_plays_nothing() {
    let definitions = [
        schema(1, "nav_msgs/msg/Odometry", "ros2msg", b"float64 x"),
        channel(1, 1, "/odom", "cdr"),
        channel(2, 1, "/wheels", "cdr"),
    ]
    .concat();
    let (_, spoken) = opened(&file(&[definitions.clone(), messages(&[2], 3)], &[])).await;
    let session = &spoken.sessions[0];
    assert_eq!(session.roles.topics("odometry"), ["/wheels"]);
    assert!(session.played().contains("odometry"));
    let (_, silent) = opened(&file(&[definitions], &[])).await;
    let session = &silent.sessions[0];
    assert_eq!(session.roles.topics("odometry"), ["/odom"]);
    assert!(session.is_silent("/odom") && session.played().is_empty());
}
