//! Where the sites of a map lie on earth, and what that makes of its geometries.
//!
//! Layers are in the map's metres. A [`SiteOnEarth`] turns them to longitude and latitude, or to metres east and north of the
//! map's origin. The latter are the coordinates of a transverse Mercator projection at the origin whose scale is
//! `1 + height / radius`, which the plane that touches the earth there agrees with to 1.5 mm at 5 km.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use arrow::array::{Array, ArrayRef, AsArray, BinaryArray, RecordBatch};
use arrow::datatypes::{DataType, Field, FieldRef, Schema};
use evermap_algorithms::geometry::geodesy::{Geodetic, MapOnEarth};
use evermap_schemas::layers::Georeference;
use evermap_schemas::{Fault, Geometry, Position};
use serde_json::{Value, json};

use crate::reader::{MapReader, texts};

/// The column that says which site a row is of.
const SITE: &str = "site";

/// Where sites lie.
#[derive(Debug, Default)]
pub struct Earth(BTreeMap<String, SiteOnEarth>);

impl Earth {
    /// The sites of a map that are georeferenced.
    ///
    /// # Errors
    /// As [`MapReader::rows`].
    pub async fn of(reader: &MapReader) -> Result<Self, Fault> {
        let rows: Vec<Georeference> = reader.rows(None).await?;
        let placed = rows
            .into_iter()
            .map(|row| (row.site.clone(), SiteOnEarth::of(&row)));
        Ok(Self(placed.collect()))
    }

    /// Whether nothing is known of any site.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Whether [`on_earth`] moves the geometries of these rows.
    pub fn moves(&self, batches: &[RecordBatch]) -> bool {
        let say_site = |batch: &RecordBatch| texts(batch, SITE).is_some();
        !self.is_empty() && batches.iter().all(say_site)
    }

    /// Where a site lies.
    pub fn place(&self, site: &str) -> Option<&SiteOnEarth> {
        self.0.get(site)
    }
}

/// Where a site lies.
#[derive(Debug, Clone)]
pub struct SiteOnEarth {
    site: String,
    origin: Geodetic,
    placed: MapOnEarth,
}

/// What coordinates become.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Coordinates {
    /// Longitude and latitude (deg) and height above the ellipsoid (m): WGS 84, as GeoJSON wants it.
    Degrees,
    /// East and north of the origin and height above the ellipsoid (m): [`SiteOnEarth::projjson`].
    Metres,
}

impl SiteOnEarth {
    fn of(row: &Georeference) -> Self {
        let origin = Geodetic {
            latitude_deg: row.latitude_deg,
            longitude_deg: row.longitude_deg,
            height_m: row.height_m.unwrap_or_default(),
        };
        Self {
            site: row.site.clone(),
            origin,
            placed: MapOnEarth::new(origin, row.heading_rad),
        }
    }

    /// East and north of the origin of a direction or point of the map, metres.
    pub fn turned(&self, x: f64, y: f64) -> [f64; 2] {
        self.placed.turned(x, y)
    }

    /// The place of a point of the map, metres.
    pub fn geodetic(&self, point: [f64; 3]) -> Geodetic {
        self.placed.geodetic(point)
    }

    fn position(&self, point: Position, to: Coordinates) -> Position {
        let place = self.geodetic(point.to_array());
        let z = point.z.map(|_| place.height_m);
        match to {
            Coordinates::Degrees => Position {
                x: place.longitude_deg,
                y: place.latitude_deg,
                z,
            },
            Coordinates::Metres => {
                let [x, y] = self.turned(point.x, point.y);
                Position { x, y, z }
            }
        }
    }

    fn scale(&self) -> f64 {
        1.0 + self.origin.height_m / self.origin.radius_m()
    }

    /// The name of the reference system of [`Coordinates::Metres`].
    pub fn name(&self) -> String {
        format!("evermap site {}", self.site)
    }

    /// What that system is: a transverse Mercator projection of WGS 84 without false easting or northing, with the
    /// latitude and longitude (deg) of its natural origin and its scale there.
    pub fn transverse_mercator(&self) -> [f64; 3] {
        [
            self.origin.latitude_deg,
            self.origin.longitude_deg,
            self.scale(),
        ]
    }

    /// The reference system of [`Coordinates::Metres`].
    pub fn projjson(&self) -> Value {
        let parameter = |name: &str, value: f64, unit: &str, code: u32| {
            json!({
                "name": name,
                "value": value,
                "unit": unit,
                "id": { "authority": "EPSG", "code": code },
            })
        };
        let axis = |name: &str, abbreviation: &str, direction: &str, unit: &str| json!({ "name": name, "abbreviation": abbreviation, "direction": direction, "unit": unit });
        json!({
            "type": "ProjectedCRS",
            "name": self.name(),
            "base_crs": {
                "type": "GeographicCRS",
                "name": "WGS 84",
                "datum": {
                    "type": "GeodeticReferenceFrame",
                    "name": "World Geodetic System 1984",
                    "ellipsoid": {
                        "name": "WGS 84",
                        "semi_major_axis": 6378137,
                        "inverse_flattening": 298.257223563,
                    },
                },
                "coordinate_system": {
                    "subtype": "ellipsoidal",
                    "axis": [
                        axis("Geodetic latitude", "Lat", "north", "degree"),
                        axis("Geodetic longitude", "Lon", "east", "degree"),
                    ],
                },
                "id": { "authority": "EPSG", "code": 4326 },
            },
            "conversion": {
                "name": "transverse Mercator at the map's origin",
                "method": {
                    "name": "Transverse Mercator",
                    "id": { "authority": "EPSG", "code": 9807 },
                },
                "parameters": [
                    parameter("Latitude of natural origin", self.origin.latitude_deg, "degree", 8801),
                    parameter("Longitude of natural origin", self.origin.longitude_deg, "degree", 8802),
                    parameter("Scale factor at natural origin", self.scale(), "unity", 8805),
                    parameter("False easting", 0.0, "metre", 8806),
                    parameter("False northing", 0.0, "metre", 8807),
                ],
            },
            "coordinate_system": {
                "subtype": "Cartesian",
                "axis": [
                    axis("Easting", "E", "east", "metre"),
                    axis("Northing", "N", "north", "metre"),
                ],
            },
        })
    }

    /// The same system as GDAL reads it beside a picture (`PAMDataset`): WKT 1.
    pub fn pam_dataset(&self) -> String {
        let [latitude_deg, longitude_deg, scale] = self.transverse_mercator();
        let name = self.name().replace(['"', '<', '>', '&'], "_");
        let wkt = format!(
            "PROJCS[\"{name}\",\
             GEOGCS[\"WGS 84\",DATUM[\"WGS_1984\",SPHEROID[\"WGS 84\",6378137,298.257223563]],\
             PRIMEM[\"Greenwich\",0],UNIT[\"degree\",0.0174532925199433]],\
             PROJECTION[\"Transverse_Mercator\"],\
             PARAMETER[\"latitude_of_origin\",{latitude_deg}],\
             PARAMETER[\"central_meridian\",{longitude_deg}],\
             PARAMETER[\"scale_factor\",{scale}],\
             PARAMETER[\"false_easting\",0],PARAMETER[\"false_northing\",0],\
             UNIT[\"metre\",1],AXIS[\"Easting\",EAST],AXIS[\"Northing\",NORTH]]"
        );
        let escaped = wkt.replace('"', "&quot;");
        format!("<PAMDataset><SRS>{escaped}</SRS></PAMDataset>\n")
    }
}

/// The file beside a picture that says where on earth it is, as GDAL has it.
pub fn beside(picture: &Path) -> PathBuf {
    let mut name = picture.as_os_str().to_owned();
    name.push(".aux.xml");
    name.into()
}

/// Rows whose geometries lie on earth. Rows that do not say their site stay as they are.
///
/// # Errors
/// A user fault for a site of which nobody knows where it lies; a data fault for a geometry that is none.
pub fn on_earth(
    batch: &RecordBatch,
    geometry: &str,
    earth: &Earth,
    to: Coordinates,
) -> Result<RecordBatch, Fault> {
    let index = batch.schema_ref().index_of(geometry).ok();
    let index = index.filter(|index| *batch.column(*index).data_type() == DataType::Binary);
    let (Some(index), Some(sites)) = (index, texts(batch, SITE)) else {
        return Ok(batch.clone());
    };
    let value = |(bytes, site): (Option<&[u8]>, Option<&str>)| {
        let site = site.unwrap_or_default();
        let place = earth.place(site).ok_or_else(|| unplaced(site))?;
        let value = bytes.map(|bytes| {
            let moved = Geometry::from_wkb(bytes)?.moved(&|point| place.position(point, to));
            Ok::<_, Fault>(moved.to_wkb().0)
        });
        value.transpose()
    };
    let values = batch.column(index).as_binary::<i32>().iter().zip(sites);
    let values = values.map(value).collect::<Result<BinaryArray, Fault>>()?;
    let mut columns: Vec<ArrayRef> = batch.columns().to_vec();
    columns[index] = Arc::new(values);
    let schema = batch.schema_ref();
    let mut fields = schema.fields().to_vec();
    fields[index] = out_of_the_map(&fields[index]);
    let schema = Schema::new_with_metadata(fields, schema.metadata().clone());
    Ok(RecordBatch::try_new(Arc::new(schema), columns)?)
}

/// The column without the frame that its values were in.
fn out_of_the_map(column: &Field) -> FieldRef {
    let mut metadata = column.metadata().clone();
    metadata.remove("frame");
    Arc::new(column.clone().with_metadata(metadata))
}

fn unplaced(site: &str) -> Fault {
    Fault::user(format!("nobody knows where site {site} lies on earth")).next(
        "choose another with --site, or the map's own metres with --local (by HTTP, local=true)",
    )
}

#[cfg(test)]
pub(crate) mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use evermap_schemas::Wkb;
    use evermap_schemas::batch;
    use evermap_schemas::layers::Intersection;

    /// A site at 52.25° N, 10.5° E, 80 m up, whose x axis points north.
    pub(crate) fn lot() -> SiteOnEarth {
        SiteOnEarth::of(&Georeference {
            site: "lot".into(),
            latitude_deg: 52.25,
            longitude_deg: 10.5,
            height_m: Some(80.0),
            heading_rad: std::f64::consts::FRAC_PI_2,
            covariance: None,
            height_sd_m: None,
            fixes: 0,
            outliers: 0,
            noise_m: None,
            drift_m: None,
            drift_s: None,
            sources: vec![],
        })
    }

    fn row() -> RecordBatch {
        let row = Intersection {
            site: "lot".into(),
            node: 4,
            degree: 3,
            x: 100.0,
            y: 50.0,
            z: 2.0,
            sources: vec![],
            geometry: Wkb::point([100.0, 50.0, 2.0]),
        };
        batch(vec![row]).unwrap()
    }

    fn point(batch: &RecordBatch) -> [f64; 3] {
        let bytes = batch.column_by_name("geometry").unwrap();
        let geometry = Geometry::from_wkb(bytes.as_binary::<i32>().value(0)).unwrap();
        geometry.paths()[0][0].to_array()
    }

    #[test]
    fn a_map_that_looks_north_has_its_x_axis_there() {
        let earth = Earth(BTreeMap::from([("lot".to_owned(), lot())]));
        let metres = on_earth(&row(), "geometry", &earth, Coordinates::Metres).unwrap();
        let [x, y, z] = point(&metres);
        assert!((x + 50.0).abs() < 1e-9 && (y - 100.0).abs() < 1e-9 && (z - 82.0).abs() < 0.01);
        let degrees = on_earth(&row(), "geometry", &earth, Coordinates::Degrees).unwrap();
        let [longitude, latitude, _] = point(&degrees);
        // As the page of georeference has it.
        assert!((longitude - 10.499_267_87).abs() < 1e-7, "{longitude}");
        assert!((latitude - 52.250_898_68).abs() < 1e-7, "{latitude}");
    }

    #[test]
    fn a_site_that_nobody_placed_is_named() {
        let fault = on_earth(&row(), "geometry", &Earth::default(), Coordinates::Metres);
        assert!(fault.unwrap_err().message.contains("lot"));
    }
}
