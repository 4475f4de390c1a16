//! Steps in Python: the same bytes as an operator's, done again when code, parameters or packages change, held to what
//! operators are held to.

use std::path::{Path, PathBuf};

use evermap_tests::server::Server;
use evermap_tests::{
    Finished, command, plan_command, rectangle, repository, simulate, text, write_drive,
};
use serde_json::Value;

/// A folder with the plans and functions of this test, and a map that is to be.
struct Bench {
    folder: tempfile::TempDir,
    python: PathBuf,
}

impl Bench {
    fn new() -> Option<Self> {
        let python = evermap_tests::python()?;
        let folder = tempfile::tempdir().unwrap();
        let here = repository().join("tests/python_steps");
        for name in ["steps.py", "frames.yaml"] {
            std::fs::copy(here.join(name), folder.path().join(name)).unwrap();
        }
        Some(Self { folder, python })
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// A drive of this many times around.
    fn drive(&self, name: &str, loops: f64) -> PathBuf {
        let path = self.path(name);
        write_drive(&path, rectangle(30.0, 20.0, loops));
        path
    }

    /// A plan of one function that reads `speeds`, and of what follows it.
    fn plan(&self, function: &str, step: &str, test: &str) -> PathBuf {
        let text = format!(
            "plan: made\nsteps:\n  speeds: {{ op: speeds }}\n  made:\n    python: steps.py:{function}\n    in: {{ speeds: speeds }}\n    {step}\nwrite: [made]\n{test}"
        );
        let path = self.path("made.yaml");
        std::fs::write(&path, text).unwrap();
        path
    }

    fn evermap(&self, arguments: &[&str]) -> Finished {
        let mut command = command(arguments);
        command.env("EVERMAP_PYTHON", &self.python);
        command.output().unwrap().into()
    }

    fn run(&self, plan: &Path, session: &Path) -> Finished {
        self.run_into("map", plan, &["--sessions", text(session)])
    }

    fn run_into(&self, map: &str, plan: &Path, more: &[&str]) -> Finished {
        let mut command = plan_command(text(plan), &self.path(map), "lot", more);
        command.env("EVERMAP_PYTHON", &self.python);
        command.env("TMPDIR", self.folder.path());
        command.output().unwrap().into()
    }

    /// The digests of a layer's files in the first version of a map.
    fn contents(&self, map: &str, layer: &str) -> Vec<Value> {
        let version = std::fs::read(self.path(map).join("versions/1.json")).unwrap();
        let version: Value = serde_json::from_slice(&version).unwrap();
        let artifacts = version["layers"][layer]["artifacts"].as_array().unwrap();
        let contents = artifacts.iter().map(|artifact| artifact["content"].clone());
        contents.collect()
    }

    fn query(&self, sql: &str) -> Value {
        let map = self.path("map");
        let arguments = ["sql", "--map", text(&map), "--format", "json", sql];
        self.evermap(&arguments).expect(0).json()
    }

    /// The steps that would be computed again, with why.
    fn forecast(&self, plan: &Path) -> Vec<(String, String)> {
        let map = self.path("map");
        let arguments = [
            "explain",
            text(plan),
            "--map",
            text(&map),
            "--format",
            "json",
        ];
        let forecasts = self.evermap(&arguments).expect(0).json();
        let said = |key: &str, row: &Value| row[key].as_str().unwrap().to_owned();
        let rows = forecasts.as_array().unwrap().iter();
        rows.filter(|row| row["recompute"] == true)
            .map(|row| (said("step", row), said("why", row)))
            .collect()
    }
}

#[test]
fn a_function_gives_the_bytes_of_its_operator() {
    let Some(bench) = Bench::new() else { return };
    let plan = bench.path("frames.yaml");
    bench.evermap(&["test", text(&plan)]).expect(0);
    let session = bench.drive("monday.mcap", 1.3);
    bench.run(&plan, &session).expect(0);
    let [by_rust, by_python] = ["by_rust", "by_python"].map(|layer| bench.contents("map", layer));
    let found = bench.query("SELECT count(*) AS n FROM by_python");
    assert!(found[0]["n"].as_u64().unwrap() > 20, "{found}");
    assert_eq!(by_python, by_rust);

    // Executors run it as this process does.
    let more = ["--sessions", text(&session), "--cluster", "in-process"];
    bench.run_into("distributed", &plan, &more).expect(0);
    assert_eq!(bench.contents("distributed", "by_python"), by_rust);
}

#[test]
fn what_changes_is_done_again_and_nothing_else() {
    let Some(bench) = Bench::new() else { return };
    let output = "output: { site: text, session: text, stamp: time, speed_kmh: f64 }";
    let step = format!("grain: rows\n    {output}");
    let plan = bench.plan("speeds_kmh", &step, "");
    let drive = bench.drive("monday.mcap", 0.5);
    bench.run(&plan, &drive).expect(0);
    let most = "SELECT round(max(speed_kmh), 3) AS kmh, count(*) AS n FROM made";
    let all = bench.query(most);
    assert_eq!(all[0]["kmh"], 7.2);
    assert_eq!(bench.forecast(&plan), []);

    let steps = std::fs::read_to_string(bench.path("steps.py")).unwrap();
    std::fs::write(bench.path("steps.py"), steps.replace("3.6", "3.5")).unwrap();
    let again = |why: &str| vec![("made".to_owned(), why.to_owned())];
    assert_eq!(
        bench.forecast(&plan),
        again("the code of made in steps.py has changed")
    );

    std::fs::write(bench.path("steps.py"), steps).unwrap();
    let with = format!("with: {{ least_mps: 1.0 }}\n    {step}");
    let plan = bench.plan("speeds_kmh", &with, "");
    assert_eq!(
        bench.forecast(&plan),
        again("made.least_mps was unset, is 1.0")
    );
    // What the function left out is counted, and a run that left something out exits 3.
    let lost = bench.run(&plan, &drive).expect(3).stderr;
    assert!(lost.contains("speed of who stands"), "{lost}");
    let fewer = bench.query(most);
    assert!(fewer[0]["n"].as_u64() < all[0]["n"].as_u64(), "{fewer}");
}

#[test]
fn a_test_finds_what_is_no_function_of_its_rows() {
    let Some(bench) = Bench::new() else { return };
    let test = "tests:
  - name: two
    given:
      speeds:
        - { site: s, session: a, stamp: 0, speed_mps: 1.0 }
        - { site: s, session: a, stamp: 1, speed_mps: 2.0 }
    expect: { made: [] }
";
    let cases = [
        (
            "drawn",
            "grain: session",
            "made other rows when it was called again",
        ),
        (
            "numbered",
            "grain: rows",
            "made other rows of one row at a time",
        ),
        (
            "digits",
            "grain: rows",
            "expected f64, found 9007199254740993",
        ),
        (
            "nameless",
            "grain: rows",
            "expected a column x, found stamp",
        ),
    ];
    for (function, grain, expected) in cases {
        let plan = bench.plan(
            function,
            &format!("{grain}\n    output: {{ x: f64 }}"),
            test,
        );
        let found = bench.evermap(&["test", text(&plan)]).expect(1).stdout;
        assert!(
            found.contains(expected),
            "expected {expected}\n   found {found}"
        );
    }
}

#[test]
fn rows_of_another_session_or_site_end_the_step() {
    let Some(bench) = Bench::new() else { return };
    let drive = bench.drive("monday.mcap", 0.1);
    let test = "tests:
  - name: two
    given:
      speeds:
        - { site: lot, session: monday, stamp: 0, speed_mps: 1.0 }
        - { site: lot, session: monday, stamp: 1, speed_mps: 2.0 }
    expect: { made: [] }
";
    let cases = [
        (
            "rows",
            "column: session, name: tuesday",
            "expected rows of session monday, found tuesday",
        ),
        (
            "session",
            "column: session",
            "expected rows of session monday, found null",
        ),
        (
            "site",
            "column: site, name: yard",
            "expected rows of site lot, found yard",
        ),
    ];
    for (grain, with, expected) in cases {
        let output = "output: { site: text, session: text }";
        let step = format!("with: {{ {with} }}\n    grain: {grain}\n    {output}");
        let plan = bench.plan("of_others", &step, test);
        let tested = bench.evermap(&["test", text(&plan)]).expect(1).stdout;
        let ran = bench.run(&plan, &drive).expect(1).stderr;
        for found in [tested, ran] {
            assert!(
                found.contains(expected),
                "expected {expected}\n   found {found}"
            );
        }
    }
    // All rows may be of any.
    let step =
        "with: { column: session, name: tuesday }\n    grain: map\n    output: { session: text }";
    let plan = bench.plan("of_others", step, "");
    bench.run(&plan, &drive).expect(0);
    let sessions = bench.query("SELECT count(DISTINCT session) AS n FROM made");
    assert_eq!(sessions[0]["n"], 2);
}

#[test]
fn sessions_of_equal_rows_have_each_their_own() {
    let Some(bench) = Bench::new() else { return };
    let drives = ["monday.mcap", "tuesday.mcap"].map(|name| bench.drive(name, 0.2));
    let step = "grain: session\n    output: { stamp: time }\n  counted:\n    sql: SELECT count(*) AS n FROM made";
    let plan = bench.plan("nameless", step, "");
    let text_of_plan = std::fs::read_to_string(&plan).unwrap();
    let all = text_of_plan.replace("write: [made]", "write: [speeds, made, counted]");
    std::fs::write(&plan, all).unwrap();
    let sessions = ["--sessions", text(&drives[0]), text(&drives[1])];
    bench.run_into("map", &plan, &sessions).expect(0);
    let contents = bench.contents("map", "made");
    assert_eq!(contents.len(), 2);
    assert_eq!(contents[0], contents[1], "one file is stored");

    let count = |query: &str| bench.query(query)[0]["n"].clone();
    let rows = count("SELECT count(*) AS n FROM speeds");
    assert!(rows.as_u64().unwrap() > 2, "{rows}");
    let stamps = "SELECT count(*) AS n FROM (SELECT stamp, count(*) AS n FROM made GROUP BY stamp) WHERE n = 2";
    assert_eq!(count(stamps).as_u64().unwrap() * 2, rows);
    for query in [
        "SELECT count(*) AS n FROM made",
        "SELECT n FROM counted",
        "SELECT rows AS n FROM layers WHERE layer = 'made'",
    ] {
        assert_eq!(count(query), rows, "{query}");
    }
    let server = Server::start(&bench.path("map"), &[]);
    let answer = server.got("/sql?format=csv&query=SELECT+count(*)+AS+n+FROM+made");
    assert!(answer.contains(&format!("\n{rows}\n")), "{answer}");
    let layer = server.got("/layers/made?format=csv");
    let stamps = layer.split_once("stamp").unwrap().1.lines();
    let stamps = stamps.filter(|line| line.contains(':')).count() as u64;
    assert_eq!(stamps, rows, "{layer}");
}

#[test]
fn what_is_wrong_with_a_step_is_said_before_anything_runs() {
    let Some(bench) = Bench::new() else { return };
    let columns = "grain: session\n    output: { x: f64 }";
    let cases = [
        (
            "drown",
            columns,
            "expected a function drown, found map_frames",
        ),
        (
            "drawn",
            "grain: session\n    output: lanez",
            "`output` names lanez, no layer of an operator; did you mean lanes?",
        ),
        (
            "drawn",
            "grain: session\n    output: { x: double }",
            "x: expected a type, such as `text`",
        ),
        (
            "drawn",
            "with: { n: 1 }\n    grain: session\n    output: { x: f64 }",
            "got an unexpected keyword argument 'n'",
        ),
        (
            "drawn",
            "pixels: { speeds: stamp }\n    grain: rows\n    output: { x: f64 }",
            "`speeds` has no column `stamp` of images",
        ),
    ];
    for (function, step, expected) in cases {
        let plan = bench.plan(function, step, "");
        let found = bench.evermap(&["check", text(&plan)]).expect(1).stderr;
        assert!(
            found.contains(expected),
            "expected {expected}\n   found {found}"
        );
    }
    let plan = bench.plan("drawn", columns, "");
    let mut command = command(&["check", text(&plan)]);
    let nobody = Finished::from(
        command
            .env("EVERMAP_PYTHON", "/nobody/python")
            .output()
            .unwrap(),
    );
    assert!(
        nobody.stderr.contains("cannot start /nobody/python"),
        "{}",
        nobody.stderr
    );
}

#[test]
fn a_function_is_given_images() {
    let Some(bench) = Bench::new() else { return };
    let world = bench.path("world");
    let small = [
        "length_m=80",
        "visits=1",
        "spacing_m=3",
        "width_px=320",
        "height_px=104",
    ];
    simulate("street", &world, &small);
    let plan = bench.path("images.yaml");
    let text = "plan: images
steps:
  files:
    python: steps.py:image_files
    in: { frames: frames }
    pixels: { frames: image }
    grain: rows
    output: { site: text, session: text, camera: text, stamp: time, kind: text, file_bytes: i64 }
write: [files]
";
    std::fs::write(&plan, text).unwrap();
    bench
        .run(&plan, &world.join("visit_a/visit_a.mcap"))
        .expect(0);
    let found = bench.query(
        "SELECT count(*) AS n, min(file_bytes) AS least, max(kind) AS kind FROM files WHERE kind IS NOT NULL",
    );
    assert!(found[0]["n"].as_u64().unwrap() >= 8, "{found}");
    assert!(found[0]["least"].as_u64().unwrap() > 500, "{found}");
}

/// The text between a fence of this language and its end.
fn fenced<'t>(page: &'t str, language: &str) -> &'t str {
    let after = page.split(&format!("```{language}\n")).nth(1).unwrap();
    after.split("```").next().unwrap()
}

#[test]
fn the_page_shows_a_plan_that_passes_its_test() {
    let Some(bench) = Bench::new() else { return };
    let page = std::fs::read_to_string(repository().join("docs/python.md")).unwrap();
    let plan = bench.path("slow_places.yaml");
    std::fs::write(&plan, fenced(&page, "yaml")).unwrap();
    std::fs::write(bench.path("steps.py"), fenced(&page, "python")).unwrap();
    let tested = bench.evermap(&["test", text(&plan)]).expect(0);
    assert!(
        tested.stdout.contains("one that stands for a second"),
        "{}",
        tested.stdout
    );
    bench.run(&plan, &bench.drive("monday.mcap", 0.5)).expect(0);
    let found = bench.query("SELECT count(*) AS stops FROM slow");
    assert!(found[0]["stops"].as_u64().unwrap() >= 1, "{found}");
}
