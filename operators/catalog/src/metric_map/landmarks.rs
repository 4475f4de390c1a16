#![doc = include_str!("landmarks.md")]

use evermap_algorithms::geometry::pose::Pose;
use evermap_algorithms::metric_map::association::{
    Appearance, FeatureRef, LandmarkPoint, Sight, appearances, mean_direction, ray_residual_rad,
    triangulate,
};
use evermap_algorithms::metric_map::features::FeatureNoise;
use evermap_contract::{Emit, Fault, Key, Operator, Port, Sides, Work};
use evermap_schemas::layers::{AdjustedPose, Features, Keyframe, Landmark, Sighting, Sources};
use evermap_schemas::roles::{Calibration, Transform};
use evermap_schemas::{Bytes, Wkb};
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::inputs::rig::OfVehicle;
use crate::inputs::survey::Survey;

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
    const VERSION: u32 = 1;
    const PAGE: &'static str = include_str!("landmarks.md");
    type Params = OfVehicle<LandmarkOptions>;
    type Output = Landmark;

    fn work() -> Work<Self::Params> {
        let poses = Port::site::<AdjustedPose>("poses");
        let sides = vec![
            Port::site::<Features>("features"),
            Port::site::<Calibration>("calibration"),
            Port::site::<Transform>("transforms"),
        ];
        Work::group(poses, Key::SITE, sides, landmarks)
    }
}

fn landmarks(
    params: &OfVehicle<LandmarkOptions>,
    poses: Vec<AdjustedPose>,
    sides: &Sides,
    emit: &mut Emit<'_>,
) -> Result<(), Fault> {
    let Some(site) = poses.first().map(|row| row.site.clone()) else {
        return Ok(());
    };
    let known = poses.iter().map(|row| {
        let pose = row.map_from_vehicle.to_array();
        (row.session.as_str(), row.keyframe, pose)
    });
    let keyframes = poses.iter().map(keyframe).collect();
    let survey = Survey::new(known, keyframes, sides, &params.vehicle, emit)?;
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
        .collect();
    let found: Vec<Landmark> = found.into_iter().flatten().collect();
    emit.skip(
        "landmark cannot be triangulated",
        (all - found.len()) as u64,
    );
    emit.rows(found)
}

/// A keyframe as far as landmarks need it.
fn keyframe(row: &AdjustedPose) -> Keyframe {
    Keyframe {
        site: row.site.clone(),
        session: row.session.clone(),
        stamp: row.stamp,
        keyframe: row.keyframe,
        distance_m: 0.0,
        odom_from_vehicle: row.map_from_vehicle.clone(),
        images: Vec::new(),
    }
}

struct Maker<'a> {
    survey: &'a Survey,
    cameras: Vec<Pose>,
    options: &'a LandmarkOptions,
    site: &'a str,
}

impl Maker<'_> {
    fn landmark(&self, landmark: u32, mut features: Vec<FeatureRef>) -> Option<Landmark> {
        features.sort_unstable();
        features.dedup();
        let sights: Vec<Sight> = features
            .iter()
            .filter_map(|feature| self.survey.scene.sight(&self.cameras, *feature))
            .collect();
        let found = triangulate(&sights)?;
        let views = self.views(&found, &features);
        let view = mean_direction(&views);
        let cosines = views.iter().map(|seen| seen.direction.dot(&view));
        let ranges = || views.iter().map(|view| view.range_m);
        let point = [found.point.x, found.point.y, found.point.z];
        Some(Landmark {
            site: self.site.to_owned(),
            landmark,
            x: point[0],
            y: point[1],
            z: point[2],
            sigma_m: found.sigma_m() * self.options.features.sigma_px,
            parallax_rad: found.parallax_rad,
            rms_px: rms_px(&sights, &found),
            view: [view.x, view.y, view.z],
            view_cos: cosines.fold(1.0, f64::min),
            near_m: ranges().fold(f64::INFINITY, f64::min),
            far_m: ranges().fold(0.0, f64::max),
            descriptors: self.descriptors(&views),
            sightings: self.sightings(&features),
            sources: self.sources(&features),
            geometry: Wkb::point(point),
        })
    }

    fn views(&self, found: &LandmarkPoint, features: &[FeatureRef]) -> Vec<Appearance> {
        let view = |feature: &FeatureRef| {
            let away = self.cameras[feature.image as usize].translation - found.point;
            let range_m = away.norm().max(1e-6);
            Appearance {
                direction: away / range_m,
                range_m,
                descriptor: self.survey.scene.feature(*feature).descriptor,
                members: 1,
            }
        };
        features.iter().map(view).collect()
    }

    fn descriptors(&self, views: &[Appearance]) -> Bytes {
        let appearances = appearances(views).into_iter().take(self.options.looks);
        Bytes(appearances.flat_map(|seen| seen.descriptor.0).collect())
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
                feature: feature.feature,
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

fn rms_px(sights: &[Sight<'_>], found: &LandmarkPoint) -> f64 {
    let squares = sights.iter().filter_map(|sight| {
        let in_camera = sight.map_from_camera.inverse().transform(&found.point);
        let angles = ray_residual_rad(&sight.ray, &in_camera)?;
        Some(angles.norm_squared() * sight.px_per_rad * sight.px_per_rad)
    });
    (squares.sum::<f64>() / sights.len().max(1) as f64).sqrt()
}
