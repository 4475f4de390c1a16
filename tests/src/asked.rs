//! A street with somebody to ask about in each image.

use std::path::PathBuf;

use crate::{Finished, run_of_site, simulate, text};

/// A question in each image, about who would stand at one place ahead of the vehicle; and what answers become: labels that are
/// tied to their images.
const PLAN: &str = "\
plan: asked
steps:
  pictures:
    sql: SELECT site, session, stamp, camera, image FROM frames
  poses:
    sql: >
      SELECT site, session, stamp, named_struct('x', 2.0 * nth, 'y', 0.0, 'z', 0.0,
        'qx', 0.0, 'qy', 0.0, 'qz', 0.0, 'qw', 1.0) AS map_from_vehicle
      FROM (SELECT site, session, stamp, row_number() OVER (PARTITION BY site, session ORDER BY stamp) AS nth FROM pictures)
  cameras: { sql: SELECT * FROM calibration }
  mounts: { sql: SELECT * FROM transforms WHERE fixed }
  said: { sql: SELECT * FROM annotations }
  label_anchors: { op: label_anchors, in: { annotations: said, poses: poses, calibration: cameras, transforms: mounts } }
  placed_labels: { op: placed_labels, in: { labels: label_anchors, poses: poses } }
  person_questions:
    sql: >
      SELECT site, row_number() OVER (PARTITION BY site ORDER BY stamp) AS question, session, stamp, camera, 0 AS person,
        3.0 AS x, 0.5 AS y, 3.0 AS range_m, make_array(100.0, 30.0, 110.0, 60.0) AS rectangle,
        0.0 AS mean, 1.0 AS variance, 0.5 AS probability, 0.1 AS gain, 'uncertain' AS reason
      FROM pictures
write: [pictures, poses, cameras, mounts, said, label_anchors, placed_labels, person_questions]
";

/// A street that is driven once, with few and small images.
pub const SMALL: [&str; 5] = [
    "length_m=80",
    "spacing_m=10",
    "width_px=256",
    "height_px=83",
    "visits=1",
];

/// A folder with the map of such a street, from one drive of at least eight images.
pub struct AskedStreet {
    folder: tempfile::TempDir,
}

impl AskedStreet {
    /// Simulates the street, and maps it.
    ///
    /// # Panics
    /// Where that cannot be done.
    #[allow(clippy::new_without_default)]
    pub fn new() -> Self {
        let street = Self {
            folder: tempfile::tempdir().expect("a folder can be made"),
        };
        simulate("street", &street.path("street"), &SMALL);
        std::fs::write(street.path("asked.yaml"), PLAN).expect("a plan can be written");
        let first = street.run(&["--sessions", text(&street.log())]);
        assert!([0, 3].contains(&first.code), "{}", first.stderr);
        street
    }

    /// A file of the folder.
    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// The map.
    pub fn map(&self) -> PathBuf {
        self.path("map")
    }

    /// The log of the drive.
    pub fn log(&self) -> PathBuf {
        self.path("street/visit_a/visit_a.mcap")
    }

    /// Runs the plan on the map, with these arguments.
    ///
    /// # Panics
    /// When the program does not start.
    pub fn run(&self, arguments: &[&str]) -> Finished {
        let (plan, map) = (self.path("asked.yaml"), self.map());
        run_of_site(text(&plan), &map, "street", arguments)
    }
}
