#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
use super::*;
use crate::mosaic::tests::tile;

fn lane(number: u32, direction: &str, points: Vec<[f64; 3]>) -> Lane {
    Lane {
        site: "lot".into(),
        lane: number,
        start_kind: "intersection".into(),
        end_kind: "dead_end".into(),
        direction: direction.into(),
        length_m: 10.0,
        points,
    }
}

/// A made-up car park: a floor with bay lines, a loop with a cross aisle, two sessions.
pub(crate) fn scene() -> Scene {
    let floor = |x: i32, y: i32| {
        move |column: usize, row: usize| {
            let (gx, gy) = (x * 64 + column as i32, y * 64 + 63 - row as i32);
            let bay = gx.rem_euclid(5) == 0 && (20..34).contains(&gy.rem_euclid(60));
            let noise = ((gx * 7919 + gy * 104_729).rem_euclid(13)) as u8;
            let hole = (gx - 20).pow(2) + (gy - 80).pow(2) < 100;
            [
                if bay { 190 } else { 96 + noise },
                if hole { 0 } else { 255 },
            ]
        }
    };
    let mut tiles = Vec::new();
    for (x, y) in [(0, 0), (1, 0), (0, 1), (1, 1), (2, 0)] {
        tiles.push(tile(0, x, y, 64, floor(x, y)));
    }
    let ring = |r: f64, n: i32| {
        (0..=n)
            .map(move |k| std::f64::consts::TAU * f64::from(k) / f64::from(n))
            .map(move |t| [40.0 + 30.0 * r * t.cos(), 28.0 + 20.0 * r * t.sin()])
    };
    let three = |points: Vec<[f64; 2]>| {
        points
            .into_iter()
            .map(|[x, y]| [x, y, 0.0])
            .collect::<Vec<_>>()
    };
    let loop_points: Vec<_> = ring(1.0, 90).collect();
    Scene {
        tiles,
        heading_rad: Some(0.5),
        lanes: vec![
            lane(0, "forward", three(loop_points[..46].to_vec())),
            lane(1, "forward", three(loop_points[45..].to_vec())),
            lane(2, "both", vec![[10.0, 28.0, 0.0], [70.0, 28.0, 0.0]]),
            lane(3, "backward", vec![[70.0, 28.0, 0.0], [92.0, 20.0, 0.0]]),
        ],
        intersections: [[10.0, 28.0], [70.0, 28.0]]
            .into_iter()
            .enumerate()
            .map(|(node, [x, y])| Crossing {
                site: "lot".into(),
                node: node as u32,
                degree: 3,
                x,
                y,
            })
            .collect(),
        trajectories: vec![
            Trajectory {
                session: "initial".into(),
                points: ring(1.01, 300).collect(),
            },
            Trajectory {
                session: "revisit_1 & <co>".into(),
                points: ring(0.97, 250).collect(),
            },
        ],
        ..Scene::default()
    }
}

#[test]
fn spaces_are_filled_by_what_was_last_seen_and_what_was_found_is_dashed() {
    let square = |x: f64| [[x, 10.0], [x + 5.0, 10.0], [x + 5.0, 15.0], [x, 15.0]].to_vec();
    let outline = |mark, title: &str, said, points| Outline {
        mark,
        title: title.into(),
        said,
        closed: true,
        points,
    };
    let with = Scene {
        outlines: vec![
            outline(Mark::Free, "space 1: drawn, free", true, square(10.0)),
            outline(Mark::Taken, "space 2: found, taken", false, square(20.0)),
            outline(Mark::Label("stop_line".into()), "", true, square(30.0)),
        ],
        ..scene()
    };
    let svg = draw(&with, Canvas::default()).unwrap().svg;
    let names: Vec<_> = with.outlines.iter().map(|one| one.mark.name()).collect();
    assert_eq!(names[2], "stop line");
    for text in ["space 1: drawn, free", colours::FREE, colours::TAKEN] {
        assert!(svg.contains(text), "{text}");
    }
    let outlines = svg.split("<g id=\"outlines\"").nth(1).unwrap();
    let outlines = outlines.split("</g>").next().unwrap();
    let dashed: Vec<bool> = outlines
        .split("<path")
        .skip(1)
        .map(|path| path.contains("stroke-dasharray"))
        .collect();
    assert_eq!(dashed, [false, true, false]);
    let without = draw(&scene(), Canvas::default()).unwrap().svg;
    assert!(!without.contains("outlines"));
}

/// The corner that nothing is drawn in; above to the left where all are alike.
#[test]
fn the_legend_covers_what_is_drawn_the_least() {
    let legend = |scene: &Scene| {
        let svg = draw(scene, Canvas::default()).unwrap().svg;
        let placed = svg.split("<g id=\"legend\" transform=\"translate(").nth(1);
        placed.unwrap().split(')').next().unwrap().to_owned()
    };
    assert_eq!(legend(&scene()), "22.0 22.0");
    let [west, south, east, north] = scene().line_bounds().unwrap();
    let (middle, low, high) = ((west + east) / 2.0, south - 20.0, north + 20.0);
    let west_half = Outline {
        mark: Mark::Free,
        title: String::new(),
        said: true,
        closed: true,
        points: vec![
            [west - 20.0, low],
            [middle, low],
            [middle, high],
            [west - 20.0, high],
        ],
    };
    let with = Scene {
        outlines: vec![west_half],
        ..scene()
    };
    assert_ne!(legend(&with), "22.0 22.0");
}

fn pixel(png: &[u8], x: usize, y: usize) -> ([u8; 4], (u32, u32)) {
    let mut reader = png::Decoder::new(std::io::Cursor::new(png))
        .read_info()
        .unwrap();
    let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut pixels).unwrap();
    let at = (y * info.width as usize + x) * 4;
    (
        [pixels[at], pixels[at + 1], pixels[at + 2], pixels[at + 3]],
        (info.width, info.height),
    )
}

#[test]
fn the_picture_holds_everything() {
    let picture = draw(
        &scene(),
        Canvas {
            width_px: 1200,
            zoom: None,
        },
    )
    .unwrap();
    for id in [
        "grid",
        "ground",
        "lanes",
        "arrows",
        "trajectories",
        "intersections",
        "legend",
        "scale",
        "north",
    ] {
        assert!(picture.svg.contains(&format!("id=\"{id}\"")), "{id}");
    }
    assert!(picture.svg.contains("rotate(28.6 0 11)"), "north");
    assert_eq!(picture.svg.matches("<title>lane ").count(), 4);
    assert_eq!(picture.svg.matches("<title>intersection ").count(), 2);
    assert!(picture.svg.contains("revisit_1 &#38; &#60;co&#62;"));
    assert!(!picture.svg.contains("NaN") && !picture.svg.contains("inf"));
    let png = png(&picture).unwrap();
    if let Ok(folder) = std::env::var("EVERMAP_LOOK") {
        std::fs::write(format!("{folder}/scene.png"), &png).unwrap();
    }
    let view = Viewport::of(
        union(
            scene().ground(Canvas::default()).unwrap().unwrap().seen(),
            scene().line_bounds(),
        )
        .unwrap(),
        1200,
    );
    let [x, y] = view.at([25.0, 28.0]);
    let ([red, _, blue, alpha], size) = pixel(&png, x as usize, y as usize + 6);
    assert_eq!(size, (picture.width_px, picture.height_px));
    assert_eq!(alpha, 255);
    assert!(
        i32::from(blue) > i32::from(red) + 40,
        "the lane is blue: {red} {blue}"
    );
    let ([red, green, blue, _], _) = pixel(&png, 3, 3);
    assert!(
        red < 40 && green < 40 && blue < 45,
        "the background is dark"
    );
}

#[test]
fn a_map_without_tiles_or_lanes_is_drawn_too() {
    let drives = Scene {
        trajectories: scene().trajectories,
        ..Scene::default()
    };
    let picture = draw(&drives, Canvas::default()).unwrap();
    assert!(!picture.svg.contains("id=\"ground\"") && picture.svg.contains("id=\"trajectories\""));
    let png = png(&picture).unwrap();
    if let Ok(folder) = std::env::var("EVERMAP_LOOK") {
        std::fs::write(format!("{folder}/drives.png"), &png).unwrap();
    }
    let standing = Scene {
        trajectories: vec![Trajectory {
            session: "s".into(),
            points: vec![[1.0, 1.0]],
        }],
        ..Scene::default()
    };
    super::png(&draw(&standing, Canvas::default()).unwrap()).unwrap();
}

#[test]
fn slow_cells_people_and_lane_speeds_are_drawn_and_explained() {
    let plain = draw(&scene(), Canvas::default()).unwrap().svg;
    let lane = scene().lanes[0].lane;
    let cell = |x: f64, shade| SlowCell {
        corner: [x, 4.0],
        side_m: 0.5,
        shade,
    };
    let with = Scene {
        lane_speeds: [(lane, [1.44, 2.66])].into(),
        slow: vec![cell(4.0, 5), cell(4.5, 1), cell(5.0, 5)],
        people: vec![[4.2, 4.2], [5.1, 4.4]],
        ..scene()
    };
    let svg = draw(&with, Canvas::default()).unwrap().svg;
    for part in ["id=\"slow\"", "id=\"people\"", "id=\"lane-speeds\""] {
        assert!(svg.contains(part) && !plain.contains(part), "{part}");
    }
    assert!(svg.contains("1.4 m/s at the slowest, 2.7 m/s in the mean"));
    assert!(svg.contains("people seen 2 times"));
    let slow = svg.split("id=\"slow\"").nth(1).unwrap();
    let slow = slow.split("</g>").next().unwrap();
    // Faint cells first; the two slowest are one path, as dense as it gets.
    let paths: Vec<&str> = slow.lines().filter(|line| line.contains("<path")).collect();
    let squares: Vec<usize> = paths.iter().map(|path| path.matches('M').count()).collect();
    assert_eq!(squares, [1, 2], "{slow}");
    assert!(paths[0].contains("\"0.13\"") && paths[1].contains("\"0.65\""));
}

#[test]
fn motion_in_the_legend_is_what_is_seen_from_above() {
    let changes = super::Changes {
        since: 1,
        moved: vec![[[0.0, 0.0], [0.03, 0.04]]],
        ..super::Changes::default()
    };
    let svg = draw(&scene().with_changes(changes), Canvas::default());
    let svg = svg.unwrap().svg;
    // Words are drawn as strokes.
    let said = super::strokes::letters("moved, at most 50 mm seen from above");
    assert!(svg.contains(&said), "{svg}");
}

#[test]
fn nothing_to_draw_and_a_zoom_that_is_not_there_are_said() {
    assert!(
        draw(&Scene::default(), Canvas::default())
            .unwrap_err()
            .to_string()
            .contains("nothing to draw")
    );
    let fault = draw(
        &scene(),
        Canvas {
            zoom: Some(7),
            ..Canvas::default()
        },
    )
    .unwrap_err();
    assert!(
        fault
            .to_string()
            .contains("expected one of the zoom levels 0, found 7"),
        "{fault}"
    );
}

#[test]
fn coarse_tiles_do_not_blur_a_small_map() {
    let mut scene = scene();
    for zoom in 1..6 {
        scene.tiles.push(tile(zoom, 0, 0, 64, |_, _| [9, 255]));
    }
    let ground = scene
        .ground(Canvas {
            width_px: 400,
            zoom: None,
        })
        .unwrap()
        .unwrap();
    assert_eq!(
        ground.cell_m, 0.5,
        "0.24 m a pixel asks for the finest level"
    );
    let ground = scene
        .ground(Canvas {
            width_px: 80,
            zoom: None,
        })
        .unwrap()
        .unwrap();
    assert!(
        ground.cell_m > 0.5,
        "a small picture is made of coarse tiles"
    );
}
