//! `evermap diff`, `evermap gc` and `evermap verify`.

use std::collections::BTreeSet;
use std::io::Write;

use evermap_engine::map::store::Store;
use evermap_engine::map::{self, Comparison, Map, Remedy};
use evermap_engine::sql::{Limits, context};
use evermap_schemas::Fault;

use crate::arguments::{DiffArgs, GcArgs, VerifyArgs};
use crate::ending::{DONE, Ending};
use crate::operators;
use crate::output::{Format, print_rows};
use crate::progress::line;
use crate::quantity::{of, of_bytes};

/// Compares two versions, layer by layer.
///
/// # Errors
/// A user fault where there is no such map, version or layer.
pub async fn diff(args: &DiffArgs) -> Ending {
    let map = Map::open(&args.map, Some(args.after)).await?;
    let context = context(Limits::default())?;
    let versions = [args.before, args.after];
    let compared = Comparison::open(&map, versions, &operators::registry(), &context).await?;
    let layers = match &args.layer {
        Some(layer) => BTreeSet::from([layer.clone()]),
        None => compared.layers(),
    };
    let mut diffs = Vec::new();
    for layer in &layers {
        let summary = compared.summary(layer).await;
        diffs.push(summary.map_err(|fault| fault.at(format!("layer {layer}")))?);
    }
    print_rows(args.format, diffs).await?;
    DONE
}

/// Forgets old versions.
///
/// # Errors
/// A user fault where there is no such map, a resource fault when files cannot be removed.
pub async fn gc(args: &GcArgs) -> Ending {
    let store = Store::open(&args.map, false)?;
    let found = map::gc(&store, args.keep, args.dry_run).await?;
    let verb = if args.dry_run {
        "would remove"
    } else {
        "removed"
    };
    let (versions, files) = (of(found.versions, "version"), of(found.files, "file"));
    writeln!(
        std::io::stdout(),
        "{verb} {versions}, {files}, {}",
        of_bytes(found.bytes)
    )?;
    DONE
}

/// Reads all of a map, or of a version, and says what is not as it should be.
///
/// # Errors
/// A data fault when something is missing, damaged or does not read; a user fault where there is no such map or version.
pub async fn verify(args: &VerifyArgs) -> Ending {
    let store = Store::open(&args.map.map, false)?;
    let verified = map::verify(&store, args.map.version).await?;
    let lost = verified.findings.iter().filter(|finding| finding.is_loss());
    let lost = lost.count() as u64;
    let remedies: Vec<String> = verified.remedies().into_iter().map(in_words).collect();
    line(&format!(
        "read {}, {}, {}",
        of(verified.versions, "version"),
        of(verified.receipts, "receipt"),
        of(verified.artifacts, "artifact")
    ));
    if args.format != Format::Table || !verified.findings.is_empty() {
        print_rows(args.format, verified.findings).await?;
    }
    if lost == 0 {
        return DONE;
    }
    let found = of(lost, "file");
    Err(
        Fault::data(format!("{found} missing, damaged or unreadable"))
            .next(remedies.join("; "))
            .into(),
    )
}

fn in_words(remedy: Remedy) -> String {
    let words = match remedy {
        Remedy::Decide(step) => return step,
        Remedy::Run => {
            "run the same plan again: it makes anew what is damaged in the newest version"
        }
        Remedy::Collect => {
            "`evermap gc` removes versions that are torn, and with older ones what only they need"
        }
        Remedy::Remove => "remove damaged records of runs: nothing else needs them",
    };
    words.to_owned()
}
