//! Embeds the plans of `plans/library`, so that `evermap run car_park` needs no file.

use std::fmt::Write;
use std::path::{Path, PathBuf};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let folder = Path::new(&std::env::var("CARGO_MANIFEST_DIR")?).join("../library");
    println!("cargo::rerun-if-changed={}", folder.display());
    let mut plans: Vec<PathBuf> = match std::fs::read_dir(&folder) {
        Ok(entries) => entries
            .filter_map(|entry| Some(entry.ok()?.path()))
            .collect(),
        Err(_) => Vec::new(),
    };
    plans.retain(|path| {
        path.extension()
            .is_some_and(|extension| extension == "yaml")
    });
    plans.sort();
    let mut list = String::from("&[\n");
    for path in plans {
        let name = path
            .file_stem()
            .unwrap_or_default()
            .to_string_lossy()
            .into_owned();
        writeln!(
            list,
            "({name:?}, include_str!({:?})),",
            path.canonicalize()?.display().to_string()
        )?;
    }
    list.push_str("]\n");
    std::fs::write(Path::new(&std::env::var("OUT_DIR")?).join("plans.rs"), list)?;
    fold_identical_code();
    Ok(())
}

/// Functions that compile to the same instructions, as those of many generic types do, are linked once. Rust links with
/// LLD on this target, which knows the option.
fn fold_identical_code() {
    let is = |name, value| std::env::var(name).is_ok_and(|found| found == value);
    if is("PROFILE", "release") && is("TARGET", "x86_64-unknown-linux-gnu") {
        println!("cargo::rustc-link-arg-bins=-Wl,--icf=all");
    }
}
