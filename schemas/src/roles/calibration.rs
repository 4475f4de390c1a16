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
        if cameras.calibrated_by(topic, &camera).is_some() {
            return Ok(Vec::new());
        }
        let Some(said) = said(message)? else {
            return Ok(Vec::new());
        };
        let mount = stereo::mount(
            &frame,
            &said.pair_from_camera,
            cameras.first_of_pair(topic, &frame),
            cameras.calibrates_rectified(topic),
        );
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
pub(super) struct Said {
    stamp: Stamp,
    /// Width and height of its images, px.
    size: [u32; 2],
    lens: Lens,
    /// The camera in the axes of its pair.
    pub(super) pair_from_camera: Pose,
}

/// What a calibration says; `None` where the camera is not calibrated.
///
/// # Errors
/// In words, where it makes no sense.
pub(super) fn said(message: &Message<'_>) -> Result<Option<Said>, String> {
    let fields = &message.fields;
    let whole = ["width", "height"].map(|name| pixels(fields, &[name]));
    let region = region(fields, whole)?;
    let (lens, pair) = match (message.cameras.calibrates_rectified(message.topic), region) {
        (true, Some(_)) => {
            return Err(
                "expected all of the sensor where images are rectified, found a region of interest"
                    .to_owned(),
            );
        }
        (true, None) => (Some(rectified(fields)?), stereo::pair_from_camera(fields)?),
        // R and P are of other images: nobody needs them but a camera that stands beside the one whose frame it names.
        (false, _) => (
            as_it_sees(fields)?,
            stereo::pair_from_camera(fields).unwrap_or(Pose::IDENTITY),
        ),
    };
    let Some(mut lens) = lens else {
        return Ok(None);
    };
    let size = region.map_or(whole, |region| {
        lens.begin_at(region.from);
        region.size
    });
    Ok(Some(Said {
        stamp: message.stamp()?,
        size,
        lens,
        pair_from_camera: pair,
    }))
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

/// The lens of images as it sees them, K and D; `None` where it is not calibrated.
fn as_it_sees(fields: &Fields<'_>) -> Result<Option<Lens>, String> {
    let intrinsics = fields.numbers(&["k", "K"]);
    let distortion = fields.numbers(&["d", "D"]);
    check_finite(intrinsics.iter().chain(&distortion))?;
    // CameraInfo: "if K[0] is 0, the camera is uncalibrated".
    if intrinsics.first().is_none_or(|fx| *fx == 0.0) {
        return Ok(None);
    }
    let model = fields.text(&["distortion_model"]).unwrap_or_default();
    Ok(Some(Lens {
        model: plain_model(&model),
        intrinsics,
        distortion,
    }))
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
mod tests {
    use std::cell::OnceCell;
    use std::sync::Arc;

    use arrow::array::{ArrayRef, ListArray, UInt32Array};
    use arrow::datatypes::Float64Type;

    use super::*;
    use crate::Stamp;
    use crate::roles::tests::members;
    use crate::roles::{CameraNames, OdometryOf};

    fn list(numbers: &[f64]) -> ArrayRef {
        let items = numbers.iter().copied().map(Some);
        Arc::new(ListArray::from_iter_primitive::<Float64Type, _, _>([Some(
            items,
        )]))
    }

    fn number(number: u32) -> ArrayRef {
        Arc::new(UInt32Array::from(vec![number]))
    }

    const K: [f64; 9] = [128.0, 0.0, 79.5, 0.0, 128.0, 59.5, 0.0, 0.0, 1.0];
    const P: [f64; 12] = [
        100.0, 0.0, 80.0, -7.0, 0.0, 100.0, 60.0, 0.0, 0.0, 0.0, 1.0, 0.0,
    ];
    const ONE: [f64; 9] = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];

    /// What an image of 160 × 120 px is calibrated as, by its K, R, P and region of interest (offsets and size).
    fn read(
        k: &[f64],
        r: &[f64],
        p: &[f64],
        roi: [u32; 4],
        images: &str,
    ) -> Result<Vec<Calibration>, String> {
        let names = ["x_offset", "y_offset", "width", "height"];
        let roi = members(names.into_iter().zip(roi.map(number)).collect());
        let members = members(vec![
            ("width", number(160)),
            ("height", number(120)),
            ("d", list(&[-0.3, 0.1, 0.0, 0.0, 0.0])),
            ("k", list(k)),
            ("r", list(r)),
            ("p", list(p)),
            ("roi", Arc::new(roi) as ArrayRef),
        ]);
        Calibration::from_message(&Message {
            site: "lot",
            session: "a",
            topic: "/front/camera_info",
            log_time: Stamp(1),
            fields: Fields::new(&members, 0),
            zero: &OnceCell::new(),
            image: None,
            cameras: &CameraNames::of_images(|_| vec![images]),
            bits: None,
            robot: &OdometryOf::default(),
        })
    }

    /// Size, K and number of distortion coefficients.
    fn lens(
        found: Result<Vec<Calibration>, String>,
    ) -> Result<([u32; 2], Vec<f64>, usize), String> {
        let rows = found?.into_iter();
        let mut rows = rows.map(|row| {
            (
                [row.width, row.height],
                row.intrinsics,
                row.distortion.len(),
            )
        });
        rows.next().ok_or_else(|| "no row".to_owned())
    }

    const RAW: &str = "/front/image_raw";
    const RECT: &str = "/front/image_rect";

    #[test]
    fn a_calibration_is_of_the_part_of_the_sensor_that_is_read() {
        let read = |k: &[f64], roi| lens(read(k, &ONE, &P, roi, RAW));
        for whole in [[0; 4], [0, 0, 160, 120]] {
            assert_eq!(read(&K, whole), Ok(([160, 120], K.to_vec(), 5)));
        }
        let middle = [128.0, 0.0, 39.5, 0.0, 128.0, 29.5, 0.0, 0.0, 1.0];
        let part = read(&K, [40, 30, 80, 60]);
        assert_eq!(part, Ok(([80, 60], middle.to_vec(), 5)));
        // Of a corner, only the size is another one.
        let corner = read(&K, [0, 0, 80, 60]);
        assert_eq!(corner, Ok(([80, 60], K.to_vec(), 5)));
        let four = read(&[128.0, 79.5, 128.0, 59.5], [40, 30, 80, 60]);
        assert_eq!(four, Ok(([80, 60], vec![128.0, 39.5, 128.0, 29.5], 5)));
        for outside in [
            [81, 0, 80, 60],
            [0, 0, 80, 121],
            [40, 30, 0, 0],
            [u32::MAX, 0, 1, 1],
        ] {
            let said = read(&K, outside).err().unwrap_or_default();
            assert!(said.contains("within the 160 × 120 px"), "{said}");
        }
    }

    /// R of 5° about y.
    fn turned() -> [f64; 9] {
        let (sin, cos) = 5.0_f64.to_radians().sin_cos();
        [cos, 0.0, sin, 0.0, 1.0, 0.0, -sin, 0.0, cos]
    }

    #[test]
    fn rectified_images_have_the_lens_of_p_or_none() {
        let rect = |r: &[f64], p: &[f64], roi| lens(read(&K, r, p, roi, RECT));
        let k = [100.0, 0.0, 80.0, 0.0, 100.0, 60.0, 0.0, 0.0, 1.0];
        for r in [&ONE[..], &[0.0; 9], &[]] {
            assert_eq!(rect(r, &P, [0; 4]), Ok(([160, 120], k.to_vec(), 0)));
        }
        let turned = turned();
        assert_eq!(rect(&turned, &P, [0; 4]), Ok(([160, 120], k.to_vec(), 0)));
        let no_number = [f64::NAN; 12];
        let mirrored = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, -1.0];
        for (r, p, roi, expected) in [
            (&ONE[..], &P[..0], [0; 4], "expected P"),
            (&ONE, &[0.0; 12], [0; 4], "expected P"),
            (&ONE, &no_number, [0; 4], "finite"),
            (&mirrored, &P, [0; 4], "expected R to be a rotation"),
            (&ONE[..4], &P, [0; 4], "expected 9 numbers as R, found 4"),
            (&ONE, &P, [40, 30, 80, 60], "region of interest"),
        ] {
            let said = rect(r, p, roi).err().unwrap_or_default();
            assert!(said.contains(expected), "{said}");
        }
        // Beside others nobody asks for R and P.
        let raw = lens(read(&K, &turned, &[], [0; 4], RAW));
        assert_eq!(raw, Ok(([160, 120], K.to_vec(), 5)));
    }

    #[test]
    fn images_that_are_turned_say_where_they_look_and_others_stay_in_their_frame() {
        let mount = |r: &[f64], images| {
            let rows = read(&K, r, &P, [0; 4], images).unwrap_or_default();
            rows.into_iter().next().and_then(|row| row.mount)
        };
        for r in [&ONE[..], &[0.0; 9], &[]] {
            assert_eq!(mount(r, RECT), None);
        }
        assert_eq!(mount(&turned(), RAW), None);
        // The other way about than R turns. Alone, a camera stands in its own frame, whatever P says.
        let half = 2.5_f64.to_radians();
        let found = mount(&turned(), RECT);
        let parts = found
            .as_ref()
            .map(|found| found.frame_from_camera.to_array());
        let [x, y, z, qx, qy, qz, qw] = parts.unwrap_or_default();
        assert_eq!([x, y, z, qx, qz], [0.0; 5]);
        assert_eq!(found.map(|found| found.frame).as_deref(), Some("front"));
        assert!((qy + half.sin()).abs() < 1e-12 && (qw - half.cos()).abs() < 1e-12);
    }

    #[test]
    fn a_camera_without_focal_length_is_not_calibrated() {
        assert_eq!(
            read(&[0.0; 9], &ONE, &P, [0; 4], RAW).map(|rows| rows.len()),
            Ok(0)
        );
    }
}
