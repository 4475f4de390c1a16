//! Labels over a view's image, and its graph over them.

use askama::Template;
use evermap_schemas::Fault;
use evermap_schemas::layers::{LabelImage, SemanticArea, SemanticGraph};
use png::ColorType;

use crate::draw::legend::{Legend, NAME_PX};
use crate::draw::pixels::{data_url, decoded, encoded};
use crate::draw::{Picture, colours, strokes};
use crate::semantic::{PicturedView, SemanticMap};

/// Between panels, px.
const GAP: u32 = 8;

/// A person's view of views: for each the image with its labels over it, and below the graph over the image.
///
/// # Errors
/// A data fault for label images that do not decode.
pub fn views(map: &SemanticMap) -> Result<Picture, Fault> {
    let widths = map.views.iter().map(|view| view.graph.width);
    let legend = Legend::of_classes(&map.classes, widths.max().unwrap_or(1));
    let mut picture = Views {
        width: legend.width,
        height: legend.height,
        views: Vec::new(),
        classes: &map.classes,
        legend,
    };
    for view in &map.views {
        let panels = Panels::of(view, &map.classes, picture.height)?;
        picture.height = panels.below() + view.graph.height + GAP;
        picture.views.push(panels);
    }
    Ok(Picture {
        svg: picture.to_string(),
        width_px: picture.width,
        height_px: picture.height,
    })
}

#[derive(Template)]
#[template(path = "views.svg")]
struct Views<'m> {
    width: u32,
    height: u32,
    views: Vec<Panels<'m>>,
    classes: &'m [String],
    legend: Legend,
}

impl Views<'_> {
    fn colour(&self, area: &SemanticArea) -> String {
        colours::class_of(&area.class, self.classes)
    }
}

/// The two panels of a view: labels over its image, and its graph over its image.
struct Panels<'m> {
    top: u32,
    photo: Option<String>,
    labels: Option<String>,
    graph: &'m SemanticGraph,
}

impl<'m> Panels<'m> {
    fn of(view: &'m PicturedView, classes: &[String], top: u32) -> Result<Self, Fault> {
        let labels = view.labels.as_ref();
        let labels = labels.map(|labels| coloured(labels, classes)).transpose()?;
        Ok(Self {
            top,
            photo: view.image.as_deref().map(data_url),
            labels: labels.as_deref().map(data_url),
            graph: &view.graph,
        })
    }

    /// The upper edge of the second panel.
    fn below(&self) -> u32 {
        self.top + self.graph.height + GAP
    }

    /// By how much the picture is moved: what crosses the seam of a panorama is drawn on both sides.
    fn copies(&self) -> &'static [f64] {
        match self.graph.wraps {
            true => &[-1.0, 0.0, 1.0],
            false => &[0.0],
        }
    }

    /// The middles of areas that touch, joined the short way around; and how thick the line is.
    fn edges(&self) -> Vec<(String, f64)> {
        let width = f64::from(self.graph.width);
        let area = |index: u16| self.graph.areas.get(usize::from(index));
        let mut lines = Vec::new();
        for edge in &self.graph.edges {
            let (Some(a), Some(b)) = (area(edge.a), area(edge.b)) else {
                continue;
            };
            let mut across = f64::from(b.u - a.u);
            if self.graph.wraps {
                across -= (across / width).round() * width;
            }
            let thick = 0.6 + f64::from(edge.boundary_px).sqrt() / 6.0;
            for copy in self.copies() {
                let x = f64::from(a.u) + copy * width;
                let path = format!("M{x:.1} {:.1}L{:.1} {:.1}", a.v, x + across, b.v);
                lines.push((path, thick));
            }
        }
        lines
    }

    /// The areas, and where their middles are drawn, px from the left.
    fn areas(&self) -> impl Iterator<Item = (&SemanticArea, f64)> {
        let width = f64::from(self.graph.width);
        self.graph.areas.iter().flat_map(move |area| {
            let copies = self.copies().iter();
            copies.map(move |copy| (area, f64::from(area.u) + copy * width))
        })
    }
}

/// The labels in the classes' colours, by name; transparent where there is no class.
fn coloured(labels: &LabelImage, classes: &[String]) -> Result<Vec<u8>, Fault> {
    let (width, height, values) =
        decoded(&labels.png.0, ColorType::Grayscale).map_err(|fault| fault.at("label image"))?;
    let palette = colours::palette(&labels.classes, classes);
    let pixels: Vec<u8> = values
        .iter()
        .flat_map(|value| palette[usize::from(*value)])
        .collect();
    encoded(width, height, ColorType::Rgba, &pixels)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::draw::png as raster;
    use evermap_schemas::layers::SemanticEdge;
    use evermap_schemas::{Bytes, Stamp};

    fn pictured() -> SemanticMap {
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
        let labels = encoded(40, 20, ColorType::Grayscale, &values).unwrap();
        let classes = vec!["tree".to_owned(), "sky".to_owned()];
        SemanticMap {
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
                    field_of_view_rad: None,
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
        // As wide as the longest name, as the view is narrower.
        assert_eq!(picture.width_px, 68);
        // The short way around: from 1 to 39 of 40 is two to the left.
        assert!(
            picture.svg.contains("M1.0 10.0L-1.0 10.0"),
            "{}",
            picture.svg
        );
        assert!(raster(&picture).unwrap().starts_with(b"\x89PNG"));
    }

    #[test]
    fn views_begin_below_the_last_line_of_the_legend() {
        let names = "building car fence person pole road sidewalk sky tree";
        let mut map = pictured();
        map.classes = names.split(' ').map(str::to_owned).collect();
        let drawn = |width: u32| {
            let mut map = map.clone();
            map.views[0].graph.width = width;
            views(&map).unwrap()
        };
        let legend = Legend::of_classes(&map.classes, 256);
        let narrow = drawn(256);
        assert_eq!(narrow.width_px, 256);
        assert!(
            narrow
                .svg
                .contains(&format!("<svg x=\"0\" y=\"{}\"", legend.height))
        );
        assert!(drawn(1024).height_px < narrow.height_px);
    }
}
