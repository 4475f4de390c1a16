#![doc = include_str!("taught_labels.md")]

use std::collections::BTreeMap;

use evermap_algorithms::semantic_map::semantic_graph::{MOST_CLASSES, VOID};
use evermap_contract::{Emit, Fault, NothingToChoose, Operator, Pixels, Port, Reason, Sides, Work};
use evermap_schemas::layers::LabelImage;
use evermap_schemas::roles::ImageAnnotation;
use evermap_schemas::{Bytes, ImageRef, Stamp, record};
use evermap_vision::{Grey, decode_grey};

use crate::inputs::painting::{ImageKey, by_image, lying, paint};
use crate::inputs::pixels::{label_image, left_out, undecoded, values_on_image};

/// See the module's page.
pub struct TaughtLabels;

record! {
    /// An image that somebody painted on, with the labels that it has otherwise.
    #[layer("painted_frames", key(site, session, stamp, camera))]
    pub struct PaintedFrame {
        /// Site that was driven.
        site: String,
        /// Session that was driven.
        session: String,
        /// Exposure instant.
        stamp: Stamp ["ns"],
        /// Camera that took the image.
        camera: String,
        /// Where the pixels are.
        image: ImageRef,
        /// Names of the classes of its labels; null where it has none.
        classes: Option<Vec<String>>,
        /// Its labels as an 8-bit grey PNG, 255 where a pixel has no class; null where it has none.
        png: Option<Bytes>,
    }
}

impl Operator for TaughtLabels {
    const NAME: &'static str = "taught_labels";
    const VERSION: u32 = 1;
    const PAGE: &'static str = include_str!("taught_labels.md");
    type Params = NothingToChoose;
    type Output = LabelImage;

    fn work() -> Work<Self::Params> {
        let frames = Port::session::<PaintedFrame>("frames").pixels("image");
        let annotations = Port::site::<ImageAnnotation>("annotations");
        Work::batches(frames, vec![annotations], SitePaint::new, SitePaint::images)
    }
}

/// What was said of a site's images.
struct SitePaint(BTreeMap<ImageKey, Vec<ImageAnnotation>>);

impl SitePaint {
    fn new(_: &NothingToChoose, sides: &Sides) -> Result<Self, Fault> {
        Ok(Self(by_image(sides.rows("annotations")?)))
    }

    fn images(
        &self,
        frames: Vec<PaintedFrame>,
        pixels: &Pixels,
        emit: &mut Emit<'_>,
    ) -> Result<(), Fault> {
        let mut room = Grey::default();
        for (row, frame) in frames.into_iter().enumerate() {
            let key = (frame.session.clone(), frame.stamp, frame.camera.clone());
            let acts = self.0.get(&key).map_or(&[][..], Vec::as_slice);
            let lying = lying(acts, &mut |reason, count| emit.skip(reason, count));
            if lying.is_empty() {
                continue;
            }
            let Some(bytes) = pixels.get(row) else {
                continue;
            };
            let label = Canvas::of(&frame, bytes, &mut room).and_then(|mut canvas| {
                canvas.lay_all(&lying, emit);
                canvas.row(frame)
            });
            match label {
                Ok(label) => emit.rows(vec![label])?,
                Err(reason) => emit.skip(reason, 1),
            }
        }
        Ok(())
    }
}

/// The labels of an image while it is painted.
struct Canvas {
    classes: Vec<String>,
    labels: Grey,
}

impl Canvas {
    /// The labels that the image has otherwise; else none anywhere.
    fn of(frame: &PaintedFrame, bytes: &[u8], room: &mut Grey) -> Result<Self, Reason> {
        let undecoded = || undecoded(&frame.camera, &frame.image.format);
        decode_grey(bytes, room).map_err(|error| left_out(&error, undecoded()))?;
        let (Some(png), Some(classes)) = (&frame.png, &frame.classes) else {
            let data = vec![VOID; room.data.len()];
            return Ok(Self {
                classes: Vec::new(),
                labels: Grey { data, ..*room },
            });
        };
        let data = values_on_image(&png.0, [room.width, room.height])?;
        Ok(Self {
            classes: classes.clone(),
            labels: Grey { data, ..*room },
        })
    }

    /// Lays paint over paint; what cannot be painted is counted.
    fn lay_all(&mut self, lying: &[&ImageAnnotation], emit: &mut Emit<'_>) {
        for act in lying {
            let size = [self.labels.width, self.labels.height].map(|side| side as usize);
            let Ok(paint) = paint(act, size) else {
                emit.skip(
                    "paint outside of its image, or with an outline that cannot be filled",
                    1,
                );
                continue;
            };
            match self.value(&act.class) {
                Some(value) => paint.lay(&mut self.labels.data, size[0], value),
                None => emit.skip("paint of one class more than labels have room for", 1),
            }
        }
    }

    /// The value of a class, which is new the first time.
    fn value(&mut self, name: &str) -> Option<u8> {
        let known = self.classes.iter().position(|class| class == name);
        let value = known.unwrap_or(self.classes.len());
        if value >= MOST_CLASSES {
            return None;
        }
        if known.is_none() {
            self.classes.push(name.to_owned());
        }
        Some(value as u8)
    }

    fn row(self, frame: PaintedFrame) -> Result<LabelImage, Reason> {
        let (width, height) = (self.labels.width, self.labels.height);
        Ok(LabelImage {
            site: frame.site,
            session: frame.session,
            stamp: frame.stamp,
            camera: frame.camera,
            width,
            height,
            classes: self.classes,
            png: label_image([width, height], self.labels.data)?,
        })
    }
}
