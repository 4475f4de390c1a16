//! From the numbers in a log to a camera.
//!
//! ROS `CameraInfo` names a model and gives a 3×3 K and a list D; other sources have habits of
//! their own. Everything is checked here, once, and an error says what was expected: a camera
//! built from half-filled fields would give a map that is wrong without looking wrong.

use super::spread::spread;
use super::{
    BrownConrady, Camera, Equirectangular, KannalaBrandt, Model, Ocam, OcamAffine, OcamCurve,
    Pinhole,
};
use nalgebra::Vector3;

/// The names [`Camera::from_calibration`] understands.
pub const MODEL_NAMES: [&str; 10] = [
    "",
    "none",
    "plumb_bob",
    "rational_polynomial",
    "equidistant",
    "kannala_brandt",
    "fisheye",
    "equirectangular",
    "ocam",
    "ocam_depth",
];

/// Why a calibration gives no camera.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum CameraError {
    /// The distortion model has no known name.
    #[error("unknown camera model \"{found}\"; known are {}", MODEL_NAMES[1..].join(", "))]
    UnknownModel {
        /// The name given.
        found: String,
    },
    /// K or D has a wrong number of entries.
    #[error("camera model \"{model}\": expected {what} of {expected} numbers, found {found}")]
    Count {
        /// The model asked for.
        model: String,
        /// `K` or `D`.
        what: &'static str,
        /// The counts that would do.
        expected: &'static str,
        /// The count given.
        found: usize,
    },
    /// A value makes no camera.
    #[error("camera model \"{model}\": {what}, found {found:?}")]
    Value {
        /// The model asked for.
        model: String,
        /// What was expected.
        what: &'static str,
        /// The value given.
        found: f64,
    },
    /// A pixel's ray is none that a lens has.
    #[error(
        "camera model \"{model}\": expected a ray of pixel {pixel:?} that leads back to it, found {found}"
    )]
    Ray {
        /// The model asked for.
        model: String,
        /// `[u, v]`.
        pixel: [f64; 2],
        /// What is there instead.
        found: String,
    },
    /// The image has no pixels.
    #[error("expected an image size in pixels, found {width} x {height}")]
    Size {
        /// Width given.
        width: u32,
        /// Height given.
        height: u32,
    },
}

/// Focal lengths are this many times the longer side of the image at least. A fisheye that sees all around would fill a spot
/// of 6 hundredths of its image; the image of a pinhole would span 178°, at whose edge the fourth power of the cosine leaves
/// less than a millionth of the light.
const SHORTEST: f64 = 0.01;

/// And this many at most: the lens would be 5 m before the sensor of a phone, which is 5 mm wide, and its image 0.06°.
const LONGEST: f64 = 1000.0;

/// What numbers of K's last row may be off by: a trace of the arithmetic that made them.
const LAST_ROW: f64 = 1e-6;

/// Places along each side of the image where a model is tried.
const TRIED: u32 = 9;

/// The part of those places, one in so many, that a model has rays for at least: a fisheye's circle, which leaves the corners
/// out, or all but a quarter of the longer side.
const SEEN: u32 = 20;

/// Rays are as far apart, in parts of what they are on the axis and as areas, somewhere in the image at least: those of a
/// pinhole 84° from its axis. A centre in other units, or far from the image, has all of them at the edge of the world.
const LEAST_SPREAD: f64 = 0.001;

/// And in parts of what they are without distortion, which moves pixels of an image and gathers not all of them in a spot.
const LEAST_KEPT: f64 = 0.1;

/// How far a ray may miss its pixel, in parts of the longer side, beyond one pixel. Polynomials of omnidirectional cameras
/// miss the axis, where none was fitted, by a few pixels.
const MISSED: f64 = 0.01;

/// That a camera has rays over its image, that they are finite, lead back to where they came from, and are not all one: by
/// distortion an image may be half as wide an angle as by [`LONGEST`].
fn check_view(model: &str, camera: &Camera) -> Result<(), CameraError> {
    let longer = f64::from(camera.width.max(camera.height));
    let at = |step: u32, size: u32| f64::from(step) / f64::from(TRIED - 1) * f64::from(size - 1);
    let mut seen = 0;
    for v in 0..TRIED {
        let mut before: Option<([f64; 2], Vector3<f64>)> = None;
        for u in 0..TRIED {
            let pixel = [at(u, camera.width), at(v, camera.height)];
            let ray = returning_ray(camera, pixel, 1.0 + MISSED * longer);
            let ray = ray.map_err(|found| CameraError::Ray {
                model: model.to_owned(),
                pixel,
                found,
            })?;
            if let (Some((other, beside)), Some(ray)) = (before, ray)
                && beside.angle(&ray) * 2.0 * LONGEST * longer < pixel[0] - other[0]
            {
                return Err(CameraError::Ray {
                    model: model.to_owned(),
                    pixel,
                    found: format!("that of pixel {other:?}"),
                });
            }
            seen += u32::from(ray.is_some());
            before = ray.map(|ray| (pixel, ray));
        }
    }
    match seen * SEEN >= TRIED * TRIED {
        true => Ok(()),
        false => Err(CameraError::Value {
            model: model.to_owned(),
            what: "expected rays for a twentieth of the image at least",
            found: f64::from(seen) / f64::from(TRIED * TRIED),
        }),
    }
}

/// That the rays of a camera are spread over a part of the world that an image shows.
fn check_spread(model: &str, camera: &Camera) -> Result<(), CameraError> {
    let Some(found) = spread(camera, TRIED) else {
        return Ok(());
    };
    let wrong = |what, found| {
        Err(CameraError::Value {
            model: model.to_owned(),
            what,
            found,
        })
    };
    if found.of_axis < LEAST_SPREAD {
        let what = "expected rays a thousandth as far apart, as areas, as on the axis of the lens at least";
        return wrong(what, found.of_axis);
    }
    if found.of_straight < LEAST_KEPT {
        let what =
            "expected rays a tenth as far apart, as areas, as without the distortion at least";
        return wrong(what, found.of_straight);
    }
    Ok(())
}

/// The ray of a pixel; `None` where the model ends before it.
fn returning_ray(
    camera: &Camera,
    pixel: [f64; 2],
    miss_px: f64,
) -> Result<Option<Vector3<f64>>, String> {
    let Some(ray) = camera.unproject(pixel) else {
        return Ok(None);
    };
    if !ray.iter().all(|part| part.is_finite()) {
        return Err("one that is not finite".to_owned());
    }
    // At its very end rounding decides whether the model goes so far.
    let Some([u, v]) = camera.project(&ray) else {
        return Ok(None);
    };
    match (u - pixel[0]).hypot(v - pixel[1]) <= miss_px {
        true => Ok(Some(ray)),
        false => Err(format!("one that leads to {:?}", [u, v])),
    }
}

impl Camera {
    /// A camera from a calibration message.
    ///
    /// `k` is either the nine entries of `[fx 0 cx; 0 fy cy; 0 0 1]`, row by row, or only
    /// `[fx, cx, fy, cy]` (its non-zero entries in that order; nine entries with zeros after the
    /// fourth count as this too). Pixel (0, 0) is the centre of the top-left pixel.
    ///
    /// | `model_name` | meaning | `d` |
    /// |---|---|---|
    /// | `""`, `none` | pinhole | empty or zeros |
    /// | `plumb_bob`, `rational_polynomial` | [`Pinhole`] | 0, 4, 5 or 8: k1 k2 p1 p2 k3 k4 k5 k6 |
    /// | `equidistant`, `kannala_brandt`, `fisheye` | [`KannalaBrandt`] | 0 or 4: k1 k2 k3 k4 |
    /// | `equirectangular` | [`Equirectangular`] | empty or zeros |
    /// | `ocam` | [`Ocam`], `k` = `[c d cx; e 1 cy; 0 0 1]` | [`OcamCurve::RadiusByElevation`] |
    /// | `ocam_depth` | the same | [`OcamCurve::DepthByRadius`] |
    ///
    /// The last row of nine entries is `0 0 1`, or `0 0 0` where nobody filled it in. More entries in `d` than a model has are
    /// accepted when they are zero. Focal lengths are of a hundredth to a thousand times the image's longer side, and the
    /// model has rays, which lead back to their pixels, for a twentieth of the image, and are spread as an image's are.
    ///
    /// # Errors
    /// [`CameraError`] says which number was not as expected, or which pixel.
    pub fn from_calibration(
        model_name: &str,
        width: u32,
        height: u32,
        k: &[f64],
        d: &[f64],
    ) -> Result<Self, CameraError> {
        if width == 0 || height == 0 {
            return Err(CameraError::Size { width, height });
        }
        let given = GivenIntrinsics {
            model: model_name,
            k,
            d,
            longer_px: f64::from(width.max(height)),
        };
        given.finite()?;
        let model = match model_name {
            "" | "none" => Model::Pinhole(given.pinhole(0, "0")?),
            "plumb_bob" | "rational_polynomial" => {
                Model::Pinhole(given.pinhole(8, "0, 4, 5 or 8")?)
            }
            "equidistant" | "kannala_brandt" | "fisheye" => {
                Model::KannalaBrandt(given.kannala_brandt()?)
            }
            "equirectangular" => Model::Equirectangular(given.equirectangular()?),
            "ocam" => given.ocam(width, height, OcamCurve::RadiusByElevation)?,
            "ocam_depth" => given.ocam(width, height, OcamCurve::DepthByRadius)?,
            found => {
                return Err(CameraError::UnknownModel {
                    found: found.to_owned(),
                });
            }
        };
        let camera = Camera::new(model, width, height);
        check_view(model_name, &camera)?;
        check_spread(model_name, &camera)?;
        Ok(camera)
    }
}

/// The numbers as given, with the name for error messages.
struct GivenIntrinsics<'a> {
    model: &'a str,
    k: &'a [f64],
    d: &'a [f64],
    /// The longer side of the image.
    longer_px: f64,
}

/// Focal lengths and centre, pixels.
struct Intrinsics {
    focal: [f64; 2],
    centre: [f64; 2],
}

impl GivenIntrinsics<'_> {
    fn count(&self, what: &'static str, expected: &'static str, found: usize) -> CameraError {
        CameraError::Count {
            model: self.model.to_owned(),
            what,
            expected,
            found,
        }
    }

    fn value(&self, what: &'static str, found: f64) -> CameraError {
        CameraError::Value {
            model: self.model.to_owned(),
            what,
            found,
        }
    }

    fn finite(&self) -> Result<(), CameraError> {
        match self.k.iter().chain(self.d).find(|value| !value.is_finite()) {
            Some(&found) => Err(self.value("expected finite numbers in K and D", found)),
            None => Ok(()),
        }
    }

    /// That the last row of a whole K is `0 0 1`: of a K that was written column by column the centre stands there. Drivers
    /// that fill in nothing but lengths and centre leave its 1 away.
    fn last_row(&self) -> Result<(), CameraError> {
        let Some([left, middle, right]) = self.k.get(6..9).filter(|_| self.k.len() == 9) else {
            return Ok(());
        };
        let off = |entry: f64, from: f64| (entry - from).abs() > LAST_ROW;
        let wrong = match off(*right, 0.0) && off(*right, 1.0) {
            true => Some(right),
            false => [left, middle].into_iter().find(|entry| off(**entry, 0.0)),
        };
        match wrong {
            Some(found) => {
                Err(self.value("expected 0 0 1 in the last row of K (row by row)", *found))
            }
            None => Ok(()),
        }
    }

    fn intrinsics(&self) -> Result<Intrinsics, CameraError> {
        self.last_row()?;
        let intrinsics = match *self.k {
            [fx, cx, fy, cy] | [fx, cx, fy, cy, 0.0, 0.0, 0.0, 0.0, 0.0] => Intrinsics {
                focal: [fx, fy],
                centre: [cx, cy],
            },
            [fx, skew, cx, lower, fy, cy, ..] if self.k.len() == 9 => {
                if skew != 0.0 || lower != 0.0 {
                    return Err(self.value("expected a K without skew", skew + lower));
                }
                Intrinsics {
                    focal: [fx, fy],
                    centre: [cx, cy],
                }
            }
            _ => return Err(self.count("K", "9 (row by row) or 4 [fx, cx, fy, cy]", self.k.len())),
        };
        for found in intrinsics.focal {
            if found <= 0.0 {
                return Err(self.value("expected positive focal lengths in K", found));
            }
            if found < SHORTEST * self.longer_px || found > LONGEST * self.longer_px {
                let what = "expected focal lengths in K of a hundredth to a thousand times the image's longer side";
                return Err(self.value(what, found));
            }
        }
        Ok(intrinsics)
    }

    /// The first `N` of D, whose given length must be one of `counts` once zeros beyond `N` are
    /// dropped; missing ones are zero.
    fn distortion<const N: usize>(
        &self,
        counts: &[usize],
        expected: &'static str,
    ) -> Result<[f64; N], CameraError> {
        let (used, beyond) = self.d.split_at(self.d.len().min(N));
        if !counts.contains(&used.len()) || beyond.iter().any(|value| *value != 0.0) {
            return Err(self.count("D", expected, self.d.len()));
        }
        let mut found = [0.0; N];
        found[..used.len()].copy_from_slice(used);
        Ok(found)
    }

    fn pinhole(&self, most: usize, expected: &'static str) -> Result<Pinhole, CameraError> {
        let Intrinsics { focal, centre } = self.intrinsics()?;
        let [k1, k2, p1, p2, k3, k4, k5, k6] = if most == 0 {
            self.distortion::<0>(&[0], expected)?;
            [0.0; 8]
        } else {
            self.distortion(&[0, 4, 5, 8], expected)?
        };
        let radial = [k1, k2, k3, k4, k5, k6];
        Ok(Pinhole::new(
            focal,
            centre,
            BrownConrady {
                radial,
                tangential: [p1, p2],
            },
        ))
    }

    fn kannala_brandt(&self) -> Result<KannalaBrandt, CameraError> {
        let Intrinsics { focal, centre } = self.intrinsics()?;
        Ok(KannalaBrandt::new(
            focal,
            centre,
            self.distortion(&[0, 4], "0 or 4")?,
        ))
    }

    fn equirectangular(&self) -> Result<Equirectangular, CameraError> {
        let Intrinsics { focal, centre } = self.intrinsics()?;
        self.distortion::<0>(&[0], "0")?;
        Ok(Equirectangular::new(focal, centre))
    }

    fn ocam(
        &self,
        width: u32,
        height: u32,
        curve: fn(Vec<f64>) -> OcamCurve,
    ) -> Result<Model, CameraError> {
        let [c, d, cx, e, one, cy, ..] = *self.k else {
            return Err(self.count("K", "9 [c d cx; e 1 cy; 0 0 1]", self.k.len()));
        };
        self.last_row()?;
        if one != 1.0 {
            return Err(self.value("expected K = [c d cx; e 1 cy; 0 0 1], with its 1", one));
        }
        if (c - d * e).abs() < 1e-9 {
            return Err(self.value(
                "expected an affine part [c d; e 1] with an inverse",
                c - d * e,
            ));
        }
        if self.d.len() < 2 {
            return Err(self.count("D", "2 or more (polynomial, rising powers)", self.d.len()));
        }
        let affine = OcamAffine { c, d, e, cx, cy };
        let corner = 2.0 * f64::from(width).hypot(f64::from(height));
        Ok(Model::Ocam(Ocam::new(
            affine,
            curve(self.d.to_vec()),
            corner,
        )))
    }
}
