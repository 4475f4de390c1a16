//! The program as a shell sees it: what goes to which stream, and how it ends.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod made_up;

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

use evermap_engine::map::Map;
use evermap_engine::sql::{Limits, context};
use serde_json::Value;

struct Ended {
    code: Option<i32>,
    out: String,
    err: String,
}

fn evermap(arguments: &[&str]) -> Ended {
    let output = Command::new(env!("CARGO_BIN_EXE_evermap"))
        .args(arguments)
        .env_remove("EVERMAP_LOG")
        .stdin(Stdio::null())
        .output()
        .unwrap();
    Ended {
        code: output.status.code(),
        out: String::from_utf8_lossy(&output.stdout).into_owned(),
        err: String::from_utf8_lossy(&output.stderr).into_owned(),
    }
}

/// Runs, and expects it to be done without a word of complaint.
fn done(arguments: &[&str]) -> String {
    let ended = evermap(arguments);
    assert_eq!(ended.code, Some(0), "{arguments:?}: {}", ended.err);
    ended.out
}

#[test]
fn what_needs_no_map_works_anywhere() {
    assert!(done(&["--version"]).starts_with("evermap "));
    assert!(done(&["--help"]).contains("Exit status"));
    assert!(done(&["operators"]).contains("keyframes"));
    assert!(done(&["operators", "keyframes"]).contains("| `baseline_m` |"));
    let list: Value = serde_json::from_str(&done(&["operators", "--format", "json"])).unwrap();
    assert!(
        list.as_array()
            .unwrap()
            .iter()
            .any(|row| row["operator"] == "keyframes")
    );
    let schema: Value = serde_json::from_str(&done(&["schema"])).unwrap();
    assert_eq!(schema["title"], "evermap plan");
    for shell in ["bash", "zsh", "fish", "powershell", "elvish"] {
        assert!(done(&["completions", shell]).contains("render"), "{shell}");
    }
}

#[test]
fn an_operator_is_printed_as_it_is_declared() {
    let registry = evermap_catalog::registry();
    let declared = registry.get("keyframes").unwrap().reference();
    assert_eq!(
        done(&["operators", "keyframes"]).trim_end(),
        declared.trim_end()
    );
}

#[test]
fn failures_end_with_1_and_wrong_usage_with_2() {
    for arguments in [
        &[][..],
        &["fly"],
        &["run", "car_park"],
        &["sql"],
        &["render", "--map", "m", "--out", "m.gif"],
    ] {
        let ended = evermap(arguments);
        assert_eq!(
            (ended.code, ended.out.as_str()),
            (Some(2), ""),
            "{arguments:?}: {}",
            ended.err
        );
    }
    for arguments in [
        &["operators", "nothing"][..],
        &["layers", "--map", "/no/such/map"],
        &["inspect", "/no/such/file.mcap"],
        &["check", "/no/such/plan.yaml"],
        &["import", "rosbag", "a.bag"],
    ] {
        let ended = evermap(arguments);
        assert_eq!(
            (ended.code, ended.out.as_str()),
            (Some(1), ""),
            "{arguments:?}: {}",
            ended.err
        );
        assert!(ended.err.starts_with("error: "), "{}", ended.err);
    }
}

#[test]
fn a_bad_plan_shows_all_its_faults_with_carets_and_makes_no_map() {
    let folder = tempfile::tempdir().unwrap();
    let plan = folder.path().join("bad.yaml");
    std::fs::write(
        &plan,
        "plan: bad\nsteps:\n  a: { op: keyframs }\n  b: { sql: SELECT * FROM c }\nwrite: [d]\n",
    )
    .unwrap();
    let map = folder.path().join("map");
    let run = evermap(&[
        "run",
        plan.to_str().unwrap(),
        "--map",
        map.to_str().unwrap(),
        "--sessions",
        "none.mcap",
    ]);
    let check = evermap(&["check", plan.to_str().unwrap()]);
    for ended in [run, check] {
        assert_eq!((ended.code, ended.out.as_str()), (Some(1), ""));
        for said in [
            "did you mean `keyframes`?",
            "bad.yaml:3:",
            "bad.yaml:4:",
            "bad.yaml:5:",
            "^^^",
            "the plan is refused",
        ] {
            assert!(ended.err.contains(said), "{said}: {}", ended.err);
        }
    }
    assert!(!map.exists());
}

/// The channels and pixels of a PNG file.
fn pixels(file: &str) -> (png::ColorType, Vec<u8>) {
    let file = std::io::BufReader::new(std::fs::File::open(file).unwrap());
    let mut reader = png::Decoder::new(file).read_info().unwrap();
    let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
    reader.next_frame(&mut pixels).unwrap();
    (reader.output_color_type().0, pixels)
}

#[test]
fn a_floor_of_which_a_part_is_in_colour_is_shown_and_exported_in_colour() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let map = path("map");
    let runtime = tokio::runtime::Runtime::new().unwrap();
    runtime.block_on(made_up::map_in_colour(Path::new(&map)));
    for (format, file) in [("png", "floor.png"), ("geotiff", "floor.tif")] {
        let out = path(file);
        done(&[
            "export",
            "overhead_tiles",
            "--map",
            &map,
            "--format",
            format,
            "--out",
            &out,
        ]);
    }
    let (channels, expected) = pixels(&path("floor.png"));
    assert_eq!(channels, png::ColorType::Rgba);
    let (pixels_of, _) = expected.as_chunks::<4>();
    assert_eq!(pixels_of.len(), 256 * 256);
    let is_yellow = |pixel: &[u8; 4]| *pixel == [190, 160, 20, 255];
    let grey = |pixel: &[u8; 4]| pixel[0] == pixel[1] && pixel[1] == pixel[2] && pixel[3] == 255;
    let yellow: Vec<usize> = (0..256 * 256)
        .filter(|at| is_yellow(&pixels_of[*at]))
        .collect();
    // In the north-eastern tile alone; all else is grey.
    assert!(yellow.len() > 100 && yellow.iter().all(|at| at % 256 >= 128 && at / 256 < 128));
    assert_eq!(
        pixels_of.iter().filter(|it| grey(it)).count(),
        256 * 256 - yellow.len()
    );
    let tiff = std::fs::File::open(path("floor.tif")).unwrap();
    let mut tiff = tiff::decoder::Decoder::new(std::io::BufReader::new(tiff)).unwrap();
    let tiff::decoder::DecodingResult::U8(cells) = tiff.read_image().unwrap() else {
        panic!("expected cells of 8 bits");
    };
    assert!(cells == expected, "the GeoTIFF shows another floor");
    let out = path("map.png");
    done(&["render", "--map", &map, "--out", &out, "--width-px", "400"]);
    let (channels, shown) = pixels(&out);
    let samples = channels.samples();
    let is_yellow = |pixel: &&[u8]| pixel[0] > pixel[2].saturating_add(60);
    assert!(shown.chunks(samples).filter(is_yellow).count() > 100);
}

fn made_up_map() -> (tempfile::TempDir, String) {
    let folder = tempfile::tempdir().unwrap();
    let map = folder.path().join("map");
    tokio::runtime::Runtime::new()
        .unwrap()
        .block_on(made_up::map(&map));
    let address = map.to_str().unwrap().to_owned();
    (folder, address)
}

#[test]
fn a_map_is_listed_queried_and_compared() {
    let (_folder, map) = made_up_map();
    let layers = done(&["layers", "--map", &map]);
    assert!(
        ["overhead_tiles", "lanes", "poses", "380"]
            .iter()
            .all(|said| layers.contains(said)),
        "{layers}"
    );
    assert!(done(&["layers", "--map", &map, "--version", "1"]).contains("200"));
    let versions: Value =
        serde_json::from_str(&done(&["versions", "--map", &map, "--format", "json"])).unwrap();
    assert_eq!(
        versions[1]["sessions"],
        serde_json::json!(["initial", "revisit_1"])
    );
    let query = "SELECT session, count(*) AS n FROM poses GROUP BY session ORDER BY session";
    assert_eq!(
        done(&["sql", "--map", &map, "--format", "csv", query]),
        "session,n\ninitial,200\nrevisit_1,180\n"
    );
    let json: Value = serde_json::from_str(&done(&[
        "sql",
        "--map",
        &map,
        "--format",
        "json",
        "SELECT lane, points FROM lanes",
    ]))
    .unwrap();
    assert_eq!(json[2]["points"][1], serde_json::json!([43.0, 25.0, 0.0]));
    let wrong = evermap(&["sql", "--map", &map, "SELECT * FROM nowhere"]);
    assert_eq!(wrong.code, Some(1));
    assert!(wrong.err.starts_with("error: user: "), "{}", wrong.err);
    let diff = done(&["diff", "1", "2", "--map", &map, "--format", "csv"]);
    assert!(diff.contains("poses,180,0,0,200"), "{diff}");
    assert!(diff.contains("lanes,0,0,0,3"), "{diff}");
    assert!(
        evermap(&["layers", "--map", &map, "--version", "9"])
            .err
            .contains("no version 9")
    );
    assert!(
        done(&["gc", "--map", &map, "--keep", "1", "--dry-run"])
            .starts_with("would remove 1 version")
    );
    assert!(
        done(&["versions", "--map", &map]).contains("| 1 "),
        "a dry run removes nothing"
    );
    done(&["gc", "--map", &map, "--keep", "1"]);
    assert!(!done(&["versions", "--map", &map]).contains("| 1 "));
}

/// Older versions of evermap let steps have any name.
#[test]
fn a_layer_that_is_called_as_a_table_of_the_map_hides_behind_it() {
    let (_folder, map) = made_up_map();
    let path = Path::new(&map).join("versions/2.json");
    let mut version: Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
    version.as_object_mut().unwrap().remove("seal").unwrap();
    for name in ["columns", "layers", "runs", "versions"] {
        version["layers"][name] = version["layers"]["lanes"].clone();
    }
    std::fs::write(&path, version.to_string()).unwrap();
    let map = map.as_str();
    let asked = async |query: &str| {
        let map = Map::open(map, None).await.unwrap();
        let context = context(Limits::default()).unwrap();
        let context = map.context(context, &evermap_catalog::registry()).unwrap();
        let rows = context.sql(query).await.unwrap().collect().await.unwrap();
        rows.iter().map(|batch| batch.num_rows()).sum::<usize>()
    };
    let all = async {
        for (query, rows) in [
            ("SELECT version FROM versions", 2),
            (
                "SELECT layer FROM layers WHERE layer IN ('lanes', 'runs')",
                2,
            ),
            (
                "SELECT * FROM columns WHERE layer = 'runs' AND \"column\" = 'seconds'",
                1,
            ),
            (
                "SELECT * FROM columns WHERE layer = 'columns' AND \"column\" = 'lane'",
                0,
            ),
            (
                "SELECT * FROM columns WHERE layer = 'lanes' AND \"column\" = 'lane'",
                1,
            ),
        ] {
            assert_eq!(asked(query).await, rows, "{query}");
        }
    };
    let in_time = async { tokio::time::timeout(Duration::from_secs(60), all).await };
    let runtime = tokio::runtime::Runtime::new().unwrap();
    runtime.block_on(in_time).expect("an answer");
}

#[test]
fn queries_are_read_from_standard_input() {
    let (_folder, map) = made_up_map();
    let mut child = Command::new(env!("CARGO_BIN_EXE_evermap"))
        .args(["sql", "--map", &map, "--format", "csv"])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    std::io::Write::write_all(
        &mut child.stdin.take().unwrap(),
        b"SELECT 1 AS a;\nSELECT ';' AS b; -- end",
    )
    .unwrap();
    let output = child.wait_with_output().unwrap();
    assert_eq!(String::from_utf8_lossy(&output.stdout), "a\n1\nb\n;\n");
}

#[test]
fn what_comes_by_standard_input_without_an_end_is_refused() {
    let (_folder, map) = made_up_map();
    for (command, what) in [
        (&["check", "-"][..], "a plan"),
        (&["sql", "--map", &map], "queries"),
    ] {
        let mut child = Command::new(env!("CARGO_BIN_EXE_evermap"))
            .args(command)
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut sent = child.stdin.take().unwrap();
        let yes = "y\n".repeat(1 << 15);
        // Until nobody reads any more.
        let pieces = (0..1 << 14).map(|_| std::io::Write::write_all(&mut sent, yes.as_bytes()));
        assert!(pieces.take_while(Result::is_ok).count() < 1 << 10);
        drop(sent);
        let ended = child.wait_with_output().unwrap();
        assert_eq!(ended.status.code(), Some(1));
        let told = String::from_utf8_lossy(&ended.stderr).into_owned();
        let expected = format!("expected {what} of at most 4 MiB, found more");
        assert!(told.contains(&expected), "{told}");
    }
}

#[test]
fn who_reads_a_beginning_and_goes_is_no_failure_in_any_format_of_text() {
    let query = "SELECT value, repeat('a', 1000) AS text FROM generate_series(1, 20000)";
    let (_folder, map) = made_up_map();
    for format in ["csv", "json", "table"] {
        let mut child = Command::new(env!("CARGO_BIN_EXE_evermap"))
            .args(["sql", "--map", &map, "--format", format, query])
            .env_remove("EVERMAP_LOG")
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut read = [0; 100];
        let mut out = child.stdout.take().unwrap();
        std::io::Read::read_exact(&mut out, &mut read).unwrap();
        drop(out);
        let ended = child.wait_with_output().unwrap();
        let said = String::from_utf8_lossy(&ended.stderr);
        assert_eq!((ended.status.code(), &*said), (Some(0), ""), "{format}");
    }
}

#[test]
fn layers_are_exported() {
    let (folder, map) = made_up_map();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let export = |layer: &str, format: &str, out: &str, more: &[&str]| {
        let arguments = [
            &[
                "export", layer, "--map", &map, "--format", format, "--out", out,
            ],
            more,
        ]
        .concat();
        evermap(&arguments)
    };
    assert_eq!(
        export("lanes", "geojson", &path("lanes.geojson"), &[]).code,
        Some(0)
    );
    let lanes: Value =
        serde_json::from_slice(&std::fs::read(path("lanes.geojson")).unwrap()).unwrap();
    assert_eq!(lanes["features"][0]["geometry"]["type"], "LineString");
    assert_eq!(lanes["features"][2]["properties"]["direction"], "both");
    let two = export("poses", "tum", &path("poses.tum"), &[]);
    assert!(
        two.code == Some(1) && two.err.contains("--session: initial, revisit_1"),
        "{}",
        two.err
    );
    assert!(!Path::new(&path("poses.tum")).exists());
    assert_eq!(
        export(
            "poses",
            "tum",
            &path("poses.tum"),
            &["--session", "initial"]
        )
        .code,
        Some(0)
    );
    let tum = std::fs::read_to_string(path("poses.tum")).unwrap();
    assert_eq!(tum.lines().count(), 201);
    assert!(
        tum.lines()
            .nth(2)
            .unwrap()
            .starts_with("1780000000.100000000 ")
    );
    assert_eq!(
        export("overhead_tiles", "png", &path("floor.png"), &[]).code,
        Some(0)
    );
    let (width, height) = size(&std::fs::read(path("floor.png")).unwrap());
    assert_eq!((width, height), (256, 256));
    assert!(
        std::fs::read_to_string(path("floor.pgw"))
            .unwrap()
            .starts_with("0.2\n0\n0\n-0.2\n0.1\n51.1")
    );
    assert_eq!(
        export("overhead_tiles", "geotiff", &path("floor.tif"), &[]).code,
        Some(0)
    );
    let tiff = std::fs::File::open(path("floor.tif")).unwrap();
    let mut tiff = tiff::decoder::Decoder::new(std::io::BufReader::new(tiff)).unwrap();
    assert_eq!(tiff.dimensions().unwrap(), (width, height));
    let tiff::decoder::DecodingResult::U8(cells) = tiff.read_image().unwrap() else {
        panic!("expected cells of 8 bits");
    };
    // Grey and alpha, cell by cell, in both.
    let picture = std::fs::File::open(path("floor.png")).unwrap();
    let mut picture = png::Decoder::new(std::io::BufReader::new(picture))
        .read_info()
        .unwrap();
    let mut expected = vec![0; picture.output_buffer_size().unwrap()];
    picture.next_frame(&mut expected).unwrap();
    assert_eq!(
        picture.output_color_type().0,
        png::ColorType::GrayscaleAlpha
    );
    assert!(cells == expected, "the GeoTIFF shows another floor");
    for wrong in ["lanes", "poses"] {
        let refused = export(wrong, "geotiff", &path("wrong.tif"), &[]);
        assert!(
            refused.err.contains("a picture is made of overhead tiles"),
            "{}",
            refused.err
        );
    }
    assert!(!Path::new(&path("wrong.tif")).exists());
    assert_eq!(
        export("lanes", "png", &path("lanes.png"), &[]).code,
        Some(1)
    );
    assert_eq!(
        export("lanes", "parquet", &path("lanes.parquet"), &[]).code,
        Some(0)
    );
    assert_eq!(
        export("nothing", "csv", &path("nothing.csv"), &[]).code,
        Some(1)
    );
}

fn made_up_metric_map() -> (tempfile::TempDir, String) {
    let folder = tempfile::tempdir().unwrap();
    let runtime = tokio::runtime::Runtime::new().unwrap();
    runtime.block_on(made_up::metric_map(folder.path()));
    let map = folder.path().to_str().unwrap().to_owned();
    (folder, map)
}

/// Lines that are no comments.
fn lines(path: &Path) -> Vec<String> {
    let text = std::fs::read_to_string(path).unwrap();
    let lines = text.lines().filter(|line| !line.starts_with('#'));
    lines.map(str::to_owned).collect()
}

#[test]
fn a_metric_map_is_exported_as_the_field_reads_it() {
    let (folder, map) = made_up_metric_map();
    let out = |name: &str| folder.path().join(name);
    let export = |layer: &str, format: &str, path: &Path| {
        let path = path.to_str().unwrap();
        done(&[
            "export", layer, "--map", &map, "--format", format, "--out", path,
        ])
    };
    export("adjusted_poses", "g2o", &out("graph.g2o"));
    let graph = lines(&out("graph.g2o"));
    let count = |tag: &str| graph.iter().filter(|line| line.starts_with(tag)).count();
    assert_eq!((count("VERTEX_SE3:QUAT "), count("FIX ")), (200, 1));
    assert_eq!(
        count("EDGE_SE3:QUAT "),
        199 + 1,
        "odometry and the loop closure"
    );

    export("adjusted_poses", "colmap", &out("model"));
    assert_eq!(
        lines(&out("model/cameras.txt")),
        ["1 OPENCV_FISHEYE 400 300 120 120 200 150 0.1 0 0 0"]
    );
    assert_eq!(lines(&out("model/images.txt")).len(), 2 * 200);
    let points = lines(&out("model/points3D.txt"));
    assert_eq!(points.len(), 201);
    assert_eq!(points[0].split(' ').count(), 8 + 2 * 3, "{}", points[0]);

    export("adjusted_poses", "tum", &out("adjusted.tum"));
    assert_eq!(lines(&out("adjusted.tum")).len(), 200);
    export("localisations", "tum", &out("localised.tum"));
    assert_eq!(lines(&out("localised.tum")).len(), 190, "ten are lost");
}

#[test]
fn the_questions_in_the_docs_have_answers() {
    let (_folder, map) = made_up_metric_map();
    let pages = ["README.md", "docs/labels.md", "docs/debugging.md"].map(|page| {
        let page = Path::new(env!("CARGO_MANIFEST_DIR"))
            .join("../..")
            .join(page);
        std::fs::read_to_string(page).unwrap()
    });
    let docs = pages.concat();
    let queries: Vec<_> = docs
        .split("evermap sql --map lot \"")
        .skip(1)
        .map(|rest| rest.split('"').next().unwrap())
        // Of a map that somebody taught, and of one with people: asked by the tests of parking spaces and of people. Of a map
        // of several versions: `first_hour` asks what changed between them.
        .filter(|query| {
            let elsewhere = [
                "parking_space",
                "space_occupancy",
                "lane_speeds",
                "person_questions",
                "diff(",
            ];
            !elsewhere.iter().any(|layer| query.contains(layer))
        })
        .collect();
    assert_eq!(queries.len(), 4);
    for query in queries {
        let answer = done(&["sql", "--map", &map, "--format", "json", query]);
        let rows: Value = serde_json::from_str(&answer).unwrap();
        assert!(!rows.as_array().unwrap().is_empty(), "{query}");
    }
}

#[test]
fn a_doubted_metric_map_shows_itself() {
    let (folder, map) = made_up_metric_map();
    let look = std::env::var("EVERMAP_LOOK").ok();
    let place = look.map_or_else(|| folder.path().to_owned(), PathBuf::from);
    let (picture, page) = (place.join("metric.png"), place.join("metric.html"));
    let (picture, page) = (picture.to_str().unwrap(), page.to_str().unwrap());
    done(&[
        "render", "--map", &map, "--view", "metric", "--out", picture,
    ]);
    assert_eq!(size(&std::fs::read(picture).unwrap()).0, 1600);
    done(&["report", "--map", &map, "--out", page]);
    let page = std::fs::read_to_string(page).unwrap();
    for said in [
        "Drift removed",
        "Residuals",
        "Loop closures",
        "Localisation",
        "What holds the map up",
        "<td class=\"n\">230</td><td class=\"n\">200</td><td class=\"n\">30</td>",
        "unnest(observations)",
        "1 loops rejected",
        "201 landmarks",
        "<td>lost</td>",
    ] {
        assert!(page.contains(said), "{said}");
    }
    let (_folder, other) = made_up_map();
    let told = evermap(&[
        "render", "--map", &other, "--view", "metric", "--out", picture,
    ]);
    assert_eq!(told.code, Some(1));
    assert!(told.err.contains("no adjusted poses"), "{}", told.err);
}

fn size(picture: &[u8]) -> (u32, u32) {
    let reader = png::Decoder::new(std::io::Cursor::new(picture))
        .read_info()
        .unwrap();
    (reader.info().width, reader.info().height)
}

#[test]
fn a_map_is_drawn_and_reported() {
    let (folder, map) = made_up_map();
    let look =
        std::env::var("EVERMAP_LOOK").map_or_else(|_| folder.path().to_owned(), PathBuf::from);
    let path = |name: &str| look.join(name).to_str().unwrap().to_owned();
    done(&[
        "render",
        "--map",
        &map,
        "--out",
        &path("map.png"),
        "--width-px",
        "900",
    ]);
    assert_eq!(size(&std::fs::read(path("map.png")).unwrap()).0, 900);
    done(&["render", "--map", &map, "--out", &path("map.svg")]);
    let svg = std::fs::read_to_string(path("map.svg")).unwrap();
    assert!(
        svg.starts_with("<svg ")
            && svg.contains("revisit_1")
            && svg.contains("data:image/png;base64")
    );
    done(&["report", "--map", &map, "--out", &path("map.html")]);
    let page = std::fs::read_to_string(path("map.html")).unwrap();
    for said in [
        "car_park, version 2",
        "images that do not decode",
        "overhead_tiles",
        "revisit_1",
        "<svg ",
    ] {
        assert!(page.contains(said), "{said}");
    }
    let nowhere = evermap(&[
        "render",
        "--map",
        &map,
        "--out",
        &path("x.png"),
        "--site",
        "moon",
    ]);
    assert!(
        nowhere.code == Some(1) && nowhere.err.contains("there are lot"),
        "{}",
        nowhere.err
    );
}

/// A real log, where the data that is not in the repository is at hand.
fn real_log() -> Option<PathBuf> {
    evermap_test_data::shared("data/mcap_real/evo/nav2_turtlebot.mcap")
}

#[test]
fn a_torn_log_is_inspected_with_loss() {
    let Some(log) = real_log() else { return };
    let whole = evermap(&["inspect", log.to_str().unwrap(), "--json"]);
    assert_eq!(whole.code, Some(0), "{}", whole.err);
    let contents: Value = serde_json::from_str(&whole.out).unwrap();
    assert!(contents["messages"].as_u64().unwrap() > 0);
    assert!(
        contents["channels"]
            .as_array()
            .unwrap()
            .iter()
            .any(|channel| channel["topic"] == "/odom")
    );
    let folder = tempfile::tempdir().unwrap();
    // Behind its only chunk, before the end of its data.
    let torn = folder.path().join("torn.mcap");
    let bytes = std::fs::read(&log).unwrap();
    std::fs::write(&torn, &bytes[..380_000]).unwrap();
    let ended = evermap(&["inspect", torn.to_str().unwrap()]);
    assert_eq!(ended.code, Some(3), "{}", ended.err);
    assert!(
        ended.err.contains("finished with loss") && ended.out.contains("/odom"),
        "{}",
        ended.err
    );
    let query = "SELECT count(*) AS n FROM \"/odom\"";
    let ended = evermap(&[
        "sql",
        "--sessions",
        torn.to_str().unwrap(),
        "--format",
        "csv",
        "-q",
        query,
    ]);
    assert_eq!(ended.code, Some(3), "{}", ended.err);
    assert!(ended.out.starts_with("n\n"));
}

#[test]
fn a_real_log_becomes_a_road_network() {
    let Some(log) = real_log() else { return };
    let folder = tempfile::tempdir().unwrap();
    let map = folder.path().join("map").to_str().unwrap().to_owned();
    let log = log.to_str().unwrap();
    let explained = done(&[
        "explain",
        "trajectory",
        "--map",
        &map,
        "--sessions",
        log,
        "--format",
        "json",
    ]);
    let explained: Value = serde_json::from_str(&explained).unwrap();
    assert!(
        explained
            .as_array()
            .unwrap()
            .iter()
            .all(|unit| unit["recompute"] == true)
    );
    let first = evermap(&[
        "run",
        "trajectory",
        "--map",
        &map,
        "--sessions",
        log,
        "--progress",
        "plain",
    ]);
    assert!(matches!(first.code, Some(0 | 3)), "{}", first.err);
    assert!(
        first.out.contains("| lanes") && first.err.contains("version 1 published"),
        "{}{}",
        first.out,
        first.err
    );
    let again = evermap(&["run", "trajectory", "--map", &map, "--sessions", log]);
    assert_eq!(again.out, first.out, "the same layers");
    assert!(
        again.err.contains("nothing has changed") && again.err.contains("0 units"),
        "{}",
        again.err
    );
    let out = folder.path().join("map.html");
    done(&["report", "--map", &map, "--out", out.to_str().unwrap()]);
    assert!(std::fs::read_to_string(out).unwrap().contains("<svg "));
}

#[cfg(unix)]
#[test]
fn a_stopped_simulation_leaves_no_half_session() {
    for (world, signal) in [("car_park", "-INT"), ("street", "-TERM")] {
        stopped(world, signal);
    }
}

/// Stops the simulation of a world while it writes a session.
#[cfg(unix)]
fn stopped(world: &str, signal: &str) {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("world");
    let mut child = Command::new(env!("CARGO_BIN_EXE_evermap"))
        .args([
            "simulate",
            world,
            "--out",
            out.to_str().unwrap(),
            "--progress",
            "none",
        ])
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let names = || -> Vec<String> {
        let files = std::fs::read_dir(&out).into_iter().flatten().flatten();
        let names = files.map(|file| file.file_name().to_string_lossy().into_owned());
        names.collect()
    };
    // It is at a session once the truth is there and something else is begun.
    let is_begun = || {
        let names = names();
        names.iter().any(|name| name == "truth") && names.len() > 1
    };
    let begun = std::time::Instant::now();
    while !is_begun() {
        assert_eq!(child.try_wait().unwrap(), None, "it ended by itself");
        assert!(begun.elapsed().as_secs() < 60, "it began no session");
        std::thread::sleep(Duration::from_millis(10));
    }
    let stop = Command::new("kill")
        .args([signal, &child.id().to_string()])
        .status()
        .unwrap();
    assert!(stop.success());
    let begun = std::time::Instant::now();
    let status = child.wait().unwrap();
    assert!(begun.elapsed().as_secs() < 10, "it stops at once");
    assert_eq!(status.code(), Some(1));
    assert_eq!(names(), ["truth"], "nothing half-written is left");
}
