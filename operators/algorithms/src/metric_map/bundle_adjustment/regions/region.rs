//! What is done with one region: the visits.

use nalgebra::Vector3;

use super::super::blocks::Blocks;
use super::super::decomposition;
use super::super::elimination::{Layout, fill};
use super::super::equations::Equations;
use super::super::schur::{Bundle, ordered};
use super::super::vehicle::Vehicles;
use super::super::{Keyframe, Options, SessionState};
use super::condensed::{BlockIndex, Condensed, Interior, condense};
use super::subproblem::Subproblem;
use crate::solving::least_squares::{SystemError, absolute_max};

/// A part of the problem at its estimate, and what is kept of a step.
pub(super) struct Region {
    pub(super) part: Subproblem,
    interior: Option<Interior<6>>,
    trial: Option<Estimate>,
}

struct Estimate {
    poses: Vec<Keyframe>,
    sessions: Vec<SessionState>,
    landmarks: Vec<Vector3<f64>>,
}

/// What a region says of an estimate.
pub(super) struct Evaluation {
    pub(super) cost: f64,
    /// Largest entry of the gradient of landmarks, and of what it has alone.
    pub(super) gradient_max: f64,
    /// Its part of the gradient of what it shares.
    pub(super) gradient: Vec<[f64; 6]>,
    /// Its part of the diagonal there.
    pub(super) diagonal: Vec<[f64; 6]>,
}

/// What a region says of a step.
pub(super) struct Moved {
    /// Of landmarks, and of what it has alone.
    pub(super) predicted_decrease: f64,
    pub(super) moved: f64,
    /// At the trial.
    pub(super) evaluation: Evaluation,
}

/// Why there is no step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Failed {
    NotPositive,
    System(SystemError),
}

impl Region {
    pub(super) fn new(part: Subproblem) -> Self {
        Self {
            part,
            interior: None,
            trial: None,
        }
    }

    /// Cost and gradient at the estimate.
    pub(super) fn evaluate(&self, options: &Options) -> Evaluation {
        evaluate(&self.part, &mut equations(&self.part, options))
    }

    /// Eliminates landmarks, then what the region has alone, and keeps what gives their steps.
    pub(super) fn eliminate(
        &mut self,
        options: &Options,
        damping: f64,
    ) -> Result<Condensed<6>, Failed> {
        // The last one's goes first.
        self.interior = None;
        let part = &self.part;
        let mut equations = equations(part, options);
        equations.linearise();
        let mut added = equations.eliminate(damping);
        // What is shared is damped once, where all its parts are together.
        for (added, index) in added.iter_mut().zip(&part.indices) {
            if matches!(index, BlockIndex::Shared(_)) {
                *added = [0.0; 6];
            }
        }
        let pairs = equations.layout.meeting(&equations.terms);
        let mut matrix = Blocks::new(part.indices.len(), &pairs);
        let own = (&equations.terms, added.as_slice());
        fill(&mut matrix, &equations.layout, &equations.sighted, own);
        let right = std::mem::take(&mut equations.steps);
        drop(equations);
        let (interior, left) = condense(&part.indices, &matrix, &right)?;
        self.interior = Some(interior);
        Ok(left)
    }

    /// The trial, from the boundary's steps. After [`Self::eliminate`] with the same damping.
    pub(super) fn substitute(
        &mut self,
        options: &Options,
        boundary: &[[f64; 6]],
        damping: f64,
    ) -> Moved {
        let part = &self.part;
        let shared = part.shared.iter().map(|at| boundary[*at as usize]);
        let shared: Vec<[f64; 6]> = shared.collect();
        let own = self.interior.take().map(|interior| interior.steps(&shared));
        let own = own.unwrap_or_default();
        let mut equations = equations(part, options);
        equations.linearise();
        equations.eliminate(damping);
        for (step, index) in equations.steps.iter_mut().zip(&part.indices) {
            *step = match index {
                BlockIndex::Own(at) => own[*at as usize],
                BlockIndex::Shared(at) => shared[*at as usize],
            };
        }
        equations.substitute();
        let predicted_decrease = equations.predicted_decrease(part.own(), damping);
        let moved = equations.bundle.moved(&equations.steps);
        equations.accept();
        let evaluation = evaluate(part, &mut equations);
        let (poses, sessions) = equations.bundle.into_estimate();
        let landmarks = equations.landmarks.into_iter().map(Vector3::from);
        self.trial = Some(Estimate {
            poses,
            sessions,
            landmarks: landmarks.collect(),
        });
        Moved {
            predicted_decrease,
            moved,
            evaluation,
        }
    }

    /// The estimate becomes the trial.
    pub(super) fn accept(&mut self) {
        if let Some(trial) = self.trial.take() {
            let problem = &mut self.part.problem;
            problem.poses = trial.poses;
            problem.sessions = trial.sessions;
            problem.landmarks = trial.landmarks;
        }
    }
}

fn equations<'a>(part: &'a Subproblem, options: &'a Options) -> Equations<6, Vehicles<'a>> {
    let taken = decomposition::take(&part.problem, options, part.sessions);
    let identity: Vec<u32> = (0..taken.blocks as u32).collect();
    let layout = Layout::new(taken.landmarks.len(), taken.sights, &identity);
    let terms = Blocks::new(taken.blocks, &ordered(&taken.pairs));
    Equations::new(taken.bundle, taken.landmarks, layout, terms)
}

fn evaluate(part: &Subproblem, equations: &mut Equations<6, Vehicles<'_>>) -> Evaluation {
    let cost = equations.linearise();
    let own = part.own().flat_map(|block| &equations.gradient[block]);
    let gradient_max = absolute_max(own.chain(equations.landmark_gradient()));
    let mut evaluation = Evaluation {
        cost,
        gradient_max,
        gradient: vec![[0.0; 6]; part.shared.len()],
        diagonal: vec![[0.0; 6]; part.shared.len()],
    };
    for (block, index) in part.indices.iter().enumerate() {
        if let BlockIndex::Shared(at) = index {
            evaluation.gradient[*at as usize] = equations.gradient[block];
            evaluation.diagonal[*at as usize] = equations.diagonal[block];
        }
    }
    evaluation
}
