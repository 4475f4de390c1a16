#![doc = include_str!("temporal_scores.md")]

use std::collections::VecDeque;

use evermap_algorithms::geometry::pose::Pose;
use evermap_algorithms::geometry::trajectory::{MAX_GAP_NS, StampedPose, pose_at};
use evermap_algorithms::semantic_map::temporal_votes::{DepthView, ScoredView, VoteOptions, Voter};
use evermap_contract::{
    Emit, Fault, Key, Operator, Pixels, Port, Reach, Reason, Sides, Stream, Work,
};
use evermap_schemas::Bytes;
use evermap_schemas::layers::{ClassScores, ScoredFrame};
use evermap_schemas::roles::OdometryPose;
use evermap_vision::{Grey16, decode_depth};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::inputs::pixels::scores;
use crate::inputs::rig::{self, Rig, VehicleFrame, frame};

/// See the module's page.
pub struct TemporalScores;

/// How votes are gathered.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct TemporalScoresParams {
    /// Views that vote, the view itself included: an odd number. Fewer vote at the ends of a session.
    #[schemars(range(min = 1, max = 101))]
    pub views: u32,
    /// Metres per unit of the depth images.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub depth_scale_m: f64,
    /// What votes.
    #[serde(flatten)]
    pub votes: VoteOptions,
    /// The frame that odometry is of.
    #[serde(flatten)]
    pub vehicle: VehicleFrame,
}

impl Default for TemporalScoresParams {
    fn default() -> Self {
        Self {
            views: 7,
            depth_scale_m: 0.001,
            votes: VoteOptions::default(),
            vehicle: VehicleFrame::default(),
        }
    }
}

impl Operator for TemporalScores {
    const NAME: &'static str = "temporal_scores";
    const VERSION: u32 = 2;
    const PAGE: &'static str = include_str!("temporal_scores.md");
    type Params = TemporalScoresParams;
    type Output = ClassScores;

    fn work() -> Work<Self::Params> {
        let mut sides = vec![Port::session::<OdometryPose>("odometry")];
        sides.extend(rig::ports(Reach::Session));
        let scored = Port::session::<ScoredFrame>("scores").pixels("image");
        Work::stream::<Window>(scored, Key::CAMERA, sides)
    }

    fn check(params: &Self::Params) -> Result<(), Fault> {
        match params.views % 2 {
            1 => Ok(()),
            _ => Err(Fault::user(format!(
                "expected an odd number of `views`, found {}",
                params.views
            ))),
        }
    }
}

/// A view as far as it is known.
struct BufferedView {
    scores: ClassScores,
    depth: Option<Grey16>,
    /// Where it was taken from, and by what camera.
    posed: Option<(Pose, Voter)>,
}

/// Views of one camera, as many as vote on one.
struct Window {
    params: TemporalScoresParams,
    rig: Rig,
    odometry: Vec<StampedPose>,
    views: VecDeque<BufferedView>,
    /// Which of them is to be voted on next.
    next: usize,
}

impl Stream for Window {
    type Params = TemporalScoresParams;
    type Row = ClassScores;

    fn open(params: &TemporalScoresParams, sides: &Sides) -> Result<Self, Fault> {
        let odometry = sides.rows::<OdometryPose>("odometry")?;
        let odometry = odometry.into_iter().filter_map(|row| {
            let pose = Pose::from_array(row.odom_from_vehicle.to_array()).ok()?;
            let stamp_ns = row.stamp.0;
            Some(StampedPose { stamp_ns, pose })
        });
        let rig = rig::sessions(sides)?.into_values().next();
        Ok(Self {
            params: params.clone(),
            rig: rig.unwrap_or_default(),
            odometry: odometry.collect(),
            views: VecDeque::new(),
            next: 0,
        })
    }

    fn push(
        &mut self,
        rows: Vec<ClassScores>,
        pixels: &Pixels,
        emit: &mut Emit<'_>,
    ) -> Result<(), Fault> {
        for (index, scores) in rows.into_iter().enumerate() {
            match self.hold(scores, pixels.get(index), emit) {
                Ok(held) => self.views.push_back(held),
                Err(reason) => emit.skip(reason, 1),
            }
            while self.views.len() > self.next + self.reach() {
                self.vote(emit)?;
            }
        }
        Ok(())
    }

    fn close(mut self, emit: &mut Emit<'_>) -> Result<(), Fault> {
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
        row: ClassScores,
        bytes: Option<&[u8]>,
        emit: &mut Emit<'_>,
    ) -> Result<BufferedView, Reason> {
        scores(&row)?;
        let mut known = |reason: Reason| emit.skip(reason, 1);
        let depth = bytes.map(|bytes| depth(&row, bytes).map_err(&mut known));
        let depth = depth.and_then(Result::ok);
        let posed = self.pose(&row).map_err(&mut known).ok();
        Ok(BufferedView {
            scores: row,
            depth,
            posed,
        })
    }

    fn pose(&self, scores: &ClassScores) -> Result<(Pose, Voter), Reason> {
        let camera = frame(&scores.camera);
        let calibration = self.rig.calibration(camera, scores.stamp)?;
        let vehicle = self.params.vehicle.name();
        let vehicle_from_camera = self.rig.vehicle_from_camera(vehicle, calibration)?;
        let camera = rig::camera(calibration, [scores.width, scores.height])?;
        let odom_from_vehicle = pose_at(&self.odometry, scores.stamp.0, MAX_GAP_NS)
            .ok_or("no odometry at the view's instant")?;
        let odom_from_camera = odom_from_vehicle.compose(&vehicle_from_camera);
        Ok((odom_from_camera, Voter::new(&camera, &self.params.votes)))
    }

    /// Emits the next view with its neighbours' votes, and forgets what no later one needs.
    fn vote(&mut self, emit: &mut Emit<'_>) -> Result<(), Fault> {
        let first = self.next.saturating_sub(self.reach());
        let end = (self.next + self.reach() + 1).min(self.views.len());
        let neighbours: Vec<ScoredView<'_>> = (first..end)
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
    fn seen<'a>(&self, held: &'a BufferedView) -> Option<ScoredView<'a>> {
        let (odom_from_camera, _) = held.posed.as_ref()?;
        let depth = held.depth.as_ref()?;
        let size = [depth.width, depth.height];
        Some(ScoredView {
            scores: scores(&held.scores).ok()?,
            depth: DepthView::new(size, &depth.data, self.params.depth_scale_m),
            odom_from_camera: *odom_from_camera,
        })
    }
}

fn depth(scores: &ClassScores, bytes: &[u8]) -> Result<Grey16, Reason> {
    let depth = decode_depth(bytes).map_err(|_| "depth image does not decode")?;
    if [depth.width, depth.height] != [scores.width, scores.height] {
        return Err("depth image has another size than its scores".into());
    }
    Ok(depth)
}
