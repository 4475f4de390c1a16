//! Labels over a view's image, its graph over them, and the matrix of a relocation run.

use std::fmt::Write;

use base64::Engine;
use evermap_schemas::Fault;
use evermap_schemas::layers::{LabelImage, SemanticArea, SemanticGraph};

use crate::draw::colours::{BACKGROUND, INK, class};
use crate::draw::{Picture, furniture};
use crate::semantic::{Semantic, Similarities};

/// Between panels, px.
const GAP: u32 = 8;
/// Height of the legend, px.
const LEGEND: u32 = 34;

/// A person's view of views: for each the image with its labels over it, and below the graph over the image.
///
/// # Errors
/// A data fault for label images that do not decode.
pub fn views(semantic: &Semantic) -> Result<Picture, Fault> {
    let width = semantic
        .views
        .iter()
        .map(|view| view.graph.width)
        .max()
        .unwrap_or(1)
        .max(1);
    let mut body = String::new();
    let mut top = LEGEND;
    for view in &semantic.views {
        let labels = match &view.labels {
            Some(labels) => image(&coloured(labels, &semantic.classes)?, &view.graph, 0.6),
            None => String::new(),
        };
        let photo = view
            .image
            .as_deref()
            .map(|bytes| image(bytes, &view.graph, 1.0))
            .unwrap_or_default();
        let panels = [
            format!("{photo}{labels}"),
            format!(
                "<g opacity=\"0.55\">{photo}</g>{}",
                graph(&view.graph, &semantic.classes)
            ),
        ];
        for panel in panels {
            let (wide, high) = (view.graph.width, view.graph.height);
            let _ = writeln!(
                body,
                "<svg x=\"0\" y=\"{top}\" width=\"{wide}\" height=\"{high}\" viewBox=\"0 0 {wide} {high}\">{panel}</svg>"
            );
            top += high + GAP;
        }
    }
    let names: Vec<(String, String)> = semantic
        .classes
        .iter()
        .enumerate()
        .map(|(index, name)| (name.clone(), class(index)))
        .collect();
    body.push_str(&furniture::row_of_names(&names, LEGEND));
    Ok(framed(width, top, &body))
}

/// The matrix of similarities, queries from left to right, views of the map from top to bottom; bright is alike.
///
/// # Errors
/// A resource fault when it cannot be encoded.
pub fn matrix(similarities: &Similarities, width_px: u32) -> Result<Picture, Fault> {
    let grey: Vec<u8> = similarities
        .values
        .iter()
        .map(|value| (value.clamp(0.0, 1.0) * 255.0).round() as u8)
        .collect();
    let (columns, rows) = (similarities.queries as u32, similarities.views as u32);
    let png = encoded(columns, rows, png::ColorType::Grayscale, &grey)?;
    let scale = (width_px / columns.max(1)).max(1);
    let (width, height) = (columns * scale, rows * scale);
    let body = format!(
        "<image width=\"{width}\" height=\"{height}\" preserveAspectRatio=\"none\" \
         style=\"image-rendering:pixelated\" image-rendering=\"optimizeSpeed\" href=\"{}\"/>\n",
        data(&png)
    );
    Ok(framed(width.max(1), height.max(1), &body))
}

fn framed(width: u32, height: u32, body: &str) -> Picture {
    Picture {
        svg: format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" \
             viewBox=\"0 0 {width} {height}\">\n<rect width=\"{width}\" height=\"{height}\" fill=\"{BACKGROUND}\"/>\n\
             {body}</svg>\n"
        ),
        width_px: width,
        height_px: height,
    }
}

fn data(bytes: &[u8]) -> String {
    let kind = if bytes.starts_with(b"\x89PNG") {
        "png"
    } else {
        "jpeg"
    };
    let text = base64::engine::general_purpose::STANDARD.encode(bytes);
    format!("data:image/{kind};base64,{text}")
}

fn image(bytes: &[u8], graph: &SemanticGraph, opacity: f64) -> String {
    format!(
        "<image width=\"{}\" height=\"{}\" preserveAspectRatio=\"none\" opacity=\"{opacity}\" href=\"{}\"/>",
        graph.width,
        graph.height,
        data(bytes)
    )
}

/// The labels in the classes' colours, by name; transparent where there is no class.
fn coloured(labels: &LabelImage, classes: &[String]) -> Result<Vec<u8>, Fault> {
    let damaged = |error: png::DecodingError| Fault::data(format!("label image: {error}"));
    let mut decoder = png::Decoder::new(std::io::Cursor::new(&labels.png.0));
    decoder.set_transformations(png::Transformations::IDENTITY);
    let mut reader = decoder.read_info().map_err(damaged)?;
    let size = reader.output_buffer_size().unwrap_or(0);
    let mut values = vec![0; size];
    let info = reader.next_frame(&mut values).map_err(damaged)?;
    if info.bit_depth != png::BitDepth::Eight || info.color_type != png::ColorType::Grayscale {
        return Err(Fault::data(
            "expected an 8-bit grey label image, found another kind",
        ));
    }
    let palette: Vec<[u8; 4]> = labels
        .classes
        .iter()
        .map(|name| {
            let index = classes.iter().position(|known| known == name);
            let [red, green, blue] = rgb(&class(index.unwrap_or(usize::MAX - 1)));
            [red, green, blue, 255]
        })
        .collect();
    let pixels: Vec<u8> = values
        .iter()
        .flat_map(|value| palette.get(usize::from(*value)).copied().unwrap_or([0; 4]))
        .collect();
    encoded(info.width, info.height, png::ColorType::Rgba, &pixels)
}

fn encoded(
    width: u32,
    height: u32,
    colour: png::ColorType,
    pixels: &[u8],
) -> Result<Vec<u8>, Fault> {
    let failed =
        |error: png::EncodingError| Fault::resource(format!("cannot encode a picture: {error}"));
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, width, height);
    encoder.set_color(colour);
    let mut writer = encoder.write_header().map_err(failed)?;
    writer.write_image_data(pixels).map_err(failed)?;
    writer.finish().map_err(failed)?;
    Ok(bytes)
}

fn rgb(colour: &str) -> [u8; 3] {
    [1, 3, 5].map(|at| {
        colour
            .get(at..at + 2)
            .and_then(|hex| u8::from_str_radix(hex, 16).ok())
            .unwrap_or(128)
    })
}

/// Ellipses of the areas and lines between those that touch; what crosses the seam is drawn on both sides.
fn graph(graph: &SemanticGraph, classes: &[String]) -> String {
    let width = f64::from(graph.width);
    let copies: &[f64] = if graph.wraps {
        &[-1.0, 0.0, 1.0]
    } else {
        &[0.0]
    };
    let mut text = String::new();
    for edge in &graph.edges {
        let area = |index: u16| graph.areas.get(usize::from(index));
        let (Some(a), Some(b)) = (area(edge.a), area(edge.b)) else {
            continue;
        };
        let mut across = f64::from(b.u - a.u);
        if graph.wraps {
            across -= (across / width).round() * width;
        }
        let thick = 0.6 + f64::from(edge.boundary_px).sqrt() / 6.0;
        for copy in copies {
            let x = f64::from(a.u) + copy * width;
            let _ = write!(
                text,
                "<path d=\"M{x:.1} {:.1}L{:.1} {:.1}\" stroke=\"{INK}\" stroke-opacity=\"0.7\" stroke-width=\"{thick:.1}\"/>",
                a.v,
                x + across,
                b.v
            );
        }
    }
    for area in &graph.areas {
        let index = classes.iter().position(|name| *name == area.class);
        let colour = class(index.unwrap_or(usize::MAX - 1));
        for copy in copies {
            text.push_str(&ellipse(area, f64::from(area.u) + copy * width, &colour));
        }
    }
    text
}

fn ellipse(area: &SemanticArea, x: f64, colour: &str) -> String {
    format!(
        "<ellipse cx=\"0\" cy=\"0\" rx=\"{:.1}\" ry=\"{:.1}\" transform=\"translate({x:.1} {:.1}) rotate({:.1})\" \
         fill=\"{colour}\" fill-opacity=\"0.12\" stroke=\"{colour}\" stroke-width=\"1.6\"/>\
         <circle cx=\"{x:.1}\" cy=\"{:.1}\" r=\"4\" fill=\"{colour}\"/>",
        area.major_px.max(1.0),
        area.minor_px.max(1.0),
        area.v,
        area.orientation_rad.to_degrees(),
        area.v
    )
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::draw::png as raster;
    use crate::semantic::PicturedView;
    use evermap_schemas::layers::SemanticEdge;
    use evermap_schemas::{Bytes, Stamp};

    fn pictured() -> Semantic {
        let area = |class: &str, u: f32| SemanticArea {
            class: class.into(),
            u,
            v: 10.0,
            pixels: 100,
            major_px: 9.0,
            minor_px: 4.0,
            orientation_rad: 0.0,
            eccentricity: 0.9,
        };
        let mut values = vec![0; 40 * 20];
        values[3] = 255;
        values[4] = 1;
        let labels = encoded(40, 20, png::ColorType::Grayscale, &values).unwrap();
        let classes = vec!["tree".to_owned(), "sky".to_owned()];
        Semantic {
            views: vec![PicturedView {
                view: "a".into(),
                image: None,
                labels: Some(LabelImage {
                    site: "s".into(),
                    session: "a".into(),
                    stamp: Stamp(0),
                    camera: "c".into(),
                    width: 40,
                    height: 20,
                    classes: classes.clone(),
                    png: Bytes(labels),
                }),
                graph: SemanticGraph {
                    width: 40,
                    height: 20,
                    wraps: true,
                    areas: vec![area("tree", 1.0), area("sky", 39.0)],
                    edges: vec![SemanticEdge {
                        a: 0,
                        b: 1,
                        boundary_px: 9,
                    }],
                },
            }],
            classes,
        }
    }

    #[test]
    fn views_are_drawn_with_labels_and_graphs() {
        let picture = views(&pictured()).unwrap();
        assert_eq!(picture.width_px, 40);
        // The short way around: from 1 to 39 of 40 is two to the left.
        assert!(
            picture.svg.contains("M1.0 10.0L-1.0 10.0"),
            "{}",
            picture.svg
        );
        assert!(raster(&picture).unwrap().starts_with(b"\x89PNG"));
    }

    #[test]
    fn a_matrix_has_a_square_for_each_pair() {
        let similarities = Similarities {
            queries: 2,
            views: 3,
            values: vec![0.0, 1.0, 0.5, 0.0, 0.0, 0.2],
        };
        let picture = matrix(&similarities, 20).unwrap();
        assert_eq!((picture.width_px, picture.height_px), (20, 30));
    }
}
