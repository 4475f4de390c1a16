//! Where people are and how fast to drive, with what its truth says of people as detections.

use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use evermap_algorithms::geometry::pose::Pose;
use evermap_algorithms::geometry::trajectory::StampedPose;
use evermap_messages::annotation::{Anchor, Annotation, Geometry};
use evermap_recording::annotations::AnnotationLog;
use evermap_tests::park::{copy, made_once};
use evermap_tests::trajectories::{rows, truth};
use evermap_tests::{evermap, run_of_site, text};
use serde_json::{Value, json};

use super::{session, world};

/// A first visit without people, and two in which they use one crossing.
const SESSIONS: [&str; 3] = ["initial", "revisit_1", "revisit_2"];

/// People at least half of whom a camera shows, at most 7.5 m away: rows of SQL.
fn people_seen(world: &Path, session: &str) -> String {
    let boxes = world.join(session).join("ped_boxes.jsonl");
    let boxes = std::fs::read_to_string(boxes).unwrap();
    let mut values = Vec::new();
    for line in boxes.lines() {
        let person: Value = serde_json::from_str(line).unwrap();
        let number = |name: &str| person[name].as_f64().unwrap_or(0.0);
        let shown = number("visible_px") >= 0.5 * number("full_px").max(1.0);
        if shown && number("range") <= 7.5 {
            let (stamp, camera) = (&person["stamp_ns"], person["camera"].as_str().unwrap());
            let place = ["id", "x", "y", "range"].map(|name| number(name).to_string());
            values.push(format!(
                "('{session}', {stamp}, '{camera}', {})",
                place.join(", ")
            ));
        }
    }
    assert!(values.len() > 50, "{session}: {} people", values.len());
    values.join(", ")
}

/// True poses at every image of so many: rows of SQL.
fn poses_of(world: &Path, session: &str, every: usize) -> String {
    let row = |pose: StampedPose| {
        let values = pose.pose.to_array().map(|value| value.to_string());
        format!("('{session}', {}, {})", pose.stamp_ns, values.join(", "))
    };
    let poses = truth(&world.join(session).join("trajectory.tum"));
    let rows: Vec<String> = poses.into_iter().step_by(every).map(row).collect();
    rows.join(", ")
}

fn poses(world: &Path, session: &str) -> String {
    poses_of(world, session, 1)
}

/// From true poses and people to speeds: what `speed` does with those of a map.
fn plan(world: &Path, folder: &Path) -> PathBuf {
    let of = |rows: fn(&Path, &str) -> String, sessions: &[&str]| {
        let rows: Vec<String> = sessions.iter().map(|it| rows(world, it)).collect();
        rows.join(", ")
    };
    let plan = format!(
        "plan: watched
steps:
  posed_images:
    sql: >
      SELECT f.site, f.session, f.stamp, f.camera, f.image,
             named_struct('x', x, 'y', y, 'z', z, 'qx', qx, 'qy', qy, 'qz', qz, 'qw', qw) AS map_from_vehicle
      FROM frames f JOIN (VALUES {}) AS v(session, stamp, x, y, z, qx, qy, qz, qw)
      ON f.session = v.session AND CAST(f.stamp AS BIGINT) = v.stamp
  poses:
    sql: SELECT DISTINCT site, session, stamp, map_from_vehicle FROM posed_images
  people_on_ground:
    sql: >
      SELECT i.site, i.session, i.stamp, i.camera, v.person, v.x, v.y, 0.0 AS z,
             0.04 AS var_x_m2, 0.0 AS cov_xy_m2, 0.04 AS var_y_m2, v.range_m, 1.0 AS probability
      FROM posed_images i JOIN (VALUES {}) AS v(session, stamp, camera, person, x, y, range_m)
      ON i.session = v.session AND CAST(i.stamp AS BIGINT) = v.stamp AND i.camera LIKE concat('%', v.camera, '%')
  lanes: {{ op: road_network }}
  exposure: {{ op: exposure, in: {{ images: posed_images }} }}
  danger_settings: {{ op: danger_settings, in: {{ people_on_ground: people_on_ground, lanes: lanes }} }}
  danger_map:
    op: danger_map
    in: {{ people_on_ground: people_on_ground, lanes: lanes, settings: danger_settings }}
  speed_map: {{ op: speed_map }}
  lane_speeds: {{ op: lane_speeds }}
write: [people_on_ground, exposure, danger_settings, danger_map, speed_map, lane_speeds]
",
        of(poses, &SESSIONS),
        of(people_seen, &SESSIONS[1..])
    );
    let path = folder.join("watched.yaml");
    std::fs::write(&path, plan).unwrap();
    path
}

fn number(rows: &[Value], name: &str) -> f64 {
    rows[0][name]
        .as_f64()
        .unwrap_or_else(|| panic!("{name}: {rows:?}"))
}

#[test]
fn it_is_driven_slowly_where_people_walk() {
    let Some(world) = world() else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let map = folder.path().join("map");
    let plan = plan(&world, folder.path());
    let logs = SESSIONS.map(|name| session(&world, name));
    let mut arguments = vec!["--sessions"];
    arguments.extend(logs.iter().map(|log| text(log)));
    let ended = run_of_site(text(&plan), &map, "park", &arguments);
    assert!([0, 3].contains(&ended.code), "{}", ended.stderr);

    // What was found there: the cells where anybody stood were looked at, and nobody else's were.
    let people = rows(
        &map,
        None,
        "SELECT count(*) AS people, count(e.looks) AS looked_at FROM people_on_ground p
         LEFT JOIN exposure e ON e.session = p.session
           AND e.column = floor(p.x / 0.5) AND e.row = floor(p.y / 0.5)",
    );
    let share = number(&people, "looked_at") / number(&people, "people");
    eprintln!(
        "{} people, {share:.3} of them where a camera looked",
        number(&people, "people")
    );
    assert!(share > 0.9);

    let settings = rows(&map, None, "SELECT * FROM danger_settings");
    eprintln!("{settings:#?}");
    assert_eq!(number(&settings, "visits"), 3.0);
    assert_eq!(number(&settings, "visits_with_people"), 2.0);
    let foretold = number(&settings, "log_likelihood");
    for other in ["expected", "kinds", "counts"] {
        let other = number(&settings, &format!("log_likelihood_of_{other}"));
        assert!(foretold > other, "{foretold} is not above {other}");
    }

    // They walk on one crossing, the right one: there it is dangerous, and slow, and nowhere else.
    let danger = rows(
        &map,
        None,
        "WITH at AS (SELECT DISTINCT CAST(floor(x / 0.5) AS INT) AS c, CAST(floor(y / 0.5) AS INT) AS r FROM people_on_ground)
         SELECT avg(danger) FILTER (WHERE c IS NOT NULL) AS there, avg(danger) FILTER (WHERE c IS NULL) AS elsewhere,
                avg(speed_mps) FILTER (WHERE c IS NOT NULL) AS slow, avg(speed_mps) FILTER (WHERE c IS NULL) AS fast,
                min(danger) AS least, max(danger) AS most, count(*) AS cells
         FROM speed_map s LEFT JOIN at ON at.c = s.column AND at.r = s.row",
    );
    eprintln!("{danger:#?}");
    assert!(number(&danger, "there") > 20.0 * number(&danger, "elsewhere"));
    assert!(number(&danger, "slow") < 2.2 && number(&danger, "fast") > 2.7);
    assert!(number(&danger, "least") >= 0.0 && number(&danger, "most") <= 1.0);
    let lanes = "SELECT min(speed_mps) AS slowest, max(speed_mps) AS fastest FROM lane_speeds";
    let lanes = rows(&map, None, lanes);
    eprintln!("{lanes:?}");
    assert!(number(&lanes, "slowest") < 2.0 && number(&lanes, "fastest") > 2.5);
    // The README's question to a map of people.
    let readme = evermap_tests::page("README.md");
    let mut queries = readme
        .split('"')
        .filter(|text| text.contains("FROM lane_speeds"));
    let slowest = rows(&map, None, queries.next().unwrap());
    assert!(!slowest.is_empty());

    let mask = folder.path().join("mask.yaml");
    let export = [
        "export",
        "speed_map",
        "--map",
        text(&map),
        "--format",
        "nav2",
        "--out",
        text(&mask),
    ];
    evermap(&export).expect(0);
    mask_has_the_speeds_of(&map, &mask);
}

/// The two files field by field, as Nav2's documentation has them, and cell by cell, as the map has the speeds.
fn mask_has_the_speeds_of(map: &Path, mask: &Path) {
    let yaml = std::fs::read_to_string(mask).unwrap();
    let field = |name: &str| {
        let mut lines = yaml.lines();
        let value = lines.find_map(|line| line.strip_prefix(name)?.strip_prefix(": "));
        value.unwrap_or_else(|| panic!("{name}: {yaml}"))
    };
    let fixed = ["image", "mode", "negate"].map(field);
    assert_eq!(fixed, ["\"mask.pgm\"", "raw", "0"]);
    let [resolution, occupied, free] = ["resolution", "occupied_thresh", "free_thresh"]
        .map(|name| field(name).parse::<f64>().unwrap());
    assert!(0.0 < free && free < occupied && occupied < 1.0, "{yaml}");
    let origin: Vec<f64> = serde_json::from_str(field("origin")).unwrap();
    assert_eq!((origin.len(), origin[2]), (3, 0.0));
    let picture = std::fs::read(mask.with_extension("pgm")).unwrap();
    let parts: Vec<&[u8]> = picture.splitn(4, |byte| *byte == b'\n').collect();
    assert_eq!((parts[0], parts[2]), (&b"P5"[..], &b"255"[..]));
    let size = std::str::from_utf8(parts[1]).unwrap().split(' ');
    let size: Vec<usize> = size.map(|side| side.parse().unwrap()).collect();
    let (width, height, pixels) = (size[0], size[1], parts[3]);
    assert_eq!(pixels.len(), width * height);
    // No limit at all is 0, and unknown, which the filter takes for an error, what is above 100.
    assert!(pixels.iter().all(|pixel| (1..=100).contains(pixel)));
    let cells = rows(map, None, "SELECT x, y, speed_mps, max_mps FROM speed_map");
    for cell in &cells {
        let number = |name: &str| cell[name].as_f64().unwrap();
        let off_m = [number("x") - origin[0], number("y") - origin[1]];
        let [column, row] = off_m.map(|off_m: f64| (off_m / resolution) as usize);
        let step = number("max_mps") / 100.0;
        assert!(yaml.contains(&format!("multiplier: {step:?}")), "{yaml}");
        let limit = step * f64::from(pixels[(height - 1 - row) * width + column]);
        let speed = number("speed_mps");
        assert!(
            limit <= speed.max(step) + 1e-9 && limit > speed - step - 1e-9,
            "{cell}: {limit}"
        );
    }
}

/// A person in an image.
struct Standing {
    image: (String, i64, String),
    at: [f64; 2],
    range_m: f64,
    /// Part of them that the image shows.
    shown: f64,
}

impl Standing {
    fn apart_m(&self, other: &Self) -> f64 {
        (self.at[0] - other.at[0]).hypot(self.at[1] - other.at[1])
    }
}

/// Everybody who is in an image, as the truth says.
fn in_images(world: &Path, session: &str) -> Vec<Standing> {
    let boxes = std::fs::read_to_string(world.join(session).join("ped_boxes.jsonl")).unwrap();
    let standing = |line: &str| {
        let person: Value = serde_json::from_str(line).unwrap();
        let number = |name: &str| person[name].as_f64().unwrap_or(0.0);
        Standing {
            image: (
                session.to_owned(),
                person["stamp_ns"].as_i64().unwrap(),
                person["camera"].as_str().unwrap().to_owned(),
            ),
            at: [number("x"), number("y")],
            range_m: number("range"),
            shown: number("visible_px") / number("full_px").max(1.0),
        }
    };
    boxes.lines().map(standing).collect()
}

/// Those of one list who have somebody of the other in the same image, less than 1.5 m away, and how far; a person 8 m away is
/// placed to half a metre along the line of sight.
fn matched<'a>(
    ones: &'a [Standing],
    others: &'a [Standing],
) -> impl Iterator<Item = (&'a Standing, Option<f64>)> {
    ones.iter().map(|one| {
        let near = others.iter().filter(|other| other.image == one.image);
        let apart = near.map(|other| one.apart_m(other)).min_by(f64::total_cmp);
        (one, apart.filter(|apart| *apart < 1.5))
    })
}

/// Images of visits, every so manyth, and true poses: steps of a plan.
fn looked_at(world: &Path, visits: &[(&str, usize)]) -> String {
    let poses = visits.iter();
    let poses: Vec<String> = poses
        .map(|(session, every)| poses_of(world, session, *every))
        .collect();
    format!(
        "  images:
    sql: >
      SELECT f.site, f.session, f.stamp, CAST(0 AS INT UNSIGNED) AS keyframe, f.camera, f.image,
             named_struct('x', x, 'y', y, 'z', z, 'qx', qx, 'qy', qy, 'qz', qz, 'qw', qw) AS map_from_vehicle
      FROM frames f JOIN (VALUES {}) AS v(session, stamp, x, y, z, qx, qy, qz, qw)
      ON f.session = v.session AND CAST(f.stamp AS BIGINT) = v.stamp
  poses:
    sql: SELECT DISTINCT site, session, stamp, map_from_vehicle FROM images
  person_hypotheses: {{ op: person_hypotheses, in: {{ images: images }} }}
",
        poses.join(", ")
    )
}

/// Runs a plan on logs; what is left out is counted.
fn run(plan: &Path, map: &Path, logs: &[PathBuf]) {
    let mut arguments = vec!["--sessions"];
    arguments.extend(logs.iter().map(|log| text(log)));
    let ended = run_of_site(text(plan), map, "park", &arguments);
    assert!([0, 3].contains(&ended.code), "{}", ended.stderr);
}

/// An image as the truth calls it.
fn image_of(row: &Value) -> (String, i64, String) {
    let camera = row["camera"].as_str().unwrap();
    let known = ["front", "left", "rear", "right"];
    let camera = known.into_iter().find(|it| camera.contains(it)).unwrap();
    let session = row["session"].as_str().unwrap().to_owned();
    (session, row["at"].as_i64().unwrap(), camera.to_owned())
}

/// Everybody whom a map found on the ground.
fn on_ground(map: &Path) -> Vec<Standing> {
    let query =
        "SELECT session, CAST(stamp AS BIGINT) AS at, camera, x, y, range_m FROM people_on_ground";
    let standing = |row: &Value| {
        let number = |name: &str| row[name].as_f64().unwrap();
        Standing {
            image: image_of(row),
            at: [number("x"), number("y")],
            range_m: number("range_m"),
            shown: 1.0,
        }
    };
    rows(map, None, query).iter().map(standing).collect()
}

/// Everybody who is in an image that was looked at.
fn in_images_looked_at(world: &Path, map: &Path, sessions: &[&str]) -> Vec<Standing> {
    let query = "SELECT session, CAST(stamp AS BIGINT) AS at FROM poses";
    let looked = rows(map, None, query);
    let looked: std::collections::BTreeSet<i64> = looked
        .iter()
        .map(|row| row["at"].as_i64().unwrap())
        .collect();
    let mut there = Vec::new();
    for session in sessions {
        there.extend(in_images(world, session));
    }
    there.retain(|one| looked.contains(&one.image.1));
    there
}

/// Ranges in which people are judged (m).
const RANGES: [(f64, f64); 3] = [(1.5, 4.0), (4.0, 6.0), (6.0, 8.0)];

/// In a range: of people at least half of whom is shown, how far each was found off, or that they were not; of those who were
/// found, whether they are people.
fn judged(
    found: &[Standing],
    there: &[Standing],
    (near, far): (f64, f64),
) -> (Vec<Option<f64>>, Vec<bool>) {
    let here = |one: &Standing| (near..far).contains(&one.range_m);
    let visible = matched(there, found).filter(|(one, _)| here(one) && one.shown >= 0.5);
    let right = matched(found, there).filter(|(one, _)| here(one));
    (
        visible.map(|(_, apart)| apart).collect(),
        right.map(|(_, apart)| apart.is_some()).collect(),
    )
}

/// Of each visit every so manyth image.
fn visits() -> Vec<(&'static str, usize)> {
    SESSIONS.into_iter().zip([16, 4, 4]).collect()
}

/// The people whom the untaught detector finds in its visits: a map, which tests share.
fn untaught(world: &Path) -> &'static Path {
    static MAP: OnceLock<PathBuf> = OnceLock::new();
    MAP.get_or_init(|| {
        let folder = made_once(env!("CARGO_TARGET_TMPDIR"), "strangers_people");
        let plan = format!(
            "plan: found
steps:
{}  people: {{ op: people, in: {{ hypotheses: person_hypotheses }} }}
  people_on_ground: {{ op: people_on_ground }}
write: [poses, person_hypotheses, people, people_on_ground]
",
            looked_at(world, &visits()),
        );
        let path = folder.join("found.yaml");
        std::fs::write(&path, plan).unwrap();
        let map = folder.join("map");
        run(&path, &map, &SESSIONS.map(|name| session(world, name)));
        map
    })
}

#[test]
fn people_are_found_before_anybody_taught() {
    let Some(world) = world() else {
        return;
    };
    let map = untaught(&world);
    let found = on_ground(map);
    let there = in_images_looked_at(&world, map, &SESSIONS);

    let (mut seen, mut known) = ([0.0; 2], [0.0; 2]);
    let mut off: Vec<f64> = Vec::new();
    for (near, far) in RANGES {
        let (recall, right) = judged(&found, &there, (near, far));
        let mut apart: Vec<f64> = recall.iter().copied().flatten().collect();
        apart.sort_by(f64::total_cmp);
        let hits = [apart.len(), right.iter().filter(|right| **right).count()];
        let of = [recall.len(), right.len()];
        eprintln!(
            "{near} to {far} m: {} of {} people found, {} of {} found are people, median {:.2} m off, {:.2} within 0.5 m",
            hits[0],
            of[0],
            hits[1],
            of[1],
            apart[apart.len() / 2],
            apart.iter().filter(|apart| **apart < 0.5).count() as f64 / apart.len() as f64,
        );
        for (sum, at) in [(&mut seen, 0), (&mut known, 1)] {
            *sum = [sum[0] + hits[at] as f64, sum[1] + of[at] as f64];
        }
        off.extend(apart);
    }
    off.sort_by(f64::total_cmp);
    let (recall, precision) = (seen[0] / seen[1], known[0] / known[1]);
    let median_m = off[off.len() / 2];
    eprintln!("recall {recall:.3}, precision {precision:.3}, median {median_m:.2} m off");
    assert!(recall > 0.6 && precision > 0.75 && median_m < 0.3);
}

/// The visit that questions are asked about, and the one that is judged.
const TAUGHT: &str = "revisit_1";
const JUDGED: &str = "revisit_2";

/// From images and answers to people.
fn teaching_plan(world: &Path, folder: &Path) -> PathBuf {
    let plan = format!(
        "plan: taught
steps:
{}  labels:
    sql: SELECT site, id AS label, kind, act AS standing, stamp AS said, anchor FROM annotations
  answered_images:
    sql: >
      SELECT i.site, i.session, i.stamp, i.keyframe, i.camera, i.image
      FROM images i
      JOIN (SELECT DISTINCT site, anchor['session'] AS session, anchor['stamp'] AS stamp, anchor['camera'] AS camera
            FROM labels WHERE kind = 'person') said
        ON said.site = i.site AND said.session = i.session AND said.stamp = i.stamp AND said.camera = i.camera
  person_examples: {{ op: person_examples, in: {{ images: answered_images, labels: labels }} }}
  person_models: {{ op: person_models, in: {{ examples: person_examples }} }}
  people: {{ op: people, in: {{ hypotheses: person_hypotheses, models: person_models }} }}
  people_on_ground: {{ op: people_on_ground }}
  asked:
    sql: SELECT * FROM person_hypotheses WHERE session = '{TAUGHT}'
  person_questions:
    op: person_questions
    in: {{ hypotheses: asked, models: person_models, examples: person_examples }}
write: [poses, person_hypotheses, person_examples, person_models, people, people_on_ground, person_questions]
",
        looked_at(world, &visits())
    );
    let path = folder.join("taught.yaml");
    std::fs::write(&path, plan).unwrap();
    path
}

/// Answers the first questions of a map as the truth has it: a log.
fn answers(world: &Path, map: &Path, most: usize, path: &Path) {
    let poses = truth(&world.join(TAUGHT).join("trajectory.tum"));
    let there = in_images(world, TAUGHT);
    let query = format!(
        "SELECT question, session, CAST(stamp AS BIGINT) AS at, camera, x, y FROM person_questions
         WHERE question <= {most} ORDER BY question"
    );
    let asked = rows(map, None, &query);
    assert_eq!(asked.len(), most);
    let mut log = AnnotationLog::begin(path, |_| false, "a test").unwrap();
    let name = path.file_stem().unwrap().to_str().unwrap();
    for (number, question) in (0..).zip(&asked) {
        let coordinate = |name: &str| question[name].as_f64().unwrap();
        let image = image_of(question);
        let vehicle = poses.iter().find(|pose| pose.stamp_ns == image.1);
        let vehicle_from_label = Pose::from_yaw(coordinate("x"), coordinate("y"), 0.0);
        let map_from_label = vehicle.unwrap().pose.compose(&vehicle_from_label);
        let asked = Standing {
            at: [map_from_label.translation.x, map_from_label.translation.y],
            range_m: 0.0,
            shown: 1.0,
            image,
        };
        let is_person = matched(&[asked], &there).all(|(_, apart)| apart.is_some());
        let corners = [[0.2, 0.2], [-0.2, 0.2], [-0.2, -0.2], [0.2, -0.2]];
        let act = Annotation {
            stamp_ns: 1_800_000_000_000_000_000 + number,
            author: "ada".into(),
            sequence: number,
            id: format!("{name} {number}"),
            kind: "person".into(),
            act: String::from(if is_person { "accepted" } else { "rejected" }),
            map_version: None,
            geometry: Some(Geometry {
                shape: "box".into(),
                points: corners.map(|[x, y]| [x, y, 0.0]).to_vec(),
                map_from_label: map_from_label.to_array(),
            }),
            anchor: Some(Anchor {
                session: TAUGHT.into(),
                stamp_ns: question["at"].as_u64().unwrap(),
                camera: Some(question["camera"].as_str().unwrap().into()),
                vehicle_from_label: vehicle_from_label.to_array(),
            }),
            image: None,
        };
        log.say_all(&[act]).unwrap();
    }
    log.finish().unwrap();
}

/// Prints what of the judged visit was found, by range; the harmonic mean of recall and precision over all.
fn f1(found: &[Standing], there: &[Standing], answered: usize) -> f64 {
    let (mut seen, mut known) = ([0, 0], [0, 0]);
    for range in RANGES {
        let (recall, right) = judged(found, there, range);
        let hits = recall.iter().flatten().count();
        let are = right.iter().filter(|right| **right).count();
        eprintln!(
            "{answered} answers, {} to {} m: {hits} of {} people found, {are} of {} found are people",
            range.0,
            range.1,
            recall.len(),
            right.len()
        );
        seen = [seen[0] + hits, seen[1] + recall.len()];
        known = [known[0] + are, known[1] + right.len()];
    }
    let [recall, precision] = [seen, known].map(|[of, all]| of as f64 / all as f64);
    let f1 = 2.0 * recall * precision / (recall + precision);
    eprintln!("{answered} answers: recall {recall:.3}, precision {precision:.3}, F1 {f1:.3}");
    f1
}

/// Without answers the people are those of the untaught detector.
fn is_untaught(map: &Path) {
    let both = rows(
        map,
        None,
        "SELECT count(*) AS believed, count(p.person) AS there, count(p.variance) AS taught,
                max(abs(h.probability - p.probability)) AS apart
         FROM person_hypotheses h LEFT JOIN people p USING (site, session, stamp, camera, person)
         WHERE h.probability >= 0.5",
    );
    let number = |name: &str| both[0][name].as_f64().unwrap();
    assert!(number("believed") > 50.0, "{both:?}");
    assert_eq!(number("believed"), number("there"));
    let people = rows(map, None, "SELECT count(*) AS n FROM people");
    assert_eq!(number("believed"), people[0]["n"].as_f64().unwrap());
    assert_eq!((number("taught"), number("apart")), (0.0, 0.0));
}

/// Ten questions are answered in each of two rounds, all about one visit; another one is judged.
#[test]
fn twenty_answers_about_one_visit_find_people_better_in_another() {
    let Some(world) = world() else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let map = copy(untaught(&world), folder.path(), "map");
    let plan = teaching_plan(&world, folder.path());
    let mut logs = vec![session(&world, TAUGHT), session(&world, JUDGED)];
    let mut judged = Vec::new();
    for round in 0..3 {
        run(&plan, &map, &logs);
        if round == 0 {
            is_untaught(&map);
            // What the page on labels asks of a map of people.
            let page = evermap_tests::page("docs/labels.md");
            let mut queries = page.split('"');
            let asked = queries.find(|text| text.contains("FROM person_questions"));
            assert!(!rows(&map, None, asked.unwrap()).is_empty());
        }
        let mut found = on_ground(&map);
        found.retain(|one| one.image.0 == JUDGED);
        let there = in_images_looked_at(&world, &map, &[JUDGED]);
        judged.push(f1(&found, &there, 10 * round));
        if round < 2 {
            let log = folder.path().join(format!("ada_{round}.mcap"));
            answers(&world, &map, 10, &log);
            logs.push(log);
        }
    }
    // The first round reads what the shared map has found.
    let found_anew = "SELECT count(*) AS n FROM runs
                      WHERE step = 'person_hypotheses' AND version = 2 AND NOT cached";
    assert_eq!(rows(&map, None, found_anew), [json!({ "n": 0 })]);
    let examples = rows(&map, None, "SELECT count(*) AS n FROM person_examples");
    assert_eq!(examples[0]["n"], 20);
    // Of some fifty people, one that is found or not is 0.02.
    assert!(
        judged[1] > judged[0] - 0.02 && judged[2] > judged[0],
        "{judged:?}"
    );
}
