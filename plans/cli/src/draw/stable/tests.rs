#![allow(clippy::unwrap_used)]
use super::*;
use crate::draw::png as raster;
use evermap_schemas::layers::{InferredLabels, LabelImage, WarpedLabels};
use evermap_schemas::{Bytes, Stamp};

const CAR: u8 = 0;
const SKY: u8 = 1;
const ROAD: u8 = 2;
/// Two rows: sky above; below, a car of six pixels: two seen, two inferred, one not known, one seen where the truth has no
/// class.
const BEFORE: [u8; 12] = [SKY, SKY, SKY, SKY, SKY, SKY, CAR, CAR, CAR, CAR, CAR, CAR];
const WARPED: [u8; 12] = [
    SKY, SKY, SKY, SKY, SKY, SKY, ROAD, SKY, CAR, CAR, VOID, ROAD,
];
const STABLE: [u8; 12] = [
    SKY, SKY, SKY, SKY, SKY, SKY, ROAD, SKY, ROAD, SKY, VOID, ROAD,
];
const CERTAINTY: [u8; 12] = [255, 255, 255, 255, 255, 255, 255, 255, 204, 153, 0, 255];
const TRUTH: [u8; 12] = [
    SKY, SKY, SKY, SKY, SKY, ROAD, ROAD, ROAD, ROAD, ROAD, ROAD, VOID,
];

fn grey(values: [u8; 12]) -> Bytes {
    Bytes(encoded(6, 2, ColorType::Grayscale, &values).unwrap())
}

fn map() -> StableMap {
    let classes = ["car", "sky", "road"].map(str::to_owned).to_vec();
    let (site, session, camera) = ("s".to_owned(), "a".to_owned(), "c".to_owned());
    let (stamp, width, height) = (Stamp(7), 6, 2);
    let before = LabelImage {
        site: site.clone(),
        session: session.clone(),
        stamp,
        camera: camera.clone(),
        width,
        height,
        classes: classes.clone(),
        png: grey(BEFORE),
    };
    let warped = WarpedLabels {
        site: site.clone(),
        session: session.clone(),
        stamp,
        camera: camera.clone(),
        width,
        height,
        classes: classes.clone(),
        png: grey(WARPED),
        views: 4,
        occlusions: vec![],
        unseen_px: 2,
        unclear_px: 1,
    };
    let stable = InferredLabels {
        site: site.clone(),
        session: session.clone(),
        stamp,
        camera: camera.clone(),
        width,
        height,
        classes: classes.clone(),
        png: grey(STABLE),
        certainty: grey(CERTAINTY),
        inferred: vec![],
        unknown_px: 1,
    };
    let view = StableView {
        shot: Shot {
            site,
            session,
            stamp,
            camera,
        },
        image: None,
        before,
        warped,
        stable,
        truth: Some(TRUTH.to_vec()),
    };
    StableMap {
        views: vec![view],
        classes,
    }
}

fn panels(map: &StableMap) -> Vec<Panel> {
    let view = &map.views[0];
    let labels = Labels::of(view).unwrap();
    labels.panels(view, &map.classes).unwrap()
}

/// The colours of a panel's pixels.
fn pixels(panel: &Panel) -> Vec<[u8; 4]> {
    use base64::Engine;
    let (_, text) = panel.href.as_ref().unwrap().split_once(',').unwrap();
    let file = base64::engine::general_purpose::STANDARD.decode(text);
    let (width, height, values) = decoded(&file.unwrap(), ColorType::Rgba).unwrap();
    assert_eq!((width, height), (6, 2));
    values.as_chunks::<4>().0.to_vec()
}

#[test]
fn each_panel_shows_its_labels_and_says_how_many() {
    let map = map();
    let panels = panels(&map);
    let kinds: Vec<&str> = panels.iter().map(|panel| panel.kind).collect();
    let all = ["image", "before", "warped", "inferred", "stable", "truth"];
    assert_eq!(kinds, all);
    let titles: Vec<&str> = panels.iter().map(|panel| &*panel.title).collect();
    let expected = [
        "no image: its log is gone, or has none",
        "before: 50.0 % moves",
        "warped: 50.0 % of that seen, by 4 views",
        "inferred: 33.3 % of that, 0.70 sure",
        "stable: 16.7 % of that not known",
        "truth: 50.0 % of seen right, 50.0 % of inferred",
    ];
    assert_eq!(titles, expected);
    let colour = |class: u8| match class {
        VOID => [0; 4],
        class => colours::rgba(&colours::class(usize::from(class))),
    };
    for (panel, labels) in [(1, BEFORE), (2, WARPED), (4, STABLE)] {
        assert_eq!(pixels(&panels[panel]), labels.map(colour), "{panel}");
    }
    // What is not inferred is faint, and what is not known is not there.
    let faint = |class: u8| {
        let [red, green, blue, _] = colour(class);
        [red, green, blue, FAINT]
    };
    let inferred = pixels(&panels[3]);
    assert_eq!(inferred[6..8], [faint(ROAD), faint(SKY)]);
    assert_eq!(inferred[8..10], [colour(ROAD), colour(SKY)]);
    assert_eq!(inferred[10..], [[0; 4], faint(ROAD)]);
    assert_eq!(inferred[0], faint(SKY));
    let truth = pixels(&panels[5]);
    let [right, though_seen, as_inferred, unknown] =
        OUTCOMES.map(|(_, colour)| colours::rgba(colour));
    let expected = [right, though_seen, right, as_inferred, unknown, faint(ROAD)];
    assert_eq!(truth[6..], expected);
    // Nothing but what moves is compared.
    assert_eq!(truth[5], faint(SKY));
}

#[test]
fn a_row_of_panoramas_goes_on_below() {
    let mut map = map();
    let picture = stable(&map, 300).unwrap();
    assert!(picture.svg.contains("<title>a/c/7</title>"));
    // (300 - 2 gaps) / 3 wide, a third of that high.
    let top = Legend::of(
        map.classes
            .iter()
            .map(String::as_str)
            .chain(OUTCOMES.map(|(name, _)| name))
            .map(|name| (name.to_owned(), String::new())),
        300,
    )
    .height;
    let (first, second) = (top + LINE_PX, top + 2 * LINE_PX + 31 + GAP_PX);
    for (kind, x, y) in [
        ("image", 0, first),
        ("warped", 204, first),
        ("inferred", 0, second),
        ("truth", 204, second),
    ] {
        let placed = format!("<g data-panel=\"{kind}\" transform=\"translate({x} {y})\">");
        assert!(picture.svg.contains(&placed), "{placed} {}", picture.svg);
    }
    assert_eq!(picture.width_px, 300);
    assert!(raster(&picture).unwrap().starts_with(b"\x89PNG"));
    // Nobody knows the truth, and there is an image.
    map.views[0].truth = None;
    map.views[0].image = Some(map.views[0].before.png.0.clone());
    let picture = stable(&map, 300).unwrap();
    assert!(!picture.svg.contains("data-panel=\"truth\""));
    assert!(picture.svg.contains("<title>image</title>"));
    for (name, _) in OUTCOMES {
        assert!(!picture.svg.contains(&strokes::letters(name)), "{name}");
    }
}

#[test]
fn labels_of_other_sizes_are_told() {
    let mut map = map();
    map.views[0].warped.png = Bytes(encoded(1, 2, ColorType::Grayscale, &[0, 0]).unwrap());
    let fault = stable(&map, 300).unwrap_err();
    assert_eq!(
        fault.to_string(),
        "data: expected labels of 6 by 2 px, found 1 by 2 (at warped_labels)"
    );
}

#[test]
fn a_view_in_which_nothing_moves_says_so() {
    let mut map = map();
    map.views[0].before.png = map.views[0].stable.png.clone();
    let panels = panels(&map);
    assert_eq!(panels[1].title, "before: nothing moves");
    assert_eq!(panels[2].title, "warped");
    assert_eq!(panels[3].title, "inferred: nothing");
    assert_eq!(panels[4].title, "stable");
    assert_eq!(percent(0, 0), "-");
}
