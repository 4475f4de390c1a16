//! A folder of camera images with the people whom a map asks about, for programs that people draw boxes with.
//!
//! ```text
//!   DIR/0001_SESSION_CAMERA_STAMP.jpg …   the images, as they were recorded, or PNG
//!   DIR/coco.json                         the boxes that are asked about; of which image and place each is
//!   DIR/label_studio.json                 the same as tasks of Label Studio, the boxes as predictions
//! ```

use std::collections::BTreeMap;
use std::path::Path;

use evermap_catalog::PERSON;
use evermap_catalog::painted::ImageKey;
use evermap_schemas::layers::PersonQuestion;
use evermap_schemas::{Fault, Stamp};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use super::pixels::{Canvas, Pixel};

/// The file that says what the others are.
pub const INDEX: &str = "coco.json";
/// The tasks of Label Studio.
pub const TASKS: &str = "label_studio.json";
/// From the centre of the first pixel at (0, 0), as rectangles of layers have it, to its corner there, as programs do.
pub const CORNER: f64 = 0.5;
/// Letters of a session's or camera's name that the name of an image has at most.
const MOST_LETTERS: usize = 64;
/// The number of what is marked; there is only one thing.
const CATEGORY: u32 = 1;

/// The images of a folder, and whom is asked about: COCO, and what else there is to know of each.
#[derive(Debug, Default, Serialize, Deserialize)]
pub struct PersonImages {
    /// The images.
    pub images: Vec<PersonImage>,
    categories: Vec<Category>,
    /// Whom is asked about, by image.
    pub annotations: Vec<AskedBox>,
}

/// An image of a camera.
#[derive(Debug, Serialize, Deserialize)]
pub struct PersonImage {
    id: usize,
    /// Its name in the folder.
    pub file_name: String,
    width: u32,
    height: u32,
    /// Site of the map.
    pub site: String,
    session: String,
    camera: String,
    stamp: Stamp,
}

#[derive(Debug, Serialize, Deserialize)]
struct Category {
    id: u32,
    name: String,
}

/// Somebody whom is asked about.
#[derive(Debug, Serialize, Deserialize)]
pub struct AskedBox {
    id: usize,
    image_id: usize,
    category_id: u32,
    /// Left, top, width and height, px from the image's upper left corner.
    bbox: [f64; 4],
    area: f64,
    iscrowd: u32,
    segmentation: Vec<Vec<f64>>,
    score: f64,
    /// Number of the question.
    pub question: u32,
    /// Where they stand in the vehicle frame, m.
    pub x: f64,
    /// Where they stand.
    pub y: f64,
}

impl PersonImages {
    /// Those of a folder.
    ///
    /// # Errors
    /// A user fault for a folder that has none.
    pub fn read(folder: &Path) -> Result<Self, Fault> {
        let path = folder.join(INDEX);
        let at = |found: String| {
            Fault::user(format!("expected a folder of camera images, found {found}"))
                .at(path.display())
                .next("`evermap export person_questions --format coco` writes one")
        };
        let text = evermap_datasets::read_text(&path).map_err(|error| at(error.to_string()))?;
        let read: Self = serde_json::from_str(&text).map_err(|error| at(error.to_string()))?;
        match read.doubled() {
            Some(doubled) => Err(at(doubled)),
            None => Ok(read),
        }
    }

    /// Two images that have an id or a name in common, in words: nothing would tell whose boxes are whose.
    fn doubled(&self) -> Option<String> {
        let (mut ids, mut names) = (BTreeMap::new(), BTreeMap::new());
        self.images.iter().find_map(|image| {
            let PersonImage { id, file_name, .. } = image;
            if let Some(other) = ids.insert(id, file_name) {
                return Some(format!("{other} and {file_name}, both with the id {id}"));
            }
            let other = names.insert(file_name, id)?;
            Some(format!("{file_name} twice, with the ids {other} and {id}"))
        })
    }

    /// Adds an image of this size with those whom is asked about; `ending` is that of its file.
    pub fn add(&mut self, (size, ending): ([u32; 2], &str), asked: &[PersonQuestion]) {
        let Some(first) = asked.first() else {
            return;
        };
        if self.categories.is_empty() {
            self.categories.push(Category {
                id: CATEGORY,
                name: PERSON.to_owned(),
            });
        }
        let id = self.images.len() + 1;
        let [width, height] = size;
        self.images.push(PersonImage {
            id,
            file_name: format!("{id:04}_{}.{ending}", name(first)),
            width,
            height,
            site: first.site.clone(),
            session: first.session.clone(),
            camera: first.camera.clone(),
            stamp: first.stamp,
        });
        for question in asked {
            let Some([left, top, right, bottom]) = cut(&question.rectangle, size) else {
                continue;
            };
            let sides = [right - left, bottom - top];
            self.annotations.push(AskedBox {
                id: self.annotations.len() + 1,
                image_id: id,
                category_id: CATEGORY,
                bbox: [left, top, sides[0], sides[1]],
                area: sides[0] * sides[1],
                iscrowd: 0,
                segmentation: Vec::new(),
                score: question.probability,
                question: question.question,
                x: question.x,
                y: question.y,
            });
        }
    }

    /// The texts of COCO and of Label Studio.
    ///
    /// # Errors
    /// A bug fault.
    pub fn texts(&self) -> Result<[String; 2], Fault> {
        let coco = serde_json::to_string_pretty(self);
        let coco = coco.map_err(|error| Fault::bug(error.to_string()))?;
        let tasks: Vec<Value> = self.images.iter().map(|image| self.task(image)).collect();
        Ok([coco, format!("{:#}", Value::Array(tasks))].map(|text| text + "\n"))
    }

    /// Those whom is asked about in an image.
    pub fn asked<'a>(&'a self, image: &'a PersonImage) -> impl Iterator<Item = &'a AskedBox> {
        let asked = self.annotations.iter();
        asked.filter(move |one| one.image_id == image.id)
    }

    /// A task of Label Studio: what is asked about is what was predicted.
    fn task(&self, image: &PersonImage) -> Value {
        let sides = [image.width, image.height].map(f64::from);
        let percent = |value: f64, axis: usize| 100.0 * value / sides[axis];
        let result = |one: &AskedBox| {
            let [left, top, width, height] = one.bbox;
            json!({
                "id": format!("question_{}", one.question),
                "type": "rectanglelabels",
                "from_name": "label",
                "to_name": "image",
                "original_width": image.width,
                "original_height": image.height,
                "image_rotation": 0,
                "score": one.score,
                "value": {
                    "x": percent(left, 0),
                    "y": percent(top, 1),
                    "width": percent(width, 0),
                    "height": percent(height, 1),
                    "rotation": 0,
                    "rectanglelabels": [PERSON],
                },
            })
        };
        let results: Vec<Value> = self.asked(image).map(result).collect();
        let version = concat!("evermap ", env!("CARGO_PKG_VERSION"));
        json!({
            "data": { "image": image.file_name },
            "predictions": [{ "model_version": version, "result": results }],
        })
    }
}

impl PersonImage {
    /// What it is an image of.
    pub fn key(&self) -> ImageKey {
        (self.session.clone(), self.stamp, self.camera.clone())
    }

    /// What is drawn on.
    pub fn canvas(&self) -> Canvas {
        Canvas {
            name: self.file_name.clone(),
            size: [self.width, self.height],
        }
    }
}

impl AskedBox {
    /// Least and largest column and row, px from the image's upper left corner.
    pub fn bounds(&self) -> [Pixel; 2] {
        let [left, top, width, height] = self.bbox;
        [[left, top], [left + width, top + height]]
    }
}

/// Session, camera and instant of an image, of letters that every program keeps.
fn name(of: &PersonQuestion) -> String {
    let plain = |text: &str| -> String {
        let letters = text.trim_matches('/').chars();
        let plain = letters.map(
            |letter| match letter.is_ascii_alphanumeric() || letter == '-' {
                true => letter,
                false => '_',
            },
        );
        plain.take(MOST_LETTERS).collect()
    };
    format!(
        "{}_{}_{}",
        plain(&of.session),
        plain(&of.camera),
        of.stamp.0
    )
}

/// A rectangle of a layer as a program has it, as far as it is in an image of this size; `None` where it is none there.
fn cut(rectangle: &[f64], [width, height]: [u32; 2]) -> Option<[f64; 4]> {
    let [left, top, right, bottom]: [f64; 4] = rectangle.try_into().ok()?;
    let within = |at: f64, size: u32| (at + CORNER).clamp(0.0, f64::from(size));
    let [left, right] = [left, right].map(|at| within(at, width));
    let [top, bottom] = [top, bottom].map(|at| within(at, height));
    (left < right && top < bottom).then_some([left, top, right, bottom])
}

#[cfg(test)]
pub(super) mod tests;
