//! The page: HTML with its style and picture inside, no reference to anything else.

use std::fmt::Write;

use evermap_engine::map::RunRow;

use crate::commands::layers::SHORT_DIGEST;
use crate::draw::escaped;
use crate::metric::Drift;
use crate::quantity::{of, of_bytes, of_seconds};
use crate::report::Facts;
use crate::report::answers::Answer;
use crate::report::metric::MetricFacts;
use crate::report::semantic::SemanticFacts;

/// Units that are shown before the rest is folded away.
const SHOWN_UNITS: usize = 15;

/// A cell: its text as HTML, and whether it is a number.
type Cell = (String, bool);

fn word(text: &str) -> Cell {
    (escaped(text), false)
}

fn number(text: impl ToString) -> Cell {
    (escaped(&text.to_string()), true)
}

fn digest(text: &str) -> Cell {
    let short: String = text.chars().take(SHORT_DIGEST).collect();
    (
        format!(
            "<code title=\"{}\">{}</code>",
            escaped(text),
            escaped(&short)
        ),
        false,
    )
}

/// A table; headings that begin with `#` stand over numbers.
fn table(headings: &[&str], rows: &[Vec<Cell>]) -> String {
    let mut text = String::from("<div class=\"wide\"><table><tr>");
    for heading in headings {
        let (class, name) = heading
            .strip_prefix('#')
            .map_or(("", *heading), |name| (" class=\"n\"", name));
        let _ = write!(text, "<th{class}>{}</th>", escaped(name));
    }
    text.push_str("</tr>\n");
    for row in rows {
        text.push_str("<tr>");
        for (cell, is_number) in row {
            let class = if *is_number { " class=\"n\"" } else { "" };
            let _ = write!(text, "<td{class}>{cell}</td>");
        }
        text.push_str("</tr>\n");
    }
    text.push_str("</table></div>\n");
    text
}

/// The whole page.
pub fn page(facts: &Facts) -> String {
    let title = escaped(&format!("{}, version {}", facts.plan, facts.version));
    let mut body = format!(
        "<h1>{title}</h1>\n<p class=\"sub\">published {} by evermap {}</p>\n",
        escaped(&facts.published),
        escaped(&facts.evermap)
    );
    if let Some(picture) = &facts.picture {
        let _ = writeln!(body, "<div class=\"picture\">{}</div>", picture.svg);
    }
    body.push_str(&numbers(facts));
    body.push_str(&losses(facts));
    if let Some(metric) = &facts.metric {
        body.push_str(&metric_map(metric));
    }
    if let Some(semantic) = &facts.semantic {
        body.push_str(&semantic_map(semantic));
    }
    let _ = write!(body, "<h2>Layers</h2>\n{}", layers(facts));
    let _ = write!(body, "<h2>Sessions</h2>\n{}", sessions(facts));
    body.push_str(&units(&facts.units));
    let _ = write!(body, "<h2>Versions</h2>\n{}", versions(facts));
    format!(
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n<title>{title}</title>\n\
         <style>\n{}</style>\n</head>\n<body>\n<main>\n{body}</main>\n</body>\n</html>\n",
        include_str!("page.css")
    )
}

fn numbers(facts: &Facts) -> String {
    let driven: f64 = facts
        .sessions
        .iter()
        .filter_map(|session| session.driven_m)
        .sum();
    let computed: Vec<&RunRow> = facts.units.iter().filter(|unit| !unit.cached).collect();
    let seconds: f64 = computed.iter().map(|unit| unit.seconds).sum();
    let bytes: u64 = facts.layers.iter().map(|layer| layer.bytes).sum();
    let lost: u64 = facts.losses.values().sum();
    let cards = [
        (facts.sessions.len().to_string(), "sessions"),
        (facts.sites.len().to_string(), "sites"),
        (length(driven), "driven"),
        (of_bytes(bytes), "in layers"),
        (
            format!("{} / {}", computed.len(), facts.units.len()),
            "units computed",
        ),
        (of_seconds(seconds), "computing"),
        (lost.to_string(), "skipped or lost"),
    ];
    let cards = cards
        .map(|(value, name)| format!("<div><b>{}</b><span>{name}</span></div>", escaped(&value)));
    format!("<div class=\"numbers\">{}</div>\n", cards.concat())
}

fn length(metres: f64) -> String {
    if metres >= 10_000.0 {
        format!("{:.1} km", metres / 1000.0)
    } else {
        format!("{metres:.1} m")
    }
}

fn losses(facts: &Facts) -> String {
    if facts.losses.is_empty() {
        return String::new();
    }
    let rows: Vec<Vec<Cell>> = facts
        .losses
        .iter()
        .map(|(reason, count)| vec![number(count), word(reason)])
        .collect();
    format!(
        "<h2 class=\"lost\">Losses</h2>\n{}",
        table(&["#count", "reason"], &rows)
    )
}

/// What a person who doubts the poses wants to see.
fn metric_map(metric: &MetricFacts) -> String {
    let mut text = String::from("<h2>Metric map</h2>\n");
    if let Some(picture) = &metric.picture {
        let _ = writeln!(
            text,
            "<div class=\"picture\">{}</div>\n<p class=\"sub\">Solid: the map's poses. Dashed: the odometry's, laid on \
             the first of them. Dots: landmarks. Green: loop closures that the map agrees with; red: those it rejects.</p>",
            picture.svg
        );
    }
    let row = |drift: &Drift| {
        vec![
            word(&drift.session),
            number(drift.keyframes),
            number(drift.mapped),
            number(length(drift.driven_m)),
            number(format!("{:.3} m", drift.end_m)),
            number(format!("{:.3} m", drift.most_m)),
        ]
    };
    let rows: Vec<_> = metric.drifts.iter().map(row).collect();
    let headings = [
        "session",
        "#keyframes",
        "#mapped",
        "#driven",
        "#drift at the end",
        "#most",
    ];
    let _ = write!(text, "<h3>Drift removed</h3>\n{}", table(&headings, &rows));
    text.push_str(&answers(&metric.answers));
    text
}

fn answers(answers: &[Answer]) -> String {
    let mut text = String::new();
    for answer in answers {
        let headings: Vec<String> = answer
            .columns
            .iter()
            .map(|(name, numeric)| format!("{}{name}", if *numeric { "#" } else { "" }))
            .collect();
        let headings: Vec<&str> = headings.iter().map(String::as_str).collect();
        let cells = |row: &Vec<String>| {
            let numeric = answer.columns.iter().map(|(_, numeric)| *numeric);
            row.iter().map(|cell| escaped(cell)).zip(numeric).collect()
        };
        let rows: Vec<Vec<Cell>> = answer.rows.iter().map(cells).collect();
        let _ = write!(
            text,
            "<h3>{}</h3>\n{}<details><summary>the query</summary><pre>{}</pre></details>\n",
            escaped(&answer.title),
            table(&headings, &rows),
            escaped_lines(&answer.query)
        );
    }
    text
}

/// What a person who doubts the places wants to see.
fn semantic_map(semantic: &SemanticFacts) -> String {
    let mut text = String::from("<h2>Semantic map</h2>\n");
    if let Some(picture) = &semantic.views {
        let _ = writeln!(
            text,
            "<div class=\"picture\">{}</div>\n<p class=\"sub\">For each view: the labels over its image, then its graph. \
             A dot and an ellipse are an area; the thicker a line, the longer the boundary.</p>",
            picture.svg
        );
    }
    if let Some(picture) = &semantic.matrix {
        let _ = writeln!(
            text,
            "<h3>Similarities</h3>\n<div class=\"picture\">{}</div>\n<p class=\"sub\">Queries from left to right, views of \
             the map from top to bottom, each by session and time. Bright: alike. Black: not kept.</p>",
            picture.svg
        );
    }
    text.push_str(&answers(&semantic.answers));
    text
}

/// As [`escaped`], with its lines kept.
fn escaped_lines(text: &str) -> String {
    let lines: Vec<_> = text.lines().map(escaped).collect();
    lines.join("\n")
}

fn layers(facts: &Facts) -> String {
    let row = |layer: &evermap_engine::map::LayerInfo| {
        vec![
            word(&layer.layer),
            number(layer.rows),
            number(of_bytes(layer.bytes)),
            number(layer.artifacts),
            word(layer.operator.as_deref().unwrap_or("SQL")),
            digest(&layer.digest),
        ]
    };
    let rows: Vec<_> = facts.layers.iter().map(row).collect();
    table(
        &["layer", "#rows", "#size", "#files", "made by", "digest"],
        &rows,
    )
}

fn sessions(facts: &Facts) -> String {
    let row = |session: &crate::report::SessionFact| {
        vec![
            word(&session.session),
            word(&session.site),
            number(session.driven_m.map(length).unwrap_or_default()),
            digest(&session.content),
        ]
    };
    let rows: Vec<_> = facts.sessions.iter().map(row).collect();
    table(&["session", "site", "#driven", "log"], &rows)
}

fn units(units: &[RunRow]) -> String {
    if units.is_empty() {
        return String::new();
    }
    let longest = units
        .iter()
        .filter(|unit| !unit.cached)
        .map(|unit| unit.seconds)
        .fold(1e-9, f64::max);
    let row = |unit: &RunRow| {
        let of = unit
            .session
            .as_ref()
            .or(unit.site.as_ref())
            .map_or("the map", String::as_str);
        let time = if unit.cached {
            ("<span class=\"reused\">reused</span>".to_owned(), true)
        } else {
            number(of_seconds(unit.seconds))
        };
        let share = if unit.cached {
            0.0
        } else {
            120.0 * unit.seconds / longest
        };
        let bar = if unit.cached {
            String::new()
        } else {
            format!("<span class=\"bar\" style=\"width:{share:.0}px\"></span>")
        };
        vec![
            word(&unit.step),
            word(of),
            time,
            (bar, false),
            number(unit.rows),
            number(of_bytes(unit.bytes)),
            number(if unit.lost == 0 {
                String::new()
            } else {
                unit.lost.to_string()
            }),
        ]
    };
    let rows: Vec<Vec<Cell>> = units.iter().map(row).collect();
    let headings = ["step", "of", "#time", "", "#rows", "#size", "#lost"];
    let (first, rest) = rows.split_at(rows.len().min(SHOWN_UNITS));
    let mut text = format!("<h2>Units</h2>\n{}", table(&headings, first));
    if !rest.is_empty() {
        let more = of(rest.len() as u64, "more unit");
        let _ = writeln!(
            text,
            "<details><summary>{more}</summary>{}</details>",
            table(&headings, rest)
        );
    }
    text
}

fn versions(facts: &Facts) -> String {
    let row = |version: &evermap_engine::map::VersionInfo| {
        vec![
            number(version.version),
            word(&version.published),
            word(&version.plan),
            number(version.sessions.len()),
            number(version.layers),
            number(version.lost),
        ]
    };
    let rows: Vec<_> = facts.versions.iter().rev().map(row).collect();
    table(
        &[
            "#version",
            "published",
            "plan",
            "#sessions",
            "#layers",
            "#lost",
        ],
        &rows,
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draw::{Drive, Look, Scene, draw};
    use crate::report::SessionFact;
    use evermap_engine::map::{LayerInfo, VersionInfo};
    use evermap_schemas::Stamp;
    use std::collections::BTreeMap;

    fn unit(step: &str, cached: bool, seconds: f64) -> RunRow {
        RunRow {
            version: 2,
            run: "r".into(),
            step: step.into(),
            session: Some("initial".into()),
            site: None,
            cached,
            rows: 10,
            bytes: 2048,
            seconds,
            started: Stamp(0),
            lost: 0,
            recipe: "ab".into(),
            content: "cd".into(),
        }
    }

    fn facts() -> Facts {
        let drive = Drive {
            session: "initial".into(),
            points: vec![[0.0, 0.0], [30.0, 10.0]],
        };
        let scene = Scene {
            drives: vec![drive],
            ..Scene::default()
        };
        let layer = LayerInfo {
            layer: "poses".into(),
            rows: 7,
            bytes: 100,
            artifacts: 1,
            operator: None,
            digest: "0123456789abcdef".into(),
        };
        let drift = Drift {
            session: "initial".into(),
            keyframes: 5,
            mapped: 4,
            driven_m: 31.6,
            end_m: 1.25,
            most_m: 1.5,
        };
        let answer = Answer {
            title: "Residuals".into(),
            query: "SELECT 1\nWHERE 1 < 2".into(),
            columns: vec![("camera".into(), false), ("rms_px".into(), true)],
            rows: vec![vec!["front".into(), "0.61".into()]],
        };
        let metric = MetricFacts {
            picture: None,
            drifts: vec![drift],
            answers: vec![answer],
        };
        let version = VersionInfo {
            version: 2,
            published: "now".into(),
            plan: "car_park".into(),
            sessions: vec!["initial".into()],
            layers: 1,
            lost: 3,
        };
        Facts {
            version: 2,
            plan: "car_park <script>".into(),
            published: "2026-01-01T00:00:00Z".into(),
            evermap: "0.1.0".into(),
            picture: draw(&scene, Look::default()).ok(),
            metric: Some(metric),
            semantic: None,
            sites: vec!["lot".into()],
            layers: vec![layer],
            sessions: vec![SessionFact {
                session: "initial".into(),
                site: "lot".into(),
                driven_m: Some(31.6),
                content: "ff".into(),
            }],
            units: (0..20)
                .map(|k| unit(&format!("step_{k}"), k > 10, 1.0 + f64::from(k)))
                .collect(),
            losses: BTreeMap::from([("dark frames".into(), 3)]),
            versions: vec![version],
        }
    }

    #[test]
    fn the_page_says_everything_and_needs_nothing_else() {
        let page = page(&facts());
        if let Ok(folder) = std::env::var("EVERMAP_LOOK") {
            let _ = std::fs::write(format!("{folder}/report.html"), &page);
        }
        for said in [
            "<svg ",
            "dark frames",
            "0123456789ab<",
            "31.6 m",
            "step_19",
            "5 more units",
            "11 / 20",
            "reused",
            "1.250 m",
            "0.61",
            "WHERE 1 &lt; 2",
            "prefers-color-scheme: dark",
            "viewport",
        ] {
            assert!(page.contains(said), "{said}");
        }
        assert!(page.contains("car_park &lt;script&gt;") && !page.contains("<script"));
        for reference in ["src=\"http", "href=\"http", "url(http", "@import", "<link"] {
            assert!(!page.contains(reference), "{reference}");
        }
    }

    #[test]
    fn a_map_without_a_picture_or_runs_has_a_page_too() {
        let bare = Facts {
            picture: None,
            units: vec![],
            losses: BTreeMap::new(),
            ..facts()
        };
        let page = page(&bare);
        assert!(!page.contains("<svg") && !page.contains("Units") && !page.contains("Losses</h2>"));
    }
}
