//! Intrinsic calibrations; logs repeat them with every image, the table does not.
//!
//! ROS says K and D of the whole sensor (`width` × `height`), R and P of what rectification makes of its image, and which
//! part of the sensor is read (`roi`, in pixels that are not binned): a row is of that part. Binning makes images smaller
//! by whole numbers, as who reads images of another size than their calibration has to expect anyway.

use crate::roles::cameras::topic_camera;
use crate::roles::stereo::{self, CameraMount};
use crate::roles::{Fields, FromMessage, Message, Messages, Role};
use crate::{Pose, Stamp, record};

record! {
    /// One camera's intrinsic calibration, valid from its stamp on; repeats of an unchanged calibration are dropped.
    #[layer("calibration", key(site, session, camera, stamp))]
    pub struct Calibration {
        /// Site that the session belongs to.
        site: String,
        /// Session that the calibration belongs to.
        session: String,
        /// Instant from which it holds.
        stamp: Stamp ["ns"],
        /// Camera that it describes: the optical frame's name; the topic without its last parts for a camera of a pair that
        /// names the frame of the first one.
        camera: String,
        /// Image width that the intrinsics are for.
        width: u32 ["px"],
        /// Image height that the intrinsics are for.
        height: u32 ["px"],
        /// `plumb_bob`, `rational_polynomial`, `equidistant`, `equirectangular` or `ocam`.
        model: String,
        /// Camera matrix, row-major; equirectangular and OCam say on the camera model's page what theirs hold.
        intrinsics: Vec<f64> ["px"],
        /// Distortion coefficients of the model.
        distortion: Vec<f64>,
        /// Where the camera is mounted, as rectified images look and as cameras of a pair stand; null where that is in the
        /// frame of its name, and along its axes.
        mount: Option<CameraMount>,
    }
}

/// Topics with intrinsic calibrations.
pub const ROLE: Role = Role::of::<Calibration>(Messages {
    drop_repeats: true,
    lasting: true,
    ..Messages::of::<Calibration>(TYPES)
});

/// Message types of calibrations.
pub(super) const TYPES: &[&str] = &["sensor_msgs/CameraInfo", "foxglove.CameraCalibration"];

impl FromMessage for Calibration {
    const MEMBERS: &'static [&'static str] = &[
        "header",
        "timestamp",
        "frame_id",
        "width",
        "height",
        "distortion_model",
        "d",
        "D",
        "k",
        "K",
        "r",
        "R",
        "p",
        "P",
        "roi",
    ];

    fn from_message(message: &Message<'_>) -> Result<Vec<Self>, String> {
        let (cameras, topic, frame) = (message.cameras, message.topic, frame(message));
        let camera = cameras.calibrated(topic, &frame);
        // Which topics are left out so is counted where cameras are named.
        if cameras.calibrated_by(topic, &camera).is_some() || cameras.is_unplaced(topic, &camera) {
            return Ok(Vec::new());
        }
        let said = said(message)?;
        let first = cameras.first_of_pair(topic, &frame);
        let pair_from_camera = match first {
            Some(_) => said.pair_from_camera?,
            // In its own frame a camera needs neither R nor P, but of rectified images, where both make sense.
            None => said.pair_from_camera.unwrap_or(Pose::IDENTITY),
        };
        let is_rectified = cameras.calibrates_rectified(topic);
        let mount = stereo::mount(&frame, &pair_from_camera, first, is_rectified);
        let [width, height] = said.size;
        let Lens {
            model,
            intrinsics,
            distortion,
        } = said.lens;
        Ok(vec![Self {
            site: message.site.to_owned(),
            session: message.session.to_owned(),
            stamp: said.stamp,
            camera,
            width,
            height,
            model,
            intrinsics,
            distortion,
            mount,
        }])
    }
}

/// The optical frame that a calibration names; the topic without its last parts where it names none.
pub(super) fn frame(message: &Message<'_>) -> String {
    let frame = message.frame();
    match frame.is_empty() {
        true => topic_camera(message.topic),
        false => frame,
    }
}

/// What a message says of a camera that is calibrated, whatever its name.
pub(super) struct CalibrationMessage {
    stamp: Stamp,
    /// Width and height of its images, px.
    size: [u32; 2],
    lens: Lens,
    /// The camera in the axes of its pair; what is wrong with R or P, in words, where images are not rectified and nobody
    /// may ask for these.
    pub(super) pair_from_camera: Result<Pose, String>,
}

/// What a calibration says.
///
/// # Errors
/// In words, where it makes no sense, or says that the camera is not calibrated.
pub(super) fn said(message: &Message<'_>) -> Result<CalibrationMessage, String> {
    let fields = &message.fields;
    let whole = ["width", "height"].map(|name| pixels(fields, &[name]));
    let region = region(fields, whole)?;
    let is_rectified = message.cameras.calibrates_rectified(message.topic);
    let (mut lens, pair_from_camera) = match (is_rectified, region) {
        (true, Some(_)) => {
            return Err(
                "expected all of the sensor where images are rectified, found a region of interest"
                    .to_owned(),
            );
        }
        (true, None) => (rectified(fields)?, Ok(stereo::pair_from_camera(fields)?)),
        // R and P are of other images: nobody needs them but a camera of a pair that names one frame.
        (false, _) => (as_it_sees(fields)?, stereo::pair_from_camera(fields)),
    };
    let size = region.map_or(whole, |region| {
        lens.begin_at(region.from);
        region.size
    });
    Ok(CalibrationMessage {
        stamp: message.stamp()?,
        size,
        lens,
        pair_from_camera,
    })
}

/// Where K holds the focal length and the centre along x, and along y: nine entries, row by row, or `fx, cx, fy, cy` and
/// nothing but zeros behind.
pub fn axes(k: &[f64]) -> [[usize; 2]; 2] {
    let full = k.len() == 9 && k[4..].iter().any(|entry| *entry != 0.0);
    match full {
        true => [[0, 2], [4, 5]],
        false => [[0, 1], [2, 3]],
    }
}

/// The numbers of a lens.
struct Lens {
    model: String,
    intrinsics: Vec<f64>,
    distortion: Vec<f64>,
}

impl Lens {
    /// Counts pixels from another one.
    fn begin_at(&mut self, pixel: [u32; 2]) {
        for ([_, centre], from) in axes(&self.intrinsics).into_iter().zip(pixel) {
            if let Some(centre) = self.intrinsics.get_mut(centre) {
                *centre -= f64::from(from);
            }
        }
    }
}

/// The part of the sensor that images show, in pixels.
#[derive(Clone, Copy)]
struct Region {
    from: [u32; 2],
    size: [u32; 2],
}

fn pixels(fields: &Fields<'_>, path: &[&str]) -> u32 {
    fields.number(path).unwrap_or(0.0) as u32
}

/// The region of interest; `None` where it is the whole image, or nobody says it.
fn region(fields: &Fields<'_>, whole: [u32; 2]) -> Result<Option<Region>, String> {
    let part = |name: &str| pixels(fields, &["roi", name]);
    let from = ["x_offset", "y_offset"].map(part);
    let size = ["width", "height"].map(part);
    if from == [0, 0] && (size == [0, 0] || size == whole) {
        return Ok(None);
    }
    // A calibration that does not say its size is of any.
    let within = |axis: usize| {
        let end = from[axis].checked_add(size[axis]);
        size[axis] > 0 && end.is_some_and(|end| whole[axis] == 0 || end <= whole[axis])
    };
    match within(0) && within(1) {
        true => Ok(Some(Region { from, size })),
        false => Err(format!(
            "expected a region of interest within the {} × {} px of the calibration, found {} × {} px from ({}, {}) on",
            whole[0], whole[1], size[0], size[1], from[0], from[1],
        )),
    }
}

/// The lens of images as it sees them, K and D.
fn as_it_sees(fields: &Fields<'_>) -> Result<Lens, String> {
    let intrinsics = fields.numbers(&["k", "K"]);
    let distortion = fields.numbers(&["d", "D"]);
    check_finite(intrinsics.iter().chain(&distortion))?;
    let Some(focal_length) = intrinsics.first() else {
        return Err("expected K, 9 numbers, found none".to_owned());
    };
    // CameraInfo: "if K[0] is 0, the camera is uncalibrated".
    if *focal_length == 0.0 {
        return Err(
            "expected a focal length, found K[0] = 0: the calibration says that the camera is uncalibrated"
                .to_owned(),
        );
    }
    let model = fields.text(&["distortion_model"]).unwrap_or_default();
    Ok(Lens {
        model: plain_model(&model),
        intrinsics,
        distortion,
    })
}

/// The lens of rectified images: P without its last column, and no distortion.
fn rectified(fields: &Fields<'_>) -> Result<Lens, String> {
    let p = fields.numbers(&["p", "P"]);
    let r = fields.numbers(&["r", "R"]);
    check_finite(p.iter().chain(&r))?;
    if p.len() != 12 || p[0] == 0.0 {
        return Err(
            "expected P, 12 numbers that are not 0, as images are rectified, found none".to_owned(),
        );
    }
    let rows = p.chunks_exact(4).flat_map(|row| &row[..3]);
    Ok(Lens {
        model: plain_model(""),
        intrinsics: rows.copied().collect(),
        distortion: Vec::new(),
    })
}

fn check_finite<'a>(mut numbers: impl Iterator<Item = &'a f64>) -> Result<(), String> {
    match numbers.all(|number| number.is_finite()) {
        true => Ok(()),
        false => Err("expected finite intrinsics".to_owned()),
    }
}

/// The model's name as the layer spells it; a model that is not known here stays as it is.
fn plain_model(model: &str) -> String {
    match model.to_lowercase().as_str() {
        "" | "radtan" | "brown_conrady" => "plumb_bob".to_owned(),
        "fisheye" | "kannala_brandt" | "kannalabrandt" | "kannala_brandt4" => {
            "equidistant".to_owned()
        }
        other => other.to_owned(),
    }
}

#[cfg(test)]
mod tests;
