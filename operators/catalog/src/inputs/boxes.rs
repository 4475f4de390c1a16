//! The overhead image and what people said of boxes on it, as the algorithms want them.

use std::collections::BTreeMap;

use evermap_algorithms::ground::boxes::GroundBox;
use evermap_algorithms::ground::boxes::mosaic::{Mosaic, Pixel};
use evermap_algorithms::ground::boxes::teaching::{Example, Said};
use evermap_algorithms::ground::tiles::TILE_CELLS;
use evermap_contract::Reason;
use evermap_schemas::Pose;
use evermap_schemas::layers::{OverheadTile, PlacedLabel};

/// Boxes are described by cells of the image: a side of fewer cells than this is too short.
const LEAST_CELLS: f64 = 4.0;
/// No box is longer (m): an image is looked at in parts of a hundred metres.
pub(crate) const LONGEST_M: f64 = 50.0;

/// The tiles of the finest zoom.
pub fn mosaic(tiles: Vec<OverheadTile>, skip: &mut impl FnMut(Reason, u64)) -> Mosaic {
    let finest = tiles.into_iter().filter(|tile| tile.zoom == 0);
    let mut tiles = finest.peekable();
    let cell_m = tiles.peek().map_or(1.0, |tile| tile.cell_m);
    if !(cell_m > 0.0 && cell_m.is_finite()) {
        skip("tile has no cell size".into(), tiles.count() as u64);
        return Mosaic::new(1.0);
    }
    let mut mosaic = Mosaic::new(cell_m);
    for tile in tiles {
        let at = [tile.tile_x, tile.tile_y].map(i64::from);
        let pixels = decoded(&tile.png.0).filter(|_| tile.cell_m == cell_m);
        if !pixels.is_some_and(|pixels| mosaic.add(at, pixels)) {
            skip("tile is not as overhead_tiles makes them".into(), 1);
        }
    }
    mosaic
}

/// Pixels of a tile, the northernmost row first; `None` where it is no grey PNG with alpha of a tile's size.
fn decoded(bytes: &[u8]) -> Option<Vec<Pixel>> {
    let mut reader = png::Decoder::new(std::io::Cursor::new(bytes))
        .read_info()
        .ok()?;
    let info = reader.info();
    let side = TILE_CELLS as u32;
    let is_tile = [info.width, info.height] == [side, side]
        && info.color_type == png::ColorType::GrayscaleAlpha
        && info.bit_depth == png::BitDepth::Eight;
    if !is_tile {
        return None;
    }
    let mut pixels = vec![0; TILE_CELLS * TILE_CELLS * 2];
    reader.next_frame(&mut pixels).ok()?;
    let (pixels, _) = pixels.as_chunks();
    Some(pixels.to_vec())
}

/// What was said of boxes of one kind.
#[derive(Default)]
pub(crate) struct Boxes {
    /// The boxes.
    pub(crate) examples: Vec<Example>,
    /// Heights of those that are of the kind (m), added up.
    pub(crate) height_sum_m: f64,
}

/// What was said of boxes, by kind. Outlines that are no boxes say nothing of where others are.
pub(crate) fn boxes(
    labels: &[PlacedLabel],
    cell_m: f64,
    skip: &mut impl FnMut(Reason, u64),
) -> BTreeMap<String, Boxes> {
    let mut kinds: BTreeMap<String, Boxes> = BTreeMap::new();
    for label in labels {
        let (Some(length_m), Some(width_m)) = (label.length_m, label.width_m) else {
            continue;
        };
        let fits = |side_m: &f64| (LEAST_CELLS * cell_m..=LONGEST_M).contains(side_m);
        let place = ground_box(&label.map_from_label, length_m, width_m);
        let Some(place) = place.filter(|_| fits(&length_m) && fits(&width_m)) else {
            skip(
                "box is no longer than a few cells, or longer than 50 m".into(),
                1,
            );
            continue;
        };
        let said = match label.standing.as_str() {
            "drawn" => Said::Drawn,
            "accepted" => Said::Accepted,
            "rejected" => Said::Rejected,
            _ => {
                skip(
                    "label was neither drawn nor accepted nor rejected".into(),
                    1,
                );
                continue;
            }
        };
        let kind = kinds.entry(label.kind.clone()).or_default();
        if said != Said::Rejected {
            kind.height_sum_m += label.map_from_label.z;
        }
        kind.examples.push(Example { place, said });
    }
    kinds
}

/// A box from above; `None` where its numbers are none.
pub(crate) fn ground_box(pose: &Pose, length_m: f64, width_m: f64) -> Option<GroundBox> {
    let rigid = evermap_algorithms::geometry::pose::Pose::from_array(pose.to_array()).ok()?;
    let [x, y, ..] = rigid.to_array();
    let found = GroundBox {
        centre: [x, y],
        yaw: rigid.yaw(),
        length_m,
        width_m,
    };
    let is_sound = length_m > 0.0 && width_m > 0.0 && length_m.hypot(width_m).is_finite();
    is_sound.then_some(found)
}

/// The frame of a box in the map, at a height.
pub(crate) fn pose(of: &GroundBox, height_m: f64) -> Pose {
    let flat =
        evermap_algorithms::geometry::pose::Pose::from_yaw(of.centre[0], of.centre[1], of.yaw);
    Pose {
        z: height_m,
        ..Pose::from_array(flat.to_array())
    }
}
