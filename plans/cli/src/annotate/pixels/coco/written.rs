//! What is read of COCO, whatever else it has.

use serde::de::{MapAccess, SeqAccess};

use crate::annotate::pixels::outline::{Numbers, PixelOutline};
use crate::annotate::pixels::{NAME, NO_SHAPE, Rectangle, Shape, degrees};
use crate::annotate::reading::{AnyJson, JsonToken, Lenient, Listed, Member, skipped, value};

/// A file.
#[derive(Debug, Default)]
pub(super) struct CocoFile {
    pub(super) images: Listed<WrittenPicture>,
    pub(super) annotations: Listed<WrittenAnnotation>,
    pub(super) categories: Listed<WrittenCategory>,
}

impl Lenient for CocoFile {
    fn member<'de, A: MapAccess<'de>>(
        &mut self,
        name: &str,
        object: &mut A,
    ) -> Result<(), A::Error> {
        match name {
            "images" => self.images = value(object)?,
            "annotations" => self.annotations = value(object)?,
            "categories" => self.categories = value(object)?,
            _ => skipped(object)?,
        }
        Ok(())
    }
}

#[derive(Debug, Default)]
pub(super) struct WrittenPicture {
    pub(super) id: Member,
    pub(super) file_name: Member,
    pub(super) width: Member,
    pub(super) height: Member,
}

impl Lenient for WrittenPicture {
    fn member<'de, A: MapAccess<'de>>(
        &mut self,
        name: &str,
        object: &mut A,
    ) -> Result<(), A::Error> {
        match name {
            "id" => self.id = value(object)?,
            "file_name" => self.file_name = value(object)?,
            "width" => self.width = value(object)?,
            "height" => self.height = value(object)?,
            _ => skipped(object)?,
        }
        Ok(())
    }
}

#[derive(Debug, Default)]
pub(super) struct WrittenCategory {
    pub(super) id: Member,
    pub(super) name: Member,
}

impl Lenient for WrittenCategory {
    fn member<'de, A: MapAccess<'de>>(
        &mut self,
        name: &str,
        object: &mut A,
    ) -> Result<(), A::Error> {
        match name {
            "id" => self.id = value(object)?,
            "name" => self.name = value(object)?,
            _ => skipped(object)?,
        }
        Ok(())
    }
}

#[derive(Debug, Default)]
pub(super) struct WrittenAnnotation {
    pub(super) image_id: Member,
    pub(super) category_id: Member,
    segmentation: Segmentation,
    bbox: Numbers<4>,
    attributes: Attributes,
}

impl Lenient for WrittenAnnotation {
    fn member<'de, A: MapAccess<'de>>(
        &mut self,
        name: &str,
        object: &mut A,
    ) -> Result<(), A::Error> {
        match name {
            "image_id" => self.image_id = value(object)?,
            "category_id" => self.category_id = value(object)?,
            "segmentation" => self.segmentation = value(object)?,
            "bbox" => self.bbox = value(object)?,
            "attributes" => self.attributes = value(object)?,
            _ => skipped(object)?,
        }
        Ok(())
    }
}

impl WrittenAnnotation {
    /// The label that it is, where it says so.
    pub(super) fn name(&self) -> Option<String> {
        self.attributes.name.word()
    }

    /// Whether its outline is not taken, but the box around it.
    pub(super) fn is_coarse(&self) -> bool {
        match self.segmentation.is {
            Member::List => self.segmentation.count > 1,
            Member::Object => true,
            _ => false,
        }
    }

    /// # Errors
    /// In words, for what is none.
    pub(super) fn shape(self) -> Result<Shape, &'static str> {
        let Segmentation { is, count, first } = self.segmentation;
        if let (Member::List, 1, Some(outline)) = (is, count, first.into_iter().next()) {
            return outline.shape();
        }
        let [left, top, width, height] = self.bbox.all().ok_or(NO_SHAPE)?;
        let degrees = degrees(&self.attributes.rotation)?;
        let found = Rectangle::about_middle([left, top], [width, height], degrees);
        Ok(Shape::Box(found))
    }
}

#[derive(Debug, Default)]
struct Attributes {
    name: Member,
    rotation: Member,
}

impl Lenient for Attributes {
    fn member<'de, A: MapAccess<'de>>(
        &mut self,
        name: &str,
        object: &mut A,
    ) -> Result<(), A::Error> {
        match name {
            NAME => self.name = value(object)?,
            "rotation" => self.rotation = value(object)?,
            _ => skipped(object)?,
        }
        Ok(())
    }
}

/// A list of outlines, the first of which counts, or a mask.
type Segmentation = Listed<FlatOutline, 1>;

/// Columns and rows in turn.
#[derive(Debug, Default)]
struct FlatOutline {
    is_list: bool,
    /// A column whose row comes next.
    column: Option<f64>,
    outline: PixelOutline,
}

impl Lenient for FlatOutline {
    fn found(&mut self, token: JsonToken<'_>) {
        self.is_list = matches!(token, JsonToken::List);
    }

    fn element<'de, A: SeqAccess<'de>>(&mut self, list: &mut A) -> Result<Option<()>, A::Error> {
        let Some(AnyJson(element)) = list.next_element::<AnyJson<Member>>()? else {
            return Ok(None);
        };
        match (self.column.take(), element.number()) {
            (None, Some(column)) => self.column = Some(column),
            (Some(column), Some(row)) => self.outline.add([column, row]),
            (_, None) => self.outline.end(),
        }
        Ok(Some(()))
    }
}

impl FlatOutline {
    fn shape(self) -> Result<Shape, &'static str> {
        match self.is_list && self.column.is_none() {
            true => self.outline.shape(),
            false => Err(NO_SHAPE),
        }
    }
}
