//! The arrows between crates that `docs/ARCHITECTURE.md` forbids, and the other walls of the house.
//!
//! Each rule is stated once, in [`WALLS`], with its reason. What is a matter of source text (one operator plan node,
//! no operator's name in the engine) follows below. A wall that no longer stands on any crate fails too.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use cargo_metadata::{DependencyKind, Metadata, MetadataCommand};

/// How far a wall reaches.
#[derive(Clone, Copy, PartialEq)]
enum Reach {
    /// What the crate's own manifest names, for its tests too.
    Named,
    /// Also what other crates of ours bring into it.
    Through,
    /// Only what the crate is built from, and what that brings: its tests may use more.
    Built,
}
use Reach::{Built, Named, Through};

/// `from` never depends on `to`. Our crates are called by their folders, others by their names; `*` ends a prefix.
struct Wall {
    from: &'static [&'static str],
    to: &'static [&'static str],
    reach: Reach,
    why: &'static str,
}

const ENGINE_LINE: &[&str] = &["datafusion*", "ballista*"];
/// All but `tests/data`, which finds data for the tests of every crate.
const OURS: &[&str] = &[
    "schemas",
    "operators/*",
    "datasets*",
    "plans/*",
    "tests",
    "tests/bench",
    "tests/fuzz",
];

const WALLS: &[Wall] = &[
    Wall {
        from: &["operators/algorithms"],
        to: &[
            "arrow*",
            "parquet",
            "opencv",
            "datafusion*",
            "ballista*",
            "tokio*",
            "object_store",
        ],
        reach: Through,
        why: "mathematics is tested with numbers alone and outlives engines",
    },
    Wall {
        from: &[
            "schemas",
            "operators/algorithms",
            "operators/vision",
            "plans/language",
            "datasets/messages",
            "datasets/video",
        ],
        to: OURS,
        reach: Named,
        why: "the foundations stand on nothing of ours, so that everything may stand on them",
    },
    Wall {
        from: &[
            "schemas",
            "operators/*",
            "datasets/messages",
            "datasets/recording",
            "datasets/worlds",
            "plans/language",
        ],
        to: ENGINE_LINE,
        reach: Through,
        why: "only scans and the engine know what runs them; most edits then rebuild in seconds",
    },
    Wall {
        from: &["operators/*"],
        to: &["tokio*", "object_store", "parquet", "mcap"],
        reach: Named,
        why: "a kernel is a pure function of batches: no files, no runtime",
    },
    Wall {
        from: &["plans/language"],
        to: &["arrow*", "parquet", "tokio*"],
        reach: Through,
        why: "a plan is checked as text, by editors too, without an engine",
    },
    Wall {
        from: &[
            "schemas",
            "operators/algorithms",
            "operators/contract",
            "operators/catalog",
            "datasets*",
            "plans/*",
        ],
        to: &["opencv"],
        reach: Named,
        why: "OpenCV is linked, configured and replaced in one crate, operators/vision",
    },
    Wall {
        from: &[
            "schemas",
            "operators/*",
            "datasets",
            "datasets/messages",
            "datasets/recording",
            "datasets/video",
            "datasets/worlds",
            "plans/*",
            "tests",
            "tests/*",
        ],
        to: &["ffmpeg*"],
        reach: Named,
        why: "FFmpeg is linked, configured and replaced in one crate, datasets/ffmpeg",
    },
    Wall {
        from: &[
            "schemas",
            "operators/*",
            "datasets",
            "datasets/messages",
            "datasets/recording",
            "datasets/video",
            "datasets/worlds",
            "plans/engine",
            "plans/functions",
            "plans/interpreter",
            "plans/language",
        ],
        to: &["datasets/ffmpeg"],
        reach: Built,
        why: "FFmpeg runs in a process of its own, evermap-video: what crashes it ends no run",
    },
    Wall {
        from: &[
            "schemas",
            "operators/algorithms",
            "operators/vision",
            "operators/contract",
            "datasets*",
            "plans/functions",
            "plans/interpreter",
            "plans/language",
            "python",
        ],
        to: &["operators/catalog"],
        reach: Named,
        why: "operators are handed to what runs them; only cli and tests choose the list",
    },
    Wall {
        from: &["plans/engine"],
        to: &[
            "operators/catalog",
            "operators/vision",
            "operators/algorithms",
        ],
        reach: Named,
        why: "the engine knows operators through the registry it is given, never by name",
    },
    Wall {
        from: &["plans/functions"],
        to: &["operators/contract", "plans/engine", "plans/language"],
        reach: Named,
        why: "functions of SQL are those of values: they know no operator, no map and no plan",
    },
    Wall {
        from: &["plans/interpreter"],
        to: &["operators/*", "plans/engine", "plans/language", "datasets*"],
        reach: Named,
        why: "an interpreter is given tables and gives rows, whatever they are of",
    },
    Wall {
        from: &["datasets/messages"],
        to: &["mcap"],
        reach: Built,
        why: "a payload is decoded the same whatever file it came in; its tests read logs",
    },
    Wall {
        from: &["operators/*"],
        to: &["datasets*", "plans/*"],
        reach: Through,
        why: "arrows point down: an operator runs the same without logs and without plans",
    },
    Wall {
        from: &["datasets", "datasets/messages"],
        to: &["operators/*", "plans/*"],
        reach: Through,
        why: "logs can be read as tables by those who want no operators",
    },
    Wall {
        from: &["datasets/worlds"],
        to: &[
            "operators/vision",
            "operators/contract",
            "operators/catalog",
            "plans/*",
            "schemas",
            "datasets",
        ],
        reach: Named,
        why: "simulated worlds share camera models and poses with operators, and nothing that they could get wrong together",
    },
    Wall {
        from: &[
            "schemas",
            "operators/*",
            "datasets*",
            "plans/language",
            "plans/cli",
        ],
        to: &["ballista*"],
        reach: Named,
        why: "a cluster is one feature of the engine",
    },
    Wall {
        from: &["schemas", "operators/*", "datasets*", "plans/*"],
        to: &["tests*"],
        reach: Built,
        why: "what exists for benchmarks and tests is no part of the program",
    },
];

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("..")
        .canonicalize()
        .unwrap()
}

fn matches(name: &str, patterns: &[&str]) -> bool {
    patterns
        .iter()
        .any(|pattern| match pattern.strip_suffix('*') {
            Some(prefix) => name.starts_with(prefix),
            None => name == *pattern,
        })
}

/// What Cargo says of our crates.
fn metadata() -> Metadata {
    MetadataCommand::new()
        .manifest_path(root().join("Cargo.toml"))
        .no_deps()
        .exec()
        .unwrap()
}

/// What each of our crates depends on: our folders and others' names.
#[derive(Default)]
struct House {
    named: BTreeMap<String, BTreeSet<String>>,
    /// Without development dependencies: what a crate hands on to those that use it.
    handed_on: BTreeMap<String, BTreeSet<String>>,
}

impl House {
    fn read() -> Self {
        let metadata = metadata();
        let root = metadata.workspace_root.canonicalize_utf8().unwrap();
        let folder = |path: &cargo_metadata::camino::Utf8Path| {
            path.canonicalize_utf8()
                .unwrap()
                .strip_prefix(&root)
                .unwrap()
                .to_string()
        };
        let mut house = Self::default();
        for package in &metadata.packages {
            let own = folder(package.manifest_path.parent().unwrap());
            house.handed_on.entry(own.clone()).or_default();
            house.named.entry(own.clone()).or_default();
            for dependency in &package.dependencies {
                let name = dependency
                    .path
                    .as_ref()
                    .map_or_else(|| dependency.name.clone(), |path| folder(path));
                if dependency.kind != DependencyKind::Development {
                    house
                        .handed_on
                        .entry(own.clone())
                        .or_default()
                        .insert(name.clone());
                }
                house.named.entry(own.clone()).or_default().insert(name);
            }
        }
        house
    }

    fn reached(&self, from: &str, reach: Reach) -> BTreeSet<String> {
        let mut found = BTreeSet::new();
        let mut open = if reach == Named {
            Vec::new()
        } else {
            vec![from.to_owned()]
        };
        while let Some(next) = open.pop() {
            for name in self.handed_on.get(&next).into_iter().flatten() {
                if found.insert(name.clone()) {
                    open.push(name.clone());
                }
            }
        }
        if reach != Built {
            found.extend(self.named[from].iter().cloned());
        }
        found
    }

    /// Arrows through walls, as sentences.
    fn breaches(&self, walls: &[Wall]) -> Vec<String> {
        let mut breaches = Vec::new();
        for wall in walls {
            for from in self.named.keys().filter(|name| matches(name, wall.from)) {
                for to in self.reached(from, wall.reach) {
                    if matches(&to, wall.to) {
                        breaches.push(format!("{from} depends on {to}; it must not: {}", wall.why));
                    }
                }
            }
        }
        breaches
    }
}

#[test]
fn no_arrow_goes_through_a_wall() {
    let breaches = House::read().breaches(WALLS);
    assert!(breaches.is_empty(), "\n{}\n", breaches.join("\n"));
}

#[test]
fn every_wall_stands_somewhere() {
    let house = House::read();
    for wall in WALLS {
        for pattern in wall.from {
            assert!(
                house.named.keys().any(|name| matches(name, &[pattern])),
                "no crate {pattern}: {}",
                wall.why
            );
        }
        for pattern in wall.to.iter().filter(|pattern| matches(pattern, OURS)) {
            assert!(
                house.named.keys().any(|name| matches(name, &[pattern])),
                "no crate {pattern}: {}",
                wall.why
            );
        }
    }
}

#[test]
fn a_forbidden_arrow_is_found_near_and_far() {
    let arrows = |list: &[(&str, &[&str])]| -> BTreeMap<String, BTreeSet<String>> {
        list.iter()
            .map(|(from, to)| {
                (
                    (*from).to_owned(),
                    to.iter().map(ToString::to_string).collect(),
                )
            })
            .collect()
    };
    let handed_on = arrows(&[("a", &["b"]), ("b", &["datafusion-sql"]), ("c", &[])]);
    let named = arrows(&[("a", &["b"]), ("b", &["datafusion-sql"]), ("c", &["b"])]);
    let house = House { named, handed_on };
    let wall = |from, reach| {
        [Wall {
            from,
            to: &["datafusion*"],
            reach,
            why: "reason",
        }]
    };
    assert_eq!(
        house.breaches(&wall(&["b"], Named)),
        ["b depends on datafusion-sql; it must not: reason"]
    );
    assert!(house.breaches(&wall(&["a"], Named)).is_empty());
    assert_eq!(house.breaches(&wall(&["a"], Through)).len(), 1);
    // Tests may use more than the crate does.
    assert!(house.breaches(&wall(&["c"], Through)).is_empty());
    assert_eq!(house.breaches(&wall(&["b"], Built)).len(), 1);
}

/// Files under a folder with an ending, sorted; build output and hidden folders left out.
fn files(folder: &Path, ending: &str) -> Vec<PathBuf> {
    let mut found = Vec::new();
    let mut entries: Vec<_> = std::fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    entries.sort();
    // What is built and made beside the sources.
    let made = match folder == root() {
        true => ["target", "sessions", "map"].as_slice(),
        false => &["target"],
    };
    for path in entries {
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        if path.is_dir() && !made.contains(&name.as_str()) && !name.starts_with('.') {
            found.extend(files(&path, ending));
        } else if name.ends_with(ending) {
            found.push(path);
        }
    }
    found
}

#[test]
fn every_crate_is_a_member_and_takes_the_workspace_lints() {
    let house = House::read();
    for manifest in files(&root(), "Cargo.toml") {
        let text = std::fs::read_to_string(&manifest).unwrap();
        if text.contains("[workspace]") {
            continue;
        }
        let folder = manifest
            .parent()
            .unwrap()
            .strip_prefix(root())
            .unwrap()
            .to_string_lossy()
            .into_owned();
        assert!(
            house.named.contains_key(&folder),
            "{folder} is no member of the workspace"
        );
        assert!(
            text.contains("[lints]\nworkspace = true"),
            "{folder} does not take the workspace's lints"
        );
    }
}

/// A program of tests is linked with all that its crate stands on: none is made of a library or program that has no tests,
/// and where `test = false` says so, there are none.
#[test]
fn programs_of_tests_are_built_where_there_are_tests() {
    let is_test = |line: &str| {
        let marks = ["#[test]", "#[tokio::test", "proptest! {"];
        marks.iter().any(|mark| line.trim_start().starts_with(mark))
    };
    for package in metadata().packages {
        let has_library = package.targets.iter().any(|target| target.is_lib());
        for target in &package.targets {
            let of_another_kind = [
                target.is_test(),
                target.is_bench(),
                target.is_example(),
                target.is_custom_build(),
            ];
            if of_another_kind.contains(&true) {
                continue;
            }
            let path = target.src_path.as_std_path();
            let sources = match target.is_bin() && has_library {
                true => vec![path.to_owned()],
                false => files(path.parent().unwrap(), ".rs"),
            };
            let has_tests = sources.iter().any(|source| {
                let text = std::fs::read_to_string(source).unwrap();
                text.lines().any(is_test)
            });
            assert_eq!(
                target.test, has_tests,
                "{} of {}: whether it is tested, and has tests",
                target.name, package.name
            );
        }
    }
}

/// A crate's own code by file: without tests, and without modules that exist for tests only.
fn code(folder: &str) -> Vec<(PathBuf, String)> {
    let sources = files(&root().join(folder).join("src"), ".rs");
    let texts: Vec<_> = sources
        .into_iter()
        .map(|path| (std::fs::read_to_string(&path).unwrap(), path))
        .collect();
    let mut test_modules = BTreeSet::new();
    for (text, path) in &texts {
        for after in text.split("#[cfg(test)]\n").skip(1) {
            if let Some((name, _)) = after
                .trim_start()
                .trim_start_matches("pub(crate) ")
                .strip_prefix("mod ")
                .and_then(|rest| rest.split_once(';'))
            {
                let stem = path.file_stem().unwrap().to_string_lossy().into_owned();
                let beside = path.parent().unwrap();
                let inside = if ["lib", "mod", "main"].contains(&stem.as_str()) {
                    beside.to_owned()
                } else {
                    beside.join(stem)
                };
                test_modules.insert(inside.join(name));
            }
        }
    }
    let is_test = |path: &Path| {
        path.with_extension("")
            .ancestors()
            .any(|part| test_modules.contains(part))
    };
    texts
        .into_iter()
        .filter(|(_, path)| !is_test(path))
        .map(|(text, path)| {
            let own = text
                .split("#[cfg(test)]\nmod tests {")
                .next()
                .unwrap_or_default()
                .to_owned();
            let code: Vec<_> = own
                .lines()
                .filter(|line| !line.trim_start().starts_with("//"))
                .collect();
            (path, code.join("\n"))
        })
        .collect()
}

/// Lines of the longest file that a reader should meet.
const LONGEST: usize = 450;

#[test]
fn no_product_file_is_long() {
    let is_test = |path: &Path| {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        name.ends_with("tests.rs") || path.components().any(|part| part.as_os_str() == "tests")
    };
    for folder in House::read().named.keys() {
        for path in files(&root().join(folder).join("src"), ".rs") {
            let path = path.strip_prefix(root()).unwrap();
            let lines = std::fs::read_to_string(root().join(path)).unwrap();
            let lines = lines.lines().count();
            assert!(
                is_test(path) || lines < LONGEST,
                "{} has {lines} lines: it has more than one subject",
                path.display()
            );
        }
    }
}

/// The files of our crates in which a text occurs, and how often.
fn occurrences(text: &str) -> Vec<(PathBuf, usize)> {
    let mut found = Vec::new();
    for folder in House::read()
        .named
        .keys()
        .filter(|name| !name.starts_with("tests"))
    {
        for (path, code) in code(folder) {
            let count = code.matches(text).count();
            if count > 0 {
                found.push((path.strip_prefix(root()).unwrap().to_owned(), count));
            }
        }
    }
    found
}

#[test]
fn one_plan_node_runs_every_operator() {
    let once = |path: &str| vec![(PathBuf::from(path), 1)];
    assert_eq!(
        occurrences("ExecutionPlan for "),
        once("plans/engine/src/nodes/node.rs"),
        "DataFusion's trait is implemented once, for all nodes"
    );
    assert_eq!(
        occurrences("Duty for "),
        [
            vec![(PathBuf::from("plans/engine/src/nodes/light/filtered.rs"), 2)],
            once("plans/engine/src/nodes/light/joined.rs"),
            once("plans/engine/src/nodes/light.rs"),
            once("plans/engine/src/nodes/operator.rs"),
            once("plans/engine/src/nodes/pixels.rs"),
            once("plans/engine/src/nodes/python.rs"),
            once("plans/engine/src/nodes/spared.rs"),
            once("plans/engine/src/sql/as_of/exec.rs"),
        ]
        .concat(),
        "a node for filters and one for what is dealt out, one around joins, one for sorts, one for operators, one for images, one for functions in Python, one for plans \
         that make much of few rows, one for as-of joins"
    );
    let engine = |(path, _): &(PathBuf, usize)| path.starts_with("plans/engine");
    let mut jobs = occurrences("Job::new");
    jobs.retain(engine);
    assert_eq!(
        jobs,
        once("plans/engine/src/nodes/operator.rs"),
        "operators run in one plan node, OperatorExec"
    );
}

/// The module of a file in `src`: `map::store`, or nothing for `lib.rs`.
fn module(path: &Path, sources: &Path) -> String {
    let path = path.strip_prefix(sources).unwrap().with_extension("");
    let parts: Vec<_> = path.iter().map(|part| part.to_str().unwrap()).collect();
    let module = parts.join("::");
    if module == "lib" {
        return String::new();
    }
    module.strip_suffix("::mod").unwrap_or(&module).to_owned()
}

/// Each module with those that its code names.
fn uses(folder: &str) -> BTreeMap<String, BTreeSet<String>> {
    let sources = root().join(folder).join("src");
    let texts: BTreeMap<_, _> = code(folder)
        .into_iter()
        .map(|(path, text)| (module(&path, &sources), text))
        .collect();
    let named = |text: &str| {
        let paths = text.split("crate::").skip(1).map(|rest| {
            let end = rest.find(|c: char| c != ':' && c != '_' && !c.is_alphanumeric());
            let parts: Vec<_> = rest[..end.unwrap_or(rest.len())].split("::").collect();
            let longest = (1..=parts.len())
                .rev()
                .map(|count| parts[..count].join("::"));
            longest.into_iter().find(|name| texts.contains_key(name))
        });
        paths.flatten().collect::<BTreeSet<_>>()
    };
    texts
        .iter()
        .map(|(name, text)| (name.clone(), named(text)))
        .collect()
}

#[test]
fn files_of_the_engine_use_each_other_in_no_circle() {
    let uses = uses("plans/engine");
    assert!(uses["unit::build"].contains("nodes::operator"));
    for start in uses.keys() {
        let (mut found, mut open) = (BTreeSet::new(), vec![start]);
        while let Some(next) = open.pop() {
            open.extend(uses[next].iter().filter(|name| found.insert(*name)));
        }
        found.retain(|name| uses[*name].contains(start) && *name != start);
        assert!(found.is_empty(), "{start} uses {found:?}, which uses it");
    }
}

#[test]
fn the_engine_names_no_operator() {
    let registry = evermap_catalog::registry();
    assert!(registry.entries().next().is_some());
    for (path, text) in code("plans/engine") {
        for entry in registry.entries() {
            assert!(
                !text.contains(&format!("\"{}\"", entry.name)),
                "{} names the operator {}",
                path.display(),
                entry.name
            );
        }
    }
}

#[test]
fn no_operator_names_another() {
    let registry = evermap_catalog::registry();
    let families: Vec<String> = std::fs::read_dir(root().join("operators/catalog/src"))
        .unwrap()
        .map(|entry| entry.unwrap())
        .filter(|entry| entry.path().is_dir() && entry.file_name() != "inputs")
        .map(|entry| entry.file_name().to_string_lossy().into_owned())
        .collect();
    assert!(families.iter().any(|family| family == "labels"));
    for entry in registry.entries() {
        for (path, text) in code("operators/catalog")
            .iter()
            .filter(|(path, _)| !path.ends_with("lib.rs"))
        {
            let own = path
                .with_extension("")
                .ancestors()
                .any(|part| part.ends_with(entry.name));
            let of_family = |family: &String| format!("crate::{family}::{}::", entry.name);
            let mut named = vec![format!("super::{}::", entry.name)];
            named.extend(families.iter().map(of_family));
            assert!(
                own || !named.iter().any(|name| text.contains(name)),
                "{} uses the operator {}",
                path.display(),
                entry.name
            );
        }
    }
}

#[test]
fn kernels_have_no_files_no_clock_and_no_threads_of_their_own() {
    const OUTSIDE: &[&str] = &[
        "std::fs",
        "std::net",
        "std::env::",
        "Instant::now",
        "SystemTime",
        "thread::spawn",
        "thread::sleep",
    ];
    for folder in [
        "operators/algorithms",
        "operators/contract",
        "operators/catalog",
    ] {
        for (path, text) in code(folder) {
            for name in OUTSIDE {
                assert!(
                    !text.contains(name),
                    "{} uses {name}: its result must depend on nothing but its input",
                    path.display()
                );
            }
        }
    }
}

/// Whether a text declares something of this kind and of just this name.
fn declares(text: &str, kind: &str, name: &str) -> bool {
    let declaration = format!("{kind} {name}");
    let mut after = text.split(declaration.as_str()).skip(1);
    after.any(|rest| !rest.starts_with(|c: char| c == '_' || c.is_alphanumeric()))
}

/// Where proptest looks for the cases that failed once: beside the folder of `main.rs` or `lib.rs`.
#[test]
fn every_case_that_failed_once_is_tried_again() {
    let mut found = 0;
    for path in files(&root(), "txt") {
        let text = path.to_str().unwrap();
        let Some((beside, source)) = text.split_once("/proptest-regressions/") else {
            continue;
        };
        let source = source.replace(".txt", ".rs");
        let folders = std::fs::read_dir(beside).unwrap();
        let folders = folders.map(|folder| folder.unwrap().path());
        let mut folders = folders.filter(|folder| {
            let has = |name: &str| folder.join(name).is_file();
            has("lib.rs") || has("main.rs")
        });
        assert!(
            folders.any(|folder| folder.join(&source).is_file()),
            "there is no {source} beside {text}"
        );
        found += 1;
    }
    assert!(found > 3, "{found}");
    for path in files(&root(), "proptest-regressions") {
        assert!(path.with_extension("rs").is_file(), "{}", path.display());
        let folder = path.parent().unwrap();
        let is_root = ["lib.rs", "main.rs"]
            .iter()
            .any(|name| folder.join(name).is_file());
        assert!(!is_root, "{} is looked for elsewhere", path.display());
    }
}

#[test]
fn the_walks_lead_through_what_there_is() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let page = std::fs::read_to_string(root.join("docs/ARCHITECTURE.md")).unwrap();
    let walks = page.split("## Two walks").nth(1).unwrap();
    let walks = walks.split("\n## ").next().unwrap();
    let mut lengths = vec![0];
    for line in walks.lines() {
        let mut quoted = line.split('`');
        let number = quoted.next().unwrap().trim().trim_end_matches('.');
        let (Ok(number), Some(file), Some(name)) =
            (number.parse::<usize>(), quoted.next(), quoted.nth(1))
        else {
            continue;
        };
        let text = std::fs::read_to_string(root.join(file)).unwrap();
        let place = |kind: &str| declares(&text, kind, name);
        assert!(place("fn") || place("struct"), "{file} has no {name}");
        if number == 1 {
            lengths.push(0);
        }
        *lengths.last_mut().unwrap() = number;
    }
    assert!(lengths[1] <= 12 && lengths[2] <= 30, "{lengths:?}");
}

#[test]
fn the_types_of_the_glossary_are_declared_where_it_says() {
    let house = House::read();
    let folders = house.named.keys().filter(|name| !name.starts_with("tests"));
    let texts = folders.flat_map(|folder| code(folder));
    // `plans/engine/src/map/lease.rs` as `/plans/engine/map/lease/`.
    let place = |path: &Path| {
        let path = path.strip_prefix(root()).unwrap().with_extension("");
        format!("/{}/", path.to_str().unwrap().replace("/src/", "/"))
    };
    let texts: Vec<(String, String)> = texts.map(|(path, text)| (place(&path), text)).collect();
    let is_declared = |folder: &str, name: &str| {
        let kinds = ["pub struct", "pub enum", "pub type", "pub trait"];
        texts.iter().any(|(place, text)| {
            place.contains(folder) && kinds.iter().any(|kind| declares(text, kind, name))
        })
    };
    let page = std::fs::read_to_string(root().join("docs/ARCHITECTURE.md")).unwrap();
    let table = page.split("| word | what it means | type |\n|---|---|---|\n");
    let rows = table.skip(1).flat_map(str::lines);
    let mut named = 0;
    for row in rows.take_while(|row| row.starts_with('|')) {
        let types = row.trim_end_matches([' ', '|']).rsplit(" | ").next();
        for path in types.unwrap().split('`').skip(1).step_by(2) {
            let Some((folder, name)) = path.rsplit_once("::") else {
                continue;
            };
            // Others are modules and fields.
            if name.starts_with(char::is_uppercase) {
                let folder = format!("/{}/", folder.replace("::", "/"));
                assert!(is_declared(&folder, name), "there is no {path}: {row}");
                named += 1;
            }
        }
    }
    assert!(named > 30, "{named}");
}

/// Whether a text has a test of this name: a function that is called alike is none.
fn has_test(text: &str, name: &str) -> bool {
    let lines: Vec<&str> = text.lines().map(str::trim).collect();
    let begins = format!("fn {name}(");
    let found = lines
        .iter()
        .position(|line| line.trim_start_matches("async ").starts_with(&begins));
    let before = lines[..found.unwrap_or_default()].iter().rev();
    let mut attributes = before.take_while(|line| line.starts_with("#["));
    attributes.any(|line| line.starts_with("#[test]") || line.starts_with("#[tokio::test"))
}

/// In CI a test that cannot run fails, and in every run random tests draw the same cases, of seeds that can be set.
#[test]
fn nothing_is_skipped_in_ci_and_seeds_are_set() {
    let read = |name: &str| std::fs::read_to_string(root().join(name)).unwrap();
    let has = |text: &str, line: &str| text.lines().any(|found| found.starts_with(line));
    assert!(has(&read(".ci/run"), "export EVERMAP_SKIP=never"));
    let settings = read(".cargo/config.toml");
    for seed in ["PROPTEST_RNG_SEED", "EVERMAP_TEST_SEED"] {
        assert!(has(&settings, &format!("{seed} = ")), "{seed} is not set");
    }
    // One look-up knows of both; another one would skip in silence.
    let name = format!("\"EVERMAP_{}\"", "SHARED");
    let looks = files(&root(), ".rs")
        .into_iter()
        .filter(|path| std::fs::read_to_string(path).unwrap().contains(&name));
    let looks: Vec<PathBuf> = looks.collect();
    assert_eq!(looks, [root().join("tests/data/src/lib.rs")]);
}

#[test]
fn every_promise_names_a_test_that_there_is() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let page = std::fs::read_to_string(root.join("docs/promises.md")).unwrap();
    let tables = page.split("| promise | held by |\n|---|---|\n").skip(1);
    let rows = tables.flat_map(|table| table.lines().take_while(|line| line.starts_with('|')));
    let mut held = 0;
    for row in rows {
        let by = row
            .trim_end_matches(['|', ' '])
            .rsplit(" | ")
            .next()
            .unwrap();
        let (mut text, mut tests) = (String::new(), 0);
        for name in by.split('`').skip(1).step_by(2) {
            if name.ends_with(".rs") {
                text = std::fs::read_to_string(root.join(name)).unwrap();
            } else {
                assert!(has_test(&text, name), "there is no test {name}: {by}");
                tests += 1;
            }
        }
        assert!(tests > 0, "nothing holds: {row}");
        held += 1;
    }
    assert!(held > 10);
}
