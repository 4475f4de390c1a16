#![doc = include_str!("temporal_scores.md")]

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

use arrow::array::{Array, RecordBatch};
use evermap_algorithms::semantic_map::class_scores::ScoresView;
use evermap_algorithms::geometry::pose::Pose;
use evermap_algorithms::semantic_map::temporal_votes::{DepthView, View, VoteOptions, Voter};
use evermap_algorithms::geometry::trajectory::{StampedPose, pose_at};
use evermap_contract::{Emit, Fault, Grain, Group, GroupKernel, Kernel, Operator, Port, Sides};
use evermap_schemas::layers::{ClassScores, ScoredFrame};
use evermap_schemas::roles::{Calibration, OdometryPose, Transform};
use evermap_schemas::{Bytes, rows};
use evermap_vision::{Grey16, decode_depth};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::inputs::images::images;
use crate::inputs::rig::{self, Reason, Rig, SessionName, frame};

/// See the module's page.
pub struct TemporalScores;

/// How votes are gathered.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct TemporalScoresParams {
    /// Views that vote, the view itself included: an odd number.
    pub views: u32,
    /// Metres per unit of the depth images.
    pub depth_scale_m: f64,
    /// Inverse depths that differ by no more than this are of the same thing (1/m).
    pub same_per_m: f64,
    /// The frame that odometry is of.
    pub vehicle_frame: String,
}

impl Default for TemporalScoresParams {
    fn default() -> Self {
        Self {
            views: 7,
            depth_scale_m: 0.001,
            same_per_m: VoteOptions::default().same_per_m,
            vehicle_frame: "base_link".to_owned(),
        }
    }
}

/// The most views: all of them are held in memory.
const MOST_VIEWS: u32 = 101;

/// Odometry poses farther apart than this say nothing about what is between them.
const MAX_GAP_NS: i64 = 1_000_000_000;

impl Operator for TemporalScores {
    const NAME: &'static str = "temporal_scores";
    const VERSION: u32 = 1;
    const PAGE: &'static str = include_str!("temporal_scores.md");
    type Params = TemporalScoresParams;
    type Output = ClassScores;

    fn ports() -> Vec<Port> {
        let camera = Grain::Key {
            columns: &["site", "session", "camera"],
            order: &["stamp"],
        };
        vec![
            Port::of::<ScoredFrame>("scores", camera).with_pixels("image"),
            Port::of::<OdometryPose>("odometry", Grain::SESSION),
            Port::of::<Calibration>("calibration", Grain::SESSION),
            Port::of::<Transform>("transforms", Grain::SESSION),
        ]
    }

    fn kernel(params: TemporalScoresParams) -> Result<Kernel, Fault> {
        if params.views.is_multiple_of(2) || params.views > MOST_VIEWS {
            return Err(Fault::user(format!(
                "expected an odd number of views up to {MOST_VIEWS}, found {}",
                params.views
            )));
        }
        let above_zero = [
            ("depth_scale_m", params.depth_scale_m),
            ("same_per_m", params.same_per_m),
        ];
        for (name, found) in above_zero {
            if !(found > 0.0 && found.is_finite()) {
                return Err(Fault::user(format!(
                    "expected {name} above 0, found {found}"
                )));
            }
        }
        Ok(Kernel::Group(Box::new(Opener {
            params: Arc::new(params),
        })))
    }
}

struct Opener {
    params: Arc<TemporalScoresParams>,
}

impl GroupKernel for Opener {
    fn open(&self, sides: &Sides) -> Result<Box<dyn Group>, Fault> {
        let mut odometry: BTreeMap<SessionName, Vec<StampedPose>> = BTreeMap::new();
        for row in sides.rows::<OdometryPose>("odometry")? {
            if let Ok(pose) = Pose::from_array(row.odom_from_vehicle.to_array()) {
                let stamp_ns = row.stamp.0;
                let session = odometry.entry((row.site, row.session)).or_default();
                session.push(StampedPose { stamp_ns, pose });
            }
        }
        for poses in odometry.values_mut() {
            poses.sort_by_key(|pose| pose.stamp_ns);
        }
        Ok(Box::new(Window {
            params: Arc::clone(&self.params),
            rigs: rig::sessions(sides)?,
            odometry,
            views: VecDeque::new(),
            next: 0,
        }))
    }
}

/// A view as far as it is known.
struct Held {
    scores: ClassScores,
    depth: Option<Grey16>,
    /// Where it was taken from, and by what camera.
    posed: Option<(Pose, Voter)>,
}

/// Views of one camera, as many as vote on one.
struct Window {
    params: Arc<TemporalScoresParams>,
    rigs: BTreeMap<SessionName, Rig>,
    odometry: BTreeMap<SessionName, Vec<StampedPose>>,
    views: VecDeque<Held>,
    /// Which of them is to be voted on next.
    next: usize,
}

impl Group for Window {
    fn push(&mut self, batch: &RecordBatch, emit: &mut Emit<'_>) -> Result<(), Fault> {
        let images = images(batch, "scores")?;
        for (index, scores) in rows::<ClassScores>(batch)?.into_iter().enumerate() {
            let bytes = images.is_valid(index).then(|| images.value(index));
            match self.hold(scores, bytes, emit) {
                Ok(held) => self.views.push_back(held),
                Err(reason) => emit.skip(reason, 1),
            }
            while self.views.len() > self.next + self.reach() {
                self.vote(emit)?;
            }
        }
        Ok(())
    }

    fn close(&mut self, emit: &mut Emit<'_>) -> Result<(), Fault> {
        while self.next < self.views.len() {
            self.vote(emit)?;
        }
        Ok(())
    }
}

impl Window {
    /// Views to either side.
    fn reach(&self) -> usize {
        (self.params.views / 2) as usize
    }

    /// Scores that make no sense are refused; a view of which only depth or place are not known stays by itself.
    fn hold(
        &self,
        scores: ClassScores,
        bytes: Option<&[u8]>,
        emit: &mut Emit<'_>,
    ) -> Result<Held, Reason> {
        view(&scores).ok_or("scores do not have the size that they claim")?;
        let mut known = |reason: Reason| emit.skip(reason, 1);
        let depth = depth(&scores, bytes).map_err(&mut known).ok();
        let posed = self.pose(&scores).map_err(&mut known).ok();
        Ok(Held {
            scores,
            depth,
            posed,
        })
    }

    fn pose(&self, scores: &ClassScores) -> Result<(Pose, Voter), Reason> {
        let session = (scores.site.clone(), scores.session.clone());
        let rig = self.rigs.get(&session).ok_or("camera has no calibration")?;
        let camera = frame(&scores.camera);
        let calibration = rig
            .calibration(camera, scores.stamp)
            .ok_or("camera has no calibration")?;
        let vehicle_from_camera = rig
            .vehicle_from_camera(frame(&self.params.vehicle_frame), camera)
            .ok_or("no fixed transforms from camera to vehicle")?;
        let camera = rig::camera(calibration, [scores.width, scores.height])?;
        let odom_from_vehicle = self
            .odometry
            .get(&session)
            .and_then(|poses| pose_at(poses, scores.stamp.0, MAX_GAP_NS))
            .ok_or("no odometry at the view's instant")?;
        let options = VoteOptions {
            same_per_m: self.params.same_per_m,
        };
        let odom_from_camera = odom_from_vehicle.compose(&vehicle_from_camera);
        Ok((odom_from_camera, Voter::new(&camera, &options)))
    }

    /// Emits the next view with its neighbours' votes, and forgets what no later one needs.
    fn vote(&mut self, emit: &mut Emit<'_>) -> Result<(), Fault> {
        let first = self.next.saturating_sub(self.reach());
        let end = (self.next + self.reach() + 1).min(self.views.len());
        let neighbours: Vec<View<'_>> = (first..end)
            .filter(|index| *index != self.next)
            .filter_map(|index| self.seen(&self.views[index]))
            .collect();
        let own = &self.views[self.next];
        let mut row = own.scores.clone();
        if let (Some((_, voter)), Some(seen)) = (&own.posed, self.seen(own)) {
            row.probabilities = Bytes(voter.vote(&seen, &neighbours));
        }
        self.next += 1;
        if self.next > self.reach() {
            self.views.pop_front();
            self.next -= 1;
        }
        emit.rows(vec![row])
    }

    /// A view that can be projected.
    fn seen<'a>(&self, held: &'a Held) -> Option<View<'a>> {
        let (odom_from_camera, _) = held.posed.as_ref()?;
        let depth = held.depth.as_ref()?;
        let size = [depth.width, depth.height];
        Some(View {
            scores: view(&held.scores)?,
            depth: DepthView::new(size, &depth.data, self.params.depth_scale_m),
            odom_from_camera: *odom_from_camera,
        })
    }
}

fn view(scores: &ClassScores) -> Option<ScoresView<'_>> {
    let size = [scores.width, scores.height];
    ScoresView::new(
        size,
        scores.stride_px,
        scores.classes.len(),
        &scores.probabilities.0,
    )
}

fn depth(scores: &ClassScores, bytes: Option<&[u8]>) -> Result<Grey16, Reason> {
    let bytes = bytes.ok_or("depth image is missing")?;
    let depth = decode_depth(bytes).map_err(|_| "depth image does not decode")?;
    if [depth.width, depth.height] != [scores.width, scores.height] {
        return Err("depth image has another size than its scores");
    }
    Ok(depth)
}
