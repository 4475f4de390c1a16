#![doc = include_str!("keyframes.md")]

use evermap_algorithms::geometry::pose::Pose;
use evermap_algorithms::metric_map::drive::{self, Exposure, KeyframeParams, Keyframer};
use evermap_contract::{Emit, Fault, Key, Operator, Pixels, Port, Sides, Stream, Work};
use evermap_schemas::layers::{Keyframe, KeyframeImage};
use evermap_schemas::roles::{Frame, OdometryPose};
use evermap_schemas::{ImageRef, Stamp};

use crate::inputs::outside;

/// See the module's page.
pub struct Keyframes;

impl Operator for Keyframes {
    const NAME: &'static str = "keyframes";
    const VERSION: u32 = 5;
    const PAGE: &'static str = include_str!("keyframes.md");
    type Params = KeyframeParams;
    type Output = Keyframe;

    fn work() -> Work<Self::Params> {
        let odometry = Port::session::<OdometryPose>("odometry");
        let sides = vec![Port::session::<Frame>("frames").optional()];
        Work::stream::<SessionKeyframer>(odometry, Key::SESSION, sides)
    }

    fn check(params: &KeyframeParams) -> Result<(), Fault> {
        params
            .check()
            .map_err(|error| Fault::user(error.to_string()))
    }
}

/// Keyframes are handed on once there are so many: messages that are far apart make many.
const ENOUGH: usize = 8192;

/// One session at work.
struct SessionKeyframer {
    keyframer: Keyframer<ImageRef>,
    /// Site and session.
    name: (String, String),
    not_rigid: u64,
}

impl Stream for SessionKeyframer {
    type Params = KeyframeParams;
    type Row = OdometryPose;

    fn open(params: &KeyframeParams, sides: &Sides) -> Result<Self, Fault> {
        let mut frames = sides.rows::<Frame>("frames")?;
        // Of several of one camera with one stamp the first one counts.
        frames.sort_by(|a, b| (&a.topic, a.log_time).cmp(&(&b.topic, b.log_time)));
        let exposures = frames.into_iter().map(|frame| Exposure {
            stamp: frame.stamp.0,
            camera: frame.camera,
            image: frame.image,
        });
        Ok(Self {
            keyframer: Keyframer::new(*params, exposures.collect()),
            name: Default::default(),
            not_rigid: 0,
        })
    }

    fn push(
        &mut self,
        rows: Vec<OdometryPose>,
        _: &Pixels,
        emit: &mut Emit<'_>,
    ) -> Result<(), Fault> {
        let mut keyframes = Vec::new();
        for row in rows {
            match Pose::from_array(row.odom_from_vehicle.to_array()) {
                Ok(pose) => keyframes.extend(self.keyframer.push(row.stamp.0, &pose)),
                Err(_) => self.not_rigid += 1,
            }
            self.name = (row.site, row.session);
            if keyframes.len() >= ENOUGH {
                self.emit(std::mem::take(&mut keyframes), emit)?;
            }
        }
        self.emit(keyframes, emit)
    }

    fn close(mut self, emit: &mut Emit<'_>) -> Result<(), Fault> {
        let keyframes = self.keyframer.finish();
        let losses = self.keyframer.losses();
        let not_rigid = self.not_rigid + losses.not_finite;
        emit.skip("odometry pose is not a rigid transform", not_rigid);
        emit.skip("odometry stamp repeats", losses.out_of_order);
        emit.skip("odometry jumped", losses.jumps);
        emit.skip("odometry paused while the vehicle moved", losses.pauses);
        emit.skip(
            "second frame of one camera with one stamp",
            losses.repeated_frames,
        );
        let (early, late) = (losses.early_frames, losses.late_frames);
        emit.skip(outside::early(early.farthest_ns, "odometry"), early.frames);
        emit.skip(outside::late(late.farthest_ns, "odometry"), late.frames);
        self.emit(keyframes, emit)
    }
}

impl SessionKeyframer {
    fn emit(
        &self,
        keyframes: Vec<drive::Keyframe<ImageRef>>,
        emit: &mut Emit<'_>,
    ) -> Result<(), Fault> {
        let rows = keyframes.into_iter().map(|keyframe| self.row(keyframe));
        emit.rows(rows.collect())
    }

    fn row(&self, keyframe: drive::Keyframe<ImageRef>) -> Keyframe {
        let images = keyframe
            .exposures
            .into_iter()
            .map(|exposure| KeyframeImage {
                camera: exposure.camera,
                stamp: Stamp(exposure.stamp),
                image: exposure.image,
            });
        let (site, session) = self.name.clone();
        Keyframe {
            site,
            session,
            stamp: Stamp(keyframe.stamp),
            keyframe: keyframe.number,
            distance_m: keyframe.distance_m,
            stretch: keyframe.stretch,
            odom_from_vehicle: evermap_schemas::Pose::from_array(
                keyframe.odom_from_vehicle.to_array(),
            ),
            images: images.collect(),
        }
    }
}
