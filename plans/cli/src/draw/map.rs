//! A scene from above.

use std::collections::BTreeSet;

use askama::Template;
use evermap_schemas::Fault;

use crate::draw::changes::{Changes, shapes};
use crate::draw::line::{along, chevrons, length, path, simplified};
use crate::draw::pixels::data_url;
use crate::draw::slowness::SHADES;
use crate::draw::viewport::{Bounds, Viewport, bounds_of, round_length, union};
use crate::draw::{Canvas, Outline, Picture, Scene, Trajectory, colours, strokes};
use crate::mosaic::Mosaic;
use crate::shown::Lane;

/// The fault of a scene without anything.
pub const NOTHING: &str = "there is nothing to draw";

/// Width of a driving lane, m.
const LANE_WIDTH_M: f64 = 2.4;
/// Radius of the marker of an intersection, m.
const MARKER_M: f64 = 1.1;
/// More landmarks, or people, than this are thinned out evenly: a picture has no room for them.
const MOST_DOTS: usize = 40_000;
/// Sessions that the legend names; the rest are counted.
const MOST_NAMED: usize = 12;
/// From one line of the legend to the next, px.
const LEGEND_LINE_PX: f64 = strokes::LETTER_PX * 2.1;
/// Where what is below the arrow to north begins, px.
const NORTH_PX: f64 = 90.0;
/// What a drawn line may be off by, px.
const TOLERANCE_PX: f64 = 0.25;

/// Draws a scene.
///
/// # Errors
/// A user fault where there is nothing to draw or no tile at the zoom level asked for, a data fault for a damaged tile.
pub fn draw(scene: &Scene, canvas: Canvas) -> Result<Picture, Fault> {
    let ground = scene.ground(canvas)?;
    let seen = ground.as_ref().and_then(Mosaic::seen);
    let bounds = union(seen, scene.line_bounds())
        .ok_or_else(|| Fault::user(NOTHING).next("publish tiles, lanes or poses in the plan"))?;
    let viewport = Viewport::of(bounds, canvas.width_px);
    let ground = ground.map(|mosaic| GroundImage::of(&mosaic, &viewport));
    let map = MapFromAbove {
        scene,
        ground: ground.transpose()?,
        legend: legend(scene, &viewport),
        scale: ScaleBar::of(&viewport),
        viewport,
    };
    Ok(Picture {
        svg: map.to_string(),
        width_px: viewport.width_px as u32,
        height_px: viewport.height_px as u32,
    })
}

#[derive(Template)]
#[template(path = "map.svg")]
struct MapFromAbove<'s> {
    scene: &'s Scene,
    viewport: Viewport,
    ground: Option<GroundImage>,
    /// Lines of text, most with the colour of a session.
    legend: Vec<(String, Option<String>)>,
    scale: ScaleBar,
}

impl MapFromAbove<'_> {
    /// By how much an arrow that points up is turned to the right to point north (deg); `None` where nobody knows.
    fn north(&self) -> Option<f64> {
        self.scene.heading_rad.map(f64::to_degrees)
    }

    fn lane_px(&self) -> f64 {
        (LANE_WIDTH_M * self.viewport.scale).clamp(4.0, 22.0)
    }

    fn arrow_px(&self) -> f64 {
        (self.lane_px() * 0.16).clamp(1.4, 3.0)
    }

    fn marker_px(&self) -> f64 {
        (MARKER_M * self.viewport.scale).clamp(4.0, 9.0)
    }

    fn lane(&self, lane: &Lane) -> String {
        path(&simplified(
            &self.viewport.line(lane.from_above()),
            TOLERANCE_PX,
        ))
    }

    /// How fast to drive on a lane, as its title ends.
    fn lane_speed(&self, lane: &Lane) -> String {
        let speed = self.scene.lane_speeds.get(&lane.lane);
        speed.map_or(String::new(), |[least, mean]| {
            format!(", {least:.1} m/s at the slowest, {mean:.1} m/s in the mean")
        })
    }

    /// The lowest speed of each lane beside its middle: where, and in letters (m/s). Lanes too short for the letters have none.
    fn lane_signs(&self) -> impl Iterator<Item = ([f64; 2], String)> {
        self.scene.lanes.iter().filter_map(|lane| {
            let [least, _] = self.scene.lane_speeds.get(&lane.lane)?;
            let text = format!("{least:.1}");
            let line = self.viewport.line(lane.from_above());
            let length = length(&line);
            let ([x, y], [dx, dy]) = along(&line, 0.5 * length)?;
            let aside = self.lane_px() + strokes::LETTER_PX;
            let middle = [x - dy * aside, y + dx * aside];
            let corner = [
                middle[0] - 0.5 * strokes::width(&text),
                middle[1] - 0.5 * strokes::LETTER_PX,
            ];
            (length > 3.0 * strokes::width(&text)).then_some((corner, text))
        })
    }

    /// Cells to be driven over slowly by shade: how much of what lies below each hides, and its outlines.
    fn slow(&self) -> impl Iterator<Item = (f64, String)> {
        (1..=SHADES).filter_map(|shade| {
            let cells = self.scene.slow.iter().filter(|cell| cell.shade == shade);
            let squares = cells.map(|cell| {
                let ([x, y], side) = (cell.corner, cell.side_m);
                let corners = [[x, y], [x + side, y], [x + side, y + side], [x, y + side]];
                path(&self.viewport.line(corners)) + "Z"
            });
            let squares: String = squares.collect();
            let opacity = 0.65 * f64::from(shade) / f64::from(SHADES);
            (!squares.is_empty()).then_some((opacity, squares))
        })
    }

    fn outline(&self, outline: &Outline) -> String {
        let line = path(&self.viewport.line(outline.points.iter().copied()));
        if outline.closed { line + "Z" } else { line }
    }

    fn arrows(&self) -> String {
        let size = (self.lane_px() * 0.3).clamp(3.0, 6.0);
        let of = |lane: &Lane| {
            let line = self.viewport.line(lane.from_above());
            chevrons(&line, &lane.direction, size)
        };
        self.scene.lanes.iter().map(of).collect()
    }

    /// Points of the map within the picture, as dots of one path.
    fn dots(&self, points: &[[f64; 2]]) -> String {
        let every = points.len().div_ceil(MOST_DOTS).max(1);
        let (width, height) = (self.viewport.width_px, self.viewport.height_px);
        let places = self.viewport.line(points.iter().step_by(every).copied());
        let inside = |[x, y]: &[f64; 2]| (0.0..=width).contains(x) && (0.0..=height).contains(y);
        let dots = places.into_iter().filter(inside);
        dots.map(|[x, y]| format!("M{x:.1} {y:.1}h0")).collect()
    }

    /// Loop closures that the map agrees with, or those that it does not.
    fn loops(&self, accepted: bool) -> Vec<String> {
        let loops = self.scene.loops.iter();
        let chosen = loops.filter(|line| line.accepted == accepted);
        let drawn = chosen.map(|line| path(&self.viewport.line(line.ends)));
        drawn.collect()
    }

    fn driven(&self, driven: &Trajectory) -> String {
        let drawn = |stretch: &[[f64; 2]]| {
            let line = self.viewport.line(stretch.iter().copied());
            path(&simplified(&line, TOLERANCE_PX))
        };
        driven.stretches().into_iter().map(drawn).collect()
    }

    fn start(&self, driven: &Trajectory) -> Option<[f64; 2]> {
        self.viewport.line(driven.points.first().copied()).pop()
    }

    /// Number, lanes that meet, and where.
    fn intersections(&self) -> impl Iterator<Item = (u32, u32, [f64; 2])> {
        let rows = self.scene.intersections.iter();
        rows.flat_map(move |row| {
            let places = self.viewport.line([[row.x, row.y]]);
            places.into_iter().map(move |at| (row.node, row.degree, at))
        })
    }

    /// Path data of what is gone and what is new.
    fn changed(&self, changed: &[Vec<[f64; 2]>]) -> String {
        shapes(changed, &self.viewport)
    }

    /// Where the legend is: above to the left, or to the right or below there, where it covers less of what is drawn.
    fn legend_at(&self) -> (f64, f64) {
        let size = [self.legend_width(), self.legend_height()];
        let right = self.viewport.width_px - size[0] - 2.0;
        let below = self.viewport.height_px - size[1] - 2.0;
        let under_north = self.scene.heading_rad.map_or(22.0, |_| NORTH_PX);
        let corners = [[22.0, 22.0], [right, under_north], [right, below]];
        let covered = corners.map(|corner| self.covered(corner, size));
        let least = covered.iter().min();
        let chosen = covered.iter().position(|count| Some(count) == least);
        corners[chosen.unwrap_or(0)].into()
    }

    /// How many outlines, and points of lines, a panel covers.
    fn covered(&self, [x, y]: [f64; 2], [width, height]: [f64; 2]) -> usize {
        let panel = [x - 10.0, y - 10.0, x - 10.0 + width, y - 10.0 + height];
        let meets = |[west, north, east, south]: Bounds| {
            west < panel[2] && east > panel[0] && north < panel[3] && south > panel[1]
        };
        let outlines = self.scene.outlines.iter().filter(|outline| {
            let points = self.viewport.line(outline.points.iter().copied());
            bounds_of(points).is_some_and(meets)
        });
        let driven = self
            .scene
            .trajectories
            .iter()
            .flat_map(|driven| &driven.points);
        let lanes = self.scene.lanes.iter().flat_map(Lane::from_above);
        let points = self.viewport.line(driven.copied().chain(lanes));
        outlines.count()
            + points
                .into_iter()
                .filter(|[x, y]| meets([*x, *y, *x, *y]))
                .count()
    }

    fn legend_y(&self, line: usize) -> f64 {
        line as f64 * LEGEND_LINE_PX
    }

    fn legend_height(&self) -> f64 {
        self.legend_y(self.legend.len()) + 11.0
    }

    fn legend_width(&self) -> f64 {
        let names = self.legend.iter();
        let widths = names.map(|(name, _)| strokes::width(name));
        widths.fold(0.0, f64::max) + 52.0
    }
}

/// The sessions' names in their colours, what outlines are of, and every other symbol that is drawn.
fn legend(scene: &Scene, viewport: &Viewport) -> Vec<(String, Option<String>)> {
    let driven = &scene.trajectories;
    let named = driven.iter().take(MOST_NAMED).enumerate();
    let mut lines: Vec<_> = named
        .map(|(index, driven)| {
            let name = strokes::name(&driven.session, 28);
            (name, Some(colours::session(index)))
        })
        .collect();
    if driven.len() > MOST_NAMED {
        lines.push((format!("+ {} more", driven.len() - MOST_NAMED), None));
    }
    let marks: BTreeSet<_> = scene.outlines.iter().map(|outline| &outline.mark).collect();
    lines.extend(marks.into_iter().map(|mark| {
        let name = strokes::name(&mark.name(), 28);
        (name, Some(mark.colour()))
    }));
    let loops = |accepted| scene.loops.iter().any(|line| line.accepted == accepted);
    let lane = match scene.lane_speeds.is_empty() {
        true => "lane",
        false => "lane, its lowest speed (m/s)",
    };
    let symbols = [
        (!scene.lanes.is_empty(), lane, colours::LANE),
        (
            !scene.intersections.is_empty(),
            "intersection",
            colours::INTERSECTION,
        ),
        (!scene.slow.is_empty(), "drive slowly", colours::SLOW),
        (!scene.people.is_empty(), "people seen", colours::PERSON),
        (!scene.landmarks.is_empty(), "landmark", colours::LANDMARK),
        (loops(true), "loop closure", colours::ACCEPTED),
        (loops(false), "loop closure, rejected", colours::REJECTED),
    ];
    lines.extend(drawn(symbols));
    let changes = scene.changes.iter();
    lines.extend(changes.flat_map(|changes| explained(changes, viewport)));
    if !scene.odometry.is_empty() {
        lines.push(("dashed: by odometry".to_owned(), None));
    }
    lines.extend(scene.notes.iter().map(|note| (note.clone(), None)));
    lines
}

/// Names and colours of the symbols that are drawn.
fn drawn<N: Into<String>>(
    symbols: impl IntoIterator<Item = (bool, N, &'static str)>,
) -> impl Iterator<Item = (String, Option<String>)> {
    let symbols = symbols.into_iter().filter(|(is_drawn, ..)| *is_drawn);
    symbols.map(|(_, name, colour)| (name.into(), Some(colour.to_owned())))
}

/// What the marks of changes mean.
fn explained(changes: &Changes, viewport: &Viewport) -> Vec<(String, Option<String>)> {
    let since = format!("since version {}", changes.since);
    let most_mm = (1e3 * changes.most_m()).round();
    // `moved_m` of `diff` has what moved up and down too, which no picture from above shows.
    let moved = format!("moved, at most {most_mm} mm seen from above");
    let kinds = [
        (
            !changes.new.is_empty(),
            format!("new {since}"),
            colours::NEW,
        ),
        (
            !changes.gone.is_empty(),
            format!("gone {since}"),
            colours::GONE,
        ),
        (!changes.moved.is_empty(), moved, colours::MOVED),
    ];
    let mut lines: Vec<_> = drawn(kinds).collect();
    let stretch = changes.stretch(viewport);
    if stretch > 1.0 {
        lines.push((format!("motion drawn {stretch} times longer"), None));
    }
    if lines.is_empty() {
        lines.push((format!("nothing changed {since}"), None));
    }
    lines
}

/// The picture of the ground, and where it lies.
struct GroundImage {
    x: f64,
    y: f64,
    width: f64,
    height: f64,
    href: String,
}

impl GroundImage {
    fn of(mosaic: &Mosaic, viewport: &Viewport) -> Result<Self, Fault> {
        let [x, y] = viewport.at([mosaic.west, mosaic.north]);
        let cell_px = mosaic.cell_m * viewport.scale;
        Ok(Self {
            x,
            y,
            width: mosaic.width as f64 * cell_px,
            height: mosaic.height as f64 * cell_px,
            href: data_url(&mosaic.png()?),
        })
    }
}

/// A bar of round length.
struct ScaleBar {
    bar_px: f64,
    label: String,
}

impl ScaleBar {
    fn of(viewport: &Viewport) -> Self {
        let metres = round_length(viewport.width_px * 0.2 / viewport.scale);
        Self {
            bar_px: metres * viewport.scale,
            label: if metres >= 1000.0 {
                format!("{} km", metres / 1000.0)
            } else {
                format!("{metres} m")
            },
        }
    }

    fn ticks(&self) -> String {
        let (end, middle) = (self.bar_px, self.bar_px / 2.0);
        format!("M0 -8V0H{end:.1}V-8M{middle:.1} -5V0")
    }

    fn label_x(&self) -> f64 {
        (self.bar_px - strokes::width(&self.label)) / 2.0
    }
}
