//! The labels of a site as they are in one version of its map, from what the map and logs say.

use std::collections::BTreeSet;
use std::path::PathBuf;

use datafusion::prelude::SessionContext;
use evermap_algorithms::geometry::pose::Pose;
use evermap_algorithms::labels::anchors::AnchorParams;
use evermap_catalog::OfVehicle;
use evermap_catalog::annotated::{Holds, MapRows, Placer, PlacingParams, anchored};
use evermap_catalog::labels::label_anchors::Obstacle;
use evermap_catalog::painted::ImageKey;
use evermap_contract::Reason;
use evermap_datasets::{Dataset, Manifest};
use evermap_language::nearest;
use evermap_schemas::layers::{
    Keyframe, LabelAnchor, MapFrame, PersonQuestion, PlacedLabel, VehiclePose,
};
use evermap_schemas::roles::{Anchor, Annotation, ImageAnnotation};
use evermap_schemas::{Fault, LayerRow, Stamp};

use super::Losses;
use super::features::DrawnFeature;
use super::known::KnownLabels;
use crate::reader::{MapReader, answered, one_site, typed};
use crate::sessions;
use crate::shown::Picture;

/// The layer in which a map keeps what was said: a step of the plan `labels`.
const SAID: &str = "said";
/// The layer in which a map keeps what was painted: a step of the plan `scene_labels`.
const PAINTED: &str = "painted";

/// The labels of a site, and what can hold new ones.
pub struct State {
    /// Site.
    pub site: String,
    /// The version that is looked at.
    pub version: u64,
    /// The labels that there are.
    pub labels: KnownLabels,
    /// Whether there is anything that labels can be tied to; on images people paint without.
    pub has_poses: bool,
    /// The poses and frames of the version.
    pub holds: Holds,
    /// The images that layers name; `None` until somebody says something of one.
    images: Option<BTreeSet<ImageKey>>,
    placer: Placer,
    acts: Vec<Annotation>,
    before: Vec<LabelAnchor>,
}

impl State {
    /// What the map says, and these logs; what does not fit together is noted.
    ///
    /// # Errors
    /// A user fault for a site that there is not, or logs that cannot be read.
    pub async fn read(
        reader: &MapReader,
        site: Option<&str>,
        logs: &[PathBuf],
        losses: &mut Losses,
    ) -> Result<Self, Fault> {
        let poses: Vec<VehiclePose> = reader.rows(None).await?;
        let pictures: Vec<Picture> = match poses.is_empty() {
            true => reader.rows(None).await?,
            false => Vec::new(),
        };
        let sites = poses.iter().map(|pose| pose.site.as_str());
        let sites: BTreeSet<&str> = sites
            .chain(pictures.iter().map(|row| row.site.as_str()))
            .collect();
        if sites.is_empty() {
            return Err(without_poses());
        }
        let site = one_site(sites, site)?;
        let mut acts: Vec<Annotation> = reader.rows_in(SAID, &site).await?;
        acts.extend(from_logs(logs, &site, losses).await?);
        let frames: Vec<MapFrame> = reader.rows(Some(&site)).await?;
        let landmarks: Vec<Obstacle> = reader.rows(Some(&site)).await?;
        let mut map = MapRows {
            poses,
            frames,
            calibration: reader.rows_in("cameras", &site).await?,
            transforms: reader.rows_in("mounts", &site).await?,
            landmarks: landmarks.iter().map(|row| [row.x, row.y, row.z]).collect(),
        };
        map.poses.retain(|pose| pose.site == site);
        let has_poses = !map.poses.is_empty();
        let placed: Vec<PlacedLabel> = reader.rows(Some(&site)).await?;
        let placer = Placer::new(
            map.poses.clone(),
            map.frames.clone(),
            placed,
            &PlacingParams::default(),
        );
        let params = OfVehicle {
            options: AnchorParams::default(),
            vehicle: reader.vehicle(&site).await?,
        };
        let holds = Holds::new(map, &params);
        let before: Vec<LabelAnchor> = reader.rows(Some(&site)).await?;
        let mut state = Self {
            site,
            version: reader.map.version.version,
            labels: KnownLabels::default(),
            has_poses,
            holds,
            images: None,
            placer,
            acts: Vec::new(),
            before,
        };
        state.add(acts, losses);
        Ok(state)
    }

    /// The kind of labels that a word may be a misspelling of; `None` for a kind that there is, or one like no other.
    pub fn meant(&self, kind: &str) -> Option<&str> {
        let kinds = self.labels.rows().iter().map(|label| label.kind.as_str());
        match self.labels.has_kind(kind) {
            true => None,
            false => nearest(kind, kinds),
        }
    }

    /// Reads which images the map names, where one of these features is of an image: to be asked before [`State::may_have`] is.
    ///
    /// # Errors
    /// As [`MapReader::rows`].
    pub async fn know_images(
        &mut self,
        reader: &MapReader,
        features: &[DrawnFeature],
    ) -> Result<(), Fault> {
        let names_one = features.iter().any(|feature| feature.image.is_some());
        if names_one && self.images.is_none() {
            self.images = Some(images(reader, &self.site).await?);
        }
        Ok(())
    }

    /// Whether there is an image, as far as the map tells: one that its layers name, or that a camera took at a vehicle pose,
    /// as labels are tied to these. Where nothing is known of a session's images, or of its cameras, it may be there.
    pub fn may_have(&self, image: &ImageKey) -> bool {
        let (session, stamp, camera) = image;
        let none = BTreeSet::new();
        let images = self.images.as_ref().unwrap_or(&none);
        if images.contains(image) {
            return true;
        }
        let first = (session.clone(), Stamp(i64::MIN), String::new());
        let next = images.range(first..).next();
        let knows_images = next.is_some_and(|(of, ..)| of == session);
        let may_be_camera = match self.holds.knows_cameras(session) {
            true => self.holds.camera(session, camera).is_some(),
            false => !knows_images,
        };
        may_be_camera && (!knows_images || self.holds.has_pose(session, *stamp))
    }

    /// Where the vehicle stood when an image was taken; `None` where the map does not say.
    pub fn map_from_vehicle(&self, (session, stamp, _): &ImageKey) -> Option<Pose> {
        self.placer.map_from_vehicle(session, *stamp)
    }

    /// Whether any of these points, m, is kilometres from every vehicle pose.
    pub fn is_far(&self, points: &[[f64; 3]]) -> bool {
        self.placer.is_far(points)
    }

    /// What ties a label to the image that shows it; `None` where the map does not say where that was taken.
    pub fn seen_in(&self, image: &ImageKey, map_from_label: &Pose) -> Option<Anchor> {
        let vehicle_from_map = self.map_from_vehicle(image)?.inverse();
        let vehicle_from_label = vehicle_from_map.compose(map_from_label);
        let (session, stamp, camera) = image.clone();
        Some(Anchor {
            session,
            stamp,
            camera: Some(camera),
            vehicle_from_label: evermap_schemas::Pose::from_array(vehicle_from_label.to_array()),
        })
    }

    /// Takes in what was said meanwhile.
    pub fn add(&mut self, acts: Vec<Annotation>, losses: &mut Losses) {
        self.acts.extend(acts);
        let mut tell = |reason: Reason, count| losses.count(&reason, count);
        let (acts, before) = (self.acts.clone(), self.before.clone());
        let labels = anchored(acts, before, &self.holds, &mut tell).into_iter();
        let placed = labels.filter_map(|label| self.placer.placed(label, &mut tell));
        self.labels = placed.collect();
    }
}

/// The images of a site that a map names: pictures, and those of keyframes and of questions about people. Plans name the images
/// of a keyframe by its own instant, too.
async fn images(reader: &MapReader, site: &str) -> Result<BTreeSet<ImageKey>, Fault> {
    let pictures: Vec<Picture> = reader.rows(Some(site)).await?;
    let pictures = pictures.into_iter();
    let pictures = pictures.map(|row| (row.session, row.stamp, row.camera));
    let mut images: BTreeSet<ImageKey> = pictures.collect();
    let keyframes: Vec<Keyframe> = reader.rows(Some(site)).await?;
    for Keyframe {
        session,
        stamp,
        images: taken,
        ..
    } in keyframes
    {
        for image in taken {
            images.insert((session.clone(), image.stamp, image.camera.clone()));
            images.insert((session.clone(), stamp, image.camera));
        }
    }
    let asked: Vec<PersonQuestion> = reader.rows(Some(site)).await?;
    images.extend(
        asked
            .into_iter()
            .map(|row| (row.session, row.stamp, row.camera)),
    );
    Ok(images)
}

/// The image that a label is tied to; `None` where it is tied to no camera's.
pub fn image_of(label: &PlacedLabel) -> Option<ImageKey> {
    let anchor = label.anchor.as_ref()?;
    Some((anchor.session.clone(), anchor.stamp, anchor.camera.clone()?))
}

/// Why there can be no labels.
pub fn without_poses() -> Fault {
    Fault::user("the map has no poses to tie labels to")
        .next("make it with the plan labels, lifelong or car_park")
}

/// What was painted on the images of a site, as the map and these logs say.
///
/// # Errors
/// A user fault for logs that cannot be read.
pub async fn painted(
    reader: &MapReader,
    site: &str,
    logs: &[PathBuf],
) -> Result<Vec<ImageAnnotation>, Fault> {
    let mut acts: Vec<ImageAnnotation> = reader.rows_in(PAINTED, site).await?;
    // What logs lose is told where their other acts are read.
    acts.extend(from_logs(logs, site, &mut Losses::default()).await?);
    Ok(acts)
}

/// The rows of a role that logs have, as read by a run; what of them is lost is noted.
async fn from_logs<T: LayerRow>(
    logs: &[PathBuf],
    site: &str,
    losses: &mut Losses,
) -> Result<Vec<T>, Fault> {
    if logs.is_empty() {
        return Ok(Vec::new());
    }
    let context = SessionContext::new();
    let manifest = Manifest {
        site: Some(site.to_owned()),
        ..Manifest::default()
    };
    let paths: Vec<String> = logs.iter().map(|path| path.display().to_string()).collect();
    let dataset = Dataset::open(&context.runtime_env(), &paths, Some(&manifest)).await?;
    dataset.register(&context)?;
    let rows = answered(&context, &format!("SELECT * FROM {}", T::NAME)).await?;
    for (reason, count) in sessions::lost([&dataset]).0 {
        losses.count(&reason, count);
    }
    typed(&rows)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A map with poses of `a` at 5 and 9 ns, of which it names these images.
    fn state(images: &[(i64, &str)]) -> State {
        let pose = |stamp: i64| VehiclePose {
            site: "lot".into(),
            session: "a".into(),
            stamp: Stamp(stamp),
            map_from_vehicle: evermap_schemas::Pose::IDENTITY,
        };
        let map = MapRows {
            poses: vec![pose(5), pose(9)],
            ..MapRows::default()
        };
        let params = OfVehicle {
            options: AnchorParams::default(),
            vehicle: evermap_catalog::VehicleFrame::default(),
        };
        let placing = PlacingParams::default();
        let placer = Placer::new(map.poses.clone(), Vec::new(), Vec::new(), &placing);
        let images = images
            .iter()
            .map(|(stamp, camera)| image("a", *stamp, camera));
        State {
            site: "lot".into(),
            version: 1,
            labels: KnownLabels::default(),
            has_poses: true,
            holds: Holds::new(map, &params),
            images: Some(images.collect()),
            placer,
            acts: Vec::new(),
            before: Vec::new(),
        }
    }

    fn image(session: &str, stamp: i64, camera: &str) -> ImageKey {
        (session.into(), Stamp(stamp), camera.into())
    }

    #[test]
    fn an_image_of_another_camera_or_instant_is_not_there() {
        let named = state(&[(5, "front"), (6, "front")]);
        assert!(named.may_have(&image("a", 6, "front")));
        assert!(!named.may_have(&image("a", 6, "right")));
        assert!(!named.may_have(&image("a", 7, "front")));
        assert!(named.map_from_vehicle(&image("a", 7, "front")).is_some());
        // Of another session, and of a map without images, nothing is known.
        assert!(named.may_have(&image("b", 7, "right")));
        assert!(state(&[]).may_have(&image("a", 7, "right")));
    }
}
