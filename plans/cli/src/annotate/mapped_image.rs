//! Somebody in a camera image: where they stand around whom a box is drawn, what box is around who stands there, and the
//! feature that says so. Boxes are in px from the image's upper left corner.

use evermap_algorithms::geometry::pose::Pose;
use evermap_algorithms::ground::people::PeopleParams;
use evermap_algorithms::ground::people::boxed::{around, overlap, standing};
use evermap_catalog::PERSON;
use evermap_catalog::annotated::Holds;
use evermap_catalog::painted::ImageKey;
use evermap_schemas::Fault;
use nalgebra::Vector3;
use serde_json::Value;

use super::features::{DrawnFeature, Geometry, Point};
use super::person_images::CORNER;
use super::state::State;
use crate::reader::MapReader;

/// A box that was drawn is about who was asked about if the two share as much of what they cover together: people draw
/// tighter than a detector.
const SAME: f64 = 0.3;
/// Half the side of the box that is drawn where somebody stands, m.
const HALF_M: f64 = 0.2;

/// Left, top, right and bottom of a box, px from the image's upper left corner.
pub type PixelBox = [f64; 4];

/// How much two boxes share, as a part of what they cover together; `None` where they are not around the same person.
pub fn same(one: &PixelBox, other: &PixelBox) -> Option<f64> {
    let shared = overlap(one, other);
    (shared >= SAME).then_some(shared)
}

/// What becomes of the sides of a box, each with its axis: left and right lie along 0, top and bottom along 1.
fn each_side(of: PixelBox, moved: impl Fn(f64, usize) -> f64) -> PixelBox {
    [0, 1, 2, 3].map(|side| moved(of[side], side % 2))
}

/// Height of the ground in the vehicle frame (m), as the steps of a site's map had it; 0 where none says.
///
/// # Errors
/// A resource fault when the store does not answer.
pub async fn plane_m(reader: &MapReader, site: &str) -> Result<f64, Fault> {
    let said = reader.map.parameter("plane_m", site).await?;
    Ok(said.as_ref().and_then(Value::as_f64).unwrap_or(0.0))
}

/// An image, and what the map knows of it.
pub struct MappedImage<'a> {
    image: &'a ImageKey,
    /// Width and height, px.
    size: [u32; 2],
    map_from_vehicle: Pose,
    holds: &'a Holds,
    params: PeopleParams,
}

impl<'a> MappedImage<'a> {
    /// An image of this width and height (px) of a map; `plane_m` is the height of the ground in the vehicle frame.
    ///
    /// # Errors
    /// In words, for an image that the map has no vehicle pose of.
    pub fn new(
        image: &'a ImageKey,
        size: [u32; 2],
        (state, plane_m): (&'a State, f64),
    ) -> Result<Self, &'static str> {
        let map_from_vehicle = state.map_from_vehicle(image);
        Ok(Self {
            image,
            size,
            map_from_vehicle: map_from_vehicle
                .ok_or("image that the map has no vehicle pose of")?,
            holds: &state.holds,
            params: PeopleParams {
                plane_m,
                ..PeopleParams::default()
            },
        })
    }

    /// Where in the vehicle frame somebody stands around whom a box is drawn, m.
    ///
    /// # Errors
    /// In words, for a camera that the map does not know, and a box that is around nobody on the ground.
    pub fn standing(&self, drawn: &PixelBox) -> Result<[f64; 2], &'static str> {
        let (session, _, camera) = self.image;
        let mounted = self.holds.camera(session, camera);
        let mounted =
            mounted.ok_or("box of a new person, in a camera that the map does not know")?;
        let scale = self.scale([mounted.camera.width, mounted.camera.height]);
        let drawn = each_side(*drawn, |at, axis| at / scale[axis] - CORNER);
        let found = standing(
            &mounted.camera,
            &mounted.vehicle_from_camera,
            &drawn,
            &self.params,
        );
        found.ok_or("box of a new person that no one standing near the vehicle would fill")
    }

    /// The box around somebody of usual size who stands at a point of the vehicle frame (m), as far as the image goes; `None`
    /// where it does not show them, or the map does not know the camera.
    pub fn around(&self, at: [f64; 2]) -> Option<PixelBox> {
        let (session, _, camera) = self.image;
        let mounted = self.holds.camera(session, camera)?;
        let scale = self.scale([mounted.camera.width, mounted.camera.height]);
        let around = around(
            &mounted.camera,
            &mounted.vehicle_from_camera,
            at,
            &self.params,
        );
        Some(each_side(around?, |at, axis| {
            let most = f64::from(self.size[axis]);
            ((at + CORNER) * scale[axis]).clamp(0.0, most)
        }))
    }

    /// How many pixels of the image are one of the lens: that is the one of images of the calibration's size.
    fn scale(&self, lens: [u32; 2]) -> [f64; 2] {
        [0, 1].map(|axis| f64::from(self.size[axis]) / f64::from(lens[axis]))
    }

    /// The feature that says something of who stands at a point of the vehicle frame (m): a small box in the map, tied to
    /// the image. `place` says which one, for people.
    pub fn feature(&self, place: String, standing: &str, [x, y]: [f64; 2]) -> DrawnFeature {
        let corners = [[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]];
        let corner = |[ahead, left]: [f64; 2]| -> Point {
            let plane_m = self.params.plane_m;
            let at = Vector3::new(x + HALF_M * ahead, y + HALF_M * left, plane_m);
            let at = self.map_from_vehicle.transform(&at);
            ([at.x, at.y], Some(at.z))
        };
        DrawnFeature {
            place,
            label: None,
            within_m: None,
            kind: Some(PERSON.to_owned()),
            category: None,
            standing: Some(standing.to_owned()),
            geometry: Some(Geometry::Closed(corners.map(corner).to_vec())),
            brush_px: None,
            image: Some(self.image.clone()),
        }
    }
}
