//! A speed map as a filter mask of Nav2's speed filter: a map as `nav2_map_server` loads it, a YAML file and a picture.
//!
//! ```text
//! speed limit of a cell = base + multiplier * value       type 2: m/s; base 0, multiplier max_mps / 100
//! value = pixel, as the map's mode is raw                 1 to 100; 0 would mean no limit, above 100 unknown
//! ```
//! Rounded down, so that no limit is above what the map recommends. Cells that the map does not have get 100, `max_mps`:
//! the filter reports unknown cells as an error. The picture's last row is the southernmost; `origin` is the corner of its
//! lower left pixel.
//!
//! Format: Nav2's pages on the map server, the costmap filter info server and the speed filter, and `map_io` of
//! `nav2_map_server`.

use arrow::array::RecordBatch;
use evermap_schemas::Fault;

use crate::raster::Raster;
use crate::reader::{COUNTED, one_site, typed};
use crate::shown::SpeedCell;

/// Pixels of the largest mask.
const MOST_PIXELS: i64 = 1 << 27;

/// What to do about cells that are far apart.
pub const SMALLER: &str = "run the plan again, which leaves out labels far from every drive; or make cells larger: cell_m of exposure";

/// The two files.
#[derive(Debug)]
pub struct Mask {
    /// A binary PGM.
    pub picture: Vec<u8>,
    /// The map's YAML, with the parameters of the filter info server as comments.
    pub yaml: String,
}

/// The limits of a speed map's cells in hundredths of its highest speed, 1 to 100, -1 where the map has no cell.
///
/// # Errors
/// A user fault for no cells, a data fault for cells that make no raster.
pub fn limits(cells: &[SpeedCell]) -> Result<(Raster, Vec<i8>), Fault> {
    let first = cells.first();
    let first = first.ok_or_else(|| Fault::user("the speed map has no cells").next(COUNTED))?;
    let (cell_m, max_mps) = (first.cell_m, first.max_mps);
    let alike = |cell: &SpeedCell| cell.cell_m == cell_m && cell.max_mps == max_mps;
    if !(cells.iter().all(alike) && cell_m > 0.0 && max_mps > 0.0) {
        let message = "expected cells of one size and one max_mps above 0, found others";
        return Err(Fault::data(message));
    }
    let raster = Raster::around(cells.iter().map(|cell| [cell.column, cell.row]));
    let raster = raster.ok_or_else(|| Fault::bug("cells have no raster"))?;
    let [width, height] = raster.size;
    if raster.cells() > MOST_PIXELS {
        let fault = Fault::data(format!(
            "expected a mask of at most {MOST_PIXELS} pixels, found {width} x {height}"
        ));
        return Err(fault.next(SMALLER));
    }
    let mut limits = vec![-1; raster.cells() as usize];
    for cell in cells {
        // What rounding makes of a hundredth must not fall below it.
        let value = (cell.speed_mps * 100.0 / max_mps + 1e-9).floor();
        // What is no number is no licence to drive fast.
        limits[raster.place([cell.column, cell.row])] = (value.min(100.0) as i8).max(1);
    }
    Ok((raster, limits))
}

/// The mask of the speed map of one site; `picture` is the name of the picture's file.
///
/// # Errors
/// A user fault for a layer that is no speed map, or of several sites; a data fault for cells that make no picture.
pub fn mask(batches: &[RecordBatch], site: Option<&str>, picture: &str) -> Result<Mask, Fault> {
    let cells: Vec<SpeedCell> = typed(batches).map_err(|fault| fault.next("export speed_map"))?;
    one_site(cells.iter().map(|cell| cell.site.as_str()), site)?;
    let (raster, limits) = limits(&cells)?;
    let (cell_m, multiplier) = (cells[0].cell_m, cells[0].max_mps / 100.0);
    let [width, height] = raster.size;
    let mut bytes = format!("P5\n{width} {height}\n255\n").into_bytes();
    let from_the_north = limits.chunks(width as usize).rev().flatten();
    bytes.extend(from_the_north.map(|limit| u8::try_from(*limit).unwrap_or(100)));
    let [west, south] = raster.corner(cell_m);
    let image = serde_json::Value::from(picture);
    let yaml = format!(
        "# Mask of Nav2's speed filter. Parameters of costmap_filter_info_server: type: 2 (m/s), base: 0.0, multiplier: {multiplier:?}\n\
         image: {image}\nmode: raw\nresolution: {cell_m:?}\norigin: [{west:?}, {south:?}, 0.0]\nnegate: 0\n\
         occupied_thresh: 0.65\nfree_thresh: 0.25\n"
    );
    Ok(Mask {
        picture: bytes,
        yaml,
    })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use evermap_schemas::batch;
    use evermap_schemas::layers::SpeedCell;

    fn cell(column: i32, row: i32, speed_mps: f64) -> SpeedCell {
        SpeedCell {
            site: "lot".into(),
            column,
            row,
            cell_m: 0.5,
            x: 0.5 * f64::from(column) + 0.25,
            y: 0.5 * f64::from(row) + 0.25,
            danger: 0.0,
            speed_mps,
            max_mps: 2.8,
        }
    }

    /// The occupancy grid that the map server makes of the two files in mode `raw`: rows from the south.
    fn loaded(mask: &Mask) -> (serde_json::Value, [usize; 2], Vec<i32>) {
        // One field a line, each value JSON but for the mode.
        let fields = mask.yaml.lines().filter(|line| !line.starts_with('#'));
        let field = |line: &str| {
            let (name, value) = line.split_once(": ").unwrap();
            let value = serde_json::from_str(value).unwrap_or_else(|_| value.into());
            (name.to_owned(), value)
        };
        let yaml: serde_json::Map<String, serde_json::Value> = fields.map(field).collect();
        let yaml = serde_json::Value::Object(yaml);
        let head = mask.picture.splitn(4, |byte| *byte == b'\n');
        let parts: Vec<&[u8]> = head.collect();
        assert_eq!((parts[0], parts[2]), (&b"P5"[..], &b"255"[..]));
        let size = std::str::from_utf8(parts[1]).unwrap().split(' ');
        let size: Vec<usize> = size.map(|part| part.parse().unwrap()).collect();
        let (width, height) = (size[0], size[1]);
        assert_eq!(parts[3].len(), width * height);
        let mut grid = vec![0; width * height];
        for y in 0..height {
            for x in 0..width {
                let pixel = i32::from(parts[3][y * width + x]);
                let value = if pixel <= 100 { pixel } else { -1 };
                grid[width * (height - y - 1) + x] = value;
            }
        }
        (yaml, [width, height], grid)
    }

    #[test]
    fn the_map_server_finds_the_speeds_where_they_are() {
        let cells = vec![
            cell(-2, 3, 1.4),
            cell(-1, 3, 2.8),
            cell(0, 5, 0.001),
            cell(-2, 4, 2.0),
        ];
        let mask = mask(&[batch(cells.clone()).unwrap()], None, "mask: 1.pgm").unwrap();
        let (yaml, [width, height], grid) = loaded(&mask);
        assert_eq!([width, height], [3, 3]);
        // Field by field, as the map server's documentation has them; origin, resolution and thresholds must be numbers.
        assert_eq!(yaml["image"], "mask: 1.pgm");
        assert_eq!(yaml["mode"], "raw");
        assert_eq!(yaml["negate"], 0);
        assert_eq!(yaml["origin"].as_array().unwrap().len(), 3);
        assert!(yaml["occupied_thresh"].as_f64() > yaml["free_thresh"].as_f64());
        let resolution = yaml["resolution"].as_f64().unwrap();
        let origin = [0, 1].map(|k| yaml["origin"][k].as_f64().unwrap());
        let multiplier = 2.8 / 100.0;
        assert!(mask.yaml.contains(&format!("multiplier: {multiplier:?}")));
        for cell in &cells {
            let at = [(cell.x, 0), (cell.y, 1)].map(|(place, k)| (place - origin[k]) / resolution);
            let value = grid[at[1] as usize * width + at[0] as usize];
            let limit = f64::from(value) * multiplier;
            assert!(
                limit <= cell.speed_mps.max(multiplier) + 1e-9,
                "{cell:?}: {limit}"
            );
            assert!(limit > cell.speed_mps - multiplier, "{cell:?}: {limit}");
        }
        // Where the map has no cell there is its highest speed, and nowhere none.
        assert_eq!(grid.iter().filter(|value| **value == 100).count(), 6);
        assert!(grid.iter().all(|value| (1..=100).contains(value)));
    }

    #[test]
    fn what_is_no_speed_map_is_refused() {
        let mut other = cell(1, 0, 1.0);
        other.cell_m = 0.25;
        let cells = |cells: Vec<SpeedCell>| mask(&[batch(cells).unwrap()], None, "a.pgm");
        assert!(cells(vec![cell(0, 0, 1.0), other]).is_err());
        assert!(cells(vec![]).is_err());
        let far = cells(vec![cell(i32::MIN, 0, 1.0), cell(i32::MAX, 9, 1.0)]);
        let far = far.unwrap_err().to_string();
        assert!(far.contains("expected a mask of at most") && far.contains(SMALLER));
    }
}
