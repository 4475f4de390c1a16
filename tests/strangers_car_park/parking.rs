//! Its parking spaces, taught by a person who knows the truth.

use std::path::{Path, PathBuf};

use evermap_algorithms::geometry::pose::Pose;
use evermap_algorithms::ground::boxes::GroundBox;
use evermap_messages::annotation::{Annotation, Geometry};
use evermap_recording::annotations::AnnotationLog;
use evermap_tests::page;
use evermap_tests::park::finished;
use evermap_tests::trajectories::{Trajectories, poses, rows, truth, truth_from_map};
use serde_json::Value;

use super::mapped::{first_drive, lend_metric_map, two_drives};
use super::{session, world};

/// Spaces that are drawn in each of the first four rounds.
const DRAWN: usize = 2;
/// Questions that are answered in each, and in one more.
const ANSWERED: usize = 20;

/// The true spaces, in the frame of a map of this world's first session.
pub(crate) fn spaces(world: &Path, map: &Path) -> Vec<GroundBox> {
    let session = world.join("initial");
    let truths: Trajectories =
        [("initial".to_owned(), truth(&session.join("trajectory.tum")))].into();
    let found = poses(map, None, "poses", "map_from_vehicle");
    let map_from_truth = truth_from_map(&found, &truths).inverse();
    let text = std::fs::read(world.join("truth/bays.geojson")).unwrap();
    let all: Value = serde_json::from_slice(&text).unwrap();
    let space = |bay: &Value| {
        let number = |name: &str| bay["properties"][name].as_f64().unwrap();
        let there = Pose::from_yaw(number("cx"), number("cy"), number("entry_yaw"));
        let here = map_from_truth.compose(&there);
        GroundBox {
            centre: [here.translation.x, here.translation.y],
            yaw: here.yaw(),
            length_m: number("length"),
            width_m: number("width"),
        }
    };
    all["features"]
        .as_array()
        .unwrap()
        .iter()
        .map(space)
        .collect()
}

/// The boxes of a query's rows, which have a pose and sides.
fn boxes(rows: &[Value]) -> Vec<GroundBox> {
    let found = |row: &Value| {
        let number = |name: &str| row[name].as_f64().unwrap();
        let pose = |name: &str| row["pose"][name].as_f64().unwrap();
        let (qz, qw) = (pose("qz"), pose("qw"));
        GroundBox {
            centre: [pose("x"), pose("y")],
            yaw: 2.0 * qz.atan2(qw),
            length_m: number("length_m"),
            width_m: number("width_m"),
        }
    };
    rows.iter().map(found).collect()
}

/// A person who knows the truth.
struct Person {
    folder: PathBuf,
    truth: Vec<GroundBox>,
    acts: Vec<(&'static str, GroundBox)>,
    said: usize,
}

impl Person {
    /// Draws the space that is farthest from all that were drawn or accepted.
    fn draw(&mut self) {
        let known = |one: &&(&str, GroundBox)| one.0 != "rejected";
        let away = |one: &&GroundBox| {
            let known = self.acts.iter().filter(known);
            let away = known.map(|(_, known)| {
                (known.centre[0] - one.centre[0]).hypot(known.centre[1] - one.centre[1])
            });
            away.fold(f64::INFINITY, f64::min)
        };
        let farthest = self.truth.iter().max_by(|a, b| away(a).total_cmp(&away(b)));
        let place = *farthest.unwrap();
        self.acts.push(("drawn", place));
    }

    /// Accepts what lies on a space, draws the space where it lies beside one, rejects the rest.
    fn answer(&mut self, asked: Vec<GroundBox>) {
        for place in asked {
            let overlap = |space: &&GroundBox| space.overlap(&place);
            let nearest = self
                .truth
                .iter()
                .max_by(|a, b| overlap(a).total_cmp(&overlap(b)));
            let space = *nearest.unwrap();
            self.acts.push(match space.overlap(&place) {
                0.8.. => ("accepted", place),
                0.5.. => ("drawn", space),
                _ => ("rejected", place),
            });
        }
    }

    /// What was not said yet, as a log.
    fn log(&mut self) -> PathBuf {
        let path = self.folder.join(format!("ada_{}.mcap", self.said));
        let mut log = AnnotationLog::begin(&path, |_| false, "a test").unwrap();
        for (number, (act, place)) in self.acts.iter().enumerate().skip(self.said) {
            let (x, y) = (0.5 * place.length_m, 0.5 * place.width_m);
            let corners = [[x, y], [-x, y], [-x, -y], [x, -y]];
            let pose = Pose::from_yaw(place.centre[0], place.centre[1], place.yaw);
            let act = Annotation {
                stamp_ns: 1_800_000_000_000_000_000 + number as u64,
                author: "ada".into(),
                sequence: number as u64,
                id: format!("box {number}"),
                kind: "parking_space".into(),
                act: (*act).into(),
                map_version: None,
                geometry: Some(Geometry {
                    shape: "box".into(),
                    points: corners.map(|[x, y]| [x, y, 0.0]).to_vec(),
                    map_from_label: pose.to_array(),
                }),
                anchor: None,
                image: None,
            };
            log.say_all(&[act]).unwrap();
        }
        log.finish().unwrap();
        self.said = self.acts.len();
        path
    }
}

/// Adds a log to a map. What is said of boxes that no vehicle came near is counted, and kept.
fn grown(map: &Path, log: &Path) {
    let run = finished("parking", map, &[log], &[]);
    let told = run.stderr.contains("label too far from every vehicle pose");
    run.expect(if told { 3 } else { 0 });
}

/// Which share of a map's spaces is right, and which share of the true ones it has.
pub(crate) fn found(map: &Path, truth: &[GroundBox]) -> (f64, f64) {
    let query = "SELECT map_from_space AS pose, length_m, width_m FROM parking_spaces";
    let found = boxes(&rows(map, None, query));
    let is_right = |one: &&GroundBox| truth.iter().any(|space| space.overlap(one) >= 0.7);
    let is_found = |space: &&GroundBox| found.iter().any(|one| space.overlap(one) >= 0.7);
    (
        found.iter().filter(is_right).count() as f64 / found.len() as f64,
        truth.iter().filter(is_found).count() as f64 / truth.len() as f64,
    )
}

/// How many spaces a session saw, nearly all, and of how many of them it knows whether they were free.
fn occupied_as_in(world: &Path, map: &Path, session: &str) -> [usize; 2] {
    let taken = std::fs::read(world.join(session).join("occupied.json")).unwrap();
    let taken: Value = serde_json::from_slice(&taken).unwrap();
    let taken = taken["occupied_bays"].as_array().unwrap();
    let truth = spaces(world, map);
    let found = rows(
        map,
        None,
        &format!(
            "SELECT s.map_from_space AS pose, s.length_m, s.width_m, o.state, o.standing, o.looked FROM parking_spaces s
             JOIN space_occupancy o USING (site, space) WHERE o.session = '{session}'"
        ),
    );
    let (mut seen, mut right) = (0, 0);
    for (place, row) in boxes(&found).iter().zip(&found) {
        let bay = truth.iter().position(|space| space.overlap(place) >= 0.7);
        let Some(bay) = bay.filter(|_| row["state"] != "unseen") else {
            continue;
        };
        seen += 1;
        right += usize::from((row["state"] == "taken") == taken.contains(&Value::from(bay)));
    }
    eprintln!(
        "{session}: of {} spaces {seen} seen, {right} right",
        truth.len()
    );
    assert!(seen as f64 >= 0.9 * truth.len() as f64, "{found:?}");
    [seen, right]
}

/// Under each car is the floor that another drive saw free, where one did.
fn floors_under_cars_were_seen_by_others(map: &Path) {
    let states = rows(
        map,
        None,
        "SELECT session, space, state FROM space_occupancy",
    );
    let floors = rows(
        map,
        None,
        "SELECT session, space, seen_session FROM floor_under_cars",
    );
    let is_free = |session: &Value, space: &Value| {
        states.iter().any(|row| {
            row["state"] == "free" && row["session"] == *session && row["space"] == *space
        })
    };
    let taken = states.iter().filter(|row| row["state"] == "taken").count();
    assert_eq!(floors.len(), taken);
    let mut seen = 0;
    for floor in &floors {
        let elsewhere = states
            .iter()
            .any(|row| row["state"] == "free" && row["space"] == floor["space"]);
        assert_eq!(floor["seen_session"].is_null(), !elsewhere, "{floor}");
        if elsewhere {
            seen += 1;
            assert!(is_free(&floor["seen_session"], &floor["space"]), "{floor}");
        }
    }
    eprintln!("under {seen} of {taken} cars another drive saw the floor");
    assert!(seen > 0);
}

/// The tile that a question names shows what is asked about.
fn tiles_show_what_is_asked(map: &Path) {
    let counted = rows(
        map,
        None,
        "SELECT count(*) AS asked, count(*) FILTER (WHERE st_intersects(t.geometry, q.geometry)) AS shown
         FROM questions q LEFT JOIN overhead_tiles t
         ON t.site = q.site AND t.zoom = 0 AND t.tile_x = q.tile_x AND t.tile_y = q.tile_y",
    );
    let number = |name: &str| counted[0][name].as_u64().unwrap();
    assert!(
        number("asked") > 0 && number("asked") == number("shown"),
        "{counted:?}"
    );
}

/// The versions whose run worked out gradients of the floor: an answer changes nothing of it.
fn described_in(map: &Path) -> Vec<Value> {
    let runs = rows(
        map,
        None,
        "SELECT version FROM runs WHERE step = 'overhead_gradients' AND NOT cached ORDER BY version",
    );
    runs.iter().map(|run| run["version"].clone()).collect()
}

/// The longest steps of the metric map that the run of a version computed.
fn metric_steps_of(map: &Path, version: u32) -> Vec<Value> {
    let query = format!(
        "SELECT DISTINCT step FROM runs WHERE version = {version} AND NOT cached
         AND step IN ('features', 'localisations', 'adjusted_poses')"
    );
    rows(map, None, &query)
}

#[test]
fn a_few_drawn_spaces_and_some_answers_find_the_others() {
    let Some(world) = world() else { return };
    let folder = tempfile::tempdir().unwrap();
    let map = first_drive(&world, folder.path());
    let none = rows(&map, None, "SELECT count(*) AS n FROM parking_spaces");
    assert_eq!(none[0]["n"], 0);
    let truth = spaces(&world, &map);
    let mut person = Person {
        folder: folder.path().to_owned(),
        truth: truth.clone(),
        acts: Vec::new(),
        said: 0,
    };
    let mut last = (0.0, 0.0);
    for round in 0..6 {
        if round < 4 {
            (0..DRAWN).for_each(|_| person.draw());
        }
        let log = person.log();
        grown(&map, &log);
        let (precision, recall) = found(&map, &truth);
        let answers = person.acts.len();
        eprintln!("round {round}: {answers} acts; precision {precision:.3}, recall {recall:.3}");
        last = (precision, recall);
        let asked = format!(
            "SELECT map_from_label AS pose, length_m, width_m FROM questions
             WHERE question <= {ANSWERED} ORDER BY question"
        );
        if round == 0 {
            tiles_show_what_is_asked(&map);
        }
        if round < 5 {
            person.answer(boxes(&rows(&map, None, &asked)));
        }
    }
    assert!(last.0 >= 0.97 && last.1 >= 0.95, "{last:?}");
    assert_eq!(described_in(&map), [1]);
    // Each space is in a row of four or eight, and entered from a lane that was driven.
    let alone = rows(
        &map,
        None,
        "SELECT row, count(*) AS n, count(lane) AS entered FROM parking_spaces GROUP BY row ORDER BY row",
    );
    let numbers = |name: &str| {
        alone
            .iter()
            .map(|row| row[name].as_i64().unwrap())
            .collect::<Vec<_>>()
    };
    let sizes = numbers("n");
    assert!(
        sizes.len() == 6 && sizes.iter().all(|n| (3..=4).contains(n)),
        "{alone:?}"
    );
    assert_eq!(numbers("entered"), numbers("n"), "{alone:?}");
    // What each drive saw of them: a second one comes when all is taught. The metric map is that of a map of which other things
    // were said.
    lend_metric_map(two_drives(&world), &map);
    grown(&map, &session(&world, "revisit_1"));
    let computed = metric_steps_of(&map, 8);
    assert!(computed.is_empty(), "{computed:?}");
    assert_eq!(described_in(&map), [1, 8]);
    floors_under_cars_were_seen_by_others(&map);
    let known = ["initial", "revisit_1"].map(|session| occupied_as_in(&world, &map, session));
    let [seen, right] = [0, 1].map(|of| known[0][of] + known[1][of]);
    assert!(right as f64 >= 0.98 * seen as f64, "{known:?}");
    // The docs' questions to a map that somebody taught.
    let docs = ["README.md", "docs/labels.md"].map(page).concat();
    let queries = docs.split("evermap sql --map lot \"").skip(1);
    let queries = queries.map(|rest| rest.split('"').next().unwrap());
    let ours: Vec<&str> = queries
        .filter(|query| query.contains("parking_space") || query.contains("space_occupancy"))
        .collect();
    assert_eq!(ours.len(), 4);
    for query in ours {
        assert!(!rows(&map, None, query).is_empty(), "{query}");
    }
}
