//! What is read of GeoJSON, whatever else it has.

use evermap_catalog::painted::ImageKey;
use evermap_schemas::Stamp;
use serde::de::{Deserialize, Deserializer, MapAccess, SeqAccess};

use super::coordinates::WrittenCoordinates;
use crate::annotate::features::{DrawnFeature, Geometry};
use crate::annotate::is_blank;
use crate::annotate::reading::{AnyJson, JsonScalar, Lenient, passed, skipped, value};

/// A file has no more features than this.
pub(super) const MOST_FEATURES: usize = 500_000;

/// A file: a collection, a feature or a geometry.
#[derive(Debug, Default)]
pub struct GeoJsonFile {
    has_type: bool,
    /// What it is, and as a bare geometry.
    pub(super) geometry: WrittenGeometry,
    /// As a collection.
    pub(super) features: WrittenFeatures,
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
    fn scalar(&mut self, scalar: JsonScalar<'_>) {
        self.geometry.scalar(scalar);
    }

    fn list(&mut self) {
        self.geometry.list();
    }

    fn object(&mut self) {
        self.geometry.object();
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

/// The features of a collection.
#[derive(Debug, Default)]
pub(super) struct WrittenFeatures {
    pub(super) is_list: bool,
    /// The first of them, so many as there may be.
    pub(super) first: Vec<WrittenFeature>,
    pub(super) count: usize,
}

impl Lenient for WrittenFeatures {
    fn list(&mut self) {
        self.is_list = true;
    }

    fn element<'de, A: SeqAccess<'de>>(&mut self, list: &mut A) -> Result<Option<()>, A::Error> {
        let found = match self.count < MOST_FEATURES {
            true => {
                let found = list.next_element::<AnyJson<WrittenFeature>>()?;
                found.map(|AnyJson(feature)| self.first.push(feature))
            }
            false => passed(list)?,
        };
        self.count += usize::from(found.is_some());
        Ok(found)
    }
}

/// A feature as it stands in a file.
#[derive(Debug, Default)]
pub(super) struct WrittenFeature {
    id: WordMember,
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
        match self.label() {
            WordMember::Said(label) => format!("feature {number}, label {label}"),
            _ => format!("feature {number}"),
        }
    }

    /// The label that it is: its property `label`, and only where it has no such property its `id`, which other programs
    /// make of the numbers of rows.
    fn label(&self) -> &WordMember {
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
            label: properties.label.unwrap_or(self.id).said()?,
            within_m: None,
            kind: properties.kind.said()?,
            category: None,
            standing: properties.standing.said()?,
            geometry: self.geometry.outline()?,
            brush_px: properties.brush_px.0,
            image: properties.image.key()?,
        })
    }
}

#[derive(Debug, Default)]
struct WrittenProperties {
    label: Option<WordMember>,
    kind: WordMember,
    standing: WordMember,
    brush_px: NumberMember,
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

/// A text, or a number as text.
#[derive(Debug, Default)]
enum WordMember {
    /// None, or a blank one.
    #[default]
    Nothing,
    Said(String),
    /// A list, an object, true or false.
    NoWord,
}

impl Lenient for WordMember {
    fn scalar(&mut self, scalar: JsonScalar<'_>) {
        *self = match scalar {
            JsonScalar::Text(text) if is_blank(text) => Self::Nothing,
            JsonScalar::Text(text) => Self::Said(text.to_owned()),
            JsonScalar::Number(number) => Self::Said(number.to_string()),
            JsonScalar::Truth => Self::NoWord,
        };
    }

    fn list(&mut self) {
        *self = Self::NoWord;
    }

    fn object(&mut self) {
        *self = Self::NoWord;
    }
}

impl WordMember {
    /// A text, where there is one.
    ///
    /// # Errors
    /// In words, for what is there and is none: what it says is not known.
    fn said(self) -> Result<Option<String>, &'static str> {
        match self {
            Self::Nothing => Ok(None),
            Self::Said(text) => Ok(Some(text)),
            Self::NoWord => Err("feature whose label, kind or standing is neither text nor number"),
        }
    }
}

/// A number.
#[derive(Debug, Default)]
struct NumberMember(Option<f64>);

impl Lenient for NumberMember {
    fn scalar(&mut self, scalar: JsonScalar<'_>) {
        if let JsonScalar::Number(number) = scalar {
            self.0 = number.as_f64();
        }
    }
}

/// Whole nanoseconds, which may be a text: JavaScript rounds such numbers.
#[derive(Debug, Default)]
struct InstantMember(Option<i64>);

impl Lenient for InstantMember {
    fn scalar(&mut self, scalar: JsonScalar<'_>) {
        self.0 = match scalar {
            JsonScalar::Number(number) => number.as_i64(),
            JsonScalar::Text(text) => text.parse().ok(),
            JsonScalar::Truth => None,
        };
    }
}

/// The image that shows a feature.
#[derive(Debug, Default)]
struct WrittenImage {
    is_there: bool,
    session: WordMember,
    stamp: InstantMember,
    camera: WordMember,
}

impl Lenient for WrittenImage {
    fn found(&mut self) {
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
        match (self.session, self.stamp.0, self.camera) {
            _ if !self.is_there => Ok(None),
            (WordMember::Said(session), Some(stamp), WordMember::Said(camera)) => {
                Ok(Some((session, Stamp(stamp), camera)))
            }
            _ => Err("feature of an image without session, stamp (ns) and camera"),
        }
    }
}

/// A geometry as it stands in a file.
#[derive(Debug, Default)]
pub(super) struct WrittenGeometry {
    is_there: bool,
    pub(super) kind: TextMember,
    coordinates: WrittenCoordinates,
}

impl Lenient for WrittenGeometry {
    fn found(&mut self) {
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
            true => self.coordinates.outline(self.kind.0.as_deref()).map(Some),
            false => Ok(None),
        }
    }
}

/// A text, if it is one.
#[derive(Debug, Default)]
pub(super) struct TextMember(pub(super) Option<String>);

impl Lenient for TextMember {
    fn scalar(&mut self, scalar: JsonScalar<'_>) {
        if let JsonScalar::Text(text) = scalar {
            self.0 = Some(text.to_owned());
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
        self.properties.name.0.as_deref()
    }
}

#[derive(Debug, Default)]
struct ReferenceProperties {
    name: TextMember,
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
