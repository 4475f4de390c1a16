//! The overhead image and its gradients, lanes and what people said of boxes, as the algorithms want them.

use std::collections::{BTreeMap, BTreeSet};

use evermap_algorithms::ground::boxes::GroundBox;
use evermap_algorithms::ground::boxes::box_index::BoxIndex;
use evermap_algorithms::ground::boxes::mosaic::{LONGEST_CELLS, Mosaic};
use evermap_algorithms::ground::boxes::picture::Picture;
use evermap_algorithms::ground::boxes::rows::LaneLine;
use evermap_algorithms::ground::boxes::teaching::{Example, Judgement, Taught};
use evermap_contract::{Fault, Reason};
use evermap_schemas::layers::{Lane, OverheadGradients, OverheadTile, PlacedLabel};
use evermap_schemas::{Bytes, Pose};
use png::ColorType;
use rayon::prelude::*;

use crate::inputs::people::PERSON;
use crate::inputs::tiles::{decoded, encoded, gradient_cells};

/// Boxes are described by cells of the image: a side of fewer cells than this is too short.
const LEAST_CELLS: f64 = 4.0;
/// No box is longer (m): an image is looked at in parts of a hundred metres.
const LONGEST_M: f64 = 50.0;
/// Boxes of one kind that share more than this part of the smaller one are on one place.
const ONE_PLACE: f64 = 0.5;

/// The tiles of the finest zoom.
fn picture(tiles: Vec<OverheadTile>, skip: &mut impl FnMut(Reason, u64)) -> Picture {
    let finest: Vec<OverheadTile> = tiles.into_iter().filter(|tile| tile.zoom == 0).collect();
    let Some(cell_m) = cell_of(finest.iter().map(|tile| tile.cell_m), skip) else {
        return Picture::new(1.0);
    };
    let mut picture = Picture::new(cell_m);
    let read = finest.into_par_iter().map(|tile| {
        let pixels = decoded(&tile.png.0).filter(|_| tile.cell_m == cell_m);
        ([tile.tile_x, tile.tile_y].map(i64::from), pixels)
    });
    for (at, pixels) in read.collect::<Vec<_>>() {
        if !pixels.is_some_and(|pixels| picture.add(at, pixels)) {
            skip("tile is not as overhead_tiles makes them".into(), 1);
        }
    }
    picture
}

/// The side of cells of tiles, which is that of the first one's (m); `None`, and they are counted, where it is none.
fn cell_of(
    mut sides_m: impl ExactSizeIterator<Item = f64>,
    skip: &mut impl FnMut(Reason, u64),
) -> Option<f64> {
    let count = sides_m.len() as u64;
    let cell_m = sides_m.next()?;
    let is_side = cell_m > 0.0 && cell_m.is_finite();
    if !is_side {
        skip("tile has no cell size".into(), count);
    }
    is_side.then_some(cell_m)
}

/// Gradients of the tiles of a site at the finest zoom, and how many of them are not among those that are known: these were
/// made of other content, or never.
///
/// # Errors
/// A bug fault where gradients do not encode.
pub fn tile_gradients(
    tiles: Vec<OverheadTile>,
    known: Vec<OverheadGradients>,
    skip: &mut impl FnMut(Reason, u64),
) -> Result<(Vec<OverheadGradients>, usize), Fault> {
    let Some(site) = tiles.first().map(|tile| tile.site.clone()) else {
        return Ok((Vec::new(), 0));
    };
    let picture = picture(tiles, skip);
    let known = known.into_iter().map(|row| (key(&row), row));
    let mut known: BTreeMap<[i64; 2], OverheadGradients> = known.collect();
    let is_known = |tile: [i64; 2], content: &str| {
        let row = known.get(&tile);
        row.is_some_and(|row| row.content == content && gradient_cells(&row.png.0).is_some())
    };
    let mut anew = 0;
    let mut rows = Vec::new();
    for tile in picture.described(is_known) {
        let Some(cells) = tile.cells else {
            rows.extend(known.remove(&tile.tile));
            continue;
        };
        anew += 1;
        rows.push(OverheadGradients {
            site: site.clone(),
            tile_x: tile.tile[0] as i32,
            tile_y: tile.tile[1] as i32,
            cell_m: picture.cell_m(),
            content: tile.content,
            png: Bytes(encoded(ColorType::GrayscaleAlpha, cells.as_flattened())?),
        });
    }
    Ok((rows, anew))
}

/// The gradients of a site.
pub fn mosaic(tiles: Vec<OverheadGradients>, skip: &mut impl FnMut(Reason, u64)) -> Mosaic {
    match counted(&tiles, skip) {
        Some(counted) => filled(counted, tiles, skip),
        None => Mosaic::new(1.0),
    }
}

/// Of the gradients of a site those that its labels are learnt from; others are not read.
pub(crate) fn taught_mosaic(
    mut tiles: Vec<OverheadGradients>,
    labels: &[PlacedLabel],
    skip: &mut impl FnMut(Reason, u64),
) -> Mosaic {
    let Some(counted) = counted(&tiles, skip) else {
        return Mosaic::new(1.0);
    };
    let kinds = boxes(labels, counted.cell_m(), &mut |_, _| {}).into_values();
    let read = kinds.map(|kind| Taught::reads(&counted, &kind.examples));
    let read: Vec<_> = read.collect();
    tiles.retain(|tile| read.iter().any(|is_read| is_read(key(tile))));
    filled(counted, tiles, skip)
}

/// Column and row of a tile of gradients.
fn key(tile: &OverheadGradients) -> [i64; 2] {
    [tile.tile_x, tile.tile_y].map(i64::from)
}

/// An image that counts its parts from all tiles, without them; `None`, and they are counted, where they have no cell size.
fn counted(tiles: &[OverheadGradients], skip: &mut impl FnMut(Reason, u64)) -> Option<Mosaic> {
    let cell_m = cell_of(tiles.iter().map(|tile| tile.cell_m), skip)?;
    let mut mosaic = Mosaic::new(cell_m);
    let fitting = tiles.iter().filter(|tile| tile.cell_m == cell_m);
    fitting.for_each(|tile| mosaic.count_from(key(tile)));
    Some(mosaic)
}

/// An image with these tiles.
fn filled(
    mut mosaic: Mosaic,
    tiles: Vec<OverheadGradients>,
    skip: &mut impl FnMut(Reason, u64),
) -> Mosaic {
    let cell_m = mosaic.cell_m();
    let read = tiles.into_par_iter().map(|tile| {
        let cells = gradient_cells(&tile.png.0).filter(|_| tile.cell_m == cell_m);
        (key(&tile), cells)
    });
    for (at, cells) in read.collect::<Vec<_>>() {
        if !cells.is_some_and(|cells| mosaic.add(at, cells)) {
            skip("tile is not as overhead_gradients makes them".into(), 1);
        }
    }
    mosaic
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

/// The longest side of a box on an image with cells of this side (m).
pub(crate) fn longest_m(cell_m: f64) -> f64 {
    LONGEST_M.min(LONGEST_CELLS * cell_m)
}

/// What a label says; nothing where it is no box.
fn example(label: &PlacedLabel, cell_m: f64) -> Result<Option<Example>, Reason> {
    let (Some(length_m), Some(width_m)) = (label.length_m, label.width_m) else {
        return Ok(None);
    };
    let fits = |side_m: &f64| (LEAST_CELLS * cell_m..=longest_m(cell_m)).contains(side_m);
    let place = ground_box(&label.map_from_label, length_m, width_m);
    let place = place.filter(|_| fits(&length_m) && fits(&width_m));
    let place = place.ok_or_else(|| {
        format!("box is no longer than a few cells, or longer than 50 m or {LONGEST_CELLS} cells")
    })?;
    let judgement = match label.standing.as_str() {
        "drawn" => Judgement::Drawn,
        "accepted" => Judgement::Accepted,
        "rejected" => Judgement::Rejected,
        _ => return Err("label was neither drawn nor accepted nor rejected".into()),
    };
    Ok(Some(Example { place, judgement }))
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
