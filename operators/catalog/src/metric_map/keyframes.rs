#![doc = include_str!("keyframes.md")]

use std::collections::VecDeque;

use arrow::array::RecordBatch;
use evermap_algorithms::metric_map::drive::{KeyframeParams, KeyframeSelector};
use evermap_algorithms::geometry::pose::Pose;
use evermap_contract::{Emit, Fault, Grain, Group, GroupKernel, Kernel, Operator, Port, Sides};
use evermap_schemas::layers::{Keyframe, KeyframeImage};
use evermap_schemas::roles::{Frame, OdometryPose};
use evermap_schemas::{Stamp, rows};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// See the module's page.
pub struct Keyframes;

/// How keyframes are chosen.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct KeyframesParams {
    /// Driven path between keyframes (m).
    pub baseline_m: f64,
    /// Motion counts only when it adds up to more than this (m).
    pub deadband_m: f64,
    /// A longer step between two odometry messages (m) is a reset, not driven path.
    pub jump_m: f64,
    /// Spread of the stamps of one frame set (s).
    pub max_gap_s: f64,
    /// A frame set that comes later than this after a due point (s) does not serve it.
    pub max_wait_s: f64,
}

impl Default for KeyframesParams {
    fn default() -> Self {
        let KeyframeParams {
            baseline_m,
            deadband_m,
            jump_m,
        } = KeyframeParams::default();
        Self {
            baseline_m,
            deadband_m,
            jump_m,
            max_gap_s: 0.04,
            max_wait_s: 1.0,
        }
    }
}

impl Operator for Keyframes {
    const NAME: &'static str = "keyframes";
    const VERSION: u32 = 1;
    const PAGE: &'static str = include_str!("keyframes.md");
    type Params = KeyframesParams;
    type Output = Keyframe;

    fn ports() -> Vec<Port> {
        vec![
            Port::of::<OdometryPose>("odometry", Grain::SESSION),
            Port::of::<Frame>("frames", Grain::SESSION).optional(),
        ]
    }

    fn kernel(params: KeyframesParams) -> Result<Kernel, Fault> {
        let KeyframesParams {
            baseline_m,
            deadband_m,
            jump_m,
            ..
        } = params;
        let selector = KeyframeSelector::new(KeyframeParams {
            baseline_m,
            deadband_m,
            jump_m,
        })
        .map_err(|error| Fault::user(error.to_string()))?;
        let max_gap_ns = nanoseconds("max_gap_s", params.max_gap_s)?;
        let max_wait_ns = nanoseconds("max_wait_s", params.max_wait_s)?;
        Ok(Kernel::Group(Box::new(Opener {
            selector,
            max_gap_ns,
            max_wait_ns,
        })))
    }
}

fn nanoseconds(name: &str, seconds: f64) -> Result<i64, Fault> {
    if (0.0..1e9).contains(&seconds) {
        Ok((seconds * 1e9).round() as i64)
    } else {
        Err(Fault::user(format!(
            "expected {name} of 0 s to 1e9 s, found {seconds}"
        )))
    }
}

struct Opener {
    selector: KeyframeSelector,
    max_gap_ns: i64,
    max_wait_ns: i64,
}

impl GroupKernel for Opener {
    fn open(&self, sides: &Sides) -> Result<Box<dyn Group>, Fault> {
        Ok(Box::new(Session {
            frames: sides.rows::<Frame>("frames")?,
            max_gap_ns: self.max_gap_ns,
            path: Path {
                selector: self.selector.clone(),
                run: 0,
                before_run_m: 0.0,
                due: VecDeque::new(),
                last_m: 0.0,
            },
            sets: FrameSets::default(),
            matcher: Matcher {
                max_wait_ns: self.max_wait_ns,
                last: None,
                given: 0,
            },
            previous: None,
            name: None,
            skipped_poses: 0,
        }))
    }
}

/// One session at work: odometry goes in, due points come out of `path`, and wait for their frame set.
struct Session {
    /// All frames of the port, until the first row says which session this is.
    frames: Vec<Frame>,
    max_gap_ns: i64,
    path: Path,
    sets: FrameSets,
    matcher: Matcher,
    previous: Option<(i64, Pose)>,
    name: Option<(String, String)>,
    skipped_poses: u64,
}

impl Group for Session {
    fn push(&mut self, batch: &RecordBatch, emit: &mut Emit<'_>) -> Result<(), Fault> {
        let mut keyframes = Vec::new();
        for row in rows::<OdometryPose>(batch)? {
            self.begin(&row, emit);
            match Pose::from_array(row.odom_from_vehicle.to_array()) {
                Ok(pose) => {
                    self.drive(row.stamp.0, &pose);
                    self.give(false, &mut keyframes);
                }
                Err(_) => self.skipped_poses += 1,
            }
        }
        emit.rows(keyframes)
    }

    fn close(&mut self, emit: &mut Emit<'_>) -> Result<(), Fault> {
        let mut keyframes = Vec::new();
        self.give(true, &mut keyframes);
        let losses = self.path.selector.losses();
        emit.skip(
            "odometry pose is no rigid transform",
            self.skipped_poses + losses.not_finite,
        );
        emit.skip("odometry stamp repeats", losses.out_of_order);
        emit.skip("odometry jumped", losses.jumps);
        emit.rows(keyframes)
    }
}

impl Session {
    /// On the first row: which session this is, and so which frames are its own.
    fn begin(&mut self, row: &OdometryPose, emit: &mut Emit<'_>) {
        if self.name.is_some() {
            return;
        }
        let own = |frame: &Frame| frame.site == row.site && frame.session == row.session;
        let frames = std::mem::take(&mut self.frames)
            .into_iter()
            .filter(own)
            .collect();
        self.sets = FrameSets::new(frames, self.max_gap_ns, emit);
        self.name = Some((row.site.clone(), row.session.clone()));
    }

    fn drive(&mut self, stamp: i64, pose: &Pose) {
        if self.previous.is_some_and(|(previous, _)| stamp <= previous) {
            // Counted by the selector; it cannot place a frame set.
            self.path.push(stamp, pose);
            return;
        }
        let jumped = self.path.push(stamp, pose);
        let from = self.previous.filter(|_| !jumped);
        self.sets.place(
            from.as_ref().map(|(stamp, pose)| (*stamp, pose)),
            (stamp, pose),
        );
        self.previous = Some((stamp, *pose));
    }

    fn give(&mut self, finished: bool, keyframes: &mut Vec<Keyframe>) {
        while let Some(mut keyframe) = self.matcher.next(&mut self.path, &mut self.sets, finished) {
            if let Some((site, session)) = &self.name {
                keyframe.site.clone_from(site);
                keyframe.session.clone_from(session);
            }
            keyframes.push(keyframe);
        }
    }
}

/// A place of the path where a keyframe is due.
#[derive(Clone, Copy)]
struct Due {
    stamp: i64,
    pose: Pose,
    distance_m: f64,
}

/// The driven path, as due points that no frame set has served yet.
struct Path {
    selector: KeyframeSelector,
    run: u32,
    /// Path driven in the runs before this one.
    before_run_m: f64,
    due: VecDeque<Due>,
    last_m: f64,
}

impl Path {
    /// Whether this pose lies beyond a jump.
    fn push(&mut self, stamp: i64, pose: &Pose) -> bool {
        let before = self.run;
        for found in self.selector.push(stamp, pose) {
            if found.run != self.run {
                self.run = found.run;
                self.before_run_m = self.last_m;
            }
            self.last_m = self.before_run_m + found.path_m;
            self.due.push_back(Due {
                stamp: found.stamp,
                pose: found.odom_from_vehicle,
                distance_m: self.last_m,
            });
        }
        self.run != before
    }

    /// Driven path at a pose: that of the last due point before it, and the straight line from there.
    fn distance_m(&self, stamp: i64, pose: &Pose) -> f64 {
        let before = self.due.iter().take_while(|due| due.stamp <= stamp).last();
        before.map_or(0.0, |due| {
            due.distance_m + (pose.translation - due.pose.translation).norm()
        })
    }
}

/// The images of all cameras at one time.
struct FrameSet {
    stamp: i64,
    images: Vec<KeyframeImage>,
}

/// A session's frame sets: those that odometry has passed have a pose.
#[derive(Default)]
struct FrameSets {
    placed: VecDeque<(FrameSet, Pose)>,
    ahead: VecDeque<FrameSet>,
}

impl FrameSets {
    fn new(mut frames: Vec<Frame>, max_gap_ns: i64, emit: &mut Emit<'_>) -> Self {
        frames.sort_by(|a, b| {
            (a.stamp, &a.camera, &a.topic, a.log_time)
                .cmp(&(b.stamp, &b.camera, &b.topic, b.log_time))
        });
        let all = frames.len();
        frames.dedup_by(|b, a| (a.stamp, &a.camera) == (b.stamp, &b.camera));
        emit.skip(
            "second frame of one camera with one stamp",
            (all - frames.len()) as u64,
        );
        let mut ahead: VecDeque<FrameSet> = VecDeque::new();
        for Frame {
            stamp,
            camera,
            image,
            ..
        } in frames
        {
            let image = KeyframeImage {
                camera,
                stamp,
                image,
            };
            match ahead.back_mut() {
                Some(set) if set.takes(&image, max_gap_ns) => set.images.push(image),
                _ => ahead.push_back(FrameSet {
                    stamp: stamp.0,
                    images: vec![image],
                }),
            }
        }
        Self {
            placed: VecDeque::new(),
            ahead,
        }
    }

    /// Gives a pose to the frame sets up to `to`; those that lie before `from`, or before `to` where there is no
    /// path between the two, have none and are dropped.
    fn place(&mut self, from: Option<(i64, &Pose)>, to: (i64, &Pose)) {
        while let Some(set) = self.ahead.pop_front_if(|set| set.stamp <= to.0) {
            let from = from
                .filter(|from| from.0 < set.stamp)
                .or((set.stamp == to.0).then_some(to));
            if let Some(from) = from {
                let pose = Pose::at_stamp(set.stamp, from, to);
                self.placed.push_back((set, pose));
            }
        }
    }
}

impl FrameSet {
    fn takes(&self, image: &KeyframeImage, max_gap_ns: i64) -> bool {
        image.stamp.0.saturating_sub(self.stamp) <= max_gap_ns
            && self.images.iter().all(|other| other.camera != image.camera)
    }
}

/// Brings due points and frame sets together.
struct Matcher {
    max_wait_ns: i64,
    last: Option<i64>,
    given: u32,
}

impl Matcher {
    /// The next keyframe that nothing which is still to come can change; once `finished`, any.
    fn next(&mut self, path: &mut Path, sets: &mut FrameSets, finished: bool) -> Option<Keyframe> {
        loop {
            let due = *path.due.front()?;
            if self.last.is_some_and(|last| due.stamp <= last) {
                path.due.pop_front();
                continue;
            }
            while sets
                .placed
                .pop_front_if(|(set, _)| set.stamp < due.stamp)
                .is_some()
            {}
            let in_time = |set: &FrameSet| set.stamp.saturating_sub(due.stamp) <= self.max_wait_ns;
            if sets.placed.is_empty() && !finished && sets.ahead.front().is_some_and(in_time) {
                return None;
            }
            let served = sets.placed.pop_front_if(|(set, _)| in_time(set));
            let (stamp, pose, distance_m, mut images) = match served {
                Some((set, pose)) => (
                    set.stamp,
                    pose,
                    path.distance_m(set.stamp, &pose),
                    set.images,
                ),
                None => (due.stamp, due.pose, due.distance_m, Vec::new()),
            };
            images.sort_by(|a, b| a.camera.cmp(&b.camera));
            path.due.pop_front();
            return Some(self.keyframe(stamp, &pose, distance_m, images));
        }
    }

    fn keyframe(
        &mut self,
        stamp: i64,
        pose: &Pose,
        distance_m: f64,
        images: Vec<KeyframeImage>,
    ) -> Keyframe {
        let keyframe = self.given;
        self.given = self.given.saturating_add(1);
        self.last = Some(stamp);
        Keyframe {
            site: String::new(),
            session: String::new(),
            stamp: Stamp(stamp),
            keyframe,
            distance_m,
            odom_from_vehicle: evermap_schemas::Pose::from_array(pose.to_array()),
            images,
        }
    }
}
