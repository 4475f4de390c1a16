//! What is damaged of the version before, made anew by the recipes that made it.
//!
//! Equal recipes give equal bytes, so that rows can be made again as long as the receipt that tells how, and the logs, are
//! there. What a recipe itself reads may be damaged too, and is mended first.

use std::collections::{BTreeMap, BTreeSet};

use evermap_schemas::Fault;
use futures::StreamExt;

use crate::map::damage::Damage;
use crate::map::lease::Lease;
use crate::map::receipt::{LogContent, OTHER_FORMAT, RECEIPTS, Receipt};
use crate::map::sound::Sound;
use crate::map::store::each;
use crate::run::Run;
use crate::run::runner::{Report, Runner};
use crate::unit::Unit;

/// Receipts by the names of the files that their units made.
pub type Makers = BTreeMap<String, Receipt>;

/// Mends files of a map on behalf of a run.
pub struct Mending<'m, 'a> {
    /// The run that needs them.
    pub run: &'m Run<'a>,
    /// Its lease.
    pub lease: &'m Lease,
    /// Which artifacts are what was written.
    pub sound: &'m Sound<'m>,
    /// Who makes them anew.
    pub runner: &'m dyn Runner,
}

impl Mending<'_, '_> {
    /// Makes these files anew, and before each what it was made from, as far as that is damaged. `makers` are receipts
    /// that the map has no longer.
    ///
    /// # Errors
    /// A data fault for a file of which nothing tells how it was made, whose log is not there, or that comes out
    /// otherwise than it was; what the unit says that makes it.
    pub async fn mend(&self, damaged: Vec<Damage>, makers: Makers) -> Result<(), Fault> {
        if damaged.is_empty() {
            return Ok(());
        }
        let makers = self.makers(makers).await?;
        let mut begun = BTreeSet::new();
        let mut damaged = damaged;
        while let Some(damage) = damaged.last() {
            let Some(maker) = makers.get(&damage.file) else {
                return Err(lost(damage, "no receipt tells how it was made"));
            };
            let deeper = self.sound.damages(maker.recipe.artifacts()).await?;
            if deeper.is_empty() {
                self.remake(damage, maker).await?;
                damaged.pop();
            } else if begun.insert(damage.file.clone()) {
                damaged.extend(deeper);
            } else {
                return Err(lost(damage, "what it was made from was damaged again"));
            }
        }
        Ok(())
    }

    /// These receipts, and those of the map.
    async fn makers(&self, mut makers: Makers) -> Result<Makers, Fault> {
        let store = self.run.store;
        let names = store.list(RECEIPTS).await?;
        let digests = names
            .iter()
            .filter_map(|(name, _)| Receipt::digest_of(name));
        let receipts = each(digests.map(|digest| Receipt::read(store, digest))).await?;
        for receipt in receipts.into_iter().flatten() {
            makers.insert(receipt.artifact.name(), receipt);
        }
        Ok(makers)
    }

    async fn remake(&self, damage: &Damage, maker: &Receipt) -> Result<(), Fault> {
        let unit = Unit {
            store: self.run.store.url().to_string(),
            recipe: maker.recipe.clone(),
            logs: Vec::new(),
            limits: self.run.limits,
            lease: self.lease.name().to_owned(),
        };
        let label = unit.label();
        tracing::warn!("{damage}; {label}, which the version before has, is made anew");
        let logs = unit.recipe.logs.iter();
        let logs = logs.map(|log| self.manifest(log).ok_or_else(|| unlogged(damage, log)));
        let logs = logs.collect::<Result<_, Fault>>()?;
        // Nobody is to take it for done meanwhile.
        let receipt = Receipt::name(&maker.digest);
        self.run.store.remove(&receipt).await?;
        let made = self.runner.start(vec![(0, Unit { logs, ..unit })]);
        let ended = made.filter_map(async |(_, report)| match report {
            Report::Advanced(_) => None,
            Report::Ended(receipt) => Some(receipt),
        });
        let fault = match std::pin::pin!(ended).next().await {
            Some(Ok(made)) if made.artifact.content == maker.artifact.content => return Ok(()),
            Some(Ok(_)) if !maker.recipe.is_of_today() => lost(damage, OTHER_FORMAT),
            Some(Ok(made)) => lost(
                damage,
                &format!("it was made anew and came out as {}", made.artifact.content),
            ),
            Some(Err(fault)) => fault.at(label),
            None => Fault::bug(format!("{label} had no outcome")),
        };
        maker.write(self.run.store).await?;
        Err(fault)
    }

    /// Where a log is, by its content.
    fn manifest(&self, log: &LogContent) -> Option<evermap_datasets::Manifest> {
        let before = self.run.base.iter().flat_map(|base| &base.sessions);
        let mut sessions = self.run.sessions.iter().chain(before);
        let found = sessions.find(|session| session.log == *log);
        found.map(|session| session.manifest.clone())
    }
}

fn unlogged(damage: &Damage, log: &LogContent) -> Fault {
    lost(
        damage,
        &format!(
            "no session {} has the log that it was made from",
            log.session
        ),
    )
}

/// A file that cannot be made anew.
fn lost(damage: &Damage, why: &str) -> Fault {
    Fault::data(format!("{damage}; it cannot be made anew: {why}"))
        .next("restore the file from a backup, or map all sessions into a new map")
}
