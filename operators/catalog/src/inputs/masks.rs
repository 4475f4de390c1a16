//! Where images show the vehicle that carries the camera, as somebody says it: parameter `mask`.

use std::collections::BTreeMap;

use evermap_contract::{Fault, GivenFile};
use evermap_vision::{Blind, Grey, ImageError, MAX_PIXELS, decode_labels};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::rig::frame;

/// Masks, as a plan or a session manifest gives them.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct Masks {
    /// Where images show the vehicle itself, by camera: polygons of `[u, v]` in the full image (px), for what `body_masks`
    /// misses; or, in place of what it learns, the path of a PNG or PGM of the images' size with one value per pixel, not
    /// 0 where it shows the vehicle. The camera `*` stands for all that are not named.
    #[schemars(extend("x-files" = true))]
    pub mask: BTreeMap<String, Mask>,
}

/// The parameter of operators that has a mask for each camera.
pub const MASK: &str = "mask";
/// What stands for all cameras that no mask names.
pub const ALL_CAMERAS: &str = "*";

/// The mask of a camera.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(from = "MaskForm", into = "MaskForm")]
pub enum Mask {
    /// Rings of `[u, v]` in the full image (px).
    Polygons(Vec<Vec<[f64; 2]>>),
    /// An image.
    Painted(Painted),
    /// One that cannot be read, and why.
    Unread(String),
}

/// An image of two values by its runs: equal images are equal text, however they were packed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Painted {
    /// Width of the image (px).
    pub width: u32,
    /// Height of the image (px).
    pub height: u32,
    /// How many pixels show the scenery, how many then the vehicle, and so on, row after row.
    pub runs: Vec<u32>,
}

/// A mask as it is written, and as it is handed on.
#[derive(Serialize, Deserialize, JsonSchema)]
#[serde(
    untagged,
    expecting = "expected polygons of [u, v], or the path of an image"
)]
#[schemars(rename = "Mask")]
enum MaskForm {
    /// Polygons of `[u, v]` in the full image (px).
    Polygons(Vec<Vec<[f64; 2]>>),
    /// The path of a PNG or PGM of the images' size, with one value per pixel: not 0 where it shows the vehicle.
    Path(String),
    /// The file, as it was read.
    File(GivenFile),
    /// What it shows.
    Painted(Painted),
}

impl JsonSchema for Mask {
    fn schema_name() -> std::borrow::Cow<'static, str> {
        MaskForm::schema_name()
    }

    fn json_schema(generator: &mut schemars::SchemaGenerator) -> schemars::Schema {
        MaskForm::json_schema(generator)
    }
}

impl From<MaskForm> for Mask {
    fn from(written: MaskForm) -> Self {
        match written {
            MaskForm::Polygons(polygons) => Self::Polygons(polygons),
            MaskForm::Path(path) => Self::Unread(format!("{path}: it was not read")),
            MaskForm::File(given) => match decode_labels(&given.hex) {
                Ok(image) => Self::Painted(Painted::of(&image)),
                Err(error) => Self::Unread(format!("{}: {}", given.file, why(error))),
            },
            MaskForm::Painted(painted) => match painted.is_whole() {
                true => Self::Painted(painted),
                false => Self::Unread("runs of an image of another size".to_owned()),
            },
        }
    }
}

impl From<Mask> for MaskForm {
    fn from(mask: Mask) -> Self {
        match mask {
            Mask::Polygons(polygons) => Self::Polygons(polygons),
            Mask::Painted(painted) => Self::Painted(painted),
            Mask::Unread(why) => Self::Path(why),
        }
    }
}

/// Why a mask is none; what holds for images of a log does not hold for it.
fn why(error: ImageError) -> ImageError {
    match error {
        ImageError::Format { found } => ImageError::Values { found },
        error => error,
    }
}

impl Painted {
    fn of(image: &Grey) -> Self {
        let mut runs = vec![0];
        let mut is_body = false;
        for value in &image.data {
            if (*value != 0) != is_body {
                is_body = !is_body;
                runs.push(0);
            }
            if let Some(run) = runs.last_mut() {
                *run += 1;
            }
        }
        Self {
            width: image.width,
            height: image.height,
            runs,
        }
    }

    /// Whether it has as many pixels as its size says, and no more than an image may have.
    fn is_whole(&self) -> bool {
        let pixels = u64::from(self.width) * u64::from(self.height);
        let runs = self.runs.iter().map(|run| u64::from(*run));
        pixels <= MAX_PIXELS && pixels == runs.sum::<u64>()
    }

    /// 255 where it shows the vehicle, else 0.
    pub(crate) fn image(&self) -> Grey {
        let mut data = Vec::new();
        for (at, run) in self.runs.iter().enumerate() {
            let value = if at % 2 == 1 { u8::MAX } else { 0 };
            data.resize(data.len() + *run as usize, value);
        }
        Grey {
            width: self.width,
            height: self.height,
            data,
        }
    }
}

impl Masks {
    /// That all of them could be read.
    ///
    /// # Errors
    /// A user fault at the camera whose mask could not.
    pub(crate) fn check(&self) -> Result<(), Fault> {
        let unread = self.mask.iter().find_map(|(camera, mask)| match mask {
            Mask::Unread(why) => Some((camera, why)),
            _ => None,
        });
        match unread {
            Some((camera, why)) => Err(Fault::user(format!(
                "expected an image that masks camera `{camera}`, found {why}"
            ))
            .at(format!("{MASK}.{camera}"))),
            None => Ok(()),
        }
    }
}

/// Masks, by the plain names of cameras, as what they cover.
pub(crate) struct CameraMasks(BTreeMap<String, Blind>);

impl CameraMasks {
    pub(crate) fn new(masks: &Masks) -> Self {
        let blind = |mask: &Mask| match mask {
            Mask::Polygons(polygons) => Blind {
                polygons: polygons.clone(),
                mask: None,
            },
            Mask::Painted(painted) => Blind {
                polygons: Vec::new(),
                mask: Some(painted.image()),
            },
            Mask::Unread(_) => Blind::default(),
        };
        let masks = masks.mask.iter();
        Self(
            masks
                .map(|(camera, mask)| (frame(camera).to_owned(), blind(mask)))
                .collect(),
        )
    }

    /// What is drawn for a camera; `None` where nothing is.
    pub(crate) fn of(&self, camera: &str) -> Option<&Blind> {
        self.0
            .get(frame(camera))
            .or_else(|| self.0.get(ALL_CAMERAS))
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use evermap_vision::encode_png;
    use serde_json::{Value, json};

    fn image() -> Grey {
        Grey {
            width: 3,
            height: 2,
            data: vec![1, 0, 0, 0, 255, 7],
        }
    }

    fn file(bytes: &[u8]) -> Value {
        let hex = bytes.iter().map(|byte| format!("{byte:02x}"));
        json!({ "file": "body.png", "hex": hex.collect::<String>() })
    }

    fn mask(value: Value) -> Mask {
        serde_json::from_value(value).unwrap()
    }

    fn masks<const N: usize>(given: [(&str, Mask); N]) -> Masks {
        let mask = given.map(|(camera, mask)| (camera.to_owned(), mask)).into();
        Masks { mask }
    }

    fn fault(value: Value) -> Fault {
        masks([("front", mask(value))]).check().unwrap_err()
    }

    #[test]
    fn an_image_is_the_same_however_it_is_packed() {
        let png = encode_png(&image()).unwrap();
        let pgm = b"P5\n3 2\n255\n\x09\0\0\0\x01\x02".to_vec();
        let runs = json!({ "width": 3, "height": 2, "runs": [0, 1, 3, 2] });
        for written in [file(&png), file(&pgm), runs.clone()] {
            let mask = mask(written);
            assert_eq!(serde_json::to_value(&mask).unwrap(), runs);
            let drawn = CameraMasks::new(&masks([("/front", mask)]));
            let shown = drawn.of("front").unwrap().mask.as_ref().unwrap();
            assert_eq!(shown.data, [255, 0, 0, 0, 255, 255]);
            assert!(drawn.of("rear").is_none());
        }
    }

    #[test]
    fn polygons_stay_polygons_and_a_star_stands_for_the_rest() {
        let ring = json!([[[0.0, 0.0], [3.0, 0.0], [3.0, 1.0]]]);
        let (front, all) = (mask(ring.clone()), mask(json!([])));
        assert_eq!(serde_json::to_value(&front).unwrap(), ring);
        let drawn = CameraMasks::new(&masks([("front", front), ("*", all)]));
        let rings = |camera| drawn.of(camera).unwrap().polygons.len();
        assert_eq!([rings("/front"), rings("rear")], [1, 0]);
    }

    #[test]
    fn what_cannot_be_read_is_told_with_camera_and_file() {
        for (written, said) in [
            (file(b"no image"), "body.png: expected a png or pgm"),
            (file(b"\xff\xd8\xff\xe0"), "body.png: "),
            (file(b"P6\n1 1\n255\n\0\0\0"), "a pnm image in colour"),
            (file(b"P5\n3 2\n255\n\0"), "truncated or damaged"),
            (file(b"P5\n99999 99999\n255\n\0"), "99999 x 99999"),
            (json!("body.png"), "body.png: it was not read"),
            (
                json!({ "width": 70_000, "height": 70_000, "runs": [4_294_967_295_u32, 605_032_705] }),
                "another size",
            ),
            (
                json!({ "width": 3, "height": 2, "runs": [5] }),
                "another size",
            ),
        ] {
            let fault = fault(written);
            assert_eq!(fault.place, "mask.front");
            let begins = "expected an image that masks camera `front`, found ";
            assert!(fault.message.starts_with(begins), "{fault}");
            assert!(fault.message.contains(said), "{fault} and {said}");
        }
        let misfit = serde_json::from_value::<Mask>(json!(5)).unwrap_err();
        assert!(misfit.to_string().contains("expected polygons"), "{misfit}");
    }
}
