//! The columns of layers that a picture shows. A layer that a query made, or an older version, needs only these.

use evermap_schemas::{Bytes, ImageRef, Pose, Stamp, layers, record};

record! {
    /// A tile, as far as it is shown.
    #[layer(layers::OverheadTile::NAME, key(site, zoom, tile_x, tile_y))]
    pub struct Tile {
        /// Site of the map.
        site: String,
        /// Level: 0 is the finest.
        zoom: u32,
        /// Tile column.
        tile_x: i32,
        /// Tile row.
        tile_y: i32,
        /// Side of a cell.
        cell_m: f64 ["m"],
        /// Side of the tile.
        size_m: f64 ["m"],
        /// PNG with alpha, grey or in colour; the first row is the northernmost.
        png: Bytes,
    }
}

record! {
    /// A lane, as far as it is shown.
    #[layer(layers::Lane::NAME, key(site, lane))]
    pub struct Lane {
        /// Site of the map.
        site: String,
        /// Number within the site.
        lane: u32,
        /// What is at the start.
        start_kind: String,
        /// What is at the end.
        end_kind: String,
        /// `forward`, `backward` or `both`; anything else has no arrows.
        direction: String,
        /// Length.
        length_m: f64 ["m"],
        /// The centre line.
        points: Vec<[f64; 3]> ["m", "map"],
    }
}
impl Lane {
    /// The centre line without heights.
    pub fn from_above(&self) -> impl Iterator<Item = [f64; 2]> {
        self.points.iter().map(|[x, y, _]| [*x, *y])
    }
}

record! {
    /// An intersection, as far as it is shown.
    #[layer(layers::Intersection::NAME, key(site, node))]
    pub struct Crossing {
        /// Site of the map.
        site: String,
        /// Number within the site.
        node: u32,
        /// Lane ends that meet here.
        degree: u32,
        /// Where it is.
        x: f64 ["m", "map"],
        /// Where it is.
        y: f64 ["m", "map"],
    }
}

record! {
    /// A landmark, as far as it is shown.
    #[layer(layers::Landmark::NAME, key(site))]
    pub struct LandmarkPoint {
        /// Site of the map.
        site: String,
        /// Where it is.
        x: f64 ["m", "map"],
        /// Where it is.
        y: f64 ["m", "map"],
        /// Where it is.
        z: f64 ["m", "map"],
    }
}

record! {
    /// A parking space, as far as it is shown.
    #[layer(layers::ParkingSpace::NAME, key(site, space))]
    pub struct Space {
        /// Site of the map.
        site: String,
        /// Number within the site.
        space: u32,
        /// `drawn` or `accepted` by a person, or `found`.
        standing: String,
        /// The label, where a person said so; null where it was found.
        label: Option<String>,
        /// Its frame in the map: the middle of the space.
        map_from_space: Pose ["", "map"],
        /// Length along x of its frame.
        length_m: f64 ["m"],
        /// Width.
        width_m: f64 ["m"],
    }
}

record! {
    /// Whether a space was free during a session, as far as it is shown.
    #[layer(layers::SpaceOccupancy::NAME, key(site, session, space))]
    pub struct SpaceState {
        /// Site of the map.
        site: String,
        /// Session that drove past.
        session: String,
        /// The space's number.
        space: u32,
        /// `free`, `taken` or `unseen`.
        state: String,
    }
}

record! {
    /// A label, as far as it is shown.
    #[layer(layers::PlacedLabel::NAME, key(site, label))]
    pub struct Label {
        /// Site of the map.
        site: String,
        /// The label.
        label: String,
        /// What it marks.
        kind: String,
        /// `drawn`, `accepted` or `rejected`.
        standing: String,
        /// `box`, `polygon` or `polyline`.
        shape: String,
        /// Its outline.
        points: Vec<[f64; 3]> ["m", "map"],
    }
}

record! {
    /// A box that may be of a kind, as far as it is shown.
    #[layer(layers::BoxHypothesis::NAME, key(site, kind, hypothesis))]
    pub struct Hypothesis {
        /// Site of the map.
        site: String,
        /// What it may mark.
        kind: String,
        /// Counted from 0, the likeliest first.
        hypothesis: u32,
        /// Its frame in the map: the middle of the box.
        map_from_label: Pose ["", "map"],
        /// Length of the box.
        length_m: f64 ["m"],
        /// Width of the box.
        width_m: f64 ["m"],
        /// Probability that it is one.
        probability: f64,
        /// Counted from 1: which to ask about first; null where others are more worth asking about.
        question: Option<u32>,
    }
}

record! {
    /// A cell of the speed map, as far as it is shown.
    #[layer(layers::SpeedCell::NAME, key(site, column, row))]
    pub struct SpeedCell {
        /// Site of the map.
        site: String,
        /// Column of the cell.
        column: i32 ["", "map"],
        /// Row of the cell.
        row: i32 ["", "map"],
        /// Side of a cell.
        cell_m: f64 ["m"],
        /// Recommended speed.
        speed_mps: f64 ["m/s"],
        /// The highest speed that is recommended anywhere.
        max_mps: f64 ["m/s"],
    }
}

record! {
    /// A cell of the danger map, as far as it is shown.
    #[layer(layers::Danger::NAME, key(site, column, row))]
    pub struct DangerCell {
        /// Site of the map.
        site: String,
        /// Column of the cell.
        column: i32 ["", "map"],
        /// Row of the cell.
        row: i32 ["", "map"],
        /// Side of a cell.
        cell_m: f64 ["m"],
        /// Probability that somebody is in the cell in one look.
        danger: f64,
    }
}

record! {
    /// How fast to drive on a lane, as far as it is shown.
    #[layer(layers::LaneSpeed::NAME, key(site, lane))]
    pub struct LaneSpeed {
        /// Site of the map.
        site: String,
        /// The lane's number within the site.
        lane: u32,
        /// The lowest recommended speed on the lane; null where it has no cell.
        speed_mps: Option<f64> ["m/s"],
        /// The mean recommended speed over its cells; null where it has none.
        mean_mps: Option<f64> ["m/s"],
    }
}

record! {
    /// A person who was seen, as far as they are shown.
    #[layer(layers::PersonOnGround::NAME, key(site))]
    pub struct PersonSeen {
        /// Site of the map.
        site: String,
        /// Where the feet are.
        x: f64 ["m", "map"],
        /// Where the feet are.
        y: f64 ["m", "map"],
    }
}

record! {
    /// A view, as far as it is told from others.
    #[layer(layers::View::NAME, key(site, session, stamp, camera))]
    pub struct Shot {
        /// Site that was driven.
        site: String,
        /// Session that was driven.
        session: String,
        /// Exposure instant.
        stamp: Stamp ["ns"],
        /// Camera that took it.
        camera: String,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use evermap_schemas::{Layer, LayerRow};

    #[test]
    fn what_is_shown_is_in_the_layers() {
        let pairs: [(Layer, Layer); 14] = [
            (Tile::layer(), layers::OverheadTile::layer()),
            (Lane::layer(), layers::Lane::layer()),
            (Crossing::layer(), layers::Intersection::layer()),
            (LandmarkPoint::layer(), layers::Landmark::layer()),
            (Space::layer(), layers::ParkingSpace::layer()),
            (SpaceState::layer(), layers::SpaceOccupancy::layer()),
            (Label::layer(), layers::PlacedLabel::layer()),
            (Hypothesis::layer(), layers::BoxHypothesis::layer()),
            (SpeedCell::layer(), layers::SpeedCell::layer()),
            (DangerCell::layer(), layers::Danger::layer()),
            (LaneSpeed::layer(), layers::LaneSpeed::layer()),
            (PersonSeen::layer(), layers::PersonOnGround::layer()),
            (Shot::layer(), layers::View::layer()),
            (Shot::layer(), layers::WarpedLabels::layer()),
        ];
        for (shown, layer) in pairs {
            for column in shown.columns {
                let declared = layer.column(column.name).map(|found| &found.data_type);
                assert_eq!(
                    declared,
                    Some(&column.data_type),
                    "{}.{}",
                    layer.name,
                    column.name
                );
            }
        }
    }
}

record! {
    /// Where an image lies that people may choose.
    #[layer("pictures", key(site, session, stamp, camera))]
    pub struct Picture {
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
    }
}
