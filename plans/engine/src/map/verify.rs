//! Whether a map is what was written: every version, receipt and artifact read and held against the others.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use evermap_schemas::{Fault, Kind, record};
use futures::TryStreamExt;

use crate::error::no_map;
use crate::map::damage::{Damage, content_damage};
use crate::map::opened::{address, begun};
use crate::map::parts::PARTS;
use crate::map::receipt::{Artifact, RECEIPTS, Receipt};
use crate::map::records::{RecordDamage, record_damage};
use crate::map::rows::RUNS;
use crate::map::sealed;
use crate::map::store::{ARTIFACTS, Store, each};
use crate::map::unread::Unread;
use crate::map::version::Version;

record! {
    /// A file of a map that is not as it should be.
    #[layer("findings", key(file))]
    pub struct Finding {
        /// `missing`, `damaged` (it has another size or content), `unreadable` (it is torn, does not fit its seal, or is
        /// not what evermap writes), or `unreferenced`: no version needs it, and `evermap gc` removes it.
        state: String,
        /// The file, within the map.
        file: String,
        /// What was expected; null where nothing was.
        expected: Option<String>,
        /// What was found; null where there is no such file.
        found: Option<String>,
        /// A version and layer that needs it; null where none does.
        needed_by: Option<String>,
    }
}

impl Finding {
    /// Whether something is lost: unreferenced files are merely left over.
    pub fn is_loss(&self) -> bool {
        self.state != "unreferenced"
    }
}

/// What [`verify`] has read, and what it found.
#[derive(Debug, Clone, Default)]
pub struct Verified {
    /// Versions that were read.
    pub versions: u64,
    /// Receipts that were read.
    pub receipts: u64,
    /// Artifacts that were read.
    pub artifacts: u64,
    /// What is not as it should be, by file.
    pub findings: Vec<Finding>,
    /// The files that a run of the same plan makes anew: rows and receipts of the newest version that reads.
    remade: BTreeSet<String>,
    /// Versions that do not read and that `gc` does not remove, by file: what a person does first.
    kept: BTreeMap<String, String>,
}

/// What can be done about a loss.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub enum Remedy {
    /// To run the same plan again: it makes anew what the newest version needs.
    Run,
    /// To let `gc` remove it, and with it the older version that it is of.
    Collect,
    /// To do what this says, as `gc` would say: a version does not read, and may need what nothing else tells.
    Decide(String),
    /// To remove it by hand, as a record of a run: nothing needs it.
    Remove,
}

impl Verified {
    /// What can be done about all that is lost.
    pub fn remedies(&self) -> BTreeSet<Remedy> {
        let lost = self.findings.iter().filter(|finding| finding.is_loss());
        lost.map(|finding| self.remedy(&finding.file)).collect()
    }

    fn remedy(&self, file: &str) -> Remedy {
        let (folder, _) = file.split_once('/').unwrap_or_default();
        if self.remade.contains(file) {
            Remedy::Run
        } else if let Some(step) = self.kept.get(file) {
            Remedy::Decide(step.clone())
        } else if folder == RUNS {
            Remedy::Remove
        } else {
            Remedy::Collect
        }
    }
}

/// What versions need.
#[derive(Default)]
struct Needed {
    artifacts: BTreeMap<String, (Artifact, String)>,
    /// Receipts by digest: the artifacts that they must lead to, one where the versions that need them agree.
    receipts: BTreeMap<String, Vec<(Artifact, String)>>,
    /// Names of parts of versions' lists, which were read with them.
    parts: BTreeSet<String>,
}

impl Needed {
    fn add(&mut self, version: &Version) {
        let number = version.version;
        for (name, layer) in &version.layers {
            let by = format!("version {number}: {name}");
            for artifact in &layer.artifacts {
                self.artifact(artifact, &by);
            }
            for (digest, artifact) in layer.recipes.iter().zip(&layer.artifacts) {
                let wanted = self.receipts.entry(digest.clone()).or_default();
                if wanted.iter().all(|(wanted, _)| wanted != artifact) {
                    wanted.push((artifact.clone(), by.clone()));
                }
            }
        }
        for (name, artifacts) in &version.previous.layers {
            for artifact in artifacts {
                self.artifact(artifact, &format!("version {number}: previous.{name}"));
            }
        }
    }

    fn artifact(&mut self, artifact: &Artifact, by: &str) {
        let name = artifact.name();
        let needed = || (artifact.clone(), by.to_owned());
        self.artifacts.entry(name).or_insert_with(needed);
    }
}

/// Reads all of a map, or of one version of it, and says what is missing, damaged, unreadable or unreferenced. Where `gc`
/// forgets a version meanwhile, it begins anew: what only that needed is not lost.
///
/// # Errors
/// A user fault for a version that there is not, or where there is no map, a resource fault when the store does not answer.
pub async fn verify(store: &Store, version: Option<u64>) -> Result<Verified, Fault> {
    loop {
        let numbers = match version {
            Some(number) => vec![number],
            None => Version::numbers(store).await?,
        };
        if numbers.is_empty() && !begun(store).await? {
            return Err(no_map(&address(store)));
        }
        let verified = verify_versions(store, &numbers, version.is_none()).await?;
        let there = Version::numbers(store).await?;
        if numbers.iter().all(|number| there.contains(number)) {
            return Ok(verified);
        }
    }
}

async fn verify_versions(store: &Store, numbers: &[u64], all: bool) -> Result<Verified, Fault> {
    let mut verified = Verified::default();
    let mut needed = Needed::default();
    let mut newest = None;
    let mut read = Version::all(store, numbers);
    while let Some((number, found)) = read.try_next().await? {
        match found {
            Ok(Some((version, parts))) => {
                needed.add(&version);
                needed.parts.extend(parts);
                newest = Some(version);
            }
            // Of all, it was forgotten since.
            Ok(None) if all => continue,
            Ok(None) => newest = Some(Version::read(store, number).await?),
            Err(fault) => {
                let file = Version::name(number);
                verified.findings.push(unreadable(&file, &fault, None));
                if let Unread::Kept(fault) = Unread::of(store, number, fault).await? {
                    verified.kept.insert(file, fault.next);
                }
            }
        }
        verified.versions += 1;
    }
    if !all {
        newest = Version::latest(store).await?;
    }
    verified.remade = newest.iter().flat_map(made_of).collect();
    verified.artifacts(store, &needed, all).await?;
    verified.receipts(store, &needed, all).await?;
    if all {
        verified.others(store, &needed).await?;
    }
    verified.findings.sort_by(|a, b| a.file.cmp(&b.file));
    Ok(verified)
}

/// The files of a version that its units have left.
fn made_of(version: &Version) -> BTreeSet<String> {
    let layers = version.layers.values();
    let files = layers.flat_map(|layer| {
        let receipts = layer.recipes.iter().map(|digest| Receipt::name(digest));
        receipts.chain(layer.artifacts.iter().map(Artifact::name))
    });
    files.collect()
}

impl Verified {
    /// Reads the artifacts that are needed, and, for `all`, the others: every name is the digest of its file.
    async fn artifacts(&mut self, store: &Store, needed: &Needed, all: bool) -> Result<(), Fault> {
        let listed = store.list(ARTIFACTS).await?;
        let there: BTreeSet<&String> = listed.iter().map(|(name, _)| name).collect();
        let wanted = listed.iter().map(|(name, _)| name);
        let wanted = wanted.filter(|name| all || needed.artifacts.contains_key(*name));
        let wanted: Vec<&String> = wanted.collect();
        let content = |name: &str| -> String {
            let file = name.rsplit('/').next().unwrap_or(name);
            file.strip_suffix(".parquet").unwrap_or(file).to_owned()
        };
        let damages = wanted
            .iter()
            .map(|name| content_damage(store, name, content(name)));
        let damages = each(damages).await?;
        self.artifacts = damages.len() as u64;
        for (name, damage) in wanted.into_iter().zip(damages) {
            let by = needed.artifacts.get(name).map(|(_, by)| by.clone());
            match damage {
                // Removed while this looked, where nobody needs it.
                Some(damage) if by.is_none() && damage.found.is_none() => {}
                Some(damage) => self.findings.push(damaged(damage, by)),
                None if by.is_none() => self.findings.push(unreferenced(name)),
                None => {}
            }
        }
        let gone = needed.artifacts.iter();
        for (name, (artifact, by)) in gone.filter(|(name, _)| !there.contains(name)) {
            // A folder is in no list of files.
            let found = store.no_file(name).await?.map(str::to_owned);
            let state = found.as_ref().map_or("missing", |_| "damaged");
            self.findings.push(Finding {
                state: state.into(),
                found,
                ..missing(name, Some(format!("{} bytes", artifact.bytes)), by.clone())
            });
        }
        Ok(())
    }

    async fn receipts(&mut self, store: &Store, needed: &Needed, all: bool) -> Result<(), Fault> {
        let mut digests: BTreeSet<String> = needed.receipts.keys().cloned().collect();
        let listed = store.list(RECEIPTS).await?;
        for (name, _) in listed.iter().filter(|_| all) {
            match Receipt::digest_of(name) {
                Some(digest) => drop(digests.insert(digest.to_owned())),
                None => self.findings.push(unreferenced(name)),
            }
        }
        let found = each(
            digests
                .into_iter()
                .map(|digest| read_receipt(store, digest)),
        )
        .await?;
        self.receipts = found.len() as u64;
        for (digest, found) in found {
            let needed = needed.receipts.get(&digest);
            let finding = self.receipt(&digest, found, needed.map_or(&[], Vec::as_slice))?;
            self.findings.extend(finding);
        }
        Ok(())
    }

    /// What is wrong with the receipt of this name, whose layers need it to lead to an artifact.
    fn receipt(
        &self,
        digest: &str,
        found: ReadReceipt,
        needed: &[(Artifact, String)],
    ) -> Result<Option<Finding>, Fault> {
        let name = Receipt::name(digest);
        let by = needed.first().map(|(_, by)| by.clone());
        let receipt = match found {
            Ok(Some(receipt)) => receipt,
            Ok(None) => {
                // Removed while this looked, where nobody needs it.
                return Ok(by.map(|by| missing(&name, None, by)));
            }
            Err(fault) => return Ok(Some(unreadable(&name, &fault, by))),
        };
        let of = receipt.recipe.digest()?;
        let differs = |expected: &str, found: &str| Damage {
            file: name.clone(),
            expected: expected.to_owned(),
            found: Some(found.to_owned()),
        };
        let artifact = &receipt.artifact;
        let other = needed.iter().find(|(wanted, _)| wanted != artifact);
        let (damage, by) = match other {
            _ if of != digest || receipt.digest != digest => {
                let [expected, found] = [digest, &of].map(|of| format!("the recipe {of}"));
                (differs(&expected, &found), by)
            }
            _ if artifact.extent != receipt.recipe.extent => {
                let extents = [&receipt.recipe.extent, &artifact.extent];
                let [expected, found] = extents.map(|of| of.label("rows"));
                (differs(&expected, &found), by)
            }
            Some((wanted, by)) => {
                let damage = differs(&in_words(wanted), &in_words(artifact));
                (damage, Some(by.clone()))
            }
            None => return Ok(by.is_none().then(|| unreferenced(&name))),
        };
        Ok(Some(damaged(damage, by)))
    }

    /// What is neither a version nor a receipt nor an artifact.
    async fn others(&mut self, store: &Store, needed: &Needed) -> Result<(), Fault> {
        for (name, _) in store.list(PARTS).await? {
            if !needed.parts.contains(&name) {
                self.findings.push(unreferenced(&name));
            }
        }
        for (name, _) in store.temporary(Duration::ZERO).await? {
            self.findings.push(unreferenced(&name));
        }
        let records = store.list(RUNS).await?;
        let damages = each(records.iter().map(|(name, _)| record_damage(store, name))).await?;
        for ((name, _), damage) in records.iter().zip(damages) {
            self.findings.extend(damage.map(|damage| match damage {
                RecordDamage::Changed(damage) => damaged(damage, None),
                unread => unreadable(name, &Fault::data(unread.to_string()), None),
            }));
        }
        Ok(())
    }
}

/// A receipt, or none, or why it does not read.
type ReadReceipt = Result<Option<Receipt>, Fault>;

async fn read_receipt(store: &Store, digest: String) -> Result<(String, ReadReceipt), Fault> {
    match sealed::read(store, &Receipt::name(&digest)).await {
        Err(fault) if fault.kind != Kind::Data => Err(fault),
        found => Ok((digest, found)),
    }
}

/// What a version and a receipt say of an artifact.
fn in_words(artifact: &Artifact) -> String {
    let Artifact {
        content,
        rows,
        bytes,
        ..
    } = artifact;
    format!("{rows} rows in {bytes} bytes, {content}")
}

fn missing(file: &str, expected: Option<String>, by: String) -> Finding {
    Finding {
        state: "missing".into(),
        file: file.to_owned(),
        expected,
        found: None,
        needed_by: Some(by),
    }
}

fn damaged(damage: Damage, needed_by: Option<String>) -> Finding {
    Finding {
        state: "damaged".into(),
        file: damage.file,
        expected: Some(damage.expected),
        found: damage.found,
        needed_by,
    }
}

fn unreadable(file: &str, fault: &Fault, needed_by: Option<String>) -> Finding {
    Finding {
        state: "unreadable".into(),
        file: file.to_owned(),
        expected: None,
        found: Some(fault.message.clone()),
        needed_by,
    }
}

fn unreferenced(file: &str) -> Finding {
    Finding {
        state: "unreferenced".into(),
        file: file.to_owned(),
        expected: None,
        found: None,
        needed_by: None,
    }
}
