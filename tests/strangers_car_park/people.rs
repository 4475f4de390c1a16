//! Where people are and how fast to drive, with what its truth says of people as detections.

use std::path::{Path, PathBuf};

use evermap_algorithms::geometry::trajectory::StampedPose;
use evermap_tests::trajectories::{rows, truth};
use evermap_tests::{Finished, evermap, plan_command, text};
use serde_json::Value;

use crate::{session, world};

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
    let ended = plan_command(text(&plan), &map, "park", &arguments).output();
    let ended: Finished = ended.unwrap().into();
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

#[test]
fn people_are_found_before_anybody_taught() {
    let Some(world) = world() else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let map = folder.path().join("map");
    let shown = [16, 4, 4];
    let poses: Vec<String> = SESSIONS
        .iter()
        .zip(shown)
        .map(|(session, every)| poses_of(&world, session, every))
        .collect();
    let plan = format!(
        "plan: found
steps:
  images:
    sql: >
      SELECT f.site, f.session, f.stamp, CAST(0 AS INT UNSIGNED) AS keyframe, f.camera, f.image,
             named_struct('x', x, 'y', y, 'z', z, 'qx', qx, 'qy', qy, 'qz', qz, 'qw', qw) AS map_from_vehicle
      FROM frames f JOIN (VALUES {}) AS v(session, stamp, x, y, z, qx, qy, qz, qw)
      ON f.session = v.session AND CAST(f.stamp AS BIGINT) = v.stamp
  poses:
    sql: SELECT DISTINCT site, session, stamp, map_from_vehicle FROM images
  people: {{ op: people, in: {{ images: images }} }}
  people_on_ground: {{ op: people_on_ground }}
write: [poses, people, people_on_ground]
",
        poses.join(", "),
    );
    let path = folder.path().join("found.yaml");
    std::fs::write(&path, plan).unwrap();
    let logs = SESSIONS.map(|name| session(&world, name));
    let mut arguments = vec!["--sessions"];
    arguments.extend(logs.iter().map(|log| text(log)));
    let ended = plan_command(text(&path), &map, "park", &arguments).output();
    let ended: Finished = ended.unwrap().into();
    assert!([0, 3].contains(&ended.code), "{}", ended.stderr);

    let looked = rows(
        &map,
        None,
        "SELECT session, CAST(stamp AS BIGINT) AS at FROM poses",
    );
    let stamp = |row: &Value| row["at"].as_i64().unwrap();
    let looked: std::collections::BTreeSet<i64> = looked.iter().map(stamp).collect();
    let found = rows(
        &map,
        None,
        "SELECT session, CAST(stamp AS BIGINT) AS at, camera, x, y, range_m FROM people_on_ground",
    );
    let found: Vec<Standing> = found
        .iter()
        .map(|row| {
            let number = |name: &str| row[name].as_f64().unwrap();
            let camera = row["camera"].as_str().unwrap();
            let known = ["front", "left", "rear", "right"];
            let camera = known.into_iter().find(|it| camera.contains(it)).unwrap();
            Standing {
                image: (
                    row["session"].as_str().unwrap().to_owned(),
                    stamp(row),
                    camera.to_owned(),
                ),
                at: [number("x"), number("y")],
                range_m: number("range_m"),
                shown: 1.0,
            }
        })
        .collect();
    let mut there = Vec::new();
    for session in SESSIONS {
        there.extend(in_images(&world, session));
    }
    there.retain(|one| looked.contains(&one.image.1));

    let (mut seen, mut known) = ([0.0; 2], [0.0; 2]);
    let mut off: Vec<f64> = Vec::new();
    for (near, far) in [(1.5, 4.0), (4.0, 6.0), (6.0, 8.0)] {
        let here = |one: &Standing| (near..far).contains(&one.range_m);
        let visible = matched(&there, &found).filter(|(one, _)| here(one) && one.shown >= 0.5);
        let recall: Vec<Option<f64>> = visible.map(|(_, apart)| apart).collect();
        let right = matched(&found, &there).filter(|(one, _)| here(one));
        let right: Vec<bool> = right.map(|(_, apart)| apart.is_some()).collect();
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
