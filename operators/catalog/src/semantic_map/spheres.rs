#![doc = include_str!("spheres.md")]

use std::collections::BTreeMap;

use evermap_algorithms::semantic_map::stable::sphere::Lens;
use evermap_contract::{Fault, Operator, Port, Reason, Sides, Work};
use evermap_schemas::layers::SphereView;
use evermap_schemas::roles::{Calibration, Frame};
use evermap_schemas::{Bytes, Stamp};
use evermap_vision::{decode_depth, image_size};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::inputs::pixels::{left_out, undecoded};
use crate::inputs::rig::{self, Rig, frame};

/// See the module's page.
pub struct Spheres;

/// How range is read.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct SpheresParams {
    /// Metres per unit of the range images.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub depth_scale_m: f64,
}

impl Default for SpheresParams {
    fn default() -> Self {
        Self {
            depth_scale_m: 0.001,
        }
    }
}

impl Operator for Spheres {
    const NAME: &'static str = "spheres";
    const VERSION: u32 = 1;
    const PAGE: &'static str = include_str!("spheres.md");
    type Params = SpheresParams;
    type Output = SphereView;

    fn work() -> Work<Self::Params> {
        let frames = Port::session::<Frame>("frames").pixels("image");
        let sides = vec![
            Port::session::<Frame>("depth").pixels("image"),
            Port::session::<Calibration>("calibration"),
        ];
        Work::each_image(frames, sides, Site::new, Site::sphere)
    }
}

/// Range images and cameras of a site's sessions.
struct Site {
    unit_m: f64,
    /// By session, camera and instant.
    range: BTreeMap<(String, String, Stamp), Vec<u8>>,
    rigs: BTreeMap<String, Rig>,
}

impl Site {
    fn new(params: &SpheresParams, sides: &Sides) -> Result<Self, Fault> {
        let frames = sides.rows::<Frame>("depth")?;
        let pixels = sides.pixels("depth", "image")?;
        let mut range = BTreeMap::new();
        for (row, frame) in frames.into_iter().enumerate() {
            if let Some(bytes) = pixels.get(row) {
                range.insert((frame.session, frame.camera, frame.stamp), bytes.to_vec());
            }
        }
        Ok(Self {
            unit_m: params.depth_scale_m,
            range,
            rigs: rig::rigs(sides.rows("calibration")?, Vec::new()),
        })
    }

    fn sphere(&self, row: Frame, image: &[u8], _: &mut ()) -> Result<[SphereView; 1], Reason> {
        let size = image_size(image);
        let undecoded = || undecoded(&row.camera, &row.image.format);
        let [width, height] = size.map_err(|error| left_out(&error, undecoded()))?;
        let key = (row.session, row.camera, row.stamp);
        let range = self.range.get(&key).ok_or("view has no range image")?;
        let (session, camera, stamp) = key;
        let decoded = decode_depth(range).map_err(|_| "range image does not decode")?;
        if [decoded.width, decoded.height] != [width, height] {
            return Err("range image has another size than the image".into());
        }
        let rig = self.rigs.get(&session);
        let rig = rig.ok_or_else(|| rig::uncalibrated(frame(&camera)))?;
        let calibration = rig.calibration(frame(&camera), stamp)?;
        let lens = Lens::of_camera(&rig::camera(calibration, [width, height])?);
        let lens = lens.ok_or("camera takes no panoramas")?;
        Ok([SphereView {
            site: row.site,
            stamp,
            width,
            height,
            focal: lens.focal.to_vec(),
            centre: lens.centre.to_vec(),
            image: Bytes(image.to_vec()),
            range: Bytes(range.clone()),
            unit_m: self.unit_m,
            session,
            camera,
        }])
    }
}
