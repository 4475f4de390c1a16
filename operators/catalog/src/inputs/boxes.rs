//! The overhead image, lanes and what people said of boxes, as the algorithms want them.

use std::collections::{BTreeMap, BTreeSet};

use evermap_algorithms::ground::boxes::GroundBox;
use evermap_algorithms::ground::boxes::box_index::BoxIndex;
use evermap_algorithms::ground::boxes::mosaic::{Mosaic, Pixel};
use evermap_algorithms::ground::boxes::rows::LaneLine;
use evermap_algorithms::ground::boxes::teaching::{Example, Said};
use evermap_algorithms::ground::tiles::TILE_CELLS;
use evermap_contract::Reason;
use evermap_schemas::Pose;
use evermap_schemas::layers::{Lane, OverheadTile, PlacedLabel};

use crate::inputs::people::PERSON;

/// Boxes are described by cells of the image: a side of fewer cells than this is too short.
const LEAST_CELLS: f64 = 4.0;
/// No box is longer (m): an image is looked at in parts of a hundred metres.
pub(crate) const LONGEST_M: f64 = 50.0;
/// Boxes of one kind that share more than this part of the smaller one are on one place.
const ONE_PLACE: f64 = 0.5;

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

/// What was said of boxes, by kind. Outlines that are no boxes say nothing of where others are, and neither do people, who
/// walk; of several on one place the one said last holds.
pub(crate) fn boxes(
    labels: &[PlacedLabel],
    cell_m: f64,
    skip: &mut impl FnMut(Reason, u64),
) -> BTreeMap<String, Boxes> {
    let mut kinds: BTreeMap<&str, Vec<(Example, &PlacedLabel)>> = BTreeMap::new();
    for label in labels.iter().filter(|label| label.kind != PERSON) {
        match example(label, cell_m) {
            Ok(Some(example)) => kinds
                .entry(label.kind.as_str())
                .or_default()
                .push((example, label)),
            Ok(None) => {}
            Err(reason) => skip(reason, 1),
        }
    }
    let kinds = kinds.into_iter();
    kinds
        .map(|(kind, said)| (kind.to_owned(), of_kind(&said, skip)))
        .collect()
}

/// What a label says; nothing where it is no box.
fn example(label: &PlacedLabel, cell_m: f64) -> Result<Option<Example>, Reason> {
    let (Some(length_m), Some(width_m)) = (label.length_m, label.width_m) else {
        return Ok(None);
    };
    let fits = |side_m: &f64| (LEAST_CELLS * cell_m..=LONGEST_M).contains(side_m);
    let place = ground_box(&label.map_from_label, length_m, width_m);
    let place = place.filter(|_| fits(&length_m) && fits(&width_m));
    let place = place.ok_or("box is no longer than a few cells, or longer than 50 m")?;
    let said = match label.standing.as_str() {
        "drawn" => Said::Drawn,
        "accepted" => Said::Accepted,
        "rejected" => Said::Rejected,
        _ => return Err("label was neither drawn nor accepted nor rejected".into()),
    };
    Ok(Some(Example { place, said }))
}

fn of_kind(said: &[(Example, &PlacedLabel)], skip: &mut impl FnMut(Reason, u64)) -> Boxes {
    let ones = said.iter().filter(|(example, _)| example.is_one());
    let ones: Vec<_> = ones.map(|(one, label)| (one.place, *label)).collect();
    let before = said_before(&ones);
    let mut boxes = Boxes::default();
    for (example, label) in said {
        if before.contains(label.label.as_str()) {
            skip("box of a kind that lies on another one".into(), 1);
            continue;
        }
        if example.is_one() {
            boxes.height_sum_m += label.map_from_label.z;
        }
        boxes.examples.push(*example);
    }
    boxes
}

/// Of boxes of one kind that are there, the labels of those on which another one lies that was said later: more than half of
/// the smaller one is shared, so both mean one place. Neighbours in a row share their lines.
pub(crate) fn said_before<'l>(ones: &[(GroundBox, &'l PlacedLabel)]) -> BTreeSet<&'l str> {
    let mut latest_first: Vec<_> = ones.iter().collect();
    latest_first.sort_by(|(_, a), (_, b)| (b.said, &b.label).cmp(&(a.said, &a.label)));
    let mut holding = BoxIndex::new(ones.iter().map(|(place, _)| *place));
    let mut before = BTreeSet::new();
    for (place, label) in latest_first {
        let is_on = |later: &GroundBox| later.cover(place) > ONE_PLACE;
        let is_said_again = holding.near(place).any(is_on);
        if is_said_again {
            before.insert(label.label.as_str());
        } else {
            holding.add(*place);
        }
    }
    before
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

/// A lane from above.
pub(crate) fn lane_line(lane: &Lane) -> LaneLine {
    LaneLine {
        lane: lane.lane,
        points: lane.points.iter().map(|[x, y, _]| [*x, *y]).collect(),
    }
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
