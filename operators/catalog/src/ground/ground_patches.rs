#![doc = include_str!("ground_patches.md")]

use std::collections::BTreeMap;
use std::sync::Arc;

use evermap_algorithms::geometry::pose::Pose;
use evermap_algorithms::ground::floor::Floor;
use evermap_algorithms::ground::projection::{GrayView, GroundLut, GroundParams, ImageView};
use evermap_contract::{Emit, Fault, Operator, Pixels, Port, Reach, Reason, Sides, Work};
use evermap_schemas::Bytes;
use evermap_schemas::layers::{BodyMask, GroundPatch, PosedImage, VehiclePose};
use evermap_vision::{Grey, ImageError, Rgb, decode_colour, decode_grey, holds_colour, image_size};
use rayon::prelude::*;

use crate::inputs::bodies::bodies;
use crate::inputs::calibrated::{Calibrated, MountedCamera};
use crate::inputs::floors::floors;
use crate::inputs::pixels::{left_out, undecoded};
use crate::inputs::rig::{self, OfVehicle, frame};

/// See the module's page.
pub struct GroundPatches;

impl Operator for GroundPatches {
    const NAME: &'static str = "ground_patches";
    const VERSION: u32 = 4;
    const PAGE: &'static str = include_str!("ground_patches.md");
    type Params = OfVehicle<GroundParams>;
    type Output = GroundPatch;

    fn work() -> Work<Self::Params> {
        let images = Port::session::<PosedImage>("images").pixels("image");
        let mut sides = rig::ports(Reach::Session).to_vec();
        sides.push(Port::session::<BodyMask>("body_masks").optional());
        sides.push(Port::session::<VehiclePose>("poses").optional());
        Work::batches(images, sides, Projector::new, Projector::patches)
    }

    fn check(params: &Self::Params) -> Result<(), Fault> {
        let checked = params.options.check();
        checked.map_err(|error| Fault::user(error.to_string()))
    }
}

/// Tables kept at most.
const MOST_TABLES: usize = 256;

struct Projector {
    params: OfVehicle<GroundParams>,
    /// By session and camera.
    bodies: BTreeMap<(String, String), Grey>,
    tables: Calibrated<GroundLut>,
    /// By session.
    floors: BTreeMap<String, Floor>,
}

/// Where images are decoded, one after the other.
#[derive(Default)]
struct Room {
    grey: Grey,
    rgb: Rgb,
}

impl Room {
    /// An image in colour where it holds any; `None` where it has more or fewer values than its size says.
    fn decoded(&mut self, bytes: &[u8]) -> Result<Option<ImageView<'_>>, ImageError> {
        if holds_colour(bytes)? {
            decode_colour(bytes, &mut self.rgb)?;
            let Rgb {
                width,
                height,
                data,
            } = &self.rgb;
            return Ok(ImageView::of_colours(*width, *height, data));
        }
        decode_grey(bytes, &mut self.grey)?;
        let Grey {
            width,
            height,
            data,
        } = &self.grey;
        let view = GrayView::new(*width, *height, data);
        Ok(view.as_ref().map(ImageView::from))
    }
}

/// How far beyond the reach of a camera heights are asked for, metres: it may sit so far from its vehicle's origin.
const BESIDE_M: f64 = 5.0;

impl Projector {
    fn new(params: &OfVehicle<GroundParams>, sides: &Sides) -> Result<Self, Fault> {
        let poses: Vec<VehiclePose> = sides.rows("poses")?;
        let reach_m = params.options.reach_m + BESIDE_M;
        Ok(Self {
            params: params.clone(),
            bodies: bodies(sides)?,
            tables: Calibrated::new(sides, &params.vehicle, MOST_TABLES)?,
            floors: floors(&poses, params.options.plane_m, reach_m),
        })
    }

    fn patches(
        &self,
        images: Vec<PosedImage>,
        pixels: &Pixels,
        emit: &mut Emit<'_>,
    ) -> Result<(), Fault> {
        // Tables first, one after the other: making one already uses all cores.
        let planned: Vec<_> = images
            .into_iter()
            .enumerate()
            .filter_map(|(row, image)| Some((self.plan(&image, pixels.get(row)?), image)))
            .collect();
        let patches = planned
            .into_par_iter()
            .map_init(Room::default, |room, (plan, image)| {
                let (bytes, table) = plan?;
                Ok([self.patch(image, bytes, &table, room)?])
            });
        emit.made(patches.collect())
    }

    fn plan<'a>(
        &self,
        image: &PosedImage,
        bytes: &'a [u8],
    ) -> Result<(&'a [u8], Arc<GroundLut>), Reason> {
        let size = image_size(bytes);
        let undecoded = || undecoded(&image.camera, &image.image.format);
        let size = size.map_err(|error| left_out(&error, undecoded()))?;
        let named = (&*image.session, &*image.camera, image.stamp);
        let table = self.tables.get(named, size, |mounted| {
            let body = self
                .bodies
                .get(&(image.session.clone(), frame(&image.camera).to_owned()));
            let body = body.filter(|body| [body.width, body.height] == size);
            let mask = body.map(|body| body.data.as_slice());
            let MountedCamera {
                camera,
                vehicle_from_camera,
            } = mounted;
            GroundLut::new(&camera, &vehicle_from_camera, &self.params.options, mask)
                .map_err(|_| "camera is not above the ground".into())
        })?;
        Ok((bytes, table))
    }

    fn patch(
        &self,
        image: PosedImage,
        bytes: &[u8],
        table: &GroundLut,
        room: &mut Room,
    ) -> Result<GroundPatch, Reason> {
        let pose = Pose::from_array(image.map_from_vehicle.to_array())
            .map_err(|_| "pose is not a rigid transform")?;
        let undecoded = || undecoded(&image.camera, &image.image.format);
        let decoded = room.decoded(bytes);
        let decoded = decoded.map_err(|error| left_out(&error, undecoded()))?;
        let view = decoded.ok_or_else(undecoded)?;
        let cell_m = self.params.options.cell_m;
        let patch = table
            .patch(view, &pose, self.floors.get(&image.session), cell_m)
            .ok_or("image shows no ground")?;
        let place = |cell: i64| i32::try_from(cell).map_err(|_| "pose is out of the map");
        let size = |cells: usize| u32::try_from(cells).map_err(|_| "pose is out of the map");
        Ok(GroundPatch {
            site: image.site,
            session: image.session,
            stamp: image.stamp,
            camera: image.camera,
            cell_m,
            column: place(patch.column)?,
            row: place(patch.row)?,
            width: size(patch.width)?,
            height: size(patch.height)?,
            values: Bytes(patch.values),
            weights: Bytes(patch.weights),
        })
    }
}
