//! Maps of drives whose odometry is slow, slips, is set anew or comes as a transform; judged by the truth.
//!
//! Figures are printed with `-- --nocapture`.

use std::path::{Path, PathBuf};

use evermap_algorithms::geometry::pose::Pose;
use evermap_algorithms::geometry::trajectory::StampedPose;
use evermap_tests::odometry::{Told, odometry, with_odometry};
use evermap_tests::park::{FEWER, Park, adjusted_error, finished};
use evermap_tests::trajectories::{Trajectories, pairs, poses, rows};
use evermap_tests::{evermap, shared, text};
use nalgebra::Vector3;

/// One drive, and its truth under the name `drive`.
struct Driven {
    folder: tempfile::TempDir,
    session: PathBuf,
    truths: Trajectories,
    odometry: Vec<StampedPose>,
}

impl Driven {
    fn new(seed: u64, loops: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let (session, truths) = Park::new(folder.path(), seed).drive(0, "drive", &[loops]);
        let odometry = odometry(&session);
        Self {
            folder,
            session,
            truths,
            odometry,
        }
    }

    /// The same drive with other odometry, mapped; what was lost on the way is said by the exit code.
    fn mapped(&self, name: &str, poses: &[StampedPose], told: Told, code: i32) -> PathBuf {
        let folder = self.folder.path().join(name);
        std::fs::create_dir(&folder).unwrap();
        let session = folder.join("drive.mcap");
        with_odometry(&self.session, &session, poses, told);
        let map = folder.join("map");
        finished("metric_map", &map, &[&session], &FEWER).expect(code);
        map
    }

    /// Root mean square error of a map, metres.
    fn error_m(&self, what: &str, map: &Path) -> f64 {
        adjusted_error(what, map, None, &self.truths)
            .position_m
            .rmse
    }

    /// When so much of the drive was over.
    fn after(&self, share: f64) -> i64 {
        self.odometry[(share * self.odometry.len() as f64) as usize].stamp_ns
    }
}

/// One message a second.
fn at_a_hertz(poses: &[StampedPose]) -> Vec<StampedPose> {
    poses.iter().step_by(50).copied().collect()
}

/// From this instant on as if the odometry began there.
fn reset(poses: &[StampedPose], at: i64) -> Vec<StampedPose> {
    let began = poses.iter().find(|pose| pose.stamp_ns >= at).unwrap().pose;
    let odometry = poses.iter().map(|found| StampedPose {
        pose: match found.stamp_ns < at {
            true => found.pose,
            false => began.inverse().compose(&found.pose),
        },
        ..*found
    });
    odometry.collect()
}

/// The wheels roll 1.5 m too far in the second after this instant.
fn slip(poses: &[StampedPose], at: i64) -> Vec<StampedPose> {
    let mut slipped = Pose::identity();
    let mut before: Option<StampedPose> = None;
    let odometry = poses.iter().map(|found| {
        if let Some(before) = before.replace(*found) {
            let step = before.pose.inverse().compose(&found.pose);
            let slips = (at..at + 1_000_000_000).contains(&found.stamp_ns);
            let seconds = (found.stamp_ns - before.stamp_ns) as f64 * 1e-9;
            let ahead = Vector3::x() * if slips { 1.5 * seconds } else { 0.0 };
            slipped = slipped.compose(&step);
            slipped = slipped.compose(&Pose::new(ahead, Default::default()));
        } else {
            slipped = found.pose;
        }
        StampedPose {
            pose: slipped,
            ..*found
        }
    });
    odometry.collect()
}

/// The stretches of the keyframes, and how many of them have a pose in the map.
fn mapped_stretches(map: &Path) -> Vec<(u64, u64, u64)> {
    let sql = "SELECT k.stretch, count(*) AS n, count(p.stamp) AS mapped FROM keyframes k \
               LEFT JOIN poses p ON p.session = k.session AND p.stamp = k.stamp GROUP BY k.stretch ORDER BY k.stretch";
    let row = |row: &serde_json::Value| {
        let [stretch, n, mapped] =
            ["stretch", "n", "mapped"].map(|name| row[name].as_u64().unwrap());
        (stretch, n, mapped)
    };
    rows(map, None, sql).iter().map(row).collect()
}

#[test]
fn a_message_a_second_is_enough() {
    let drive = Driven::new(21, "loops=0.5");
    let map = drive.mapped("slow", &at_a_hertz(&drive.odometry), Told::Poses, 0);
    assert!(drive.error_m("odometry at 1 Hz", &map) <= 0.05);
}

#[test]
fn a_reset_and_slipping_wheels_are_survived() {
    let drive = Driven::new(21, "loops=0.9");
    let reset = reset(&drive.odometry, drive.after(0.35));
    let disturbed = slip(&reset, drive.after(0.6));
    let map = drive.mapped("disturbed", &disturbed, Told::Poses, 3);
    let error_m = drive.error_m("a reset and a slip of 1.5 m", &map);
    let stretches = mapped_stretches(&map);
    assert!(error_m <= 0.05);
    assert!(
        matches!(stretches[..], [(0, n, mapped)] if n == mapped),
        "{stretches:?}"
    );
}

#[test]
fn what_a_reset_at_a_hertz_leaves_open_is_closed_by_sight_or_left_out() {
    let drive = Driven::new(22, "loops=1.3");
    let disturbed = reset(&at_a_hertz(&drive.odometry), drive.after(0.5));
    let map = drive.mapped("disturbed", &disturbed, Told::Poses, 3);
    let error_m = drive.error_m("a reset at 1 Hz", &map);
    let stretches = mapped_stretches(&map);
    eprintln!("{stretches:?}");
    assert!(error_m <= 0.05);
    assert!(stretches.len() == 2 && stretches[0].1 == stretches[0].2);
    assert!([0, stretches[1].1].contains(&stretches[1].2));
}

#[test]
fn a_transform_is_as_good_as_odometry() {
    let drive = Driven::new(23, "loops=0.3");
    let poses = |told| {
        let name = format!("{told:?}");
        let map = drive.mapped(&name, &drive.odometry, told, 0);
        let sql = "SELECT stamp, map_from_vehicle FROM poses ORDER BY stamp";
        (drive.error_m(&name, &map), rows(&map, None, sql))
    };
    let (of_poses, of_transforms) = (poses(Told::Poses), poses(Told::Transforms));
    assert!(!of_poses.1.is_empty());
    assert_eq!(of_poses, of_transforms);
}

#[test]
fn a_strangers_transforms_are_its_odometry() {
    let Some(log) = shared("data/mcap_real/evo/nav2_turtlebot.mcap") else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let manifest = folder.path().join("sessions.yaml");
    std::fs::write(&manifest, "roles: { odometry: /tf }\n").unwrap();
    let read = |more: &[&str]| {
        let sql = "SELECT CAST(stamp AS BIGINT) AS stamp, odom_from_vehicle AS pose FROM odometry ORDER BY stamp";
        let mut arguments = vec!["sql", "--sessions", text(&log), "--format", "json"];
        arguments.extend(more);
        arguments.push(sql);
        evermap(&arguments).expect(0).json()
    };
    let (odom, tf) = (read(&[]), read(&["--manifest", text(&manifest)]));
    assert!(odom.as_array().unwrap().len() > 100);
    assert_eq!(odom, tf);
}

/// Wheels see a flat floor, whatever it is like.
#[test]
fn an_imu_knows_what_is_up() {
    let folder = tempfile::tempdir().unwrap();
    let settings = [
        "imu=true",
        "floor_slope=0.06",
        "width_px=32",
        "height_px=32",
        "rate_hz=5",
        "floor_texels_per_m=10",
    ];
    let (session, truths) = Park::new(folder.path(), 5).drive(0, "drive", &settings);
    let map = folder.path().join("roads");
    finished("trajectory", &map, &[&session], &[]).expect(0);
    let found = pairs(&poses(&map, None, "poses", "map_from_vehicle"), &truths);
    let found = &found["drive"];
    let start = &found[0];
    let height = |pose: &Pose, start: &Pose| pose.translation.z - start.translation.z;
    let up = |pose: &Pose| pose.rotation.inverse() * Vector3::z();
    let (mut metres, mut radians, mut climbed) = (0.0_f64, 0.0_f64, 0.0_f64);
    let (mut way_m, mut last) = (0.0, start.truth.translation);
    for pair in found {
        way_m += (pair.truth.translation - last).norm();
        last = pair.truth.translation;
        let truth = height(&pair.truth, &start.truth);
        metres = metres.max((height(&pair.estimate, &start.estimate) - truth).abs());
        radians = radians.max(up(&pair.estimate).angle(&up(&pair.truth)));
        climbed = climbed.max(truth.abs());
    }
    eprintln!(
        "{way_m:.0} m over a floor that rises by {climbed:.2} m: {metres:.2} m and {:.2}° off at most",
        radians.to_degrees()
    );
    assert!(climbed > 0.5, "{climbed}");
    // An accelerometer that is off by 0.05 m/s² at rest has the vehicle lean by 0.3°, and climb 0.5 m in 100 m.
    let most = 0.5_f64.to_radians();
    assert!(radians < most && metres < most * way_m);
}
