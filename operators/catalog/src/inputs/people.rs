//! Images as whoever looks for people in them wants them: decoded, upright, with a detector beside.

use std::sync::Arc;

use evermap_algorithms::ground::people::upright::{Picture, Upright};
use evermap_algorithms::ground::people::{PeopleParams, WindowDetector};
use evermap_algorithms::ground::projection::GrayView;
use evermap_algorithms::learning::gaussian_process::LinearProcess;
use evermap_contract::{Fault, Reason, Sides};
use evermap_schemas::Stamp;
use evermap_schemas::layers::PersonModel;
use evermap_vision::{Grey, PeopleDetector, decode_grey};

use crate::inputs::calibrated::{Calibrated, MountedCamera};
use crate::inputs::pixels::{left_out, undecoded};
use crate::inputs::rig::OfVehicle;

/// Kind of the labels that say who is a person, and what is none.
pub const PERSON: &str = "person";
/// Standing of those that say that somebody is none.
pub(crate) const REJECTED: &str = "rejected";
/// Who was answered about stands within this (m), in the vehicle frame, of who is asked about in the same image.
pub const ANSWERED_M: f64 = 0.3;
/// Cameras kept at most, each with tables of some 20 MB.
const MOST_VIEWS: usize = 16;

/// What was learnt of people on a site; `None` before there is a model.
///
/// # Errors
/// A data fault for a model that does not have the numbers that it claims.
pub(crate) fn learnt(sides: &Sides) -> Result<Option<LinearProcess>, Fault> {
    let Some(model) = sides.rows::<PersonModel>("models")?.pop() else {
        return Ok(None);
    };
    let PersonModel {
        weights,
        scale,
        noise,
        spread,
        ..
    } = model;
    let process = LinearProcess::from_parts(weights, [scale, noise], &spread);
    let process = process.ok_or_else(|| {
        Fault::data("expected a model of people with the numbers that it claims, found others")
    })?;
    Ok(Some(process))
}

/// # Errors
/// A user fault where nobody is looked for at any range.
pub(crate) fn check(params: &PeopleParams) -> Result<(), Fault> {
    let PeopleParams {
        nearest_m,
        farthest_m,
        ..
    } = params;
    if nearest_m < farthest_m {
        return Ok(());
    }
    Err(Fault::user(format!(
        "expected `nearest_m` below `farthest_m`, found {nearest_m} m and {farthest_m} m"
    )))
}

/// Looks at images.
pub(crate) struct Looking {
    params: OfVehicle<PeopleParams>,
    cameras: Calibrated<Upright>,
}

/// What a thread keeps from image to image.
#[derive(Default)]
pub(crate) struct Room {
    grey: Grey,
    detector: Option<Detector>,
}

/// An image, with all that people are looked for with.
pub(crate) struct Sight<'a> {
    pub(crate) upright: &'a Upright,
    pub(crate) image: &'a GrayView<'a>,
    pub(crate) detector: &'a mut Detector,
    pub(crate) params: &'a PeopleParams,
}

impl Looking {
    pub(crate) fn new(params: &OfVehicle<PeopleParams>, sides: &Sides) -> Result<Self, Fault> {
        Ok(Self {
            params: params.clone(),
            cameras: Calibrated::new(sides, &params.vehicle, MOST_VIEWS)?,
        })
    }

    /// Height of the ground in the vehicle frame (m).
    pub(crate) fn plane_m(&self) -> f64 {
        self.params.options.plane_m
    }

    /// What is found in an image, named by session, camera and instant, that was recorded in this format.
    pub(crate) fn at<T>(
        &self,
        named: (&str, &str, Stamp),
        format: &str,
        bytes: &[u8],
        room: &mut Room,
        find: impl FnOnce(Sight<'_>) -> T,
    ) -> Result<T, Reason> {
        let undecoded = || undecoded(named.1, format);
        decode_grey(bytes, &mut room.grey).map_err(|error| left_out(&error, undecoded()))?;
        let Grey {
            width,
            height,
            ref data,
        } = room.grey;
        let view = GrayView::new(width, height, data).ok_or_else(undecoded)?;
        let upright = self.upright(named, [width, height])?;
        if room.detector.is_none() {
            let detector = PeopleDetector::new().map_err(|_| "detector does not work")?;
            room.detector = Some(Detector {
                detector,
                image: Grey::default(),
            });
        }
        let detector = room.detector.as_mut().ok_or("detector does not work")?;
        Ok(find(Sight {
            upright: &upright,
            image: &view,
            detector,
            params: &self.params.options,
        }))
    }

    fn upright(&self, named: (&str, &str, Stamp), size: [u32; 2]) -> Result<Arc<Upright>, Reason> {
        self.cameras.get(named, size, |mounted| {
            let MountedCamera {
                camera,
                vehicle_from_camera,
            } = mounted;
            Upright::new(camera, &vehicle_from_camera, &self.params.options)
                .ok_or("camera is not above the ground".into())
        })
    }
}

/// OpenCV's detector on pictures.
pub(crate) struct Detector {
    detector: PeopleDetector,
    image: Grey,
}

impl Detector {
    fn take(&mut self, picture: &Picture) {
        let height = picture.values.len() / picture.width.max(1);
        self.image.width = picture.width as u32;
        self.image.height = height as u32;
        self.image.data.clone_from(&picture.values);
    }
}

impl WindowDetector for Detector {
    fn scan(&mut self, image: &Picture, least: f64) -> Vec<([usize; 2], f64)> {
        self.take(image);
        let found = self.detector.scan(&self.image, least).unwrap_or_default();
        let place = |(at, score): ([u32; 2], f64)| (at.map(|at| at as usize), score);
        found.into_iter().map(place).collect()
    }

    fn score(&mut self, window: &Picture) -> f64 {
        self.take(window);
        self.detector.score(&self.image).unwrap_or(f64::NAN)
    }

    fn describe(&mut self, window: &Picture) -> Vec<f32> {
        self.take(window);
        self.detector.describe(&self.image).unwrap_or_default()
    }
}
