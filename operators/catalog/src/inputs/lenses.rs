//! What a calibration says of a whole image: whether it goes all around, and how far it sees.

use std::collections::BTreeMap;

use evermap_algorithms::geometry::camera::Camera;
use evermap_contract::{Fault, Port, Reach, Reason, Sides};
use evermap_schemas::Stamp;
use evermap_schemas::roles::Calibration;

use crate::inputs::rig::{self, Rig, frame};

/// The lenses of a site's cameras. An image without a calibration that can be used is taken for a plain one: its last
/// column is not next to its first one, and how far it sees is not known.
pub(crate) struct Lenses {
    /// By session.
    rigs: BTreeMap<String, Rig>,
}

/// The port that they are read from.
pub(crate) fn port(reach: Reach) -> Port {
    Port::of::<Calibration>("calibration", reach).optional()
}

impl Lenses {
    /// From the port `calibration`.
    pub(crate) fn new(sides: &Sides) -> Result<Self, Fault> {
        Ok(Self {
            rigs: rig::rigs(sides.rows("calibration")?, Vec::new()),
        })
    }

    /// The camera that took an image of this size (px), as calibrated at that instant; `None` where it is not calibrated.
    ///
    /// # Errors
    /// In words, for a calibration that no lens has, or one of images of another shape.
    pub(crate) fn camera(
        &self,
        (session, camera, stamp): (&str, &str, Stamp),
        size: [u32; 2],
    ) -> Result<Option<Camera>, Reason> {
        let rig = self.rigs.get(session);
        let found = rig.and_then(|rig| rig.calibration(frame(camera), stamp).ok());
        found.map(|found| rig::camera(found, size)).transpose()
    }

    /// Whether the last column of an image of this size (px) is next to its first one.
    pub(crate) fn wraps(&self, image: (&str, &str, Stamp), size: [u32; 2]) -> bool {
        let camera = self.camera(image, size).ok().flatten();
        camera.is_some_and(|camera| camera.wraps())
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use evermap_schemas::batch;
    use std::f64::consts::TAU;

    fn calibration(camera: &str, model: &str) -> Calibration {
        let f = 1024.0 / TAU;
        Calibration {
            site: "town".into(),
            session: "a".into(),
            stamp: Stamp(0),
            camera: camera.into(),
            width: 1024,
            height: 333,
            model: model.into(),
            intrinsics: vec![f, 511.5, f, 166.0],
            distortion: Vec::new(),
            mount: None,
        }
    }

    #[test]
    fn the_calibration_says_which_images_go_around() {
        let rows = vec![
            calibration("/roof", "equirectangular"),
            calibration("odd", "of no known lens"),
        ];
        let table = ("calibration".to_owned(), vec![batch(rows).unwrap()]);
        let lenses = Lenses::new(&Sides::new(BTreeMap::from([table]))).unwrap();
        let at = |session, camera| (session, camera, Stamp(5));
        assert!(lenses.wraps(at("a", "roof"), [1024, 333]));
        // Of half the size, but not cut.
        assert!(lenses.wraps(at("a", "roof"), [512, 167]));
        for plain in [at("b", "roof"), at("a", "front"), at("a", "odd")] {
            assert!(!lenses.wraps(plain, [1024, 333]), "{plain:?}");
        }
    }
}
