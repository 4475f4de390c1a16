//! What is read of GeoJSON, whatever else it has.

use evermap_catalog::painted::ImageKey;
use evermap_schemas::Stamp;
use serde::de::{Deserialize, Deserializer, MapAccess};

use super::coordinates::WrittenCoordinates;
use crate::annotate::features::{DrawnFeature, Geometry};
use crate::annotate::reading::{AnyJson, JsonToken, Lenient, Listed, Member, skipped, value};

/// A file: a collection, a feature or a geometry.
#[derive(Debug, Default)]
pub struct GeoJsonFile {
    has_type: bool,
    /// What it is, and as a bare geometry.
    pub(super) geometry: WrittenGeometry,
    /// As a collection.
    pub(super) features: Listed<WrittenFeature>,
    /// As a feature.
    pub(super) feature: WrittenFeature,
    pub(super) crs: ReferenceSystem,
}

impl GeoJsonFile {
    /// Whether it says what it is: other JSON does not.
    pub fn is_typed(&self) -> bool {
        self.has_type
    }

    /// Whether it says of its coordinates, as evermap does, that they are on earth.
    pub fn is_on_earth(&self) -> bool {
        matches!(self.geometry.coordinates, WrittenCoordinates::OnEarth)
    }
}

impl<'de> Deserialize<'de> for GeoJsonFile {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        AnyJson::deserialize(from).map(|AnyJson(read)| read)
    }
}

impl Lenient for GeoJsonFile {
    fn found(&mut self, token: JsonToken<'_>) {
        self.geometry.found(token);
    }

    fn member<'de, A: MapAccess<'de>>(
        &mut self,
        name: &str,
        object: &mut A,
    ) -> Result<(), A::Error> {
        self.has_type |= name == "type";
        match name {
            "type" | "coordinates" => self.geometry.member(name, object)?,
            "features" => self.features = value(object)?,
            "crs" => self.crs = value(object)?,
            _ => self.feature.member(name, object)?,
        }
        Ok(())
    }
}

/// A feature as it stands in a file.
#[derive(Debug, Default)]
pub(super) struct WrittenFeature {
    id: Member,
    properties: WrittenProperties,
    geometry: WrittenGeometry,
}

impl Lenient for WrittenFeature {
    fn member<'de, A: MapAccess<'de>>(
        &mut self,
        name: &str,
        object: &mut A,
    ) -> Result<(), A::Error> {
        match name {
            "id" => self.id = value(object)?,
            "properties" => self.properties = value(object)?,
            "geometry" => self.geometry = value(object)?,
            _ => skipped(object)?,
        }
        Ok(())
    }
}

impl WrittenFeature {
    /// One that says nothing else.
    pub(super) fn bare(geometry: WrittenGeometry) -> Self {
        Self {
            geometry,
            ..Self::default()
        }
    }

    /// Which one of a file it is, for people.
    pub(super) fn place(&self, number: usize) -> String {
        match self.label().word() {
            Some(label) => format!("feature {number}, label {label}"),
            None => format!("feature {number}"),
        }
    }

    /// The label that it is: its property `label`, and only where it has no such property its `id`, which other programs
    /// make of the numbers of rows.
    fn label(&self) -> &Member {
        self.properties.label.as_ref().unwrap_or(&self.id)
    }

    /// What it draws.
    ///
    /// # Errors
    /// In words, for what is no feature of a map.
    pub(super) fn drawn(self, place: String) -> Result<DrawnFeature, &'static str> {
        let properties = self.properties;
        Ok(DrawnFeature {
            place,
            label: said(properties.label.as_ref().unwrap_or(&self.id))?,
            within_m: None,
            kind: said(&properties.kind)?,
            category: None,
            standing: said(&properties.standing)?,
            geometry: self.geometry.outline()?,
            brush_px: properties.brush_px.number(),
            image: properties.image.key()?,
        })
    }
}

#[derive(Debug, Default)]
struct WrittenProperties {
    label: Option<Member>,
    kind: Member,
    standing: Member,
    brush_px: Member,
    image: WrittenImage,
}

impl Lenient for WrittenProperties {
    fn member<'de, A: MapAccess<'de>>(
        &mut self,
        name: &str,
        object: &mut A,
    ) -> Result<(), A::Error> {
        match name {
            "label" => self.label = Some(value(object)?),
            "kind" => self.kind = value(object)?,
            "standing" => self.standing = value(object)?,
            "brush_px" => self.brush_px = value(object)?,
            "image" => self.image = value(object)?,
            _ => skipped(object)?,
        }
        Ok(())
    }
}

/// A text, where there is one.
///
/// # Errors
/// In words, for what is there and is none: what it says is not known.
fn said(member: &Member) -> Result<Option<String>, &'static str> {
    match member {
        Member::Truth(_) | Member::List | Member::Object => {
            Err("feature whose label, kind or standing is neither text nor number")
        }
        member => Ok(member.word()),
    }
}

/// Whole nanoseconds, which may be a text: JavaScript rounds such numbers.
fn instant(member: &Member) -> Option<i64> {
    match member {
        Member::Number(number) => number.as_i64(),
        Member::Text(text) => text.parse().ok(),
        _ => None,
    }
}

/// The image that shows a feature.
#[derive(Debug, Default)]
struct WrittenImage {
    is_there: bool,
    session: Member,
    stamp: Member,
    camera: Member,
}

impl Lenient for WrittenImage {
    fn found(&mut self, _: JsonToken<'_>) {
        self.is_there = true;
    }

    fn member<'de, A: MapAccess<'de>>(
        &mut self,
        name: &str,
        object: &mut A,
    ) -> Result<(), A::Error> {
        match name {
            "session" => self.session = value(object)?,
            "stamp" => self.stamp = value(object)?,
            "camera" => self.camera = value(object)?,
            _ => skipped(object)?,
        }
        Ok(())
    }
}

impl WrittenImage {
    /// Its name; `None` where a feature has none.
    ///
    /// # Errors
    /// In words, for half of one.
    fn key(self) -> Result<Option<ImageKey>, &'static str> {
        match (
            self.session.word(),
            instant(&self.stamp),
            self.camera.word(),
        ) {
            _ if !self.is_there => Ok(None),
            (Some(session), Some(stamp), Some(camera)) => Ok(Some((session, Stamp(stamp), camera))),
            _ => Err("feature of an image without session, stamp (ns) and camera"),
        }
    }
}

/// A geometry as it stands in a file.
#[derive(Debug, Default)]
pub(super) struct WrittenGeometry {
    is_there: bool,
    pub(super) kind: Member,
    coordinates: WrittenCoordinates,
}

impl Lenient for WrittenGeometry {
    fn found(&mut self, _: JsonToken<'_>) {
        self.is_there = true;
    }

    fn member<'de, A: MapAccess<'de>>(
        &mut self,
        name: &str,
        object: &mut A,
    ) -> Result<(), A::Error> {
        match name {
            "type" => self.kind = value(object)?,
            "coordinates" => self.coordinates = value(object)?,
            _ => skipped(object)?,
        }
        Ok(())
    }
}

impl WrittenGeometry {
    /// The outline; `None` for a feature that has none.
    ///
    /// # Errors
    /// In words, for what is no outline.
    fn outline(self) -> Result<Option<Geometry>, &'static str> {
        match self.is_there {
            true => self.coordinates.outline(self.kind.text()).map(Some),
            false => Ok(None),
        }
    }
}

/// The reference system that programs write which know of no local metres.
#[derive(Debug, Default)]
pub(super) struct ReferenceSystem {
    properties: ReferenceProperties,
}

impl Lenient for ReferenceSystem {
    fn member<'de, A: MapAccess<'de>>(
        &mut self,
        name: &str,
        object: &mut A,
    ) -> Result<(), A::Error> {
        match name {
            "properties" => self.properties = value(object)?,
            _ => skipped(object)?,
        }
        Ok(())
    }
}

impl ReferenceSystem {
    pub(super) fn name(&self) -> Option<&str> {
        self.properties.name.text()
    }
}

#[derive(Debug, Default)]
struct ReferenceProperties {
    name: Member,
}

impl Lenient for ReferenceProperties {
    fn member<'de, A: MapAccess<'de>>(
        &mut self,
        name: &str,
        object: &mut A,
    ) -> Result<(), A::Error> {
        match name {
            "name" => self.name = value(object)?,
            _ => skipped(object)?,
        }
        Ok(())
    }
}
