//! Views without what moves: image, labels before, with what others saw, what is inferred, and all of it; where the truth is
//! known, beside it.

use askama::Template;
use evermap_algorithms::semantic_map::semantic_graph::VOID;
use evermap_schemas::Fault;
use png::ColorType;

use crate::draw::legend::{Legend, NAME_PX};
use crate::draw::pixels::{data_url, decoded, encoded};
use crate::draw::{Picture, colours, strokes};
use crate::shown::Shot;
use crate::stable::{StableMap, StableView};

/// Between panels, px.
const GAP_PX: u32 = 8;
/// Height of a line of letters, px.
const LINE_PX: u32 = 18;
/// Panels side by side of views that are at least twice as wide as high: the row of a view goes on below.
const WIDE_COLUMNS: u32 = 3;
/// How much of a label's colour is left where something else is shown.
const FAINT: u8 = 56;

/// The views one below another, each with its panels side by side; those of panoramas in two lines.
///
/// # Errors
/// A data fault for label images that do not decode, or are not of one size.
pub fn stable(map: &StableMap, width_px: u32) -> Result<Picture, Fault> {
    let compared = map.views.iter().any(|view| view.truth.is_some());
    let named = map.classes.iter().enumerate();
    let named = named.map(|(index, name)| (name.clone(), colours::class(index)));
    let outcomes = OUTCOMES.map(|(name, colour)| (name.to_owned(), colour.to_owned()));
    let outcomes = outcomes.into_iter().filter(|_| compared);
    let legend = Legend::of(named.chain(outcomes), width_px);
    let mut picture = Stable {
        width: legend.width,
        height: legend.height,
        views: Vec::new(),
        legend,
    };
    for view in &map.views {
        let panels = Labels::of(view)?.panels(view, &map.classes)?;
        picture.add(view, panels);
    }
    Ok(Picture {
        svg: picture.to_string(),
        width_px: picture.width,
        height_px: picture.height,
    })
}

#[derive(Template)]
#[template(path = "stable.svg")]
struct Stable {
    width: u32,
    height: u32,
    views: Vec<Row>,
    legend: Legend,
}

/// A view's panels.
struct Row {
    name: String,
    /// Upper edge of its name, px.
    top: u32,
    panels: Vec<PlacedPanel>,
}

/// Where a panel's title is, and its image a line below it.
struct PlacedPanel {
    x: u32,
    y: u32,
    width: u32,
    height: u32,
    panel: Panel,
}

/// What is drawn in one place.
struct Panel {
    /// What programs know it by.
    kind: &'static str,
    title: String,
    /// The image; a photo is drawn smoothly, labels pixel by pixel; `None` where there is none.
    href: Option<String>,
    is_photo: bool,
}

impl PlacedPanel {
    /// The strokes of the title, as far as there is room for it.
    fn letters(&self) -> String {
        let letter = strokes::width("nn") - strokes::width("n");
        let most = (f64::from(self.width) / letter) as usize;
        strokes::letters(&strokes::name(&self.panel.title, most))
    }
}

impl Stable {
    /// Adds the row of a view below those that are there.
    fn add(&mut self, view: &StableView, panels: Vec<Panel>) {
        let (width, height) = (view.stable.width.max(1), view.stable.height.max(1));
        let columns = match width >= 2 * height {
            true => WIDE_COLUMNS,
            false => panels.len() as u32,
        };
        let wide = (self.width.saturating_sub(GAP_PX * (columns - 1)) / columns).max(1);
        let high = (f64::from(wide) * f64::from(height) / f64::from(width)).round();
        let high = (high as u32).max(1);
        let top = self.height;
        let place = |(number, panel): (u32, Panel)| PlacedPanel {
            x: number % columns * (wide + GAP_PX),
            y: top + LINE_PX + number / columns * (LINE_PX + high + GAP_PX),
            width: wide,
            height: high,
            panel,
        };
        let panels: Vec<PlacedPanel> = (0..).zip(panels).map(place).collect();
        let last = panels.last().map_or(top, |last| last.y);
        self.height = last + LINE_PX + high + 2 * GAP_PX;
        let Shot {
            session,
            stamp,
            camera,
            ..
        } = &view.shot;
        self.views.push(Row {
            name: strokes::printable(&format!("{session}/{camera}/{}", stamp.0)),
            top,
            panels,
        });
    }
}

/// What became of a pixel's label.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Fate {
    /// It is of what stays.
    Stays,
    /// What is behind it was seen by others.
    Seen,
    /// What is behind it was inferred.
    Inferred,
    /// Nobody knows what is behind it.
    Unknown,
}

/// What a label behind something that moves turned out to be, in the legend: right, wrong though it was seen, wrong as it
/// was inferred, not said.
const OUTCOMES: [(&str, &str); 4] = [
    ("right", colours::FREE),
    ("wrong, though seen", colours::MOVED),
    ("wrong, as inferred", colours::TAKEN),
    ("not known", colours::UNSEEN),
];

/// The decoded labels of a view, all of one size.
struct Labels<'v> {
    before: Vec<u8>,
    warped: Vec<u8>,
    stable: Vec<u8>,
    certainty: Vec<u8>,
    truth: Option<&'v [u8]>,
}

impl<'v> Labels<'v> {
    fn of(view: &'v StableView) -> Result<Self, Fault> {
        let size = [view.stable.width, view.stable.height];
        let labels = |png: &[u8], layer: &str| {
            let (width, height, values) =
                decoded(png, ColorType::Grayscale).map_err(|fault| fault.at(layer))?;
            match [width, height] == size {
                true => Ok(values),
                false => Err(Fault::data(format!(
                    "expected labels of {} by {} px, found {width} by {height}",
                    size[0], size[1]
                ))
                .at(layer)),
            }
        };
        let stable = labels(&view.stable.png.0, "inferred_labels")?;
        let truth = view.truth.as_deref();
        Ok(Self {
            before: labels(&view.before.png.0, "label_images")?,
            warped: labels(&view.warped.png.0, "warped_labels")?,
            certainty: labels(&view.stable.certainty.0, "inferred_labels")?,
            truth: truth.filter(|truth| truth.len() == stable.len()),
            stable,
        })
    }

    fn fate(&self, at: usize) -> Fate {
        match (self.stable[at], self.certainty[at]) {
            (stable, _) if stable == self.before[at] => Fate::Stays,
            (VOID, _) => Fate::Unknown,
            (_, u8::MAX) => Fate::Seen,
            _ => Fate::Inferred,
        }
    }

    /// What a label behind something that moves turned out to be, as a place in [`OUTCOMES`]; `None` of what stays, and where
    /// the truth has no class.
    fn outcome(&self, at: usize) -> Option<usize> {
        let truth = *self.truth?.get(at)?;
        match self.fate(at) {
            _ if truth == VOID => None,
            Fate::Stays => None,
            Fate::Unknown => Some(3),
            _ if truth == self.stable[at] => Some(0),
            Fate::Seen => Some(1),
            Fate::Inferred => Some(2),
        }
    }

    fn panels(&self, view: &StableView, classes: &[String]) -> Result<Vec<Panel>, Fault> {
        let size = [view.stable.width, view.stable.height];
        let titles = Titles::of(self);
        let given = colours::palette(&view.before.classes, classes);
        let warped = colours::palette(&view.warped.classes, classes);
        let stable = colours::palette(&view.stable.classes, classes);
        let faint = |at: usize| {
            let [red, green, blue, alpha] = stable[usize::from(self.stable[at])];
            [red, green, blue, alpha.min(FAINT)]
        };
        let inferred = |at: usize| match self.fate(at) {
            Fate::Inferred => stable[usize::from(self.stable[at])],
            _ => faint(at),
        };
        let panel = |kind, title, colour: &dyn Fn(usize) -> [u8; 4]| {
            let pixels: Vec<u8> = (0..self.stable.len()).flat_map(colour).collect();
            let png = encoded(size[0], size[1], ColorType::Rgba, &pixels)?;
            Ok::<_, Fault>(Panel {
                kind,
                title,
                href: Some(data_url(&png)),
                is_photo: false,
            })
        };
        let mut panels = vec![
            photo(view),
            panel("before", titles.before(), &|at| {
                given[usize::from(self.before[at])]
            })?,
            panel("warped", titles.warped(view.warped.views), &|at| {
                warped[usize::from(self.warped[at])]
            })?,
            panel("inferred", titles.inferred(), &inferred)?,
            panel("stable", titles.stable(), &|at| {
                stable[usize::from(self.stable[at])]
            })?,
        ];
        if self.truth.is_some() {
            let outcome = |at: usize| match self.outcome(at) {
                Some(outcome) => colours::rgba(OUTCOMES[outcome].1),
                None => faint(at),
            };
            panels.push(panel("truth", titles.truth(), &outcome)?);
        }
        Ok(panels)
    }
}

fn photo(view: &StableView) -> Panel {
    let title = match view.image {
        Some(_) => "image",
        None => "no image: its log is gone, or has none",
    };
    Panel {
        kind: "image",
        title: title.to_owned(),
        href: view.image.as_deref().map(data_url),
        is_photo: true,
    }
}

/// The pixels of a view, counted for the titles of its panels.
#[derive(Default)]
struct Titles {
    all: u32,
    seen: u32,
    inferred: u32,
    unknown: u32,
    /// Sum of the probabilities of what was inferred.
    sure: f64,
    /// By place in [`OUTCOMES`], of what was seen, then of what was inferred.
    outcomes: [[u32; 4]; 2],
}

impl Titles {
    fn of(labels: &Labels<'_>) -> Self {
        let mut counted = Self::default();
        for at in 0..labels.stable.len() {
            counted.all += 1;
            let fate = labels.fate(at);
            match fate {
                Fate::Stays => {}
                Fate::Seen => counted.seen += 1,
                Fate::Unknown => counted.unknown += 1,
                Fate::Inferred => {
                    counted.inferred += 1;
                    counted.sure += f64::from(labels.certainty[at]) / f64::from(u8::MAX);
                }
            }
            if let Some(outcome) = labels.outcome(at) {
                counted.outcomes[usize::from(fate == Fate::Inferred)][outcome] += 1;
            }
        }
        counted
    }

    fn moving(&self) -> u32 {
        self.seen + self.inferred + self.unknown
    }

    fn before(&self) -> String {
        match self.moving() {
            0 => "before: nothing moves".to_owned(),
            moving => format!("before: {} moves", percent(moving, self.all)),
        }
    }

    fn warped(&self, views: u32) -> String {
        match self.moving() {
            0 => "warped".to_owned(),
            moving => {
                let seen = percent(self.seen, moving);
                format!("warped: {seen} of that seen, by {views} views")
            }
        }
    }

    fn inferred(&self) -> String {
        match self.inferred {
            0 => "inferred: nothing".to_owned(),
            inferred => {
                let sure = self.sure / f64::from(inferred);
                let share = percent(inferred, self.moving());
                format!("inferred: {share} of that, {sure:.2} sure")
            }
        }
    }

    fn stable(&self) -> String {
        match self.moving() {
            0 => "stable".to_owned(),
            moving => format!(
                "stable: {} of that not known",
                percent(self.unknown, moving)
            ),
        }
    }

    fn truth(&self) -> String {
        let [seen, inferred] = self
            .outcomes
            .map(|[right, though, as_inferred, _]| percent(right, right + though + as_inferred));
        format!("truth: {seen} of seen right, {inferred} of inferred")
    }
}

/// A share of a whole; a dash where there is none.
fn percent(part: u32, whole: u32) -> String {
    match whole {
        0 => "-".to_owned(),
        _ => format!("{:.1} %", 100.0 * f64::from(part) / f64::from(whole)),
    }
}

#[cfg(test)]
mod tests;
