#![doc = include_str!("landmarks.md")]

use evermap_algorithms::geometry::pose::Pose;
use evermap_algorithms::metric_map::association::{FeatureRef, describe, descriptors_of};
use evermap_algorithms::metric_map::features::FeatureNoise;
use evermap_contract::{Emit, Fault, Key, Operator, Port, Reach, Sides, Work};
use evermap_schemas::layers::{AdjustedPose, Landmark, Sighting, Sources};
use evermap_schemas::{Bytes, Wkb};
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::inputs::rig::{self, OfVehicle};
use crate::inputs::survey::{NewDrives, Survey};

/// See the module's page.
pub struct Landmarks;

/// What landmarks need to know.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct LandmarkOptions {
    /// How exactly features lie; scales `sigma_m`.
    #[serde(flatten)]
    pub features: FeatureNoise,
    /// Descriptors kept of a landmark, at most: those that stand for most sightings.
    #[schemars(range(min = 1))]
    pub looks: usize,
}

impl Default for LandmarkOptions {
    fn default() -> Self {
        Self {
            features: FeatureNoise::default(),
            looks: 4,
        }
    }
}

impl Operator for Landmarks {
    const NAME: &'static str = "landmarks";
    const VERSION: u32 = 5;
    const PAGE: &'static str = include_str!("landmarks.md");
    type Params = OfVehicle<LandmarkOptions>;
    type Output = Landmark;

    fn work() -> Work<Self::Params> {
        let poses = Port::site::<AdjustedPose>("poses");
        Work::group(poses, Key::SITE, rig::ports(Reach::Site).into(), landmarks)
    }
}

fn landmarks(
    params: &OfVehicle<LandmarkOptions>,
    poses: Vec<AdjustedPose>,
    sides: Sides,
    emit: &mut Emit<'_>,
) -> Result<(), Fault> {
    let site = poses[0].site.clone();
    let new = NewDrives::default();
    let survey = Survey::new(&poses, new, &sides, &params.vehicle, emit)?;
    let seen: Vec<_> = survey.landmarks(&poses).into_iter().collect();
    let all = seen.len();
    let maker = Maker {
        cameras: survey.scene.map_from_cameras(&survey.poses),
        survey: &survey,
        options: &params.options,
        site: &site,
    };
    let found: Vec<Option<Landmark>> = seen
        .into_par_iter()
        .map(|(landmark, features)| maker.landmark(landmark, features))
        .collect::<Result<_, Fault>>()?;
    let found: Vec<Landmark> = found.into_iter().flatten().collect();
    emit.skip(
        "landmark cannot be triangulated",
        (all - found.len()) as u64,
    );
    emit.rows(found)
}

struct Maker<'a> {
    survey: &'a Survey,
    cameras: Vec<Pose>,
    options: &'a LandmarkOptions,
    site: &'a str,
}

impl Maker<'_> {
    fn landmark(
        &self,
        landmark: u32,
        mut features: Vec<FeatureRef>,
    ) -> Result<Option<Landmark>, Fault> {
        features.sort_unstable();
        features.dedup();
        let looks = self.options.looks;
        let seen = descriptors_of::<Fault>(self.survey, &features)?;
        let found = describe(&self.survey.scene, &self.cameras, &features, &seen, looks);
        let Some(found) = found else {
            return Ok(None);
        };
        let point: [f64; 3] = found.place.point.into();
        let descriptors = found.descriptors.iter().flat_map(|look| look.0);
        Ok(Some(Landmark {
            site: self.site.to_owned(),
            landmark,
            x: point[0],
            y: point[1],
            z: point[2],
            sigma_m: found.place.sigma_m() * self.options.features.sigma_px,
            parallax_rad: found.place.parallax_rad,
            rms_px: found.rms_px,
            view: found.view.into(),
            view_cos: found.view_cos,
            near_m: found.near_m,
            far_m: found.far_m,
            descriptors: Bytes(descriptors.collect()),
            sightings: self.sightings(&features),
            sources: self.sources(&features),
            geometry: Wkb::point(point),
        }))
    }

    fn sightings(&self, features: &[FeatureRef]) -> Vec<Sighting> {
        let sighting = |feature: &FeatureRef| {
            let scene = &self.survey.scene;
            let keyframe =
                &self.survey.keyframes[scene.images[feature.image as usize].keyframe as usize];
            Sighting {
                session: keyframe.session.clone(),
                keyframe: keyframe.number,
                camera: scene.camera(feature.image).name.clone(),
                feature: self.survey.number(*feature),
            }
        };
        let mut sightings: Vec<Sighting> = features.iter().map(sighting).collect();
        sightings.sort_by(|a, b| {
            (&a.session, a.keyframe, &a.camera).cmp(&(&b.session, b.keyframe, &b.camera))
        });
        sightings
    }

    fn sources(&self, features: &[FeatureRef]) -> Vec<evermap_schemas::layers::Source> {
        let mut sources = Sources::default();
        for feature in features {
            let image = &self.survey.scene.images[feature.image as usize];
            let keyframe = &self.survey.keyframes[image.keyframe as usize];
            sources.add(&keyframe.session, keyframe.stamp, keyframe.stamp);
        }
        sources.into_rows()
    }
}
