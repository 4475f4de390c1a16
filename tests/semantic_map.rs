//! The semantic map on a street with exact truth: what is asked of it, and where another visit is.
//!
//! Figures are printed with `-- --nocapture`.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use evermap_tests::trajectories::{rows, truth};
use evermap_tests::{Finished, evermap, run_of_site, shared, simulate, text};
use serde_json::Value;

/// Runs a plan on sessions of one site.
fn run(plan: &str, map: &Path, more: &[&str]) -> Finished {
    run_of_site(plan, map, "street", more)
}

/// A manifest of one visit, with its labels from this topic.
fn manifest(folder: &Path, world: &Path, visit: &str, labels: &str) -> PathBuf {
    let path = folder.join(format!("{visit}.yaml"));
    let log = world.join(format!("{visit}/{visit}.mcap"));
    let yaml = format!(
        "sessions: [{{ name: {visit}, files: ['{}'] }}]\nroles: {{ label_frames: ['{labels}'] }}\n",
        log.display()
    );
    std::fs::write(&path, yaml).unwrap();
    path
}

fn names(rows: &[Value]) -> Vec<&str> {
    rows.iter()
        .map(|row| row["view"].as_str().unwrap())
        .collect()
}

#[test]
fn a_street_answers_what_is_asked_of_it() {
    let Some(world) = shared("worlds/street_small") else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let map = folder.path().join("map");
    run(
        "semantic_map",
        &map,
        &["--sessions", text(&world.join("visit_a/visit_a.mcap"))],
    )
    .expect(0);

    let asked = |condition: &str| {
        let query = format!("SELECT view FROM views WHERE {condition} ORDER BY view");
        rows(&map, None, &query)
    };
    let all = asked("true").len();
    assert_eq!(all, 60);
    // What the index says, the graphs say too.
    for by_index in [
        "contains(graph, 'building', 2)",
        "NOT contains(graph, 'car')",
    ] {
        let by_graphs = by_index.replace("graph", "coalesce(graph, graph)");
        assert_eq!(asked(by_index), asked(&by_graphs), "{by_index}");
    }
    let with = asked("contains(graph, 'car')").len();
    let without = asked("NOT contains(graph, 'car')").len();
    assert_eq!(with + without, all);
    assert!(with > 0 && asked("contains(graph, 'building', 2)").len() > 10);
    let on_road = asked("related(graph, 'car', 'on', 'road')");
    assert!(
        !on_road.is_empty() && on_road.len() <= with,
        "{} of {with}",
        on_road.len()
    );
    assert!(!asked("related(graph, 'tree', 'right of', 'building')").is_empty());

    // Sky ends where something stands on the ground.
    let skyline =
        "related(graph, 'sky', 'touches', 'building') OR related(graph, 'sky', 'touches', 'tree')";
    assert_eq!(asked(skyline).len(), all);
    let query = "SELECT other FROM relations WHERE class = 'sky' ORDER BY strength DESC LIMIT 1";
    let strongest = rows(&map, None, query);
    let strongest = strongest[0]["other"].as_str().unwrap();
    assert!(["building", "tree"].contains(&strongest), "{strongest}");

    let report = folder.path().join("report.html");
    evermap(&["report", "--map", text(&map), "--out", text(&report)]).expect(0);
    let page = std::fs::read_to_string(&report).unwrap();
    assert!(page.contains("Semantic map") && page.contains("<ellipse"));
    let picture = folder.path().join("views.png");
    evermap(&[
        "render",
        "--map",
        text(&map),
        "--view",
        "views",
        "--out",
        text(&picture),
    ])
    .expect(0);
    assert!(std::fs::metadata(&picture).unwrap().len() > 50_000);
}

/// Distance (m) of each query from the view that looks most like it.
fn relocated_m(map: &Path, world: &Path) -> Vec<f64> {
    let places = |visit: &str| truth(&world.join(format!("{visit}/trajectory.tum")));
    let (here, there) = (places("visit_b"), places("visit_a"));
    let query = "SELECT CAST(stamp AS BIGINT) AS at, CAST(map_stamp AS BIGINT) AS map_at FROM relocations WHERE rank = 0 ORDER BY stamp";
    let place = |places: &[evermap_algorithms::geometry::trajectory::StampedPose], at: &Value| {
        let found = places
            .iter()
            .find(|pose| Some(pose.stamp_ns) == at.as_i64());
        found
            .expect("each panorama has a true pose")
            .pose
            .to_array()
    };
    rows(map, None, query)
        .iter()
        .map(|row| {
            let (a, b) = (place(&here, &row["at"]), place(&there, &row["map_at"]));
            (a[0] - b[0]).hypot(a[1] - b[1])
        })
        .collect()
}

#[test]
fn another_visit_is_found_where_it_was_with_true_and_with_noisy_labels() {
    let Some(world) = shared("worlds/street_small") else {
        return;
    };
    for (labels, least) in [("/panorama/labels", 0.97), ("/panorama/labels_noisy", 0.95)] {
        let folder = tempfile::tempdir().unwrap();
        let map = folder.path().join("map");
        for visit in ["visit_a", "visit_b"] {
            let manifest = manifest(folder.path(), &world, visit, labels);
            run("relocate", &map, &["--manifest", text(&manifest)]).expect(0);
        }
        let found = relocated_m(&map, &world);
        assert_eq!(
            found.len(),
            60,
            "every view of the second visit has a best one"
        );
        let right = found.iter().filter(|distance| **distance <= 5.0).count() as f64 / 60.0;
        eprintln!("{labels}: recall@1 within 5 m {right:.3}");
        assert!(right >= least, "{labels}: recall@1 {right}");
        // The drive of the first visit says what a hit is worth, and is not wrong where it is sure.
        let certain = rows(
            &map,
            None,
            "SELECT certainty FROM relocations WHERE rank = 0 ORDER BY stamp",
        );
        let certain: Vec<f64> = certain
            .iter()
            .map(|row| row["certainty"].as_f64().unwrap())
            .collect();
        let sure = certain.iter().zip(&found).filter(|(sure, _)| **sure >= 0.9);
        let wrong = sure.clone().filter(|(_, distance)| **distance > 5.0);
        eprintln!("{labels}: sure of {} of 60", sure.clone().count());
        assert!(sure.count() >= 30 && wrong.count() == 0, "{certain:?}");
        let matrix = folder.path().join("matrix.png");
        evermap(&[
            "render",
            "--map",
            text(&map),
            "--view",
            "similarities",
            "--out",
            text(&matrix),
        ])
        .expect(0);
        let sure = rows(
            &map,
            None,
            "SELECT min(similarity) AS low, max(similarity) AS high FROM relocations",
        );
        let bound = |name: &str| sure[0][name].as_f64().unwrap();
        assert!(bound("low") >= 0.0 && bound("high") <= 1.0);
    }
}

#[test]
fn a_simulated_street_is_mapped_from_its_labels() {
    let folder = tempfile::tempdir().unwrap();
    let (street, map) = (folder.path().join("street"), folder.path().join("map"));
    let small = [
        "length_m=90",
        "width_px=512",
        "height_px=166",
        "colour=false",
    ];
    simulate("street", &street, &small);
    for visit in ["visit_a", "visit_b"] {
        let log = street.join(format!("{visit}/{visit}.mcap"));
        run("relocate", &map, &["--sessions", text(&log)]).expect(0);
    }
    let counts = rows(
        &map,
        None,
        "SELECT count(*) AS views, count(DISTINCT session) AS sessions FROM views",
    );
    assert_eq!(counts[0]["sessions"], 2);
    assert!(counts[0]["views"].as_i64().unwrap() > 40, "{counts:?}");
    let best = rows(&map, None, "SELECT view FROM relocations WHERE rank = 0");
    assert!(names(&best).iter().all(|view| view.starts_with("visit_b/")));
    assert!(best.len() > 20, "{}", best.len());
}

#[test]
fn views_of_a_vehicle_that_is_called_otherwise_are_kept_without_a_position_and_counted() {
    let folder = tempfile::tempdir().unwrap();
    let (street, map) = (folder.path().join("street"), folder.path().join("map"));
    let small = [
        "length_m=90",
        "width_px=256",
        "height_px=83",
        "colour=false",
        "visits=1",
    ];
    simulate("street", &street, &small);
    let log = street.join("visit_a/visit_a.mcap");
    let misspelt = "views.vehicle_frame=chasis";
    let arguments = ["--sessions", text(&log), "--set", misspelt];
    let ended = run("semantic_map", &map, &arguments).expect(3);
    let reason =
        "fixed transforms from frame `panorama_optical_frame` lead to `base_link`, not to `chasis`";
    assert!(ended.stderr.contains(reason), "{}", ended.stderr);
    let query = "SELECT count(*) AS views, count(map_from_view) AS placed FROM views";
    let counted = &rows(&map, None, query)[0];
    assert_eq!(counted["views"], 60);
    assert_eq!(counted["placed"], 0);
}

/// Label images of a map, pixel by pixel, by stamp.
fn labels(map: &Path) -> BTreeMap<i64, Vec<u8>> {
    let query = "SELECT CAST(stamp AS BIGINT) AS at, encode(png, 'hex') AS png FROM label_images";
    let decoded = |row: &Value| {
        let hex = row["png"].as_str().unwrap();
        let bytes = (0..hex.len())
            .step_by(2)
            .map(|at| u8::from_str_radix(&hex[at..at + 2], 16));
        let bytes = bytes.collect::<Result<Vec<_>, _>>().unwrap();
        let mut image = png::Decoder::new(std::io::Cursor::new(bytes))
            .read_info()
            .unwrap();
        let mut pixels = vec![0; image.output_buffer_size().unwrap()];
        image.next_frame(&mut pixels).unwrap();
        (row["at"].as_i64().unwrap(), pixels)
    };
    rows(map, None, query).iter().map(decoded).collect()
}

#[test]
fn labels_are_learnt_and_given_to_frames() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let street = path("street");
    let small = [
        "length_m=120",
        "spacing_m=5",
        "width_px=512",
        "height_px=166",
        "visits=1",
    ];
    simulate("street", &street, &small);
    let log = street.join("visit_a/visit_a.mcap");
    let (given, learnt) = (path("given"), path("learnt"));
    run("semantic_map", &given, &["--sessions", text(&log)]).expect(0);
    let mut more = vec!["--sessions", text(&log)];
    for setting in [
        "samples.samples=500",
        "samples.backbone_areas_px=[43200]",
        "pixel_network.least_steps=500",
        "crf_settings.trials=1",
        "crf_settings.images=2",
    ] {
        more.extend(["--set", setting]);
    }
    run("scene_labels", &learnt, &more).expect(0);
    let (given, learnt) = (labels(&given), labels(&learnt));
    assert!(given.len() > 15 && given.keys().eq(learnt.keys()));
    let mut right = 0;
    let mut all = 0;
    for (stamp, truth) in &given {
        all += truth.len();
        right += truth
            .iter()
            .zip(&learnt[stamp])
            .filter(|(a, b)| a == b)
            .count();
    }
    let share = right as f64 / all as f64;
    eprintln!("pixels right: {share:.3} in {} views", given.len());
    assert!(share > 0.8, "{share}");
}
