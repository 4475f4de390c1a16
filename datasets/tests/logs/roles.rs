//! A role is one descriptor: one that is made up here has a key in manifests, inference and a table like any other.
#![allow(clippy::unwrap_used, clippy::panic)]

use crate::common::by_hand::{self, channel, file, message, schema, transform, transforms};
use crate::common::{Log, context, count, in_memory, rows, text};
use crate::hostile::{messages, opened};
use datafusion::prelude::SessionContext;
use evermap_datasets::fault::fault_of;
use evermap_datasets::{Dataset, Manifest, Reason, Recordings};
use evermap_schemas::roles::{self, FromMessage, Message, Messages, OdometryPose, Role};
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
            stamp: message.stamp()?,
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
    assert!(dataset.unknown_topics.is_empty());
    let (_, named) = open("roles: {remarks: [/text, /tex, '/no*']}")
        .await
        .unwrap();
    assert_eq!(named.sessions[0].roles.topics("remarks"), ["/text"]);
    let unknown = ["/tex", "/no*"].map(|topic| ("roles.remarks".to_owned(), topic.to_owned()));
    assert_eq!(named.unknown_topics, unknown);
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

/// Three messages on `/tf` of each of these transforms in turn, as many metres ahead as their number.
fn tf(chains: &[(&str, &str)]) -> Vec<u8> {
    let definitions = [transforms(1), channel(1, 1, "/tf", "json")];
    let numbered = chains.iter().cycle().take(3 * chains.len()).zip(0_u32..);
    let messages = numbered
        .map(|((parent, child), number)| transform(1, number, [parent, child], f64::from(number)));
    let records: Vec<Vec<u8>> = definitions.into_iter().chain(messages).collect();
    file(&records, &[])
}

/// The log's tables, opened with a manifest.
async fn opened_with(log: &[u8], manifest: &str) -> (SessionContext, Dataset) {
    let manifest = Manifest::parse(manifest).unwrap();
    opened_by(log, &manifest).await.unwrap()
}

async fn opened_by(log: &[u8], manifest: &Manifest) -> Result<(SessionContext, Dataset), Fault> {
    let context = context(2);
    let runtime = context.runtime_env();
    let url = Url::parse("memory://logs").unwrap();
    runtime.register_object_store(&url, in_memory(log).await);
    let paths = ["memory://logs/log.mcap".to_owned()];
    let dataset = Dataset::open(&runtime, &paths, Some(manifest)).await?;
    dataset.register(&context)?;
    Ok((context, dataset))
}

/// What keeps a log from being opened with a manifest: where it is, what it is, and what to do.
async fn refused(log: &[u8], manifest: &str) -> [String; 3] {
    let manifest = Manifest::parse(manifest).unwrap();
    let fault = opened_by(log, &manifest).await.err().unwrap();
    [fault.place, fault.message, fault.next]
}

/// A log of `nav_msgs/Odometry`: topics, the frame that their messages are of, and how many there are.
fn odometry(topics: &[(&str, &str, u32)]) -> Vec<u8> {
    let fields = br#"{"type": "object", "properties": {"child_frame_id": {"type": "string"}}}"#;
    let mut records = vec![schema(1, "nav_msgs/Odometry", "jsonschema", fields)];
    for ((topic, frame, messages), id) in topics.iter().zip(1_u16..) {
        records.push(channel(id, 1, topic, "json"));
        let said = serde_json::json!({ "child_frame_id": frame }).to_string();
        records.extend((0..*messages).map(|number| message(id, number, said.as_bytes())));
    }
    file(&records, &[])
}

/// How far ahead the odometry of a log was, or what keeps it from being read.
async fn ahead(log: &[u8], manifest: &str) -> Result<Vec<f64>, String> {
    let (context, dataset) = opened_with(log, manifest).await;
    let query = "SELECT * FROM odometry ORDER BY stamp";
    let batches = context.sql(query).await.unwrap().collect().await;
    let batches = batches.map_err(|error| fault_of(&error).to_string())?;
    assert!(dataset.losses.is_empty());
    let poses = batches
        .iter()
        .flat_map(|batch| typed::<OdometryPose>(batch).unwrap());
    Ok(poses.map(|row| row.odom_from_vehicle.x).collect())
}

const ONE: [(&str, &str); 2] = [("a/odom", "a/base_link"), ("a/base_link", "a/wheel")];

#[tokio::test]
async fn odometry_among_transforms_is_that_of_the_robot_that_is_meant() {
    let one = tf(&ONE);
    assert_eq!(ahead(&one, "").await.unwrap(), [0.0, 2.0, 4.0]);
    let slash = tf(&[("/odom", "/base_footprint")]);
    assert_eq!(ahead(&slash, "").await.unwrap(), [0.0, 1.0, 2.0]);
    let both = tf(&[ONE[0], ("b/odom", "b/base_link")]);
    let fault = ahead(&both, "").await.unwrap_err();
    for said in [
        "log.mcap: topic /tf",
        "found that of a/base_link, b/base_link",
        "`defaults: { vehicle_frame: a/base_link }`",
    ] {
        assert!(fault.contains(said), "{said}: {fault}");
    }
    let second = "defaults: {vehicle_frame: /b/base_link}";
    assert_eq!(ahead(&both, second).await.unwrap(), [1.0, 3.0, 5.0]);
    let third = "defaults: {vehicle_frame: c/base_link}";
    let fault = ahead(&both, third).await.unwrap_err();
    assert!(fault.contains("the odometry of c among"), "{fault}");
    // What is read of transforms themselves needs no choice.
    let (context, _) = opened_with(&both, "").await;
    assert_eq!(count(&context, "SELECT * FROM transforms").await, 6);
}

#[tokio::test]
async fn odometry_without_a_prefix_goes_before_that_of_robots() {
    let log = tf(&[ONE[0], ("odom", "base_link")]);
    assert_eq!(ahead(&log, "").await.unwrap(), [1.0, 3.0, 5.0]);
    let named = "defaults: {vehicle_frame: a/base_link}";
    assert_eq!(ahead(&log, named).await.unwrap(), [0.0, 2.0, 4.0]);
}

#[tokio::test]
async fn a_session_is_opened_again_with_the_robot_that_was_meant() {
    let log = tf(&ONE);
    let (_, dataset) = opened_with(&log, "defaults: {vehicle_frame: a/base_link}").await;
    let again = Manifest {
        defaults: dataset.sessions[0].vehicle.to_manifest(),
        ..Manifest::default()
    };
    assert_eq!(again.vehicle().frame(), "a/base_link");
    let (_, dataset) = opened_with(&log, "").await;
    assert!(dataset.sessions[0].vehicle.to_manifest().is_empty());
    // Where odometry has a topic of its own, no row depends on what the vehicle's frame is called.
    let definitions = [
        schema(1, "nav_msgs/msg/Odometry", "ros2msg", b"float64 x"),
        channel(1, 1, "/odom", "cdr"),
    ]
    .concat();
    let plain = file(&[definitions, messages(&[1], 3)], &[]);
    let (_, dataset) = opened_with(&plain, "defaults: {vehicle_frame: chassis}").await;
    assert!(dataset.sessions[0].vehicle.to_manifest().is_empty());
}

#[tokio::test]
async fn of_odometry_topics_the_one_of_the_vehicle_is_read() {
    let log = odometry(&[
        ("/x/odom", "a/base_link", 9),
        ("/y/odom", "/b/base_footprint", 5),
        ("/z/odom", "b/base_link", 3),
    ]);
    // Which is read, whether another would do too, and whether the vehicle chose.
    for (manifest, topic, told, of_vehicle) in [
        ("", "/x/odom", true, false),
        (
            "defaults: {vehicle_frame: base_link}",
            "/x/odom",
            true,
            false,
        ),
        ("defaults: {vehicle_frame: c_link}", "/x/odom", true, false),
        (
            "defaults: {vehicle_frame: a/base_link}",
            "/x/odom",
            false,
            true,
        ),
        (
            "defaults: {vehicle_frame: /b/base_link}",
            "/z/odom",
            false,
            true,
        ),
        (
            "defaults: {vehicle_frame: b/base_footprint}",
            "/y/odom",
            false,
            true,
        ),
        ("defaults: {vehicle_frame: b/lidar}", "/y/odom", true, true),
    ] {
        let (_, dataset) = opened_with(&log, manifest).await;
        let session = &dataset.sessions[0];
        assert_eq!(session.roles.topics("odometry"), [topic], "{manifest}");
        assert_eq!(
            dataset.notes.len(),
            usize::from(told),
            "{:?}",
            dataset.notes
        );
        // The same rows are read again by what was chosen.
        let again = Manifest {
            roles: session.roles.to_manifest(),
            defaults: session.vehicle.to_manifest(),
            ..Manifest::default()
        };
        assert_eq!(again.defaults.is_empty(), !of_vehicle, "{manifest}");
        let (_, again) = opened_by(&log, &again).await.unwrap();
        assert_eq!(again.sessions[0].roles, session.roles);
    }
}

#[tokio::test]
async fn odometry_of_another_robot_than_the_vehicle_is_refused() {
    let [one, other] = [("/x/odom", "a/base_link", 9), ("/y/odom", "b/base_link", 3)];
    let said =
        "expected odometry of b/base_link, found that of a/base_link on /x/odom, another robot's";
    let vehicle = "defaults: {vehicle_frame: b/base_link}";
    let alone = refused(&odometry(&[one]), vehicle).await;
    let next = "say which one is the vehicle in a session manifest: `defaults: { vehicle_frame: a/base_link }`";
    assert_eq!(alone, ["session log", said, next]);
    let both = odometry(&[one, other]);
    let named = format!("{vehicle}\nroles: {{odometry: /x/odom}}");
    let next = "give the role odometry the topic /y/odom in a session manifest";
    assert_eq!(refused(&both, &named).await, ["roles.odometry", said, next]);
    // Frames without a prefix, and of a part of the robot, are nobody else's.
    for frame in ["base_link", "a/lidar", "a/arm/tool"] {
        let manifest = format!("defaults: {{vehicle_frame: {frame}}}");
        let (_, dataset) = opened_with(&odometry(&[one]), &manifest).await;
        assert_eq!(dataset.sessions[0].roles.topics("odometry"), ["/x/odom"]);
        assert!(dataset.sessions[0].vehicle.to_manifest().is_empty());
    }
}

/// A log of topics, each with the frames that its messages name, that many times.
fn named(topics: &[(&str, &str, &str, u32)]) -> Vec<u8> {
    let text = serde_json::json!({"type": "string"});
    let mut records = Vec::new();
    for ((topic, kind, frame, messages), id) in topics.iter().zip(1_u16..) {
        let fields = serde_json::json!({"type": "object", "properties": {
            "frame_id": text, "child_frame_id": text,
        }});
        let fields = fields.to_string();
        records.push(schema(id, kind, "jsonschema", fields.as_bytes()));
        records.push(channel(id, id, topic, "json"));
        let said = serde_json::json!({"frame_id": frame, "child_frame_id": frame}).to_string();
        records.extend((0..*messages).map(|number| message(id, number, said.as_bytes())));
    }
    file(&records, &[])
}

const ODOMETRY: &str = "nav_msgs/Odometry";
const IMAGE: &str = "foxglove.CompressedImage";
const CALIBRATION: &str = "foxglove.CameraCalibration";
const TRANSFORM: &str = "foxglove.FrameTransform";

/// Two robots of which the second one speaks more, with cameras of these frames.
fn robots(cameras: [&'static str; 2], vehicles: [&'static str; 2]) -> Vec<Topics> {
    vec![
        ("/r1/cam/calibration", CALIBRATION, cameras[0], 1),
        ("/r1/cam/image", IMAGE, cameras[0], 2),
        ("/r1/odom", ODOMETRY, vehicles[0], 2),
        ("/r2/cam/calibration", CALIBRATION, cameras[1], 1),
        ("/r2/cam/image", IMAGE, cameras[1], 2),
        ("/r2/odom", ODOMETRY, vehicles[1], 3),
    ]
}

type Topics = (&'static str, &'static str, &'static str, u32);

/// What is read of some roles.
fn read_of(dataset: &Dataset) -> Vec<String> {
    let roles = &dataset.sessions[0].roles;
    let read = ["odometry", "frames", "calibration", "transforms"].map(|role| roles.topics(role));
    read.concat()
}

#[tokio::test]
async fn topics_of_one_robot_are_read_where_frames_of_several_are_called_alike() {
    let alike = || robots(["cam", "cam"], ["base_link", "base_link"]);
    let of = |robot: &str| {
        let names = ["odom", "cam/image", "cam/calibration"];
        names.map(|name| format!("/{robot}/{name}"))
    };
    let mut own = alike();
    own.push(("/r1/tf_static", TRANSFORM, "cam", 1));
    let own = named(&own);
    let (_, dataset) = opened_with(&own, "").await;
    let first = [&of("r1")[..], &["/r1/tf_static".to_owned()]].concat();
    assert_eq!(read_of(&dataset), first);
    let note = "session log: topics of several robots would do: those behind /r1 are read, and none behind /r2; say which one \
                is the vehicle in a session manifest: `roles: { odometry: /r2/odom }`";
    assert_eq!(dataset.notes, [note]);
    // What was chosen is chosen again, and nothing said.
    let again = Manifest {
        roles: dataset.sessions[0].roles.to_manifest(),
        ..Manifest::default()
    };
    let (_, again) = opened_by(&own, &again).await.unwrap();
    assert_eq!(again.sessions[0].roles, dataset.sessions[0].roles);
    assert!(again.notes.is_empty(), "{:?}", again.notes);
    for manifest in [
        "roles: {odometry: /r2/odom}",
        "roles: {frames: /r2/cam/image}",
    ] {
        let (_, dataset) = opened_with(&own, manifest).await;
        assert_eq!(read_of(&dataset), of("r2"), "{manifest}");
        assert!(dataset.notes.is_empty(), "{:?}", dataset.notes);
    }
    // Transforms that all share do not tell them apart, and cameras of one frame do.
    let mut shared = alike();
    shared.push(("/tf_static", TRANSFORM, "cam", 1));
    let (_, dataset) = opened_with(&named(&shared), "").await;
    let second = [&of("r2")[..], &["/tf_static".to_owned()]].concat();
    assert_eq!(read_of(&dataset), second);
}

#[tokio::test]
async fn cameras_of_one_vehicle_that_have_odometry_are_all_read() {
    let mut topics = robots(["front", "rear"], ["base_link", "base_link"]);
    topics.push(("/tf_static", TRANSFORM, "front", 1));
    let (_, dataset) = opened_with(&named(&topics), "").await;
    let frames = dataset.sessions[0].roles.topics("frames");
    assert_eq!(frames, ["/r1/cam/image", "/r2/cam/image"]);
}

#[tokio::test]
async fn the_vehicle_that_is_named_chooses_all_topics_of_its_robot() {
    let mut topics = robots(["a/cam", "b/cam"], ["a/base_link", "b/base_link"]);
    topics.push(("/tf_static", TRANSFORM, "a/cam", 1));
    let log = named(&topics);
    for (frame, robot) in [("a/base_link", "r1"), ("b/lidar", "r2")] {
        let manifest = format!("defaults: {{vehicle_frame: {frame}}}");
        let (_, dataset) = opened_with(&log, &manifest).await;
        let names = ["odom", "cam/image", "cam/calibration"];
        let own = names.map(|name| format!("/{robot}/{name}"));
        let own = [&own[..], &["/tf_static".to_owned()]].concat();
        assert_eq!(read_of(&dataset), own);
        assert!(dataset.notes.is_empty(), "{:?}", dataset.notes);
    }
    let (_, dataset) = opened_with(&log, "").await;
    let choice = "vehicle in a session manifest: `defaults: { vehicle_frame: a/base_link }`";
    assert!(dataset.notes[0].ends_with(choice), "{:?}", dataset.notes);
    // Their cameras are told apart by their frames, so a manifest may give those of both.
    let both = "roles: {odometry: /r1/odom, frames: ['/r1/*', '/r2/*']}";
    let (_, dataset) = opened_with(&log, both).await;
    assert_eq!(dataset.sessions[0].roles.topics("frames").len(), 2);
}

#[tokio::test]
async fn halves_of_two_robots_are_refused() {
    let log = named(&robots(["cam", "cam"], ["base_link", "base_link"]));
    let said = "expected topics of one robot, found /r1/cam/image for the role frames, and others behind /r2";
    let next = "give it topics behind /r2, such as /r2/cam/image, or read all behind /r1: say which one is the vehicle in a \
                session manifest: `roles: { odometry: /r1/odom }`";
    for frames in ["/r1/cam/image", "/*/cam/image"] {
        let manifest = format!("roles: {{odometry: /r2/odom, frames: '{frames}'}}");
        assert_eq!(refused(&log, &manifest).await, ["roles.frames", said, next]);
    }
}

#[tokio::test]
async fn odometry_is_the_transform_that_ends_in_the_frame_that_a_manifest_names() {
    let log = tf(&[("map", "odom"), ("odom", "chassis"), ("chassis", "wheel")]);
    let named = "defaults: {vehicle_frame: chassis}";
    assert_eq!(ahead(&log, named).await.unwrap(), [1.0, 4.0, 7.0]);
    let drone = tf(&[("world", "drone")]);
    let named = "defaults: {vehicle_frame: /drone}";
    assert_eq!(ahead(&drone, named).await.unwrap(), [0.0, 1.0, 2.0]);
}

#[tokio::test]
async fn transforms_that_move_no_vehicle_are_counted_with_what_a_manifest_may_say() {
    let (context, dataset) = opened_with(&tf(&[("odom", "chassis")]), "").await;
    for _ in 0..2 {
        assert_eq!(count(&context, "SELECT * FROM odometry").await, 0);
    }
    let said = "memory://logs/log.mcap: topics of transforms that move no vehicle on /tf: expected a transform from odom to \
                base_link, found odom -> chassis; say which one is the vehicle in a session manifest: \
                `defaults: { vehicle_frame: chassis }`";
    let told: Vec<_> = dataset.losses.told().into_iter().collect();
    assert_eq!(told, [(said.to_owned(), 1)]);
}

/// Two that publish on one topic would be one vehicle that leaps between theirs, and what a sender says before it knows its
/// frames would be all that is read.
#[tokio::test]
async fn odometry_of_other_frames_than_most_messages_of_its_topic_is_counted() {
    let fields = br#"{"type": "object", "properties": {
        "header": {"type": "object", "properties": {"frame_id": {"type": "string"}}},
        "child_frame_id": {"type": "string"},
        "pose": {"type": "object", "properties": {"pose": {"type": "object", "properties": {
            "position": {"type": "object", "properties":
                {"x": {"type": "number"}, "y": {"type": "number"}, "z": {"type": "number"}}},
            "orientation": {"type": "object", "properties":
                {"x": {"type": "number"}, "y": {"type": "number"}, "z": {"type": "number"}, "w": {"type": "number"}}}
        }}}}
    }}"#;
    let said = [
        ("", "", 9.0),
        ("/odom", "a/base_link", 0.0),
        ("b/odom", "b/base_link", 5.0),
        ("odom", "a/base_link", 1.0),
        ("odom", "/a/base_link", 2.0),
        ("b/odom", "b/base_link", 6.0),
    ];
    let messages = said.iter().zip(0..).map(|((parent, child, x), number)| {
        let pose = serde_json::json!({
            "position": {"x": x, "y": 0.0, "z": 0.0},
            "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
        });
        let said = serde_json::json!({
            "header": {"frame_id": parent}, "child_frame_id": child, "pose": {"pose": pose},
        });
        message(1, number, said.to_string().as_bytes())
    });
    let definitions = [
        schema(1, "nav_msgs/Odometry", "jsonschema", fields),
        channel(1, 1, "/odom", "json"),
    ];
    let log = file(
        &definitions.into_iter().chain(messages).collect::<Vec<_>>(),
        &[],
    );
    let (context, dataset) = opened_with(&log, "").await;
    let query = "SELECT * FROM odometry ORDER BY stamp";
    let batches = context.sql(query).await.unwrap().collect().await.unwrap();
    let poses = batches
        .iter()
        .flat_map(|batch| typed::<OdometryPose>(batch).unwrap());
    let found: Vec<f64> = poses.map(|row| row.odom_from_vehicle.x).collect();
    assert_eq!(found, [0.0, 1.0, 2.0]);
    let told: Vec<_> = dataset.losses.told().into_iter().collect();
    let [(said, count)] = &told[..] else {
        panic!("{told:?}");
    };
    let expected = r#"expected the pose of "a/base_link" in "odom", as most messages have it, found that of "" in """#;
    assert!(said.contains(expected), "{said}");
    assert_eq!(*count, 3, "{said}");
}

/// A frame has one parent: what moves the vehicle in another one is not read, and that is said.
#[tokio::test]
async fn transforms_that_move_the_vehicle_in_another_frame_are_counted() {
    let log = tf(&[("odom", "base_link"), ("map", "base_link"), ("map", "odom")]);
    for manifest in ["", "defaults: {vehicle_frame: base_link}"] {
        let (context, dataset) = opened_with(&log, manifest).await;
        for _ in 0..2 {
            assert_eq!(count(&context, "SELECT * FROM odometry").await, 3);
        }
        let said = "memory://logs/log.mcap: transforms that move the vehicle in another frame on /tf: base_link moves in map, \
                    too; odometry is read of odom -> base_link";
        let told: Vec<_> = dataset.losses.told().into_iter().collect();
        assert_eq!(told, [(said.to_owned(), 3)], "{manifest}");
    }
    let chain = tf(&[("odom", "base_footprint"), ("base_footprint", "base_link")]);
    assert_eq!(ahead(&chain, "").await.unwrap(), [0.0, 2.0, 4.0]);
}

/// Drivers that know no `/tf_static` send mounts again and again on `/tf`.
#[tokio::test]
async fn a_frame_that_no_transform_of_a_session_moves_is_fixed_and_has_one_row() {
    let sent = (0..6_u32).flat_map(|turn| {
        let ahead = f64::from(turn);
        let steered = if turn == 5 { 2.001 } else { 2.0 };
        [
            (["base", "left"], 1.0),
            (["odom", "base"], ahead),
            (["map", "odom"], 5.0),
            (["base", "steered"], steered),
            (["/base", "/right"], 3.0),
        ]
    });
    let messages = sent.zip(0_u32..);
    let messages = messages.map(|((frames, x), number)| transform(1, number, frames, x));
    let definitions = [
        transforms(1),
        channel(1, 1, "/tf", "json"),
        channel(2, 1, "/tf_static", "json"),
        transform(2, 0, ["base", "right"], 3.0),
    ];
    let records: Vec<Vec<u8>> = definitions.into_iter().chain(messages).collect();
    let log = file(&records, &[]);
    let (context, dataset) = opened_with(&log, "").await;
    for _ in 0..2 {
        let fixed = rows(
            &context,
            "SELECT * FROM transforms WHERE fixed ORDER BY child",
        )
        .await;
        let fixed = fixed
            .iter()
            .flat_map(|batch| typed::<roles::Transform>(batch).unwrap());
        let fixed: Vec<_> = fixed
            .map(|row| (row.parent, row.child, row.parent_from_child.x))
            .collect();
        let mount = |child: &str, x: f64| ("base".to_owned(), child.to_owned(), x);
        assert_eq!(fixed, [mount("left", 1.0), mount("right", 3.0)]);
    }
    for (child, sent) in [
        ("left", 1),
        ("base", 6),
        ("odom", 6),
        ("steered", 6),
        ("right", 7),
    ] {
        let of_child = format!("SELECT * FROM transforms WHERE child = '{child}'");
        assert_eq!(count(&context, &of_child).await, sent, "{child}");
    }
    assert!(dataset.losses.is_empty());
}

#[tokio::test]
async fn other_poses_go_before_transforms_that_move_no_vehicle() {
    const POSE: &[u8] =
        br#"{"type": "object", "properties": {"pose": {"type": "object", "properties": {
        "position": {"type": "object", "properties": {"x": {"type": "number"}}}}}}}"#;
    let log = |parent: &str, child: &str| {
        let records = [
            transforms(1),
            channel(1, 1, "/tf", "json"),
            schema(2, "foxglove.PoseInFrame", "jsonschema", POSE),
            channel(2, 2, "/slam/pose", "json"),
            transform(1, 0, [parent, child], 0.0),
            message(2, 0, b"{}"),
        ];
        file(&records, &[])
    };
    let wheel = log("base_link", "wheel");
    let (_, dataset) = opened_with(&wheel, "").await;
    assert_eq!(dataset.sessions[0].roles.topics("odometry"), ["/slam/pose"]);
    assert_eq!(dataset.sessions[0].roles.topics("transforms"), ["/tf"]);
    let note = "odometry is read from /slam/pose: /tf moves no vehicle";
    assert!(dataset.notes[0].contains(note), "{:?}", dataset.notes);
    let (_, dataset) = opened_with(&wheel, "roles: {odometry: /tf}").await;
    assert_eq!(dataset.sessions[0].roles.topics("odometry"), ["/tf"]);
    let named = "defaults: {vehicle_frame: wheel}";
    for (log, manifest) in [(log("odom", "base_link"), ""), (wheel, named)] {
        let (_, dataset) = opened_with(&log, manifest).await;
        assert_eq!(dataset.sessions[0].roles.topics("odometry"), ["/tf"]);
    }
}

/// A metadata record that names classes of these values.
fn label_classes(values: &[&str]) -> Vec<u8> {
    let entry = |value: &&str| {
        let text = [value.as_bytes(), b"a class"].map(by_hand::text);
        text.concat()
    };
    let entries: Vec<u8> = values.iter().flat_map(entry).collect();
    let body = [by_hand::text(b"label_classes"), by_hand::text(&entries)];
    by_hand::record(12, &body.concat())
}

#[tokio::test]
async fn classes_of_what_is_no_pixel_value_are_counted_with_what_was_found() {
    let records = [
        channel(1, 0, "/t", "json"),
        message(1, 0, b"{}"),
        label_classes(&["0", "26000", "255", "26001"]),
        label_classes(&["1", "car"]),
    ];
    let (context, dataset) = opened(&file(&records, &[])).await;
    // What is read twice is counted once.
    for _ in 0..2 {
        let query = "SELECT * FROM label_classes WHERE class = 'a class'";
        assert_eq!(count(&context, query).await, 3);
        let lost = dataset.losses.entries().into_iter();
        let lost: Vec<_> = lost
            .map(|lost| (lost.reason, lost.loss.count, lost.detail))
            .collect();
        let told = |found: &str| {
            format!("expected pixel values from 0 to 255 in label_classes, found {found}")
        };
        let expected = [
            (Reason::BadEntry, 2, told("\"26000\"")),
            (Reason::BadEntry, 1, told("\"car\"")),
        ];
        assert_eq!(lost, expected);
    }
}
