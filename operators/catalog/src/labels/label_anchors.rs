#![doc = include_str!("label_anchors.md")]

use evermap_algorithms::labels::anchors::AnchorParams;
use evermap_contract::{Emit, Fault, Key, Operator, Port, Reach, Sides, Work};
use evermap_schemas::layers::{LabelAnchor, MapFrame, VehiclePose};
use evermap_schemas::record;
use evermap_schemas::roles::Annotation;

use crate::inputs::labels::{Holds, MapRows, anchored};
use crate::inputs::rig::{self, OfVehicle};

/// See the module's page.
pub struct LabelAnchors;

record! {
    /// What may hide a label: of a landmark, where it is.
    #[layer("landmarks", key(site, landmark))]
    pub struct Obstacle {
        /// Site of the map.
        site: String,
        /// Number of the landmark.
        landmark: u32,
        /// Where it is.
        x: f64 ["m", "map"],
        /// Where it is.
        y: f64 ["m", "map"],
        /// Where it is.
        z: f64 ["m", "map"],
    }
}

impl Operator for LabelAnchors {
    const NAME: &'static str = "label_anchors";
    const VERSION: u32 = 2;
    const PAGE: &'static str = include_str!("label_anchors.md");
    type Params = OfVehicle<AnchorParams>;
    type Output = LabelAnchor;

    fn work() -> Work<Self::Params> {
        let annotations = Port::site::<Annotation>("annotations");
        let mut sides = vec![
            Port::site::<VehiclePose>("poses"),
            Port::site::<MapFrame>("frames").optional(),
        ];
        sides.extend(rig::ports(Reach::Site).map(Port::optional));
        sides.extend([
            Port::site::<Obstacle>("landmarks").optional(),
            Port::site::<LabelAnchor>("previous").optional(),
            Port::site::<VehiclePose>("previous_poses").optional(),
            Port::site::<MapFrame>("previous_frames").optional(),
        ]);
        Work::group(annotations, Key::SITE, sides, hold)
    }
}

fn hold(
    params: &OfVehicle<AnchorParams>,
    annotations: Vec<Annotation>,
    sides: Sides,
    emit: &mut Emit<'_>,
) -> Result<(), Fault> {
    let landmarks: Vec<Obstacle> = sides.rows("landmarks")?;
    let mut map = MapRows {
        poses: sides.rows("previous_poses")?,
        frames: sides.rows("previous_frames")?,
        calibration: sides.rows("calibration")?,
        transforms: sides.rows("transforms")?,
        landmarks: landmarks.iter().map(|row| [row.x, row.y, row.z]).collect(),
    };
    // What is drawn is drawn on a version that there is; on the first one, where there is none before.
    if map.poses.is_empty() {
        map.poses = sides.rows("poses")?;
        map.frames = sides.rows("frames")?;
    }
    let holds = Holds::new(map, params);
    let before = sides.rows("previous")?;
    let mut skip = |reason, count| emit.skip(reason, count);
    let labels = anchored(annotations, before, &holds, &mut skip);
    emit.rows(labels)
}
