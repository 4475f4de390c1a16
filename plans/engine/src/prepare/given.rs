//! Sessions that are given to a run: what is known of them before their logs are read.

use std::collections::{BTreeMap, BTreeSet};

use evermap_datasets::manifest::{Bits, SessionFiles};
use evermap_datasets::{Manifest, Session};
use evermap_schemas::Fault;

use super::Replaced;
use crate::digest::digest_of;
use crate::map::receipt::LogContent;
use crate::map::version::MappedSession;

/// A session that a run is given.
pub struct Given {
    name: String,
    site: String,
    manifest: Manifest,
}

/// Sessions that a run is given, which `manifest` may say the sites of, beside those that the map has.
pub fn joining(
    sessions: &[Session],
    manifest: Option<&Manifest>,
    mapped: &BTreeMap<String, MappedSession>,
) -> Vec<Given> {
    let named = manifest.into_iter().flat_map(|manifest| &manifest.sessions);
    let named = named.filter(|named| named.site.is_some());
    let sited: BTreeSet<&str> = named.map(|named| named.name.as_str()).collect();
    let all = manifest.is_some_and(|manifest| manifest.site.is_some());
    let given = |session: &Session| {
        let site = site_of(session, all || sited.contains(&*session.name), mapped);
        Given {
            name: session.name.to_string(),
            manifest: manifest_of(session, &site),
            site,
        }
    };
    sessions.iter().map(given).collect()
}

impl Given {
    /// Joins the sessions that the map has, in the place of one of its name. Gives that one, where it was of another log.
    ///
    /// # Errors
    /// A bug fault for a manifest that has no digest.
    pub fn join(
        self,
        content: String,
        mapped: &mut BTreeMap<String, MappedSession>,
    ) -> Result<Option<Replaced>, Fault> {
        let log = LogContent {
            session: self.name.clone(),
            site: self.site,
            content,
            roles: digest_of_tables(&self.manifest)?,
        };
        let manifest = self.manifest;
        let now = MappedSession { log, manifest };
        let before = mapped.get(&self.name);
        let replaced = before.and_then(|before| replaces(&now, before));
        mapped.insert(self.name, now);
        Ok(replaced)
    }
}

/// The sessions of the coming version, each with its manifest and its site: those that the map has, and in the place of some
/// those that join it.
pub fn coming<'a>(
    joining: &'a [Given],
    mapped: &'a BTreeMap<String, MappedSession>,
) -> impl Iterator<Item = (&'a str, &'a Manifest, &'a str)> {
    let names: BTreeSet<&str> = joining.iter().map(|given| given.name.as_str()).collect();
    let stay = mapped.iter();
    let stay = stay.filter(move |(name, _)| !names.contains(name.as_str()));
    let stay = stay.map(|(name, session)| {
        let site = session.log.site.as_str();
        (name.as_str(), &session.manifest, site)
    });
    let join = joining.iter();
    stay.chain(join.map(|given| (given.name.as_str(), &given.manifest, given.site.as_str())))
}

/// That a log takes the place of another one.
fn replaces(now: &MappedSession, before: &MappedSession) -> Option<Replaced> {
    let files = |session: &MappedSession| -> Vec<String> {
        let files = session
            .manifest
            .sessions
            .iter()
            .flat_map(|session| &session.files);
        files.cloned().collect()
    };
    let (there, here) = (files(before), files(now));
    let same =
        now.log.content == before.log.content || there.iter().any(|file| here.contains(file));
    (!same).then(|| Replaced {
        session: now.log.session.clone(),
        before: there.join(", "),
        now: here.join(", "),
    })
}

/// The site of a session: what is said now, else what was said when it was mapped, else its own.
fn site_of(session: &Session, sited: bool, mapped: &BTreeMap<String, MappedSession>) -> String {
    match mapped.get(&*session.name) {
        Some(mapped) if !sited => mapped.log.site.clone(),
        _ => session.site.to_string(),
    }
}

/// The digest of all that says which rows a log's tables have.
fn digest_of_tables(manifest: &Manifest) -> Result<String, Fault> {
    match (manifest.vehicle().frame(), manifest.bits.is_empty()) {
        ("", true) => digest_of(&manifest.roles),
        (vehicle, true) => digest_of(&(&manifest.roles, vehicle)),
        (vehicle, false) => digest_of(&(&manifest.roles, vehicle, &manifest.bits)),
    }
}

/// The manifest that opens just this session, with its topics as they were resolved, and its vehicle.
fn manifest_of(session: &Session, site: &str) -> Manifest {
    Manifest {
        site: Some(site.to_owned()),
        sessions: vec![SessionFiles {
            name: session.name.to_string(),
            files: session.parts.iter().map(|part| part.url.clone()).collect(),
            site: Some(site.to_owned()),
        }],
        roles: session.roles.to_manifest(),
        bits: Bits::exactly(&session.bits),
        defaults: session.vehicle.to_manifest(),
    }
}
