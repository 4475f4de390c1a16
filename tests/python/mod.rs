//! The Python package reads what `evermap sql` prints, and runs plans; the guide's code does what it says.

use std::path::{Path, PathBuf};

use evermap_tests::server::{map, script};
use evermap_tests::{Finished, repository, rows_of, text, write_drive};
use serde_json::{Value, json};

/// The package, put together from what the build of these tests has made.
fn package(folder: &Path) -> PathBuf {
    let built = std::env::current_exe().unwrap();
    let library = built.with_file_name("libevermap_python.so");
    let source = repository().join("python/evermap");
    let target = folder.join("package/evermap");
    std::fs::create_dir_all(&target).unwrap();
    std::fs::copy(source.join("__init__.py"), target.join("__init__.py")).unwrap();
    std::os::unix::fs::symlink(library, target.join("_evermap.abi3.so")).unwrap();
    folder.join("package")
}

/// The code of a page, block after block.
fn code(page: &str) -> String {
    let blocks = page.split("```python\n").skip(1);
    let blocks = blocks.map(|block| block.split("```").next().unwrap());
    blocks.collect::<Vec<_>>().join("\n")
}

#[test]
fn python_reads_what_evermap_sql_prints() {
    let folder = tempfile::tempdir().unwrap();
    let map = map(folder.path());
    let queries = [
        "SELECT lane, direction, length_m, points FROM lanes ORDER BY lane",
        "SELECT count(*) AS n FROM poses",
        "SELECT session, map_from_vehicle FROM poses ORDER BY session, stamp LIMIT 3",
        "SELECT node, x, y FROM intersections ORDER BY node",
        "SELECT l.lane, st_length(l.geometry) AS m FROM lanes l ORDER BY l.lane",
        "SELECT count(*) AS n FROM monday.\"/odom\"",
    ];
    let answer = |query: &str| json!([query, rows_of(&map, query)]);
    let answers = folder.path().join("answers.json");
    let found: Vec<Value> = queries.iter().map(|query| answer(query)).collect();
    std::fs::write(&answers, Value::from(found).to_string()).unwrap();
    let drive = folder.path().join("wednesday.mcap");
    write_drive(&drive, evermap_tests::rectangle(28.0, 20.0, 1.0));
    let guide = std::fs::read_to_string(repository().join("docs/python.md")).unwrap();
    let notebook = folder.path().join("notebook.py");
    std::fs::write(&notebook, code(&guide)).unwrap();
    std::os::unix::fs::symlink(&map, folder.path().join("lot")).unwrap();
    let monday = folder.path().join("monday.mcap");
    let arguments = [text(&map), text(&monday), text(&answers), text(&notebook)];
    let Some(mut python) = script("python/check.py", &arguments) else {
        return;
    };
    python.env("PYTHONPATH", package(folder.path()));
    python.current_dir(folder.path());
    Finished::from(python.output().unwrap()).expect(0);
    assert!(!Path::new("/tmp/evermap-python.csv").exists());
}
