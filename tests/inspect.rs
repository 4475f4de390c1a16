//! What `evermap inspect` says of a log, word by word, and the manifest that it writes.

use std::path::Path;

use evermap_datasets::log::record::{MAGIC, split};
use evermap_tests::json_log::JsonLog;
use evermap_tests::{Finished, command, evermap, text, write_nothing};
use serde_json::{Value, json};

/// Nanoseconds at which all logs here begin.
const START: u64 = 1_700_000_000_000_000_000;

/// Writes a log of ten seconds: odometry at 10 Hz with nothing between 4 and 6 s, two mounted cameras of which the
/// rear one records nothing, one image a second, a topic that nobody reads.
fn write(path: &Path) {
    let mut log = JsonLog::new(path);
    let (number, string) = (json!({"type": "number"}), json!({"type": "string"}));
    let object = |names: &[&str]| {
        let members = names
            .iter()
            .map(|name| ((*name).to_owned(), number.clone()));
        json!({"type": "object", "properties": members.collect::<serde_json::Map<_, _>>()})
    };
    let stamp = json!({"type": "object", "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}}});
    let (xyz, xyzw) = (object(&["x", "y", "z"]), object(&["x", "y", "z", "w"]));
    let pose = json!({"type": "object", "properties": {"position": xyz, "orientation": xyzw}});
    let odometry = json!({"timestamp": stamp, "frame_id": string, "pose": pose});
    let odometry = log.topic_of("/odom", "foxglove.PoseInFrame", &odometry);
    let transform = json!({
        "timestamp": stamp, "parent_frame_id": string, "child_frame_id": string, "translation": xyz, "rotation": xyzw,
    });
    let fixed = log.topic_of("/tf_static", "foxglove.FrameTransform", &transform);
    let moving = log.topic_of("/tf", "foxglove.FrameTransform", &transform);
    let images = json!({
        "timestamp": stamp, "frame_id": string, "format": string,
        "data": {"type": "string", "contentEncoding": "base64"},
    });
    let images = log.topic_of("/front/image", "foxglove.CompressedImage", &images);
    let battery = log.topic_of("/battery", "our.Battery", &json!({"volts": number}));

    let send = |log: &mut JsonLog, topic: u16, tenth: u64, mut message: Value| {
        let time = START + tenth * 100_000_000;
        message["timestamp"] = json!({"sec": time / 1_000_000_000, "nsec": time % 1_000_000_000});
        log.send(topic, 0, time, &message);
    };
    let nowhere = json!({"x": 0.0, "y": 0.0, "z": 0.0});
    let ahead = json!({"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0});
    let between = |parent: &str, child: &str| {
        json!({
            "parent_frame_id": parent, "child_frame_id": child, "translation": nowhere, "rotation": ahead,
        })
    };
    send(&mut log, fixed, 0, between("chassis", "bumper"));
    send(&mut log, fixed, 0, between("bumper", "front"));
    send(&mut log, fixed, 0, between("chassis", "rear"));
    send(&mut log, battery, 0, json!({"volts": 12.5}));
    for tenth in 0..=100 {
        send(&mut log, moving, tenth, between("odom", "chassis"));
        if !(41..60).contains(&tenth) {
            let position = json!({"x": 0.1 * tenth as f64, "y": 0.0, "z": 0.0});
            let pose = json!({"position": position, "orientation": ahead});
            send(
                &mut log,
                odometry,
                tenth,
                json!({"frame_id": "odom", "pose": pose}),
            );
        }
        if tenth % 10 == 0 {
            let image = json!({"frame_id": "front", "format": "jpeg", "data": "/9j/4AAQ"});
            send(&mut log, images, tenth, image);
        }
    }
    log.finish();
}

fn run_in(folder: &Path, arguments: &[&str]) -> Finished {
    let mut command = command(arguments);
    let output = command.current_dir(folder).output();
    output.expect("evermap starts").into()
}

/// Runs a plan on a map of this name.
fn run_plan_in(folder: &Path, plan: &str, map: &str, given: &[&str]) -> Finished {
    let run = ["run", plan, "--map", map, "--progress", "none"];
    run_in(folder, &[&run[..], given].concat())
}

/// The rows that a query of a map of this name has.
fn rows_in(folder: &Path, map: &str, query: &str) -> Value {
    let asked = ["sql", "--map", map, "--format", "json", query];
    run_in(folder, &asked).expect(0).json()
}

/// How far the vehicle drove ahead, by the poses of a map of this name.
fn driven_m(folder: &Path, map: &str) -> f64 {
    let query = "SELECT max(map_from_vehicle['x']) AS m FROM poses";
    rows_in(folder, map, query)[0]["m"].as_f64().unwrap()
}

/// Lines that say what the test is about, without the figures of the file's own bytes.
const SAID: &str = "\
messages     198
start        2023-11-14T22:13:20+00:00
end          2023-11-14T22:13:30+00:00  (10.0 s)

channels
         1            /battery      our.Battery [json, jsonschema]
        11   1.00 Hz  /front/image  foxglove.CompressedImage [json, jsonschema]
        82   8.10 Hz  /odom         foxglove.PoseInFrame [json, jsonschema]  nothing for 2.00 s after 4.00 s
       101     10 Hz  /tf           foxglove.FrameTransform [json, jsonschema]
         3            /tf_static    foxglove.FrameTransform [json, jsonschema]

roles
  frames       /front/image
  odometry     /odom
  transforms   /tf, /tf_static

frames
  bumper -> front (fixed)
  chassis -> bumper (fixed)
  chassis -> rear (fixed)
  odom -> chassis (moving)

cameras
  front (/front/image): mounted on chassis

plans
";

#[test]
fn inspect_lists_rates_gaps_frames_roles_and_plans() {
    let folder = tempfile::tempdir().unwrap();
    write(&folder.path().join("drive.mcap"));
    let said = run_in(folder.path(), &["inspect", "drive.mcap"])
        .expect(0)
        .stdout;
    let lines = said.lines().filter(|line| {
        let own = [
            "file ", "size ", "profile ", "library ", "index ", "chunks ",
        ];
        !own.iter().any(|own| line.starts_with(own))
    });
    let lines = lines.collect::<Vec<_>>().join("\n");
    let (before, plans) = lines.split_at(SAID.len().min(lines.len()));
    assert_eq!(before, SAID, "{said}");
    assert!(
        plans.contains("  trajectory   can run on this file"),
        "{plans}"
    );
    assert!(
        plans.contains("label_frames (step label_images)"),
        "{plans}"
    );
    let json = run_in(folder.path(), &["inspect", "--json", "drive.mcap"]);
    let json = json.expect(0).json();
    let odometry = json["channels"].as_array().unwrap().iter();
    let odometry = odometry.clone().find(|channel| channel["topic"] == "/odom");
    assert_eq!(odometry.unwrap()["longest_gap_s"], 2.0);
    let quick = run_in(
        folder.path(),
        &["inspect", "--quick", "--json", "drive.mcap"],
    );
    let quick = quick.expect(0).json();
    assert!(quick["frames"].is_null() && quick["channels"][0]["rate_hz"].is_null());
}

const WRITTEN: &str = "\
# Sessions of one site make one map. Without a site, each session is a site of its own.
site: drive

# The files of a session are the parts of one recording; relative paths begin at this file's folder.
sessions:
  - name: drive
    files: [FOLDER/drive.mcap]

# Which topics play which role, in all sessions. In a pattern, `*` stands for anything.
roles:
";

#[test]
fn the_manifest_that_inspect_writes_runs_and_is_edited() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    write(&at("drive.mcap"));
    let written = run_in(folder.path(), &["inspect", "--manifest", "drive.mcap"]);
    let written = written.expect(0).stdout;
    let expected = WRITTEN.replace("FOLDER", text(&folder.path().canonicalize().unwrap()));
    assert!(written.contains(&expected), "{written}");
    for line in [
        "\n  odometry: /odom  # foxglove.PoseInFrame\n",
        "\n  frames:\n    - /front/image  # foxglove.CompressedImage\n",
        "\n    - /tf_static  # foxglove.FrameTransform\n",
        "\n  # annotations:  # none found; evermap.Annotation\n",
        "\n# bits: { /camera/image_raw: 12 }\n",
        "\n  vehicle_frame: chassis  # frames of the logs: bumper, chassis, front, odom, rear\n",
        "\n  # odometry_scale_sigma: 0.01\n",
        "\n  # mask: { front: [[[0, 720], [1280, 720], [1280, 960], [0, 960]]] }\n",
    ] {
        assert!(written.contains(line), "{line}: {written}");
    }
    let manifest = at("drive.yaml");
    // Some editors begin a file with a byte order mark.
    std::fs::write(&manifest, format!("\u{feff}{written}")).unwrap();
    let map = at("map");
    let run = |map: &Path, manifest: &Path| {
        let manifest = ["--manifest", text(manifest)];
        run_plan_in(folder.path(), "trajectory", text(map), &manifest)
    };
    run(&map, &manifest).expect(0);
    let sites = evermap(&[
        "sql",
        "--map",
        text(&map),
        "--format",
        "csv",
        "SELECT DISTINCT site FROM lanes",
    ]);
    assert_eq!(sites.expect(0).stdout, "site\ndrive\n");

    // All that is commented out is what is meant where it is commented out: with it, the plan is checked as before.
    let without = |text: &str| {
        let lines = text.lines().map(|line| match line.strip_prefix("  # ") {
            Some(rest)
                if rest.starts_with(|c: char| c.is_lowercase())
                    && rest.contains(": ")
                    && !rest.contains("#") =>
            {
                format!("  {rest}\n")
            }
            _ => format!("{line}\n"),
        });
        lines.collect::<String>()
    };
    let all = without(&written);
    assert!(
        all.contains("\n  odometry_scale_sigma: 0.01\n") && all.contains("\n  mask: {"),
        "{all}"
    );
    std::fs::write(&manifest, &all).unwrap();
    let explained = evermap(&["explain", "lifelong", "--manifest", text(&manifest)]);
    let explained = explained.expect(0).stdout;
    assert!(explained.contains("vehicle_frame: chassis"), "{explained}");
    assert!(
        explained.contains("odometry_scale_sigma: 0.01"),
        "{explained}"
    );

    let drive = at("drive.mcap");
    let masked = "defaults:\n  mask: { rear: [[[0, 0], [9, 0], [9, 9]]] }\n";
    std::fs::write(&manifest, masked).unwrap();
    let sessions = ["--manifest", text(&manifest), "--sessions", text(&drive)];
    let asked = [&["check", "lifelong"][..], &sessions].concat();
    let said = evermap(&asked).stderr;
    let warning =
        "warning: `mask` names `rear`, which no session given has: their cameras are `front`";
    assert!(said.contains(warning), "{said}");
    for (edit, place, said) in [
        ("odometri: /odom", "2:3", "expected one of the roles"),
        (
            "odometry: /odm",
            "2:13",
            "expected a topic for the role odometry that fits /odm",
        ),
        (
            "odometry: /front/image",
            "2:13",
            "for the role odometry, found /front/image of foxglove.CompressedImage",
        ),
        ("odometry: ['/od*', '/tf']", "2:13", "expected one topic"),
    ] {
        std::fs::write(&manifest, format!("roles:\n  {edit}\n")).unwrap();
        let named = ["--manifest", text(&manifest), "--sessions", text(&drive)];
        for asked in [
            &["check", "trajectory"][..],
            &["run", "trajectory", "--map", text(&map)],
            &["sql", "--query", "SELECT 1"],
        ] {
            let refused = evermap(&[asked, &named].concat()).expect(1).stderr;
            let place = format!("drive.yaml:{place}");
            assert!(
                refused.contains(&place) && refused.contains(said),
                "{edit}: {refused}"
            );
        }
    }
    for (edit, said) in [
        ("vehicle_frame: [1]", "vehicle_frame"),
        ("vehicle_frme: chassis", "did you mean `vehicle_frame`?"),
        ("odometry_scale_sigma: -1", "odometry_scale_sigma"),
    ] {
        std::fs::write(&manifest, format!("defaults:\n  {edit}\n")).unwrap();
        let refused = evermap(&["check", "metric_map", "--manifest", text(&manifest)]);
        let refused = refused.expect(1).stderr;
        assert!(
            refused.contains("drive.yaml:2") && refused.contains(said),
            "{edit}: {refused}"
        );
    }
}

#[test]
fn the_schema_of_manifests_has_every_role_and_every_parameter() {
    let schema = evermap(&["schema", "manifest"]).expect(0).json();
    let properties = &schema["properties"];
    for role in [
        "odometry",
        "frames",
        "depth_frames",
        "calibration",
        "transforms",
    ] {
        let role = &properties["roles"]["properties"][role];
        assert!(role["description"].is_string(), "{role}");
    }
    let defaults = &properties["defaults"]["properties"];
    let reference = defaults["vehicle_frame"]["anyOf"][0]["$ref"]
        .as_str()
        .unwrap();
    let described = schema.pointer(reference.trim_start_matches('#')).unwrap();
    assert!(described["description"].is_string(), "{described}");
    assert_eq!(schema["additionalProperties"], false);
    let session = schema["properties"]["sessions"]["items"]["$ref"]
        .as_str()
        .unwrap();
    let session = schema.pointer(session.trim_start_matches('#')).unwrap();
    assert_eq!(session["required"], json!(["name", "files"]));
}

/// A topic whose name would clear the screen and set colours is printed without doing so, on both outputs.
#[test]
fn names_that_move_a_cursor_are_escaped() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("log.mcap");
    let named = ("S\u{9b}31m", &b"no JSON\x1b[1m"[..]);
    write_nothing(&path, "/a\u{1b}[2Jb", named);
    for (asked, names_it) in [
        (vec!["inspect", text(&path)], true),
        (vec!["sql", "--sessions", text(&path), "SHOW TABLES"], true),
        (
            vec!["sql", "--sessions", text(&path), "FROM \"/a\u{1b}[2Jb\""],
            true,
        ),
        (
            vec!["check", "trajectory", "--sessions", text(&path)],
            false,
        ),
    ] {
        let told = command(&asked).output().unwrap();
        let told = [told.stdout, told.stderr].map(|text| String::from_utf8(text).unwrap());
        for text in &told {
            assert!(!text.contains(['\u{1b}', '\u{9b}']), "{asked:?}: {text:?}");
        }
        let is_named = told.iter().any(|text| text.contains("/a\\u{1b}[2Jb"));
        assert!(is_named || !names_it, "{asked:?}: {told:?}");
    }
}

/// A payload outside chunks has no checksum of its own: that of the whole tells, also where an attachment lies between.
#[test]
fn a_flipped_bit_outside_chunks_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("log.mcap");
    let options = mcap::WriteOptions::new().use_chunks(false);
    let mut log = JsonLog::with(&path, options);
    let topic = log.topic("/a", "S", b"{\"type\": \"object\"}");
    let attachment = mcap::Attachment {
        log_time: 1,
        create_time: 1,
        name: "notes".to_owned(),
        media_type: "text/plain".to_owned(),
        data: vec![b'n'; 3 << 20].into(),
    };
    log.0.attach(&attachment).unwrap();
    let message = json!({"volts": 12.25});
    log.send(topic, 0, 1, &message);
    log.finish();
    let told = evermap(&["inspect", text(&path)]);
    assert_eq!(told.code, 0, "{}", told.stderr);
    let mut bytes = std::fs::read(&path).unwrap();
    let payload = message.to_string();
    let at = bytes
        .windows(payload.len())
        .position(|w| w == payload.as_bytes());
    bytes[at.unwrap() + 10] ^= 1;
    std::fs::write(&path, &bytes).unwrap();
    let told = evermap(&["inspect", text(&path)]);
    assert_eq!(told.code, 3, "{}", told.stdout);
    let said = "logs with a wrong checksum of their data";
    assert!(told.stdout.contains(said), "{}", told.stdout);
    assert!(
        told.stdout.contains("expected the checksum"),
        "{}",
        told.stdout
    );
}

/// Messages went with a chunk that was cut out, and its summary leads nowhere: what it counts is held against the file.
#[test]
fn messages_that_went_with_a_chunk_are_told_by_inspect_and_queries() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("log.mcap");
    let options = mcap::WriteOptions::new().chunk_size(Some(200));
    let mut log = JsonLog::with(&path, options);
    let topic = log.0.add_channel(0, "/a", "json", &Default::default());
    let topic = topic.unwrap();
    for sequence in 0..40 {
        log.send(topic, sequence, sequence.into(), &json!({}));
    }
    log.finish();
    let query = "SELECT count(*) AS n FROM messages";
    let asked = ["sql", "--format", "json", "--sessions", text(&path), query];
    let told = evermap(&["inspect", text(&path)]);
    assert!(told.expect(0).stdout.contains("index        summary\n"));
    evermap(&asked).expect(0);

    let bytes = std::fs::read(&path).unwrap();
    let mut at = MAGIC.len();
    let mut chunks = Vec::new();
    while let Some((opcode, _, used)) = split(&bytes[at..]) {
        if opcode == mcap::records::op::CHUNK {
            chunks.push(at);
        }
        at += used;
    }
    assert!(chunks.len() > 4);
    let cut = [&bytes[..chunks[2]], &bytes[chunks[3]..]].concat();
    std::fs::write(&path, cut).unwrap();
    let told = evermap(&["inspect", text(&path)]).expect(3).stdout;
    for said in [
        "index        a summary that is not believed; read from the start",
        "summaries that contradict their file",
        "expected 40 messages as the summary says, found 3",
    ] {
        assert!(told.contains(said), "{said}: {told}");
    }
    let told = evermap(&asked).expect(3);
    let rows = told.json();
    assert!((20..40).contains(&rows[0]["n"].as_u64().unwrap()), "{rows}");
    assert!(
        told.stderr.contains("expected 40 messages"),
        "{}",
        told.stderr
    );
}

/// A key of metadata that comes twice takes the record out of queries, and `inspect` says so.
#[test]
fn damaged_metadata_is_told_by_inspect_and_queries() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("log.mcap");
    let options = mcap::WriteOptions::new().calculate_data_section_crc(false);
    let file = std::fs::File::create(&path).unwrap();
    let mut log = options.create(file).unwrap();
    let classes = [("1", "road"), ("2", "car")];
    let classes = classes.map(|(value, name)| (value.to_owned(), name.to_owned()));
    let metadata = mcap::records::Metadata {
        name: "label_classes".to_owned(),
        metadata: classes.into(),
    };
    log.write_metadata(&metadata).unwrap();
    log.finish().unwrap();
    let asked = ["sql", "--sessions", text(&path), "SELECT * FROM metadata"];
    let told = evermap(&["inspect", text(&path)]).expect(0).stdout;
    assert!(told.contains("metadata     label_classes"), "{told}");
    evermap(&asked).expect(0);

    let mut bytes = std::fs::read(&path).unwrap();
    let second = b"\x01\0\0\x002";
    let at = bytes.windows(5).position(|found| found == second);
    bytes[at.unwrap() + 4] = b'1';
    std::fs::write(&path, bytes).unwrap();
    let said = "expected each key once, found \"1\" twice";
    for asked in [
        &["inspect", text(&path)][..],
        &["inspect", "--quick", text(&path)],
    ] {
        let told = evermap(asked).expect(3).stdout;
        assert!(told.contains("damaged attachments or metadata"), "{told}");
        assert!(
            told.contains(said) && !told.contains("metadata     label"),
            "{told}"
        );
    }
    let told = evermap(&asked).expect(3).stderr;
    assert!(told.contains(said), "{told}");
}

/// A run reads all of a log for its digest, also what lies between messages.
#[test]
fn a_run_tells_of_a_flipped_bit_outside_chunks_and_remembers_it() {
    let folder = tempfile::tempdir().unwrap();
    let options = mcap::WriteOptions::new().use_chunks(false);
    let mut log = JsonLog::with(&folder.path().join("drive.mcap"), options);
    let numbers = |names: &[&str]| {
        let member = |name: &&str| ((*name).to_owned(), json!({"type": "number"}));
        let members: serde_json::Map<_, _> = names.iter().map(member).collect();
        json!({"type": "object", "properties": members})
    };
    let pose = json!({"type": "object", "properties": {
        "position": numbers(&["x", "y", "z"]), "orientation": numbers(&["x", "y", "z", "w"]),
    }});
    let members = json!({"frame_id": {"type": "string"}, "pose": pose});
    let odometry = log.topic_of("/odom", "foxglove.PoseInFrame", &members);
    let attachment = mcap::Attachment {
        log_time: 1,
        create_time: 1,
        name: "notes".to_owned(),
        media_type: "text/plain".to_owned(),
        data: vec![b'n'; 1000].into(),
    };
    log.0.attach(&attachment).unwrap();
    for tenth in 0..20_u32 {
        let message = json!({"frame_id": "odom", "pose": {
            "position": {"x": f64::from(tenth) + 0.125, "y": 0.0, "z": 0.0},
            "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
        }});
        let time = START + u64::from(tenth) * 100_000_000;
        log.send(odometry, tenth, time, &message);
    }
    log.finish();
    let run =
        |log: &str, map: &str| run_plan_in(folder.path(), "trajectory", map, &["--sessions", log]);
    let said = "logs with a wrong checksum of their data";
    let sound = run("drive.mcap", "sound");
    assert!(!sound.stderr.contains(said), "{}", sound.stderr);
    let mut bytes = std::fs::read(folder.path().join("drive.mcap")).unwrap();
    let at = bytes.windows(5).position(|found| found == b"6.125");
    bytes[at.unwrap()] ^= 1;
    std::fs::write(folder.path().join("flipped.mcap"), bytes).unwrap();
    // The second time the log is not read again.
    for _ in 0..2 {
        let told = run("flipped.mcap", "flipped").expect(3).stderr;
        assert!(told.contains(said), "{told}");
    }
}

#[test]
fn messages_that_no_checksum_covers_are_told() {
    let folder = tempfile::tempdir().unwrap();
    let told = |summed: bool| {
        let path = folder.path().join(format!("{summed}.mcap"));
        let options = mcap::WriteOptions::new().use_chunks(false);
        let options = options.calculate_data_section_crc(summed);
        let mut log = JsonLog::with(&path, options);
        let topic = log.0.add_channel(0, "/a", "json", &Default::default());
        log.send(topic.unwrap(), 0, 1, &json!({}));
        log.finish();
        evermap(&["inspect", text(&path)]).expect(0).stdout
    };
    let note = "note         1 message outside of chunks with no checksum to hold to";
    assert!(told(false).contains(note));
    assert!(!told(true).contains("no checksum"));
}

/// A topic whose name has a line break, and a tab, is on one line.
#[test]
fn names_that_break_a_line_are_escaped() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("log.mcap");
    let mut log = JsonLog::new(&path);
    let topic = "/a\nloss\tat byte 7";
    let channel = log.topic(topic, "S\n", b"{\"type\": \"object\"}");
    log.send(channel, 0, 1, &json!({}));
    let metadata = mcap::records::Metadata {
        name: "of\nit".to_owned(),
        metadata: Default::default(),
    };
    log.0.write_metadata(&metadata).unwrap();
    log.finish();
    let told = evermap(&["inspect", text(&path)]);
    for line in [
        "/a\\nloss\\tat byte 7  S\\n [json, jsonschema]",
        "metadata     of\\nit",
    ] {
        let mut lines = told.stdout.lines();
        assert!(lines.any(|told| told.contains(line)), "{}", told.stdout);
    }
    // Programs get the names as they are.
    let told = evermap(&["inspect", "--json", text(&path)]).json();
    assert_eq!(told["channels"][0]["topic"], topic);
}

/// Writes a log of two seconds with the odometry of two robots on `/tf`, 0.1 and 0.2 m a message ahead.
fn write_robots(path: &Path) {
    let first = ("robot1/odom", "robot1/base_link", 0.1);
    write_moving(path, &[first, ("robot2/odom", "robot2/base_link", 0.2)]);
}

/// Writes a log of two seconds with these transforms on `/tf`, each so many metres a message ahead.
fn write_moving(path: &Path, transforms: &[(&str, &str, f64)]) {
    let mut log = JsonLog::new(path);
    let (number, string) = (json!({"type": "number"}), json!({"type": "string"}));
    let xyz = json!({"type": "object", "properties": {"x": number, "y": number, "z": number}});
    let xyzw = json!({"type": "object", "properties": {"x": number, "y": number, "z": number, "w": number}});
    let members = json!({
        "parent_frame_id": string, "child_frame_id": string, "translation": xyz, "rotation": xyzw,
    });
    let topic = log.topic_of("/tf", "foxglove.FrameTransform", &members);
    for tenth in 0..20_u32 {
        for (parent, child, step_m) in transforms {
            let message = json!({
                "parent_frame_id": parent,
                "child_frame_id": child,
                "translation": {"x": step_m * f64::from(tenth), "y": 0.0, "z": 0.0},
                "rotation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
            });
            let time = START + u64::from(tenth) * 100_000_000;
            log.send(topic, tenth, time, &message);
        }
    }
    log.finish();
}

#[test]
fn transforms_of_other_names_are_odometry_once_a_manifest_says_the_frame_and_counted_before() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    write_moving(&at("drone.mcap"), &[("world", "drone", 0.1)]);
    let inspected = run_in(folder.path(), &["inspect", "drone.mcap"]).expect(0);
    let checked = ["check", "trajectory", "--sessions", "drone.mcap"];
    let checked = run_in(folder.path(), &checked).expect(0).stderr;
    let lacks = "  trajectory   lacks odometry (step inertial_odometry)\n";
    assert!(inspected.stdout.contains(lacks), "{}", inspected.stdout);
    for said in [inspected.stdout, checked] {
        let note = "nothing comes of odometry, as /tf moves no vehicle: expected a transform from odom to base_link, found \
                    world -> drone; say which one is the vehicle";
        assert!(said.contains(note), "{said}");
    }
    let run = |map: &str, given: &[&str]| run_plan_in(folder.path(), "trajectory", map, given);
    let told = run("none", &["--sessions", "drone.mcap"]).expect(3).stderr;
    for said in [
        "topics of transforms that move no vehicle on /tf",
        "found world -> drone",
        "`defaults: { vehicle_frame: drone }`",
        "no layer has rows",
    ] {
        assert!(told.contains(said), "{said}: {told}");
    }
    let written = run_in(folder.path(), &["inspect", "--manifest", "drone.mcap"]);
    std::fs::write(at("drone.yaml"), written.expect(0).stdout).unwrap();
    run("map", &["--manifest", "drone.yaml"]).expect(0);
    let query = "SELECT max(map_from_vehicle['x']) > 1 AS moved FROM poses";
    let asked = rows_in(folder.path(), "map", query);
    assert_eq!(asked[0]["moved"], true);
}

#[test]
fn of_robots_that_share_a_log_a_manifest_says_which_is_the_vehicle() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    write_robots(&at("drive.mcap"));
    let choice = "say which one is the vehicle in a session manifest: `defaults: { vehicle_frame: robot1/base_link }`";
    let inspected = run_in(folder.path(), &["inspect", "drive.mcap"])
        .expect(0)
        .stdout;
    let told = format!("\nrobots\n  robot1/base_link, robot2/base_link: {choice}\n");
    assert!(inspected.contains(&told), "{inspected}");

    let run = |map: &str, given: &[&str]| run_plan_in(folder.path(), "trajectory", map, given);
    let refused = run("map", &["--sessions", "drive.mcap"]).expect(1).stderr;
    let found = "expected the odometry of one robot among transforms, found that of robot1/base_link, robot2/base_link";
    assert!(
        refused.contains(found) && refused.contains(choice),
        "{refused}"
    );

    let written = run_in(folder.path(), &["inspect", "--manifest", "drive.mcap"]);
    let written = written.expect(0).stdout;
    let asked = "\n  # vehicle_frame: robot1/base_link  # say which robot is the vehicle: robot1/base_link, robot2/base_link\n";
    assert!(written.contains(asked), "{written}");
    let driven_m = |robot: &str| {
        let said = format!("\n  vehicle_frame: {robot}/base_link\n");
        let manifest = format!("{robot}.yaml");
        std::fs::write(at(&manifest), written.replace(asked, &said)).unwrap();
        // One map, made anew where the vehicle is another.
        run("map", &["--manifest", &manifest]).expect(0);
        driven_m(folder.path(), "map")
    };
    let (first, second) = (driven_m("robot1"), driven_m("robot2"));
    assert!(
        (1.0..=1.9).contains(&first) && (second - 2.0 * first).abs() < 0.5,
        "{first} {second}"
    );
}

#[test]
fn a_plan_or_a_setting_says_which_is_the_vehicle_as_a_manifest_does() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    write_robots(&at("drive.mcap"));
    let second =
        "plan: second\nextends: trajectory\ndefaults: { vehicle_frame: robot2/base_link }\n";
    std::fs::write(at("second.yaml"), second).unwrap();
    let roads = "plan: roads\nextends: georeference\nneeds: []\n";
    std::fs::write(at("roads.yaml"), roads).unwrap();
    let run = |plan: &str, map: &str, more: &[&str]| {
        let given = ["--sessions", "drive.mcap"];
        run_plan_in(folder.path(), plan, map, &[&given[..], more].concat())
    };
    let driven_m = |map: &str| driven_m(folder.path(), map);
    run("second.yaml", "planned", &[]).expect(0);
    let set = |step: &str, robot: &str| format!("{step}.vehicle_frame={robot}/base_link");
    let first = set("inertial_odometry", "robot1");
    run("trajectory", "set", &["--set", &first]).expect(0);
    let (first_m, second_m) = (driven_m("set"), driven_m("planned"));
    assert!(
        (1.0..=1.9).contains(&first_m) && (second_m - 2.0 * first_m).abs() < 0.5,
        "{first_m} {second_m}"
    );

    // One odometry is of one vehicle.
    let other = set("antenna_positions", "robot2");
    let sets = ["--set", &first, "--set", &other];
    let refused = run("roads.yaml", "map", &sets).expect(1).stderr;
    for said in [
        "the odometry of session drive",
        "robot1/base_link (step inertial_odometry) and robot2/base_link (step antenna_positions)",
        "say it once, in `defaults: { vehicle_frame: robot1/base_link }` of the plan or of a session manifest",
    ] {
        assert!(refused.contains(said), "{said}: {refused}");
    }
    assert!(!at("map").join("versions").exists());
}

/// Writes a log of these topics in JSON: name, type, members of the type, messages one tenth of a second apart.
fn write_topics(path: &Path, topics: &[(&str, &str, Value, Vec<Value>)]) {
    let mut log = JsonLog::new(path);
    for (topic, kind, members, messages) in topics {
        let topic = log.topic_of(topic, kind, members);
        for (message, tenth) in messages.iter().zip(0_u32..) {
            let time = START + u64::from(tenth) * 100_000_000;
            log.send(topic, tenth, time, message);
        }
    }
    log.finish();
}

/// Members of a point, of a rotation, and of `nav_msgs/Odometry`.
fn members() -> [Value; 3] {
    let object = |names: &[&str]| {
        let member = |name: &&str| ((*name).to_owned(), json!({"type": "number"}));
        let members: serde_json::Map<_, _> = names.iter().map(member).collect();
        json!({"type": "object", "properties": members})
    };
    let (xyz, xyzw) = (object(&["x", "y", "z"]), object(&["x", "y", "z", "w"]));
    let pose = json!({"type": "object", "properties": {"position": xyz, "orientation": xyzw}});
    let covariant = json!({"type": "object", "properties": {"pose": pose}});
    let odometry = json!({"child_frame_id": {"type": "string"}, "pose": covariant});
    [xyz, xyzw, odometry]
}

/// Messages of odometry over two seconds, each so many metres ahead.
fn odometry_of(frame: &str, step_m: f64) -> Vec<Value> {
    let ahead = json!({"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0});
    let message = |tenth: u32| {
        let place = json!({"x": step_m * f64::from(tenth), "y": 0.0, "z": 0.0});
        let pose = json!({"position": place, "orientation": ahead});
        json!({"child_frame_id": frame, "pose": {"pose": pose}})
    };
    (0..20).map(message).collect()
}

#[test]
fn of_robots_with_odometry_topics_that_of_the_vehicle_is_read_and_another_ones_refused() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let [.., odometry] = members();
    let topic = |topic, frame, step_m| {
        let messages = odometry_of(frame, step_m);
        (topic, "nav_msgs/Odometry", odometry.clone(), messages)
    };
    let topics = [
        topic("/robot1/odom", "robot1/base_link", 0.1),
        topic("/robot2/odom", "robot2/base_link", 0.2),
    ];
    write_topics(&at("drive.mcap"), &topics);
    let vehicle = "defaults: { vehicle_frame: robot2/base_link }\n";
    std::fs::write(at("robot2.yaml"), vehicle).unwrap();
    let first = format!("{vehicle}roles: {{ odometry: /robot1/odom }}\n");
    std::fs::write(at("first.yaml"), first).unwrap();
    let given = ["--sessions", "drive.mcap"];
    let run = |map: &str, more: &[&str]| {
        let given = [&given[..], more].concat();
        run_plan_in(folder.path(), "trajectory", map, &given)
    };
    let driven_m = |map: &str| driven_m(folder.path(), map);
    let set = ["--set", "inertial_odometry.vehicle_frame=robot2/base_link"];
    run("first", &[]).expect(0);
    run("second", &["--manifest", "robot2.yaml"]).expect(0);
    run("set", &set).expect(0);
    let [first_m, second_m, set_m] = ["first", "second", "set"].map(driven_m);
    assert!((1.0..=1.9).contains(&first_m), "{first_m}");
    assert!(
        (second_m - 2.0 * first_m).abs() < 0.5,
        "{first_m} {second_m}"
    );
    assert_eq!(set_m, second_m);

    let check = ["check", "trajectory"];
    let check = |more: &[&str]| run_in(folder.path(), &[&check[..], &given[..], more].concat());
    let named = ["--manifest", "first.yaml"];
    for refused in [run("map", &named), check(&named)] {
        let refused = refused.expect(1).stderr;
        for said in [
            "expected odometry of robot2/base_link, found that of robot1/base_link on /robot1/odom, another robot's",
            "first.yaml:2:",
            "give the role odometry the topic /robot2/odom in a session manifest",
        ] {
            assert!(refused.contains(said), "{said}: {refused}");
        }
    }
    let third = ["--set", "inertial_odometry.vehicle_frame=robot3/base_link"];
    for refused in [run("map", &third), check(&third)] {
        let refused = refused.expect(1).stderr;
        let said = "expected odometry of robot3/base_link, found that of robot1/base_link";
        assert!(refused.contains(said), "{refused}");
    }
    assert!(!at("map").join("versions").exists());
}

#[test]
fn of_robots_whose_frames_are_called_alike_one_is_read_and_halves_of_two_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let [xyz, xyzw, odometry] = members();
    let string = json!({"type": "string"});
    let image = json!({
        "frame_id": string, "format": string, "data": {"type": "string", "contentEncoding": "base64"},
    });
    let transform = json!({
        "parent_frame_id": string, "child_frame_id": string, "translation": xyz, "rotation": xyzw,
    });
    let fixed = json!({
        "parent_frame_id": "base_link", "child_frame_id": "front",
        "translation": {"x": 1.0, "y": 0.0, "z": 0.0}, "rotation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
    });
    let picture = json!({"frame_id": "front", "format": "jpeg", "data": "/9j/"});
    let odom = |topic, step_m| {
        let messages = odometry_of("base_link", step_m);
        (topic, "nav_msgs/Odometry", odometry.clone(), messages)
    };
    let camera = |topic| {
        let messages = vec![picture.clone()];
        (topic, "foxglove.CompressedImage", image.clone(), messages)
    };
    let [mut first, second] = [odom("/robot1/odom", 0.1), odom("/robot2/odom", 0.2)];
    first.3.pop();
    let topics = [
        first,
        second,
        camera("/robot1/front/image"),
        camera("/robot2/front/image"),
        (
            "/robot1/tf_static",
            "foxglove.FrameTransform",
            transform,
            vec![fixed],
        ),
    ];
    write_topics(&at("drive.mcap"), &topics);
    let chosen = "roles: { odometry: /robot2/odom }\n";
    std::fs::write(at("robot2.yaml"), chosen).unwrap();
    let halves = "roles:\n  odometry: /robot2/odom\n  frames: /robot1/front/image\n";
    std::fs::write(at("halves.yaml"), halves).unwrap();
    let given = ["--sessions", "drive.mcap"];
    let run = |map: &str, more: &[&str]| {
        let given = [&given[..], more].concat();
        run_plan_in(folder.path(), "trajectory", map, &given)
    };
    let driven_m = |map: &str| driven_m(folder.path(), map);
    let note = "note: session drive: topics of several robots would do: those behind /robot1 are read, and none behind /robot2; \
                say which one is the vehicle in a session manifest: `roles: { odometry: /robot2/odom }`";
    let told = run("first", &[]).expect(0).stderr;
    assert!(told.contains(note), "{told}");
    let inspect = |options: &[&str]| {
        let inspect = ["inspect", "drive.mcap"];
        run_in(folder.path(), &[&inspect[..], options].concat())
    };
    let line = note.replacen("note: ", "\nnote         ", 1);
    for inspected in [inspect(&[]), inspect(&["--quick"])] {
        assert!(inspected.stdout.contains(&line), "{}", inspected.stdout);
    }
    let written = inspect(&["--manifest"]);
    assert!(written.stderr.contains(note), "{}", written.stderr);
    assert!(
        written.stdout.contains("/robot1/odom"),
        "{}",
        written.stdout
    );
    let named = run("second", &["--manifest", "robot2.yaml"])
        .expect(0)
        .stderr;
    assert!(!named.contains("several robots"), "{named}");
    let (first_m, second_m) = (driven_m("first"), driven_m("second"));
    assert!(
        (1.0..=1.9).contains(&first_m) && (second_m - 2.0 * first_m).abs() < 0.5,
        "{first_m} {second_m}"
    );

    let manifest = ["--manifest", "halves.yaml"];
    let check = [&["check", "trajectory"][..], &given[..], &manifest[..]].concat();
    for refused in [run("map", &manifest), run_in(folder.path(), &check)] {
        let refused = refused.expect(1).stderr;
        for said in [
            "expected topics of one robot, found /robot1/front/image for the role frames, and others behind /robot2",
            "halves.yaml:3:",
            "give it topics behind /robot2, such as /robot2/front/image",
        ] {
            assert!(refused.contains(said), "{said}: {refused}");
        }
    }
    assert!(!at("map").join("versions").exists());
}

#[test]
fn odometry_of_a_frame_elsewhere_on_the_vehicle_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let string = json!({"type": "string"});
    let [xyz, xyzw, members] = members();
    let place = |x: f64| json!({"x": x, "y": 0.0, "z": 0.0});
    let ahead = json!({"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0});
    let inspected = |child: &str| {
        let fixed = json!({
            "parent_frame_id": "base_link", "child_frame_id": "imu_link", "translation": place(2.0), "rotation": ahead,
        });
        let transform = json!({
            "parent_frame_id": string, "child_frame_id": string, "translation": xyz, "rotation": xyzw,
        });
        let topics = [
            (
                "/tf_static",
                "foxglove.FrameTransform",
                transform,
                vec![fixed],
            ),
            (
                "/odom",
                "nav_msgs/Odometry",
                members.clone(),
                odometry_of(child, 0.1),
            ),
        ];
        write_topics(&folder.path().join("drive.mcap"), &topics);
        run_in(folder.path(), &["inspect", "drive.mcap"])
            .expect(0)
            .stdout
    };
    let note = "\nnote         session drive: odometry is of imu_link, 2.00 m and 0.0° from base_link, and read as if it were of \
                base_link; say `defaults: { vehicle_frame: imu_link }` in a session manifest\n";
    let told = inspected("imu_link");
    assert!(told.contains(note), "{told}");
    for silent in ["", "base_link", "/base_link", "base_footprint"] {
        let told = inspected(silent);
        assert!(!told.contains("\nnote "), "{silent}: {told}");
    }
    inspected("imu_link");
    let run = |more: &[&str]| {
        let given = [&["--sessions", "drive.mcap"][..], more].concat();
        let ran = run_plan_in(folder.path(), "trajectory", "map", &given);
        ran.expect(0).stderr
    };
    let told = run(&[]);
    assert!(
        told.contains("note: session drive: odometry is of imu_link"),
        "{told}"
    );
    std::fs::write(
        folder.path().join("imu.yaml"),
        "defaults: { vehicle_frame: imu_link }\n",
    )
    .unwrap();
    let told = run(&["--manifest", "imu.yaml"]);
    assert!(!told.contains("odometry is of"), "{told}");
}

#[test]
fn a_session_whose_receiver_had_no_fix_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let (string, number) = (json!({"type": "string"}), json!({"type": "number"}));
    let object = |names: &[&str]| {
        let member = |name: &&str| ((*name).to_owned(), number.clone());
        let members: serde_json::Map<_, _> = names.iter().map(member).collect();
        json!({"type": "object", "properties": members})
    };
    let place = json!({"type": "object", "properties": {
        "position": object(&["x", "y", "z"]), "orientation": object(&["x", "y", "z", "w"]),
    }});
    let odometry = (0..20).map(|tenth| {
        json!({"frame_id": "odom", "pose": {
            "position": {"x": tenth, "y": 0.0, "z": 0.0},
            "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
        }})
    });
    let odometry: Vec<Value> = odometry.collect();
    let write = |name: &str, statuses: &[i32]| {
        let fix = |status: &i32| json!({"status": {"status": status}, "latitude": 52.25, "longitude": 10.5, "altitude": 80.0});
        let fixes = json!({
            "status": object(&["status"]), "latitude": number, "longitude": number, "altitude": number,
        });
        let topics = [
            (
                "/odom",
                "foxglove.PoseInFrame",
                json!({"frame_id": string, "pose": place}),
                odometry.clone(),
            ),
            (
                "/fix",
                "sensor_msgs/NavSatFix",
                fixes,
                statuses.iter().map(fix).collect(),
            ),
        ];
        write_topics(&folder.path().join(name), &topics);
    };
    write("garage.mcap", &[-1; 3]);
    write("street.mcap", &[-1, -1, 0, 2]);
    let said = "note: session garage: 3 messages on /fix, and none is a fix";
    let sessions = ["--sessions", "garage.mcap", "street.mcap"];
    let check = [&["check", "georeference"], &sessions[..]].concat();
    let map = ["--map", "map", "--progress", "none", "--site", "lot"];
    let run = [&["run", "georeference"], &map[..], &sessions[..]].concat();
    for arguments in [check, run] {
        let told = run_in(folder.path(), &arguments).stderr;
        assert_eq!(told.matches(said).count(), 1, "{told}");
        assert_eq!(told.matches("none is a fix").count(), 1, "{told}");
    }
    // Who reads no fixes need not know.
    let check = [&["check", "trajectory"], &sessions[..]].concat();
    let told = run_in(folder.path(), &check).expect(0).stderr;
    assert!(!told.contains("none is a fix"), "{told}");
}

#[test]
fn a_topic_that_is_called_as_a_role_is_named_behind_its_session() {
    let folder = tempfile::tempdir().unwrap();
    let members = json!({"volts": {"type": "number"}});
    let topics = [(
        "odometry",
        "our.Battery",
        members,
        vec![json!({"volts": 12.5})],
    )];
    write_topics(&folder.path().join("drive.mcap"), &topics);
    let query = "SELECT volts FROM drive.odometry";
    let asked = ["sql", "--sessions", "drive.mcap", "--format", "json", query];
    let asked = run_in(folder.path(), &asked).expect(0);
    let note =
        "odometry in a query is what every log has, not the topic: that is \"drive\".\"odometry\"";
    assert!(asked.stderr.contains(note), "{}", asked.stderr);
    assert_eq!(asked.json()[0]["volts"], 12.5);
}

#[test]
fn what_a_manifest_names_and_nothing_has_is_warned_of_and_a_surveyed_site_needs_no_fixes() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    write_moving(&at("drive.mcap"), &[("odom", "base_link", 0.1)]);
    let run = |plan: &str, map: &str, site: &str| {
        let manifest = format!(
            "site: lot\nsessions: [{{ name: drive, files: [drive.mcap] }}]\nroles: {{ odometry: [/tf, /tff] }}\n\
             defaults: {{ origins: {{ {site}: [52.25, 10.5, 80.0, 0.0] }} }}\n"
        );
        std::fs::write(at("lot.yaml"), manifest).unwrap();
        run_plan_in(folder.path(), plan, map, &["--manifest", "lot.yaml"])
    };
    let topic = "`roles.odometry` names `/tff`, which no session has: their topics are `/tf`; did you mean `/tf`?";
    let site =
        "`origins` names `lott`, which no session has: their sites are `lot`; did you mean `lot`?";
    let refused = run("georeference", "none", "lott").expect(1).stderr;
    for said in ["expected gnss_fixes", topic, site] {
        assert!(refused.contains(said), "{said}: {refused}");
    }
    let told = run("georeference", "map", "lot").expect(0).stderr;
    assert!(told.contains(&format!("warning: {topic}")), "{told}");
    assert!(!told.contains("`origins`"), "{told}");
    let check = ["check", "georeference", "--manifest", "lot.yaml"];
    let checked = run_in(folder.path(), &check).expect(0).stderr;
    assert_eq!(checked.matches(topic).count(), 1, "{checked}");
    assert!(!checked.contains("`origins`"), "{checked}");
    let query = "SELECT site, latitude_deg FROM georeference";
    let asked = rows_in(folder.path(), "map", query);
    assert_eq!(
        (&asked[0]["site"], &asked[0]["latitude_deg"]),
        (&json!("lot"), &json!(52.25))
    );
}

#[test]
fn sessions_have_the_same_sites_in_queries_checks_and_runs() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    write_moving(&at("drive.mcap"), &[("odom", "base_link", 0.1)]);
    // A name like any other.
    let manifest = "site: default\nsessions: [{ name: drive, files: [drive.mcap] }]\n\
                    defaults: { origins: { default: [52.25, 10.5, 80.0, 0.0] } }\n";
    std::fs::write(at("surveyed.yaml"), manifest).unwrap();
    let surveyed = ["--manifest", "surveyed.yaml"];
    let alone = ["--sessions", "drive.mcap"];
    for (plan, given, site) in [
        ("georeference", surveyed, "default"),
        ("trajectory", alone, "drive"),
    ] {
        let check = [&["check", plan], &given[..]].concat();
        run_in(folder.path(), &check).expect(0);
        run_plan_in(folder.path(), plan, site, &given).expect(0);
        let of_map = [&["--map", site][..], &["SELECT DISTINCT site FROM poses"]].concat();
        let of_logs = [&given[..], &["SELECT DISTINCT site FROM odometry"]].concat();
        for asked in [of_map, of_logs] {
            let sql = [&["sql", "--format", "csv"], &asked[..]].concat();
            let answer = run_in(folder.path(), &sql).expect(0).stdout;
            assert_eq!(answer, format!("site\n{site}\n"), "{asked:?}");
        }
    }
}

#[test]
fn the_same_recording_under_two_names_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    write_moving(&at("drive.mcap"), &[("odom", "base_link", 0.1)]);
    write_moving(&at("other.mcap"), &[("odom", "base_link", 0.2)]);
    std::fs::copy(at("drive.mcap"), at("drive (1).mcap")).unwrap();
    let run = |given: &[&str]| {
        let given = [&["--sessions"][..], given].concat();
        let ran = run_plan_in(folder.path(), "trajectory", "map", &given);
        ran.expect(0).stderr
    };
    let same = "is the same recording as session";
    let told = run(&["drive.mcap", "other.mcap"]);
    assert!(!told.contains(same), "{told}");
    let told = run(&["drive (1).mcap"]);
    let said = format!("note: session drive (1) {same} drive, and counts as another drive");
    assert!(told.contains(&said), "{told}");
}
