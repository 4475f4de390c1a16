//! The columns of layers that a picture shows. A layer that a query made, or an older version, needs only these.

use evermap_schemas::{Bytes, layers, record};

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
        /// Grey PNG with alpha; the first row is the northernmost.
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
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use evermap_schemas::{Layer, LayerRow};

    #[test]
    fn what_is_shown_is_in_the_layers() {
        let pairs: [(Layer, Layer); 4] = [
            (Tile::layer(), layers::OverheadTile::layer()),
            (Lane::layer(), layers::Lane::layer()),
            (Crossing::layer(), layers::Intersection::layer()),
            (LandmarkPoint::layer(), layers::Landmark::layer()),
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
