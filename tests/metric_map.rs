//! The metric map on worlds with exact truth: how far poses are off, what revisits make of them, and what the map does
//! when something is wrong.
//!
//! Figures are printed with `-- --nocapture`. `error` is the absolute trajectory error after one rigid alignment, without
//! scale, of the whole map; the odometry's error beside it is after an alignment of each drive for itself.

use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use evermap_algorithms::geometry::geodesy::{Geodetic, Tangent};
use evermap_algorithms::geometry::trajectory::pose_at;
use evermap_bench::trajectory::relative_error;
use evermap_tests::kitti::Stretch;
use evermap_tests::park::{
    FEWER, Localised, Park, adjusted_error, copy, finished, made_once, run, run_small,
};
use evermap_tests::trajectories::{Trajectories, pairs, poses, rows};
use evermap_tests::{layers_of, plan_command, simulate, text};
use nalgebra::{Rotation3, Vector3};
use serde_json::Value;

/// The map of a first drive around the western island of one car park, which tests of other drives share.
struct FirstDrive {
    map: PathBuf,
    truths: Trajectories,
}

impl FirstDrive {
    const SEED: u64 = 14;
    const RECEIVER: [&str; 3] = ["gnss=true", "gnss_noise_m=1", "gnss_outage_s=5"];

    fn get() -> &'static Self {
        static FIRST: OnceLock<FirstDrive> = OnceLock::new();
        FIRST.get_or_init(|| {
            let folder = made_once(env!("CARGO_TARGET_TMPDIR"), "metric_map");
            let map = folder.join("map");
            let park = Park::new(&folder, Self::SEED);
            let (initial, truths) = park.drive(0, "initial", &Self::RECEIVER);
            run_small("metric_map", &map, &[&initial]);
            Self { map, truths }
        })
    }
}

#[test]
fn a_simulated_car_park_is_mapped_and_found_again_from_the_other_direction() {
    let folder = tempfile::tempdir().unwrap();
    let first = FirstDrive::get();
    let mut truths = first.truths.clone();
    let map = copy(&first.map, folder.path(), "map");
    let park = Park::new(folder.path(), FirstDrive::SEED);
    let first = adjusted_error("simulated, initial", &map, None, &truths);
    assert!(first.position_m.rmse <= 0.05);
    for (version, index, name) in [(2, 4, "same_way"), (3, 1, "other_way")] {
        let (session, truth) = park.drive(index, name, &["loops=0.5"]);
        truths.extend(truth);
        run_small("lifelong", &map, &[&session]);
        assert!(Localised::of(&map, version, name, &truths).is_never_silently_wrong());
    }
    let last = adjusted_error("simulated, three drives", &map, None, &truths);
    assert!(last.position_m.rmse <= 0.03);
}

#[test]
fn a_map_of_a_car_with_a_receiver_lies_where_it_is_on_earth() {
    let first = FirstDrive::get();
    let found = rows(&first.map, None, "SELECT * FROM georeference");
    let [found] = found.as_slice() else {
        panic!("{found:?}");
    };
    let number = |name: &str| found[name].as_f64().unwrap();
    let place = |latitude: &str, longitude: &str, height: &str, of: &Value| Geodetic {
        latitude_deg: of[latitude].as_f64().unwrap(),
        longitude_deg: of[longitude].as_f64().unwrap(),
        height_m: of[height].as_f64().unwrap(),
    };
    let of_earth = |of: &Value| place("latitude_deg", "longitude_deg", "height_m", of);
    let world = first
        .map
        .parent()
        .unwrap()
        .join("world_initial/truth/world.json");
    let world: Value = serde_json::from_slice(&std::fs::read(world).unwrap()).unwrap();
    let truth = Tangent::at(of_earth(&world["origin"]));
    let here = Tangent::at(of_earth(found));
    let turn = Rotation3::from_axis_angle(&Vector3::z_axis(), number("heading_rad"));
    let mapped = poses(&first.map, None, "poses", "map_from_vehicle");
    let mut worst = 0.0_f64;
    for pose in &mapped["initial"] {
        let there = pose_at(&first.truths["initial"], pose.stamp_ns, 500_000_000).unwrap();
        let on_earth = truth.enu(here.geodetic(&(turn * pose.pose.translation)));
        worst = worst.max((on_earth - there.translation).xy().norm());
    }
    eprintln!("on earth: at most {worst:.2} m off, {found}");
    assert!(worst < 0.5, "{worst} m");
    assert_eq!((number("outliers"), number("drift_m")), (0.0, 0.0));
    assert!((0.8..1.2).contains(&number("noise_m")));
}

#[test]
fn odometry_that_is_wrong_by_5_percent_does_not_set_the_maps_scale() {
    let folder = tempfile::tempdir().unwrap();
    let map = folder.path().join("map");
    let (session, truths) = Park::new(folder.path(), 12).drive(
        0,
        "initial",
        &["loops=0.6", "odometry_scale_error=0.05"],
    );
    run_small("metric_map", &map, &[&session]);
    let error = adjusted_error("odometry 5 % long", &map, None, &truths);
    assert!(error.position_m.rmse <= 0.10);
}

#[test]
fn a_calibration_that_is_off_by_half_a_pixel_costs_centimetres() {
    let folder = tempfile::tempdir().unwrap();
    let map = folder.path().join("map");
    let (session, truths) = Park::new(folder.path(), 13).drive(
        0,
        "initial",
        &["loops=0.6", "calibration_error_px=0.5"],
    );
    run_small("metric_map", &map, &[&session]);
    let error = adjusted_error("calibration off by half a pixel", &map, None, &truths);
    assert!(error.position_m.rmse <= 0.10);
}

/// The loop closures of a drive, and nothing that is made of them.
const JUST_LOOPS: &str = "
plan: just_loops
extends: metric_map
drop:
  [graph_poses, adjusted_poses, landmarks, map_frames, frame_poses, poses, antenna_positions, georeference]
";

/// The adjusted poses of a drive, and nothing that is made of them.
const JUST_POSES: &str = "
plan: just_poses
extends: metric_map
drop: [landmarks, map_frames, frame_poses, poses, antenna_positions, georeference]
";

#[test]
fn loops_are_the_same_where_the_features_do_not_fit_into_memory() {
    let setting = "loop_closures.window_m=2.5";
    let rows = "SELECT * FROM loop_closures";
    is_the_same_where_features_do_not_fit(JUST_LOOPS, setting, rows);
}

#[test]
fn adjusted_poses_are_the_same_where_the_features_do_not_fit_into_memory() {
    let setting = "adjusted_poses.drop_sigmas=3.9";
    let rows = "SELECT session, stamp, map_from_vehicle, array_length(observations) AS seen, md5(descriptors) AS looks \
         FROM adjusted_poses";
    is_the_same_where_features_do_not_fit(JUST_POSES, setting, rows);
}

/// Makes a step of the first drive's map anew, with this setting, from what is there: with memory for all features, and with
/// less.
fn is_the_same_where_features_do_not_fit(plan_text: &str, setting: &str, sql: &str) {
    let folder = tempfile::tempdir().unwrap();
    let first = &FirstDrive::get().map;
    let plan = folder.path().join("plan.yaml");
    std::fs::write(&plan, plan_text).unwrap();
    let session = first.parent().unwrap().join("world_initial/initial.mcap");
    // Gives the rows, and whether a table was in a file.
    let made = |name: &str, memory: &str| {
        let map = copy(first, folder.path(), name);
        let anew = ["--set", setting, "--memory", memory];
        let more = [&FEWER[..], &anew, &["--sessions", text(&session)]].concat();
        let mut command = plan_command(text(&plan), &map, "park", &more);
        let ran = command.env("EVERMAP_LOG", "evermap_engine=debug").output();
        let told = evermap_tests::Finished::from(ran.unwrap()).expect(0).stderr;
        let of_sides: Vec<&str> = told.split("side_file_bytes=").skip(1).collect();
        assert!(!of_sides.is_empty(), "{told}");
        let in_file = of_sides.iter().any(|bytes| !bytes.starts_with('0'));
        (rows(&map, Some(2), sql), in_file)
    };
    let (held, in_file) = made("held", "4GiB");
    assert!(!held.is_empty() && !in_file);
    assert_eq!(made("fetched", "32MiB"), (held, true));
}

/// One loop closure in five says that a keyframe stands where another one stood.
const FALSE_LOOPS: &str = "
plan: disturbed
extends: metric_map
steps:
  numbered_loops:
    sql: >
      SELECT *, row_number() OVER (ORDER BY session, stamp, other_session, other_stamp) AS n,
             count(*) OVER () AS total
      FROM loop_closures
  disturbed_loops:
    sql: >
      SELECT * EXCLUDE (n, total) FROM numbered_loops
      UNION ALL
      SELECT a.site, a.session, a.stamp, a.keyframe, b.other_session, b.other_stamp, b.other_keyframe,
             b.other_from_vehicle, a.matches, a.inliers, a.sigma_m, a.sigma_rad
      FROM numbered_loops a
      JOIN numbered_loops b ON b.site = a.site AND b.n = (5 * a.n + a.total / 2) % a.total
      WHERE a.n % 4 = 0 AND b.other_stamp < a.stamp AND b.other_keyframe + 20 < a.keyframe
  graph_poses:
    in: { loop_closures: disturbed_loops }
write: [disturbed_loops]
";

#[test]
fn false_loop_closures_are_found_out() {
    let folder = tempfile::tempdir().unwrap();
    let (plan, map) = (
        folder.path().join("disturbed.yaml"),
        folder.path().join("map"),
    );
    std::fs::write(&plan, FALSE_LOOPS).unwrap();
    let (session, truths) = Park::new(folder.path(), 16).drive(0, "initial", &["loops=1"]);
    run_small(text(&plan), &map, &[&session]);
    let counted = rows(
        &map,
        None,
        "SELECT (SELECT count(*) FROM loop_closures) AS of, (SELECT count(*) FROM disturbed_loops) AS n",
    );
    let [of, n] = ["of", "n"].map(|name| counted[0][name].as_f64().unwrap());
    eprintln!("{} of {n} loop closures are false", n - of);
    assert!(n - of >= 0.15 * n, "{counted:?}");
    let error = adjusted_error("with false loop closures", &map, None, &truths);
    assert!(error.position_m.rmse <= 0.05);
}

#[test]
fn a_dark_camera_and_a_strange_start_do_no_harm() {
    let folder = tempfile::tempdir().unwrap();
    let first = FirstDrive::get();
    let mut truths = first.truths.clone();
    let park = Park::new(folder.path(), FirstDrive::SEED);
    adjusted_error("before the trials", &first.map, None, &truths);

    let (dark, truth) = park.drive(4, "dark", &["loops=0.5", "dark_camera=left"]);
    truths.extend(truth);
    let of_dark = copy(&first.map, folder.path(), "of_dark");
    run_small("lifelong", &of_dark, &[&dark]);
    let localised = Localised::of(&of_dark, 2, "dark", &truths);
    assert!(localised.is_never_silently_wrong() && localised.lost_share() < 0.1);
    let error = adjusted_error("with one camera dark", &of_dark, None, &truths);
    assert!(error.position_m.rmse <= 0.05);

    // The eastern loop was never mapped; the drive comes from there.
    let (strange, truth) = park.drive(4, "strange", &["start_m=90", "loops=1"]);
    truths.extend(truth);
    let of_strange = copy(&first.map, folder.path(), "of_strange");
    run_small("lifelong", &of_strange, &[&strange]);
    let localised = Localised::of(&of_strange, 2, "strange", &truths);
    assert!(localised.is_never_silently_wrong());
    assert!(localised.lost > 0 && localised.lost_share() < 0.9);
    adjusted_error("with a strange start", &of_strange, None, &truths);
}

/// Asserts that a session did not join a copy of the map, and that none of its keyframes was localised in it.
fn assert_not_merged(map: &Path, folder: &Path, name: &str, session: &Path) -> PathBuf {
    let aside = copy(map, folder, &format!("of_{name}"));
    // Keyframes that are left out of the map are a loss.
    finished("lifelong", &aside, &[session], &FEWER).expect(3);
    let count = |of: &str| {
        let query = format!("SELECT count(*) AS n FROM {of} session = '{name}'");
        rows(&aside, None, &query)[0]["n"].as_u64().unwrap()
    };
    let [driven, found, merged] = [
        "localisations WHERE",
        "localisations WHERE state != 'lost' AND",
        "adjusted_poses WHERE",
    ]
    .map(count);
    eprintln!("{name}: {found} of {driven} keyframes localised, {merged} merged");
    assert!(driven > 0);
    assert_eq!([found, merged], [0, 0], "{name}");
    aside
}

/// The log of a simulated street of 90 m, driven once, which the tests share.
fn street() -> &'static Path {
    static STREET: OnceLock<PathBuf> = OnceLock::new();
    STREET.get_or_init(|| {
        let out = made_once(env!("CARGO_TARGET_TMPDIR"), "metric_map_street");
        let small = [
            "length_m=90",
            "visits=1",
            "spacing_m=0.75",
            "width_px=768",
            "height_px=250",
        ];
        simulate("street", &out, &small);
        let session = out.join("street.mcap");
        std::fs::rename(out.join("visit_a").join("visit_a.mcap"), &session).unwrap();
        session
    })
}

#[test]
fn another_place_is_not_merged() {
    let folder = tempfile::tempdir().unwrap();
    let FirstDrive { map, truths } = FirstDrive::get();
    let first = adjusted_error("before another place", map, None, truths);
    // Car parks of one drawing: they share layout and much of their paint, and the gate that the first drive begins at.
    for (seed, index, name) in [(99, 0, "from_the_gate"), (77, 4, "from_the_aisle")] {
        let (other, _) = Park::new(folder.path(), seed).drive(index, name, &["loops=0.4"]);
        assert_not_merged(map, folder.path(), name, &other);
    }
    let beside = assert_not_merged(map, folder.path(), "street", street());
    let error = adjusted_error("beside another place", &beside, None, truths);
    assert!(error.position_m.rmse <= first.position_m.rmse + 0.01);
    if let Some(stretch) = Stretch::find() {
        let road = stretch.write(folder.path(), "road", 0, 1);
        assert_not_merged(map, folder.path(), "road", &road.session);
    }
}

#[test]
fn neither_a_car_park_nor_a_road_is_merged_into_a_street() {
    let folder = tempfile::tempdir().unwrap();
    let map = folder.path().join("map");
    run_small("metric_map", &map, &[street()]);
    let (park, _) = Park::new(folder.path(), 14).drive(4, "park", &["loops=0.4"]);
    assert_not_merged(&map, folder.path(), "park", &park);
    if let Some(stretch) = Stretch::find() {
        let road = stretch.write(folder.path(), "road", 0, 1);
        assert_not_merged(&map, folder.path(), "road", &road.session);
    }
}

#[test]
fn a_drive_that_leaves_the_mapped_part_is_localised_until_then() {
    let folder = tempfile::tempdir().unwrap();
    let first = FirstDrive::get();
    let mut truths = first.truths.clone();
    let map = copy(&first.map, folder.path(), "map");
    let park = Park::new(folder.path(), FirstDrive::SEED);
    // The western loop was mapped; after it the drive goes on to the eastern one.
    let (leaving, truth) = park.drive(4, "leaving", &["loops=1"]);
    truths.extend(truth);
    run_small("lifelong", &map, &[&leaving]);
    let localised = Localised::of(&map, 2, "leaving", &truths);
    assert!(localised.is_never_silently_wrong());
    let lost = "SELECT count(*) FILTER (WHERE part < 0.4 AND state = 'lost') AS before, \
                count(*) FILTER (WHERE part < 0.4) AS all_before, \
                count(*) FILTER (WHERE part > 0.9 AND state != 'lost') AS after FROM \
                (SELECT state, percent_rank() OVER (ORDER BY stamp) AS part FROM localisations \
                 WHERE session = 'leaving')";
    let counted = rows(&map, Some(2), lost);
    eprintln!("leaving: {}", counted[0]);
    let [before, all_before, after] =
        ["before", "all_before", "after"].map(|name| counted[0][name].as_f64().unwrap());
    assert!(before < 0.1 * all_before && after == 0.0, "{counted:?}");
}

#[test]
fn one_camera_on_the_road_halves_the_odometrys_turning_and_finds_its_way_again() {
    let Some(stretch) = Stretch::find() else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let map = folder.path().join("whole");
    let all = stretch.write(folder.path(), "all", 0, 1);
    run("metric_map", &map, &[&all.session]);
    let truths: Trajectories = [("all".to_owned(), all.truth)].into();
    let estimates = poses(&map, None, "poses", "map_from_vehicle");
    let odometry: Trajectories = [("all".to_owned(), all.odometry)].into();
    let drift =
        |estimates: &Trajectories| relative_error(&pairs(estimates, &truths)["all"], 10.0).unwrap();
    let (found, drifted) = (drift(&estimates), drift(&odometry));
    eprintln!(
        "KITTI: {:.2} % and {:.4} deg/m; odometry {:.2} % and {:.4} deg/m",
        100.0 * found.translation.rmse,
        found.rotation_rad_per_m.rmse.to_degrees(),
        100.0 * drifted.translation.rmse,
        drifted.rotation_rad_per_m.rmse.to_degrees()
    );
    assert!(found.translation.rmse <= 0.02);
    assert!(found.rotation_rad_per_m.rmse <= 0.5 * drifted.rotation_rad_per_m.rmse);

    let map = folder.path().join("map");
    let (even, odd) = (
        stretch.write(folder.path(), "even", 0, 2),
        stretch.write(folder.path(), "odd", 1, 2),
    );
    run("metric_map", &map, &[&even.session]);
    run("lifelong", &map, &[&odd.session]);
    let truths: Trajectories = [
        ("even".to_owned(), even.truth),
        ("odd".to_owned(), odd.truth),
    ]
    .into();
    let localised = Localised::of(&map, 2, "odd", &truths);
    assert!(localised.lost_share() < 0.1);
    assert!(localised.error.unwrap().position_m.median <= 0.10);
}

#[test]
fn threads_and_partitions_do_not_change_the_map() {
    let folder = tempfile::tempdir().unwrap();
    let park = Park::new(folder.path(), 15);
    let (initial, _) = park.drive(
        0,
        "initial",
        &["loops=0.4", "width_px=320", "height_px=240"],
    );
    let (revisit, _) = park.drive(
        4,
        "revisit",
        &["loops=0.4", "width_px=320", "height_px=240"],
    );
    let digests = |jobs: &str| {
        let map = folder.path().join(format!("map_{jobs}"));
        for (plan, session) in [("metric_map", &initial), ("lifelong", &revisit)] {
            let more = [&FEWER[..], &["--jobs", jobs, "--sessions", text(session)]].concat();
            let mut command = plan_command(plan, &map, "park", &more);
            let done = command.env("RAYON_NUM_THREADS", jobs).output().unwrap();
            evermap_tests::Finished::from(done).expect(0);
        }
        let layers = layers_of(&map);
        let digest = |layer: &serde_json::Value| (layer["layer"].clone(), layer["digest"].clone());
        layers
            .as_array()
            .unwrap()
            .iter()
            .map(digest)
            .collect::<Vec<_>>()
    };
    assert_eq!(digests("1"), digests("3"));
}
