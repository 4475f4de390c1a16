#![doc = include_str!("view_links.md")]

use evermap_algorithms::geometry::pose;
use evermap_algorithms::semantic_map::stable::registration::{Options, Pyramid, State, register};
use evermap_contract::{Emit, Fault, Key, Operator, Port, Reason, Sides, Work};
use evermap_schemas::Pose;
use evermap_schemas::layers::{LabelImage, SphereView, ViewLink, ViewRegistration};
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::inputs::spheres::{MovingClasses, Spheres, ViewKey, covariance, sigma_m};

/// See the module's page.
pub struct ViewLinks;

/// How views of one drive are linked.
#[derive(Debug, Clone, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct ViewLinksParams {
    /// How two panoramas are laid onto each other.
    #[serde(flatten)]
    pub options: Options,
    /// What moves: its range has no say.
    #[serde(flatten)]
    pub classes: MovingClasses,
}

impl Operator for ViewLinks {
    const NAME: &'static str = "view_links";
    const VERSION: u32 = 4;
    const PAGE: &'static str = include_str!("view_links.md");
    type Params = ViewLinksParams;
    type Output = ViewLink;

    fn work() -> Work<Self::Params> {
        let spheres = Port::session::<SphereView>("spheres");
        let sides = vec![
            Port::session::<ViewRegistration>("registrations").optional(),
            Port::session::<LabelImage>("label_images").optional(),
        ];
        Work::group(spheres, Key::CAMERA, sides, links)
    }
}

/// Views that are ready to be registered at a time.
const AT_ONCE: usize = 32;

fn links(
    params: &ViewLinksParams,
    rows: Vec<SphereView>,
    sides: Sides,
    emit: &mut Emit<'_>,
) -> Result<(), Fault> {
    let first = &rows[0];
    let (site, camera) = (first.site.clone(), first.camera.clone());
    let key = |row: &SphereView| (row.session.clone(), row.camera.clone(), row.stamp);
    let views: Vec<ViewKey> = rows.iter().map(key).collect();
    let spheres = Spheres::of(rows, &sides)?;
    let mut before: Option<(&ViewKey, Option<Pyramid>)> = None;
    for views in views.chunks(AT_ONCE) {
        let opened = views.par_iter().map(|view| {
            let pyramid = spheres.pyramid(view, &params.classes, &params.options);
            (view, pyramid)
        });
        let opened: Vec<(&ViewKey, Result<Pyramid, Reason>)> = opened.collect();
        let mut held: Vec<_> = before.take().into_iter().collect();
        for (view, pyramid) in opened {
            let pyramid = pyramid.map_err(|reason| emit.skip(reason, 1));
            held.push((view, pyramid.ok()));
        }
        let pairs = held.par_windows(2);
        let driven = pairs.filter_map(|pair| driven(&site, &pair[0], &pair[1], &params.options));
        emit.rows(driven.collect::<Vec<_>>())?;
        before = held.pop();
    }
    let registrations = sides.rows::<ViewRegistration>("registrations")?.into_iter();
    let of_camera = registrations.filter(|row| row.camera == camera);
    emit.rows(of_camera.filter_map(registered).collect::<Vec<_>>())
}

/// The link of a view with the one before it in its drive; `None` where they do not fit together.
fn driven(
    site: &str,
    (other, there): &(&ViewKey, Option<Pyramid>),
    (view, here): &(&ViewKey, Option<Pyramid>),
    options: &Options,
) -> Option<ViewLink> {
    let found = register(
        there.as_ref()?,
        here.as_ref()?,
        Some(&pose::Pose::identity()),
        options,
    )?;
    let ((session, camera, stamp), (other_session, other_camera, other_stamp)) = (view, other);
    (found.state == State::Converged).then(|| ViewLink {
        site: site.to_owned(),
        session: session.clone(),
        stamp: *stamp,
        camera: camera.clone(),
        kind: "driven".to_owned(),
        other_session: other_session.clone(),
        other_stamp: *other_stamp,
        other_camera: other_camera.clone(),
        other_view_from_view: Pose::from_array(found.reference_from_other.to_array()),
        covariance: covariance(&found),
        sigma_m: sigma_m(&found),
    })
}

/// A registration that converged, as a link.
fn registered(row: ViewRegistration) -> Option<ViewLink> {
    let converged = row.state == State::Converged.name();
    Some(ViewLink {
        other_view_from_view: row.map_view_from_view.filter(|_| converged)?,
        sigma_m: row.sigma_m?,
        site: row.site,
        session: row.session,
        stamp: row.stamp,
        camera: row.camera,
        kind: "registered".to_owned(),
        other_session: row.map_session,
        other_stamp: row.map_stamp,
        other_camera: row.map_camera,
        covariance: row.covariance,
    })
}
