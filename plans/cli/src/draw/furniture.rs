//! What helps to read a map: a scale bar, a north arrow, the names of sessions.

use std::fmt::Write;

use crate::draw::colours::{BACKGROUND, FAINT, INK, session};
use crate::draw::strokes;
use crate::draw::view::{View, round_length};

/// From the picture's edge, px.
const MARGIN: f64 = 22.0;
/// Height of letters, px.
const LETTER: f64 = 9.0;
/// Sessions that the legend names; the rest are counted.
const MOST_NAMED: usize = 12;

fn panel(x: f64, y: f64, width: f64, height: f64) -> String {
    format!(
        "<rect x=\"{x:.1}\" y=\"{y:.1}\" width=\"{width:.1}\" height=\"{height:.1}\" rx=\"6\" fill=\"{BACKGROUND}\" \
         fill-opacity=\"0.78\" stroke=\"{FAINT}\" stroke-opacity=\"0.12\"/>\n"
    )
}

fn letters(at: [f64; 2], text: &str) -> String {
    format!("<path d=\"{}\"/>\n", strokes::path(at, LETTER, text))
}

/// A bar of round length with its length in metres, at the lower left.
pub fn scale_bar(view: &View) -> String {
    let metres = round_length(view.width_px * 0.2 / view.scale);
    let label = if metres >= 1000.0 {
        format!("{} Km", metres / 1000.0)
    } else {
        format!("{metres} m")
    };
    let (x, y) = (MARGIN, view.height_px - MARGIN);
    let bar = metres * view.scale;
    let ticks = format!(
        "M{x:.1} {0:.1}V{y:.1}H{1:.1}V{0:.1}M{2:.1} {3:.1}V{y:.1}",
        y - 8.0,
        x + bar,
        x + bar / 2.0,
        y - 5.0
    );
    let middle = x + bar / 2.0 - strokes::width(&label, LETTER) / 2.0;
    let back = panel(x - 10.0, y - 32.0, bar + 20.0, 42.0);
    format!(
        "<g id=\"scale\">\n{back}<path d=\"{ticks}\"/>\n{}</g>\n",
        letters([middle, y - 23.0], &label)
    )
}

/// An arrow along the map's y axis, at the upper right.
pub fn north_arrow(view: &View) -> String {
    let (x, y) = (view.width_px - MARGIN - 10.0, MARGIN);
    let back = panel(x - 18.0, y - 10.0, 36.0, 58.0);
    let arrow = format!(
        "M{x:.1} {:.1}V{y:.1}M{:.1} {:.1}L{x:.1} {y:.1}L{:.1} {:.1}",
        y + 22.0,
        x - 6.0,
        y + 8.0,
        x + 6.0,
        y + 8.0
    );
    format!(
        "<g id=\"north\">\n{back}<path d=\"{arrow}\"/>\n{}</g>\n",
        letters([x - 3.0, y + 30.0], "N")
    )
}

/// The sessions' names in their colours, at the upper left.
pub fn legend(names: &[String]) -> String {
    if names.is_empty() {
        return String::new();
    }
    let mut lines: Vec<(Option<String>, String)> = names
        .iter()
        .take(MOST_NAMED)
        .enumerate()
        .map(|(index, name)| (Some(session(index)), strokes::name(name, 28)))
        .collect();
    if names.len() > MOST_NAMED {
        lines.push((None, format!("+ {} MORE", names.len() - MOST_NAMED)));
    }
    let widest = lines
        .iter()
        .map(|(_, text)| strokes::width(text, LETTER))
        .fold(0.0, f64::max);
    let line = LETTER * 2.1;
    let height = lines.len() as f64 * line;
    let mut text = panel(MARGIN - 10.0, MARGIN - 10.0, widest + 52.0, height + 11.0);
    for (index, (colour, name)) in lines.iter().enumerate() {
        let y = MARGIN + index as f64 * line;
        if let Some(colour) = colour {
            let middle = y + LETTER / 2.0;
            text.push_str(&format!(
                "<path d=\"M{MARGIN:.1} {middle:.1}h20\" stroke=\"{colour}\" stroke-width=\"3\"/>\n"
            ));
        }
        text.push_str(&letters([MARGIN + 30.0, y], name));
    }
    format!("<g id=\"legend\">\n{text}</g>\n")
}

/// Names with their colours, side by side in a strip of this height.
pub fn row_of_names(names: &[(String, String)], height: u32) -> String {
    let top = (f64::from(height) - LETTER) / 2.0;
    let mut x = MARGIN / 2.0;
    let mut text = String::new();
    for (name, colour) in names {
        let name = strokes::name(name, 20);
        let _ = writeln!(
            text,
            "<rect x=\"{x:.1}\" y=\"{top:.1}\" width=\"{LETTER}\" height=\"{LETTER}\" fill=\"{colour}\"/>\n\
             <path d=\"{}\" fill=\"none\" stroke=\"{INK}\" stroke-width=\"1.3\"/>",
            strokes::path([x + LETTER * 1.6, top], LETTER, &name)
        );
        x += LETTER * 3.6 + strokes::width(&name, LETTER);
    }
    text
}

/// All of it, in one group with the ink of letters.
pub fn furniture(view: &View, sessions: &[String]) -> String {
    format!(
        "<g fill=\"none\" stroke=\"{INK}\" stroke-width=\"1.3\" stroke-linecap=\"round\" stroke-linejoin=\"round\">\n{}{}{}</g>\n",
        legend(sessions),
        scale_bar(view),
        north_arrow(view)
    )
}
