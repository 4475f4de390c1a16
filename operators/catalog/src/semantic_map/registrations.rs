#![doc = include_str!("registrations.md")]

use evermap_algorithms::geometry::pose;
use evermap_algorithms::semantic_map::stable::registration::{
    Options, Pyramid, Registration, State, register,
};
use evermap_contract::{Emit, Fault, Key, Operator, Port, Reason, Sides, Work};
use evermap_schemas::Pose;
use evermap_schemas::layers::{LabelImage, Relocation, SphereView, ViewRegistration};
use nalgebra::{UnitQuaternion, Vector3};
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::inputs::spheres::{MovingClasses, Spheres, ViewKey, covariance, sigma_m};

/// See the module's page.
pub struct Registrations;

/// How views are registered.
#[derive(Debug, Clone, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct RegistrationsParams {
    /// How two panoramas are laid onto each other.
    #[serde(flatten)]
    pub options: Options,
    /// What moves: its range has no say.
    #[serde(flatten)]
    pub classes: MovingClasses,
}

impl Operator for Registrations {
    const NAME: &'static str = "registrations";
    const VERSION: u32 = 5;
    const PAGE: &'static str = include_str!("registrations.md");
    type Params = RegistrationsParams;
    type Output = ViewRegistration;

    fn work() -> Work<Self::Params> {
        let relocations = Port::session::<Relocation>("relocations");
        let sides = vec![
            Port::site::<SphereView>("spheres"),
            Port::site::<LabelImage>("label_images").optional(),
        ];
        Work::group(relocations, Key::CAMERA, sides, registrations)
    }
}

fn registrations(
    params: &RegistrationsParams,
    relocations: Vec<Relocation>,
    sides: Sides,
    emit: &mut Emit<'_>,
) -> Result<(), Fault> {
    let site = Site {
        params,
        spheres: Spheres::new(&sides)?,
    };
    let views: Vec<&[Relocation]> = relocations.chunk_by(|a, b| a.stamp == b.stamp).collect();
    let made = views.into_par_iter().map(|view| site.of_view(view));
    emit.made(made.collect())
}

struct Site<'a> {
    params: &'a RegistrationsParams,
    spheres: Spheres,
}

impl Site<'_> {
    /// A view's registrations with all its candidates, the best first.
    fn of_view(&self, candidates: &[Relocation]) -> Result<Vec<ViewRegistration>, Reason> {
        let first = &candidates[0];
        let key = |row: &Relocation| (row.session.clone(), row.camera.clone(), row.stamp);
        let view = self.pyramid(&key(first))?;
        let mut found: Vec<(Option<Registration>, &Relocation)> = candidates
            .iter()
            .map(|row| (self.with(row, &view), row))
            .collect();
        found.sort_by(|(a, first), (b, second)| {
            order(b.as_ref())
                .partial_cmp(&order(a.as_ref()))
                .unwrap_or(std::cmp::Ordering::Equal)
                .then(first.rank.cmp(&second.rank))
        });
        let rows = found.into_iter().zip(0..);
        Ok(rows
            .map(|((found, row), rank)| line(row, rank, found.as_ref()))
            .collect())
    }

    /// `None` where the map's view has no panorama, or hardly any range.
    fn with(&self, row: &Relocation, view: &Pyramid) -> Option<Registration> {
        let key = (
            row.map_session.clone(),
            row.map_camera.clone(),
            row.map_stamp,
        );
        let map_view = self.pyramid(&key).ok()?;
        register(&map_view, view, guess(row).as_ref(), &self.params.options)
    }

    fn pyramid(&self, view: &ViewKey) -> Result<Pyramid, Reason> {
        let (classes, options) = (&self.params.classes, &self.params.options);
        self.spheres.pyramid(view, classes, options)
    }
}

/// The heading that relocation tells, at the map's view; `None` where it tells none.
fn guess(row: &Relocation) -> Option<pose::Pose> {
    // Counter-clockwise seen from above; the optical frame's y looks down.
    let turn = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), -row.yaw_rad?);
    Some(pose::Pose::new(Vector3::zeros(), turn))
}

/// The larger the better: whether it converged, then the share of points that fit.
fn order(found: Option<&Registration>) -> (bool, f64) {
    found.map_or((false, -1.0), |found| {
        (
            found.state == State::Converged,
            found.overlap * found.inliers,
        )
    })
}

fn line(row: &Relocation, rank: u32, found: Option<&Registration>) -> ViewRegistration {
    ViewRegistration {
        site: row.site.clone(),
        session: row.session.clone(),
        stamp: row.stamp,
        camera: row.camera.clone(),
        rank,
        relocation_rank: row.rank,
        map_session: row.map_session.clone(),
        map_stamp: row.map_stamp,
        map_camera: row.map_camera.clone(),
        state: found
            .map_or("no range", |found| found.state.name())
            .to_owned(),
        map_view_from_view: found
            .map(|found| Pose::from_array(found.reference_from_other.to_array())),
        covariance: found.map_or_else(Vec::new, covariance),
        sigma_m: found.map(sigma_m),
        overlap: found.map_or(0.0, |found| found.overlap),
        inliers: found.map_or(0.0, |found| found.inliers),
        correlation: found.and_then(|found| found.correlation),
        gain: found.map(|found| found.brightness[0]),
    }
}
