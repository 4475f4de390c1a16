#![doc = include_str!("people.md")]

use std::sync::Arc;

use evermap_algorithms::ground::people::search::people;
use evermap_algorithms::ground::people::upright::{Picture, Upright};
use evermap_algorithms::ground::people::{PeopleParams, WindowDetector};
use evermap_algorithms::ground::projection::GrayView;
use evermap_contract::{Fault, Operator, Port, Reach, Reason, Sides, Work};
use evermap_schemas::layers::{FrameImage, Person};
use evermap_vision::{Grey, PeopleDetector, decode_grey};

use crate::inputs::calibrated::{Calibrated, Mounted};
use crate::inputs::pixels::{left_out, undecoded};
use crate::inputs::rig::{self, OfVehicle};

/// See the module's page.
pub struct People;

impl Operator for People {
    const NAME: &'static str = "people";
    const VERSION: u32 = 1;
    const PAGE: &'static str = include_str!("people.md");
    type Params = OfVehicle<PeopleParams>;
    type Output = Person;

    fn work() -> Work<Self::Params> {
        let images = Port::session::<FrameImage>("images").pixels("image");
        let sides = rig::ports(Reach::Session).to_vec();
        Work::each_image(images, sides, Finder::new, Finder::people)
    }

    fn check(params: &Self::Params) -> Result<(), Fault> {
        let PeopleParams {
            nearest_m,
            farthest_m,
            ..
        } = params.options;
        if nearest_m < farthest_m {
            return Ok(());
        }
        Err(Fault::user(format!(
            "expected `nearest_m` below `farthest_m`, found {nearest_m} m and {farthest_m} m"
        )))
    }
}

/// Cameras kept at most, each with tables of some 20 MB.
const MOST_VIEWS: usize = 16;

struct Finder {
    params: OfVehicle<PeopleParams>,
    cameras: Calibrated<Upright>,
}

/// What a thread keeps from image to image.
#[derive(Default)]
struct Room {
    grey: Grey,
    detector: Option<Detector>,
}

impl Finder {
    fn new(params: &OfVehicle<PeopleParams>, sides: &Sides) -> Result<Self, Fault> {
        Ok(Self {
            params: params.clone(),
            cameras: Calibrated::new(sides, &params.vehicle, MOST_VIEWS)?,
        })
    }

    fn people(
        &self,
        image: FrameImage,
        bytes: &[u8],
        room: &mut Room,
    ) -> Result<Vec<Person>, Reason> {
        let undecoded = || undecoded(&image.camera, &image.image.format);
        decode_grey(bytes, &mut room.grey).map_err(|error| left_out(&error, undecoded()))?;
        let Grey {
            width,
            height,
            ref data,
        } = room.grey;
        let view = GrayView::new(width, height, data).ok_or_else(undecoded)?;
        let upright = self.upright(&image, [width, height])?;
        if room.detector.is_none() {
            let detector = PeopleDetector::new().map_err(|_| "detector does not work")?;
            room.detector = Some(Detector {
                detector,
                image: Grey::default(),
            });
        }
        let detector = room.detector.as_mut().ok_or("detector does not work")?;
        let found = people(&upright, &view, detector, &self.params.options);
        let rows = (0..).zip(found).map(|(person, found)| Person {
            site: image.site.clone(),
            session: image.session.clone(),
            stamp: image.stamp,
            camera: image.camera.clone(),
            person,
            x: found.position[0],
            y: found.position[1],
            z: self.params.options.plane_m,
            var_x_m2: found.covariance[0],
            cov_xy_m2: found.covariance[1],
            var_y_m2: found.covariance[2],
            range_m: found.range_m,
            rectangle: found.rectangle.to_vec(),
            score: found.score,
            probability: found.probability,
        });
        Ok(rows.collect())
    }

    fn upright(&self, image: &FrameImage, size: [u32; 2]) -> Result<Arc<Upright>, Reason> {
        let named = (&*image.session, &*image.camera, image.stamp);
        self.cameras.get(named, size, |mounted| {
            let Mounted {
                camera,
                vehicle_from_camera,
            } = mounted;
            Upright::new(camera, &vehicle_from_camera, &self.params.options)
                .ok_or("camera is not above the ground".into())
        })
    }
}

/// OpenCV's detector on pictures.
struct Detector {
    detector: PeopleDetector,
    image: Grey,
}

impl Detector {
    fn take(&mut self, picture: &Picture) -> &Grey {
        let height = picture.values.len() / picture.width.max(1);
        self.image.width = picture.width as u32;
        self.image.height = height as u32;
        self.image.data.clone_from(&picture.values);
        &self.image
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
}
