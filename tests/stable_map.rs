//! The stable map on streets with exact truth: where views were taken, what is behind cars, and what that is good for.
//!
//! Figures are printed with `-- --nocapture`.

use std::collections::{BTreeMap, VecDeque};
use std::io::Cursor;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use evermap_algorithms::geometry::pose::Pose;
use evermap_algorithms::semantic_map::semantic_graph::{Labels, VOID};
use evermap_algorithms::semantic_map::stable::classes::Kinds;
use evermap_algorithms::semantic_map::stable::inference::{Options, Teller, infer};
use evermap_algorithms::semantic_map::stable::occlusion::{Model, Occlusion};
use evermap_tests::park::made_once;
use evermap_tests::trajectories::{rows, truth};
use evermap_tests::turned::turned;
use evermap_tests::{Finished, evermap, rows_of_log, run_of_site, shared, simulate, text};
use nalgebra::{UnitQuaternion, Vector3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::Value;

const VISITS: [&str; 2] = ["visit_a", "visit_b"];

/// Those that this world has.
fn visits(world: &Path) -> impl Iterator<Item = &'static str> {
    VISITS
        .into_iter()
        .filter(|visit| world.join(visit).exists())
}

/// All that is inferred, however unsure: what is sure is chosen here.
const ALL: [&str; 2] = ["--set", "inferred_labels.min_probability=0"];

/// Maps both visits of a world, with labels of this topic; runs end with this code.
fn mapped(world: &Path, folder: &Path, labels: &str, code: i32) -> PathBuf {
    run("stable_map", world, folder, (labels, &ALL), code)
}

/// Only registers the views of the second visit.
fn registered(world: &Path, folder: &Path, labels: &str) -> PathBuf {
    const PLAN: &str = "plan: registered\nextends: relocate\nsteps:\n  spheres: { op: spheres, in: { depth: depth_frames } }\n  \
                        registrations: { op: registrations, in: { label_images: label_images } }\n\
                        write: [spheres, registrations]\n";
    let plan = folder.join("registered.yaml");
    std::fs::write(&plan, PLAN).unwrap();
    run(text(&plan), world, folder, (labels, &[]), 0)
}

fn run(
    plan: &str,
    world: &Path,
    folder: &Path,
    (labels, more): (&str, &[&str]),
    code: i32,
) -> PathBuf {
    let map = folder.join("map");
    for visit in visits(world) {
        let log = world.join(format!("{visit}/{visit}.mcap"));
        let yaml = format!(
            "sessions: [{{ name: {visit}, files: ['{}'] }}]\nroles: {{ label_frames: ['{labels}'] }}\n",
            log.display()
        );
        let manifest = folder.join(format!("{visit}.yaml"));
        std::fs::write(&manifest, yaml).unwrap();
        let arguments = [&["--manifest", text(&manifest)], more].concat();
        let code = if visit == VISITS[0] { 0 } else { code };
        run_of_site(plan, &map, "street", &arguments).expect(code);
    }
    map
}

fn pose(value: &Value) -> Pose {
    let number = |name: &str| value[name].as_f64().unwrap();
    Pose::from_array(["x", "y", "z", "qx", "qy", "qz", "qw"].map(number)).unwrap()
}

/// By how much views of a visit are turned to the right (rad), by stamp.
type Turns = BTreeMap<&'static str, BTreeMap<i64, f64>>;

/// A turn of the optical frame, whose y looks down.
fn to_the_right(turn: f64) -> Pose {
    let turn = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), turn);
    Pose::new(Vector3::zeros(), turn)
}

/// Where each panorama was taken, by visit and stamp.
fn cameras(world: &Path, turns: &Turns) -> BTreeMap<(String, i64), Pose> {
    let mut cameras = BTreeMap::new();
    for visit in VISITS {
        let log = world.join(format!("{visit}/{visit}.mcap"));
        let query = "SELECT parent_from_child AS mount FROM transforms";
        let mount = pose(&rows_of_log(&log, query)[0]["mount"]);
        for at in truth(&world.join(format!("{visit}/trajectory.tum"))) {
            let of_visit = turns.get(visit).and_then(|turns| turns.get(&at.stamp_ns));
            let turn = of_visit.map_or(Pose::identity(), |turn| to_the_right(*turn));
            let camera = at.pose.compose(&mount).compose(&turn);
            cameras.insert((visit.to_owned(), at.stamp_ns), camera);
        }
    }
    cameras
}

fn middle(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// Registrations beside the truth, of which right ones are within 10 cm.
struct Compared {
    /// All.
    found: usize,
    /// Those of views within 5 m.
    near: usize,
    /// Those of them that converged.
    converged: usize,
    /// Of all, those that converged at a wrong place.
    wrong: usize,
    /// By how many of its standard deviations each right one is off, the least first.
    deviations: Vec<f64>,
}

fn registrations(world: &Path, map: &Path, turns: &Turns, name: &str) -> Compared {
    let cameras = cameras(world, turns);
    let query = "SELECT session, CAST(stamp AS BIGINT) AS at, map_session, CAST(map_stamp AS BIGINT) AS map_at, rank, \
                 state, map_view_from_view AS found, sigma_m FROM registrations ORDER BY stamp, rank";
    let (mut near, mut converged, mut wrong, mut first) = (0, 0, 0, 0);
    let (mut away_m, mut away_deg, mut deviations) = (Vec::new(), Vec::new(), Vec::new());
    let found = rows(map, None, query);
    for row in &found {
        let camera = |session: &str, stamp: &str| {
            let session = row[session].as_str().unwrap().to_owned();
            cameras[&(session, row[stamp].as_i64().unwrap())]
        };
        let truth = camera("map_session", "map_at").inverse();
        let truth = truth.compose(&camera("session", "at"));
        let is_near = truth.translation.norm() <= 5.0;
        near += usize::from(is_near);
        if row["state"] != "converged" {
            continue;
        }
        let off = truth.inverse().compose(&pose(&row["found"]));
        let off_m = off.translation.norm();
        if off_m > 0.1 {
            wrong += 1;
        } else {
            deviations.push(off_m / row["sigma_m"].as_f64().unwrap());
        }
        converged += usize::from(is_near);
        first += usize::from(row["rank"] == 0 && off_m <= 0.1);
        if is_near {
            away_m.push(off_m);
            away_deg.push(off.rotation.angle().to_degrees());
        }
    }
    let (away_m, away_deg) = (middle(away_m), middle(away_deg));
    deviations.sort_by(f64::total_cmp);
    let compared = Compared {
        found: found.len(),
        near,
        converged,
        wrong,
        deviations,
    };
    eprintln!(
        "{name}: of {near} pairs within 5 m {converged} converged, {wrong} of all {} wrongly; median {away_m:.4} m, \
         {away_deg:.4} degrees; {first} views end in a pose; median {:.2} deviations, {:.2} within two",
        compared.found,
        compared.median(),
        compared.within_two()
    );
    assert!(away_m <= 0.03 && away_deg <= 0.2);
    compared
}

impl Compared {
    fn median(&self) -> f64 {
        self.deviations[self.deviations.len() / 2]
    }

    fn within_two(&self) -> f64 {
        let within = self.deviations.partition_point(|off| *off <= 2.0);
        within as f64 / self.deviations.len() as f64
    }
}

fn check_registrations(world: &Path, map: &Path, name: &str) {
    let compared = registrations(world, map, &Turns::new(), name);
    assert!(compared.near > 0 && compared.converged as f64 >= 0.9 * compared.near as f64);
    assert!(compared.wrong as f64 <= 0.01 * compared.found as f64);
    // Of a normal error whose largest deviation is one, the size is within two deviations in 0.74 (all three axes alike) to
    // 0.95 (one axis), and its median is 1.54 to 0.67.
    assert!(compared.within_two() >= 0.6, "{:?}", compared.deviations);
    let median = compared.median();
    assert!((0.3..2.0).contains(&median), "{:?}", compared.deviations);
}

fn decoded(bytes: &[u8]) -> Vec<u8> {
    let mut image = png::Decoder::new(Cursor::new(bytes)).read_info().unwrap();
    let mut pixels = vec![0; image.output_buffer_size().unwrap()];
    image.next_frame(&mut pixels).unwrap();
    pixels
}

fn image(hex: &Value) -> Vec<u8> {
    let hex = hex.as_str().unwrap();
    let bytes = (0..hex.len()).step_by(2);
    let bytes: Vec<u8> = bytes
        .map(|at| u8::from_str_radix(&hex[at..at + 2], 16).unwrap())
        .collect();
    decoded(&bytes)
}

/// A view of the first visit: labels as given, with what others saw, as they are by the plan, and without cars in truth.
struct View {
    stamp: i64,
    before: Vec<u8>,
    warped: Vec<u8>,
    stable: Vec<u8>,
    certainty: Vec<u8>,
    truth: Vec<u8>,
    occlusions: Vec<Occlusion>,
    size: [u32; 2],
    classes: Vec<String>,
}

fn views(world: &Path, map: &Path) -> Vec<View> {
    let query = "SELECT encode(l.png, 'hex') AS before, encode(w.png, 'hex') AS warped, encode(i.png, 'hex') AS stable, \
                 encode(i.certainty, 'hex') AS certainty, i.unknown_px, CAST(l.stamp AS BIGINT) AS at, \
                 w.occlusions, w.width, w.height, w.classes \
                 FROM label_images l JOIN warped_labels w ON l.session = w.session AND l.stamp = w.stamp \
                 JOIN inferred_labels i ON l.session = i.session AND l.stamp = i.stamp \
                 WHERE l.session = 'visit_a' ORDER BY l.stamp";
    let view = |(number, row): (usize, &Value)| {
        let classes: Vec<String> = serde_json::from_value(row["classes"].clone()).unwrap();
        let class = |name: &Value| classes.iter().position(|class| name == class).unwrap() as u8;
        let occlusions = row["occlusions"].as_array().unwrap().iter();
        let occlusions = occlusions.map(|seen| Occlusion {
            dynamic: class(&seen["dynamic"]),
            class: class(&seen["class"]),
            pixels: seen["pixels"].as_u64().unwrap(),
        });
        let path = world.join(format!("visit_a/static_labels/{number:06}.png"));
        let stable = image(&row["stable"]);
        let unknown = stable.iter().filter(|label| **label == VOID).count() as u64;
        assert_eq!(row["unknown_px"], unknown, "of view {number}");
        View {
            stamp: row["at"].as_i64().unwrap(),
            before: image(&row["before"]),
            warped: image(&row["warped"]),
            stable,
            certainty: image(&row["certainty"]),
            truth: decoded(&std::fs::read(path).unwrap()),
            occlusions: occlusions.collect(),
            size: ["width", "height"].map(|side| row[side].as_u64().unwrap() as u32),
            classes,
        }
    };
    rows(map, None, query)
        .iter()
        .enumerate()
        .map(view)
        .collect()
}

/// Pixels by true class, then by the one that was given.
#[derive(Default)]
struct Score(BTreeMap<(u8, u8), u64>);

impl Score {
    fn add(&mut self, truth: u8, given: u8) {
        *self.0.entry((truth, given)).or_default() += 1;
    }

    fn sum(&self, which: impl Fn(u8, u8) -> bool) -> f64 {
        let counted = self
            .0
            .iter()
            .filter(|((truth, given), _)| which(*truth, *given));
        counted.map(|(_, pixels)| *pixels as f64).sum()
    }

    fn precision(&self) -> f64 {
        self.sum(|truth, given| truth == given) / self.sum(|_, given| given != VOID)
    }

    /// Precision and number of the pixels that were given a class.
    fn of_class(&self, class: u8) -> (f64, f64) {
        let given = self.sum(|_, given| given == class);
        let right = self.sum(|truth, given| truth == class && given == class);
        (right / given.max(1.0), given)
    }

    fn told(&self, name: &str, classes: &[String]) {
        eprintln!(
            "  {name}: precision {:.4}, recall {:.3} of {} pixels",
            self.precision(),
            self.sum(|truth, given| truth == given) / self.sum(|_, _| true),
            self.sum(|_, _| true)
        );
        for (class, number) in classes.iter().zip(0..) {
            let right = self.sum(|truth, given| truth == number && given == number);
            let (precision, given) = self.of_class(number);
            let there = self.sum(|truth, _| truth == number);
            if given + there > 0.0 {
                let recall = right / there.max(1.0);
                eprintln!(
                    "    {class}: precision {precision:.3}, recall {recall:.3}, {there} pixels"
                );
            }
        }
    }
}

/// Labels of pixels, each with whether it is right and how sure it is: what is said, precisely or much.
#[derive(Default)]
struct Claims(Vec<(f64, bool)>);

impl Claims {
    fn sort(&mut self) {
        self.0.sort_by(|a, b| b.0.total_cmp(&a.0));
    }

    /// Of the surest ones that are this share of all: how many are right.
    fn precision_at(&self, recall: f64) -> f64 {
        let count = ((self.0.len() as f64 * recall) as usize).max(1);
        let right = self.0.iter().take(count).filter(|(_, right)| *right);
        right.count() as f64 / count as f64
    }

    /// Precision and share of those that are at least this sure.
    fn surer(&self, than: f64) -> (f64, f64) {
        let claimed = self.0.iter().filter(|(sure, _)| *sure >= than).count();
        let share = claimed as f64 / self.0.len() as f64;
        (self.precision_at(share), share)
    }
}

/// Each pixel that is dynamic or has no class gets that of the static one that is nearest in the picture (city blocks, across
/// the seam), and how far away that is.
fn nearest(labels: &[u8], width: usize, dynamic: u8) -> (Vec<u8>, Vec<u32>) {
    let mut found = labels.to_vec();
    let mut steps = vec![0; labels.len()];
    let is_open = |class: u8| class == dynamic || class == VOID;
    let mut ahead: VecDeque<usize> = (0..labels.len())
        .filter(|at| !is_open(labels[*at]))
        .collect();
    while let Some(at) = ahead.pop_front() {
        let (column, row) = (at % width, at - at % width);
        let beside = [
            row + (column + 1) % width,
            row + (column + width - 1) % width,
        ];
        let above = at.checked_sub(width);
        let below = Some(at + width).filter(|at| *at < labels.len());
        for next in beside.into_iter().chain(above).chain(below) {
            if is_open(found[next]) {
                found[next] = found[at];
                steps[next] = steps[at] + 1;
                ahead.push_back(next);
            }
        }
    }
    (found, steps)
}

/// At least these shares.
struct Least {
    /// Of the pixels behind cars, those that were seen.
    seen: f64,
    /// Of those that are said, those that are right.
    right: f64,
    /// The same of each class.
    right_of_class: f64,
}

/// What is behind cars: as others saw it, and as it is inferred for views whose stretch of street the model does not know.
fn check_labels(world: &Path, map: &Path, name: &str, least: &Least) {
    const STRETCHES: usize = 6;
    let views = views(world, map);
    let classes = &views[0].classes;
    let number = |name: &str| classes.iter().position(|class| class == name).unwrap() as u8;
    let (car, road) = (number("car"), number("road"));
    let kinds = Kinds::new(classes, &["car".to_owned()], &["sky".to_owned()]).unwrap();
    let stretch = |view: usize| view * STRETCHES / views.len();
    let [
        mut said,
        mut seen,
        mut inferred,
        mut ellipses,
        mut always,
        mut beside,
    ] = [(); 6].map(|()| Score::default());
    let [mut claims, mut near_claims] = [(); 2].map(|()| Claims::default());
    let (mut cars, mut unclear) = (0, 0);
    for (index, view) in views.iter().enumerate() {
        let known = views
            .iter()
            .enumerate()
            .filter(|(other, _)| stretch(*other) != stretch(index));
        let counts = known.flat_map(|(_, other)| other.occlusions.iter().copied());
        let model = Model::new(classes.len(), counts);
        let [width, height] = view.size;
        let labels = Labels {
            width,
            height,
            values: &view.warped,
        };
        let teller = Teller::Ellipses(&model);
        let all = Options {
            min_probability: 0.0,
            ..Options::default()
        };
        let found = infer(&labels, true, &kinds, teller, &all).unwrap();
        let (near, steps) = nearest(&view.warped, width as usize, car);
        for (at, truth) in view
            .truth
            .iter()
            .enumerate()
            .filter(|(at, _)| view.before[*at] == car)
        {
            cars += 1;
            assert_ne!(view.stable[at], car, "something that moves is left");
            let sure = f64::from(view.certainty[at]) / 255.0;
            // As the plan ships: what is less sure is not said.
            let is_said = sure >= Options::default().min_probability;
            said.add(*truth, if is_said { view.stable[at] } else { VOID });
            if view.warped[at] == VOID {
                unclear += 1;
                assert_eq!(view.stable[at], VOID);
            } else if view.warped[at] != car {
                seen.add(*truth, view.warped[at]);
                assert_eq!(view.stable[at], view.warped[at]);
            } else {
                inferred.add(*truth, view.stable[at]);
                claims.0.push((sure, view.stable[at] == *truth));
                near_claims
                    .0
                    .push((-f64::from(steps[at]), near[at] == *truth));
                ellipses.add(*truth, found.labels[at]);
                always.add(*truth, road);
                beside.add(*truth, near[at]);
            }
        }
        for (at, before) in view
            .before
            .iter()
            .enumerate()
            .filter(|(_, before)| **before != car)
        {
            assert_eq!(view.stable[at], *before, "what stays was changed");
        }
    }
    eprintln!(
        "{name}: of {cars} pixels behind cars {:.3} were seen, {:.3} are not clear",
        seen.sum(|_, _| true) / f64::from(cars),
        f64::from(unclear) / f64::from(cars)
    );
    for (score, what) in [
        (&said, "all that is said"),
        (&seen, "seen"),
        (
            &inferred,
            "inferred, however unsure, cross-validated by stretches",
        ),
        (&ellipses, "by the paper's equations"),
        (&always, "always road"),
        (&beside, "nearest static neighbour"),
    ] {
        score.told(what, classes);
    }
    assert!(seen.sum(|_, _| true) > least.seen * f64::from(cars));
    assert!(said.precision() >= least.right, "{}", said.precision());
    for (class, number) in classes.iter().zip(0..) {
        let (precision, given) = said.of_class(number);
        // Of a few pixels, a share says little.
        assert!(
            precision >= least.right_of_class || given < 1000.0,
            "{class}: {precision}"
        );
    }
    claims.sort();
    near_claims.sort();
    for sure in [0.5, 0.7, 0.8, 0.9, 0.95] {
        let (precision, share) = claims.surer(sure);
        eprintln!("  at least {sure} sure: precision {precision:.3} of {share:.3}");
    }
    for recall in [0.2, 0.4, 0.6, 0.8, 1.0] {
        let (own, near) = (
            claims.precision_at(recall),
            near_claims.precision_at(recall),
        );
        eprintln!("  of {recall} of the pixels, precision {own:.3}; nearest neighbour {near:.3}");
        assert!(own > near && own > always.precision());
    }
    let (precision, share) = claims.surer(f64::from(230_u8) / 255.0);
    assert!(precision >= 0.975 && share > 0.2, "{precision} of {share}");
    assert!(inferred.precision() > ellipses.precision());
    let query = "SELECT class, pixels, probability, deviation FROM occlusion_model WHERE dynamic = 'car' ORDER BY probability DESC";
    let mut sum = 0.0;
    for row in rows(map, None, query) {
        let number = |name: &str| row[name].as_f64().unwrap();
        eprintln!(
            "  car hides {}: {:.3} ± {:.3}",
            row["class"],
            number("probability"),
            number("deviation")
        );
        sum += number("probability");
        assert!((0.0..0.5).contains(&number("deviation")));
    }
    assert!((sum - 1.0).abs() < 1e-9);
    // What was inferred says so, as many pixels as were left.
    let query = "SELECT sum(pixels) AS pixels, min(probability) AS low, max(probability) AS high FROM inferred_areas";
    let areas = &rows(map, None, query)[0];
    let left = &rows(
        map,
        None,
        "SELECT sum(unseen_px) AS pixels FROM warped_labels",
    )[0];
    assert_eq!(areas["pixels"], left["pixels"]);
    assert!(areas["low"].as_f64().unwrap() > 0.0 && areas["high"].as_f64().unwrap() <= 1.0);
}

/// The map, drawn as its stable labels.
fn drawn(map: &Path, out: &Path, code: i32) -> Finished {
    let line = ["render", "--map", text(map), "--view", "stable", "--out"];
    evermap(&[&line[..], &[text(out)]].concat()).expect(code)
}

fn percent(part: usize, whole: usize) -> String {
    format!("{:.1} %", 100.0 * part as f64 / whole as f64)
}

/// Beside each view's image, a picture says what became of what was labelled as a car, and how that compares with the truth;
/// and a report shows the picture with the model's table.
fn check_pictures(world: &Path, map: &Path, folder: &Path) {
    let out = folder.join("stable.svg");
    drawn(map, &out, 0);
    let picture = std::fs::read_to_string(&out).unwrap();
    let mut compared = 0;
    for view in views(world, map) {
        let Some((_, row)) = picture.split_once(&format!("/{}</title>", view.stamp)) else {
            continue;
        };
        compared += 1;
        let car = view
            .classes
            .iter()
            .position(|class| class == "car")
            .unwrap() as u8;
        let pixels = (0..view.before.len()).filter(|at| view.before[*at] == car);
        let moving = pixels.clone().count();
        let is_said = |at: &usize| view.stable[*at] != VOID;
        let right = |sure: &dyn Fn(u8) -> bool| {
            let said = pixels.clone().filter(is_said);
            let said = said.filter(|at| sure(view.certainty[*at]));
            let right = said
                .clone()
                .filter(|at| view.stable[*at] == view.truth[*at]);
            (said.clone().count(), right.count())
        };
        let ((seen, seen_right), (inferred, inferred_right)) =
            (right(&|sure| sure == 255), right(&|sure| sure < 255));
        assert!(seen > 0 && inferred > 0);
        let shares = [
            (moving, view.before.len()),
            (seen, moving),
            (inferred, moving),
        ];
        let [moves, was_seen, was_inferred] = shares.map(|(part, whole)| percent(part, whole));
        for title in [
            "<title>image<".to_owned(),
            format!("<title>before: {moves} moves<"),
            format!("<title>warped: {was_seen} of that seen, "),
            format!("<title>inferred: {was_inferred} of that, "),
            format!(
                "<title>stable: {} of that",
                percent(moving - seen - inferred, moving)
            ),
            format!(
                "<title>truth: {} of seen right, {} of inferred<",
                percent(seen_right, seen),
                percent(inferred_right, inferred)
            ),
        ] {
            // Of this view, whose panels come next.
            let at = row.find(&title).expect(&title);
            let before = row[..at].matches("data-panel=\"image\"").count();
            assert_eq!(before, 1, "{title}");
        }
    }
    assert!(compared > 0, "no view of the first visit is drawn");
    let out = folder.join("stable.png");
    drawn(map, &out, 0);
    let png = png::Decoder::new(Cursor::new(std::fs::read(&out).unwrap()));
    assert_eq!(png.read_info().unwrap().info().width, 1600);

    let out = folder.join("report.html");
    evermap(&["report", "--map", text(map), "--out", text(&out)]).expect(0);
    let page = std::fs::read_to_string(&out).unwrap();
    let (_, page) = page.split_once("<h2>Stable map</h2>").unwrap();
    assert!(page.contains("data-panel=\"truth\"") && page.contains("<h3>Inferred areas</h3>"));
    let query = "SELECT class, pixels, round(100 * probability, 1) AS percent, round(100 * deviation, 1) AS deviation \
                 FROM occlusion_model WHERE dynamic = 'car'";
    let model = rows(map, None, query);
    assert!(model.len() > 3);
    for row in model {
        let [percent, deviation] = ["percent", "deviation"].map(|name| row[name].as_f64().unwrap());
        let (class, pixels) = (row["class"].as_str().unwrap(), &row["pixels"]);
        let cells = format!(
            "<td>car</td><td>{class}</td><td class=\"n\">{pixels}</td><td class=\"n\">{percent:?}</td>\
             <td class=\"n\">{deviation:?}</td>"
        );
        assert!(page.contains(&cells), "{cells}");
    }
}

#[test]
fn a_street_without_its_cars() {
    let Some(world) = shared("worlds/street_small") else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let map = mapped(&world, folder.path(), "/panorama/labels", 0);
    check_registrations(&world, &map, "street_small");
    let least = Least {
        seen: 0.8,
        right: 0.985,
        right_of_class: 0.96,
    };
    check_labels(&world, &map, "street_small", &least);
    check_pictures(&world, &map, folder.path());
}

/// A simulated street, which the tests share.
fn simulated() -> &'static Path {
    static STREET: OnceLock<PathBuf> = OnceLock::new();
    STREET.get_or_init(|| {
        let street = made_once(env!("CARGO_TARGET_TMPDIR"), "stable_map");
        simulate("street", &street, &["length_m=110", "seed=7"]);
        street
    })
}

#[test]
fn noisy_labels_do_not_mislead_registration() {
    let folder = tempfile::tempdir().unwrap();
    let street = simulated();
    let map = registered(street, folder.path(), "/panorama/labels_noisy");
    check_registrations(street, &map, "a simulated street, noisy labels");
    // Of a map that is not asked what is behind cars, nothing is drawn.
    let told = drawn(&map, &folder.path().join("stable.png"), 1).stderr;
    assert!(
        told.contains("the map has no warped_labels of street"),
        "{told}"
    );
    assert!(told.contains("map it with the plan stable_map"), "{told}");
    let out = folder.path().join("report.html");
    evermap(&["report", "--map", text(&map), "--out", text(&out)]).expect(0);
    let page = std::fs::read_to_string(&out).unwrap();
    assert!(page.contains("Semantic map") && !page.contains("Stable map"));
}

/// One visit alone: driving past cars shows what they hide. None of the limits was chosen on this street. The little sky that
/// cars hide, and signs, are not as precise: what is far away others see past what is nearer.
#[test]
fn another_street_without_its_cars() {
    let folder = tempfile::tempdir().unwrap();
    let street = folder.path().join("street");
    std::fs::create_dir(&street).unwrap();
    std::os::unix::fs::symlink(simulated().join(VISITS[0]), street.join(VISITS[0])).unwrap();
    let map = mapped(&street, folder.path(), "/panorama/labels", 0);
    let least = Least {
        seen: 0.65,
        right: 0.97,
        right_of_class: 0.85,
    };
    check_labels(&street, &map, "a simulated street", &least);
    check_pictures(&street, &map, folder.path());
}

/// Little but the ground is in range, so that range fits metres away too; labels are noisy, and every view of the second
/// visit looks elsewhere.
#[test]
fn views_that_look_elsewhere_end_in_a_pose_where_little_tells_places_apart() {
    let folder = tempfile::tempdir().unwrap();
    let street = folder.path().join("street");
    simulate("street", &street, &["length_m=90", "seed=7"]);
    let log = street.join("visit_b/visit_b.mcap");
    let straight = street.join("straight.mcap");
    std::fs::rename(&log, &straight).unwrap();
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let turns = turned(&straight, &log, || random.random_range(0.0..1.0));
    let map = registered(&street, folder.path(), "/panorama/labels_noisy");
    let turns = Turns::from([("visit_b", turns)]);
    let Compared {
        found,
        near,
        converged,
        wrong,
        ..
    } = registrations(&street, &map, &turns, "a bare loop");
    assert!(
        converged as f64 >= 0.75 * near as f64,
        "{converged} of {near}"
    );
    assert!(wrong as f64 <= 0.03 * found as f64, "{wrong} of {found}");
}

#[test]
fn views_without_range_are_counted() {
    let folder = tempfile::tempdir().unwrap();
    let street = folder.path().join("street");
    let small = [
        "length_m=90",
        "width_px=256",
        "height_px=83",
        "colour=false",
    ];
    simulate("street", &street, &small);
    // 3: views that relocation found have no panorama with range, which is counted.
    let map = mapped(&street, folder.path(), "/panorama/labels", 3);
    let count = |of: &str| {
        rows(&map, None, &format!("SELECT count(*) AS rows FROM {of}"))[0]["rows"].clone()
    };
    assert_eq!(
        (count("spheres"), count("registrations")),
        (0.into(), 0.into())
    );
    assert_eq!(count("occlusion_model"), 0);
    // Nothing is known of what is behind cars, and nothing is made up: no car is left in the graphs.
    assert_eq!(count("stable_views"), count("views"));
    assert_eq!(count("stable_views WHERE contains(graph, 'car')"), 0);
    // Nor is there a camera image, which is said.
    let out = folder.path().join("stable.svg");
    drawn(&map, &out, 0);
    let picture = std::fs::read_to_string(&out).unwrap();
    for title in [
        "no image: its log is gone, or has none",
        "inferred: nothing",
    ] {
        assert!(
            picture.contains(&format!("<title>{title}</title>")),
            "{title}"
        );
    }
}
