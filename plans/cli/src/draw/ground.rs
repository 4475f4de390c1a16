//! The ground: tiles, or a faint grid where there are none.

use base64::Engine;
use evermap_schemas::Fault;

use crate::draw::colours::FAINT;
use crate::draw::view::{View, round_length};
use crate::mosaic::Mosaic;

/// The picture of the ground as an SVG image.
///
/// # Errors
/// As [`Mosaic::png`].
pub fn image(view: &View, mosaic: &Mosaic) -> Result<String, Fault> {
    let [x, y] = view.at([mosaic.west, mosaic.north]);
    let (width, height) = (
        mosaic.width as f64 * mosaic.cell_m * view.scale,
        mosaic.height as f64 * mosaic.cell_m * view.scale,
    );
    let png = base64::engine::general_purpose::STANDARD.encode(mosaic.png()?);
    Ok(format!(
        "<image id=\"ground\" x=\"{x:.2}\" y=\"{y:.2}\" width=\"{width:.2}\" height=\"{height:.2}\" \
         preserveAspectRatio=\"none\" href=\"data:image/png;base64,{png}\"/>\n"
    ))
}

/// Grid lines at round metres, some ten across the picture.
pub fn grid(view: &View) -> String {
    let step = round_length(view.width_px / view.scale / 8.0);
    let (east, south) = (
        view.west + view.width_px / view.scale,
        view.north - view.height_px / view.scale,
    );
    let mut path = String::new();
    for k in multiples(view.west, east, step) {
        let [x, _] = view.at([k, 0.0]);
        path.push_str(&format!("M{x:.1} 0V{:.1}", view.height_px));
    }
    for k in multiples(south, view.north, step) {
        let [_, y] = view.at([0.0, k]);
        path.push_str(&format!("M0 {y:.1}H{:.1}", view.width_px));
    }
    format!(
        "<path id=\"grid\" d=\"{path}\" fill=\"none\" stroke=\"{FAINT}\" stroke-opacity=\"0.06\" stroke-width=\"1\"/>\n"
    )
}

fn multiples(from: f64, to: f64, step: f64) -> impl Iterator<Item = f64> {
    let (first, last) = ((from / step).ceil() as i64, (to / step).floor() as i64);
    (first..=last).take(100).map(move |k| k as f64 * step)
}
