//! COLMAP's text model: `cameras.txt`, `images.txt`, `points3D.txt`.
//!
//! COLMAP has the centre of the first pixel at (0.5, 0.5), evermap at (0, 0). A camera is one of COLMAP's for each
//! session, as calibrations differ. Images are named `SESSION/CAMERA/NANOSECONDS.jpg`.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::Path;

use arrow::array::RecordBatch;
use evermap_algorithms::geometry::camera::{Camera, Model};
use evermap_algorithms::geometry::pose::Pose;
use evermap_algorithms::geometry::rig::Rig;
use evermap_schemas::Fault;
use evermap_schemas::layers::{AdjustedPose, Features, Landmark};
use evermap_schemas::roles::{Calibration, Transform};

use crate::annotate::person_images::CORNER;
use crate::ending::Failure;
use crate::output::Folder;
use crate::reader::{MapReader, one_site, typed};

/// What a model is made of, of one site.
struct Parts {
    poses: Vec<AdjustedPose>,
    landmarks: Vec<Landmark>,
    features: Vec<Features>,
    rigs: BTreeMap<String, Rig>,
}

/// Writes a model of adjusted poses into a folder.
///
/// # Errors
/// A user fault for a map without the layers, or a lens that COLMAP does not have.
pub async fn export(
    reader: &MapReader,
    batches: &[RecordBatch],
    site: Option<&str>,
    out: &Path,
) -> Result<(), Failure> {
    let model = model(&gather(reader, batches, site).await?)?;
    let mut folder = Folder::create(out)?;
    for (name, text) in [
        ("cameras.txt", &model.cameras),
        ("images.txt", &model.images),
        ("points3D.txt", &model.points),
    ] {
        folder.add(name, text.as_bytes())?;
    }
    Ok(folder.finish()?)
}

async fn gather(
    reader: &MapReader,
    batches: &[RecordBatch],
    site: Option<&str>,
) -> Result<Parts, Fault> {
    let mut poses: Vec<AdjustedPose> = typed(batches)?;
    let site = one_site(poses.iter().map(|row| row.site.as_str()), site)?;
    poses.sort_by(|a, b| (&a.session, a.stamp).cmp(&(&b.session, b.stamp)));
    let features: Vec<Features> = reader.needed(Some(&site)).await?;
    let calibration: Vec<Calibration> = reader.needed_in("cameras", &site).await?;
    let transforms: Vec<Transform> = reader.needed_in("mounts", &site).await?;
    let vehicle = reader.vehicle(&site).await?;
    let sizes = features.iter().map(without_content).collect();
    Ok(Parts {
        rigs: evermap_catalog::rigs(sizes, calibration, transforms, &vehicle),
        poses,
        landmarks: reader.needed(Some(&site)).await?,
        features,
    })
}

fn without_content(row: &Features) -> Features {
    Features {
        site: row.site.clone(),
        session: row.session.clone(),
        camera: row.camera.clone(),
        u: Vec::new(),
        v: Vec::new(),
        size_px: Vec::new(),
        descriptors: Default::default(),
        ..*row
    }
}

/// The three files.
struct Texts {
    cameras: String,
    images: String,
    points: String,
}

/// Session, keyframe, camera.
type ImageName<'a> = (&'a str, u32, &'a str);

fn model(parts: &Parts) -> Result<Texts, Fault> {
    let mut texts = Texts {
        cameras: String::from("# CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]\n"),
        images: String::from(
            "# IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME\n# POINTS2D[] as X Y POINT3D_ID\n",
        ),
        points: String::from("# POINT3D_ID X Y Z R G B ERROR TRACK[] as IMAGE_ID POINT2D_IDX\n"),
    };
    let mut numbers = BTreeMap::new();
    for (session, rig) in &parts.rigs {
        for camera in &rig.cameras {
            let number = numbers.len() + 1;
            numbers.insert((session.as_str(), camera.name.as_str()), (number, camera));
            let _ = writeln!(texts.cameras, "{number} {}", lens(&camera.camera)?);
        }
    }
    let features: BTreeMap<ImageName<'_>, &Features> = parts
        .features
        .iter()
        .map(|row| ((&*row.session, row.keyframe, &*row.camera), row))
        .collect();
    let mut tracks: BTreeMap<u32, String> = BTreeMap::new();
    let mut image = 0;
    for pose in &parts.poses {
        let map_from_vehicle = Pose::from_array(pose.map_from_vehicle.to_array())
            .map_err(|error| Fault::data(error.to_string()).at(&pose.session))?;
        let cameras = numbers.range((pose.session.as_str(), "")..);
        for ((_, name), (number, camera)) in
            cameras.take_while(|((session, _), _)| *session == pose.session)
        {
            let Some(row) = features.get(&(&*pose.session, pose.keyframe, *name)) else {
                continue;
            };
            image += 1;
            let camera_from_map = map_from_vehicle
                .compose(&camera.vehicle_from_camera)
                .inverse();
            texts
                .images
                .push_str(&header(image, *number, &camera_from_map, row));
            texts
                .images
                .push_str(&points(image, pose, row, &mut tracks));
        }
    }
    for row in &parts.landmarks {
        if let Some(track) = tracks.get(&row.landmark) {
            let Landmark {
                landmark,
                x,
                y,
                z,
                rms_px,
                ..
            } = row;
            let id = landmark + 1;
            let _ = writeln!(texts.points, "{id} {x} {y} {z} 128 128 128 {rms_px}{track}");
        }
    }
    Ok(texts)
}

fn header(image: u32, camera: usize, camera_from_map: &Pose, row: &Features) -> String {
    let [x, y, z, qx, qy, qz, qw] = camera_from_map.to_array();
    let (session, camera_name) = (within(&row.session), within(&row.camera));
    let name = format!("{session}/{camera_name}/{}.jpg", row.stamp.0);
    format!("{image} {qw} {qx} {qy} {qz} {x} {y} {z} {camera} {name}\n")
}

/// A name as a part of an image's: without what separates words, and leading nowhere but into a folder, as programs open what an
/// image is called beneath that of all images.
fn within(name: &str) -> String {
    let parts = name.split('/').filter(|part| !part.is_empty());
    let parts = parts.map(|part| match part {
        "." | ".." => part.replace('.', "_"),
        part => part.replace(char::is_whitespace, "_"),
    });
    parts.collect::<Vec<_>>().join("/")
}

/// The features of an image with their landmarks; sightings are noted in the landmarks' tracks.
fn points(
    image: u32,
    pose: &AdjustedPose,
    row: &Features,
    tracks: &mut BTreeMap<u32, String>,
) -> String {
    let observed = pose
        .observations
        .iter()
        .filter(|seen| seen.camera == row.camera);
    let landmarks: BTreeMap<u32, u32> =
        observed.map(|seen| (seen.feature, seen.landmark)).collect();
    let mut line = String::new();
    for (index, (u, v)) in (0..).zip(row.u.iter().zip(&row.v)) {
        let (x, y) = (f64::from(*u) + CORNER, f64::from(*v) + CORNER);
        let landmark = landmarks.get(&index);
        let point = landmark.map_or(-1, |landmark| i64::from(*landmark) + 1);
        let _ = write!(line, "{x} {y} {point} ");
        if let Some(landmark) = landmark {
            let _ = write!(tracks.entry(*landmark).or_default(), " {image} {index}");
        }
    }
    format!("{}\n", line.trim_end())
}

/// A camera as COLMAP writes it: model, size, parameters.
fn lens(camera: &Camera) -> Result<String, Fault> {
    let (name, parameters) = match &camera.model {
        Model::Pinhole(lens) => {
            let (focal, centre, bent) = (lens.focal(), lens.centre(), lens.distortion());
            let [k1, k2, k3, k4, k5, k6] = bent.radial;
            let [p1, p2] = bent.tangential;
            let (name, bent) = if [k3, k4, k5, k6] != [0.0; 4] {
                ("FULL_OPENCV", vec![k1, k2, p1, p2, k3, k4, k5, k6])
            } else if [k1, k2, p1, p2] != [0.0; 4] {
                ("OPENCV", vec![k1, k2, p1, p2])
            } else {
                ("PINHOLE", vec![])
            };
            (name, parameters(focal, centre, &bent))
        }
        Model::KannalaBrandt(lens) => (
            "OPENCV_FISHEYE",
            parameters(lens.focal(), lens.centre(), &lens.distortion()),
        ),
        Model::Equirectangular(_) => return Err(no_lens("panoramas")),
        Model::Ocam(_) => return Err(no_lens("OCam lenses")),
    };
    Ok(format!(
        "{name} {} {}{parameters}",
        camera.width, camera.height
    ))
}

fn no_lens(what: &str) -> Fault {
    Fault::user(format!("COLMAP has no camera model for {what}"))
        .next("calibrate the camera as plumb_bob, rational_polynomial or equidistant")
}

fn parameters(focal: [f64; 2], centre: [f64; 2], distortion: &[f64]) -> String {
    let centre = centre.map(|value| value + CORNER);
    let all = focal.iter().chain(&centre).chain(distortion);
    all.map(|value| format!(" {value}")).collect()
}

#[cfg(test)]
mod tests;
