//! Label images: exact ones, and such as a labeller makes who errs.

use crate::cast::FAR;
use crate::lens::{Lens, TILE};
use crate::street::classes::Class;
use crate::street::sight::{Scenery, Sight};

/// Classes of all pixels, row by row, and the rays that saw them.
pub fn classes(scenery: &Scenery, lens: &Lens, sight: &Sight, bare: bool) -> Vec<Class> {
    let (ranges, faces) = match &sight.bare {
        Some(found) if bare => (&found.range_m, &found.face),
        _ => (&sight.range_m, &sight.face),
    };
    let mut classes = vec![Class::Other; ranges.len()];
    each_pixel(lens, |pixel, own| {
        let ray = sight.turned(own);
        classes[pixel] = scenery.class(sight, ranges[pixel], faces[pixel], ray);
    });
    classes
}

/// Calls for every pixel with its index and its ray in the vehicle's frame.
pub fn each_pixel(lens: &Lens, mut call: impl FnMut(usize, [f32; 3])) {
    for (index, tile) in lens.tiles.iter().enumerate() {
        let (left, top) = (index % lens.columns * TILE, index / lens.columns * TILE);
        for row in 0..TILE.min(lens.height - top) {
            for column in 0..TILE.min(lens.width - left) {
                let i = row * TILE + column;
                let own = [tile.rays[0][i], tile.rays[1][i], tile.rays[2][i]];
                call((top + row) * lens.width + left + column, own);
            }
        }
    }
}

/// Range images end here, metres.
const DEPTH_REACH_M: f32 = 65.0;
/// Steps of inverse range, 1/m.
const DEPTH_STEP: f32 = 2e-4;

/// A range image as stereo makes it, millimetres along the ray; 0 where nothing is measured.
/// `noise` are standard normal numbers.
pub fn depth(sight: &Sight, mut noise: impl FnMut() -> f32) -> Vec<u16> {
    let measured = |range: &f32| {
        let step = 0.5 * noise();
        if *range >= DEPTH_REACH_M.min(FAR) {
            return 0;
        }
        let inverse = (1.0 / (range * DEPTH_STEP) + step).round().max(1.0);
        (1000.0 / (inverse * DEPTH_STEP))
            .round()
            .clamp(0.0, 65_535.0) as u16
    };
    sight.range_m.iter().map(measured).collect()
}
