//! Sessions that are given to a run: what is known of them before their logs are read.

use std::collections::{BTreeMap, BTreeSet};

use chrono::DateTime;
use evermap_datasets::manifest::{Bits, SessionFiles};
use evermap_datasets::{Manifest, Session};
use evermap_schemas::Fault;

use super::Replaced;
use crate::digest::digest_of;
use crate::map::receipt::LogContent;
use crate::map::version::{MappedSession, Version};

/// A session that a run is given.
pub struct GivenSession {
    name: String,
    site: String,
    manifest: Manifest,
    times: Option<(i64, i64)>,
}

/// Sessions that a run is given, which `manifest` may say the sites of, beside those that the map has.
pub fn joining(
    sessions: &[Session],
    manifest: Option<&Manifest>,
    mapped: &BTreeMap<String, MappedSession>,
) -> Vec<GivenSession> {
    let named = manifest.into_iter().flat_map(|manifest| &manifest.sessions);
    let named = named.filter(|named| named.site.is_some());
    let sited: BTreeSet<&str> = named.map(|named| named.name.as_str()).collect();
    let all = manifest.is_some_and(|manifest| manifest.site.is_some());
    let given = |session: &Session| {
        let site = site_of(session, all || sited.contains(&*session.name), mapped);
        GivenSession {
            name: session.name.to_string(),
            manifest: manifest_of(session, &site),
            site,
            times: session.time_range(),
        }
    };
    sessions.iter().map(given).collect()
}

impl GivenSession {
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
        let before = mapped.get(&self.name);
        // What was noted of a log stays, so that a version is not another one for it.
        let known = before.filter(|before| before.log.content == log.content);
        let now = MappedSession {
            times: known.and_then(|known| known.times).or(self.times),
            manifest: self.manifest,
            log,
        };
        let replaced = before.and_then(|before| replaces(&now, before));
        mapped.insert(self.name, now);
        Ok(replaced)
    }
}

/// The sessions of the coming version, each with its manifest and its site: those that the map has, and in the place of some
/// those that join it.
pub fn coming<'a>(
    joining: &'a [GivenSession],
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

/// That logs of a version hold another recording by now than it was made from, in sentences: a log that has no time in common
/// with what it was is not that one grown, or written anew.
pub fn overwritten(base: Option<&Version>, sessions: &[MappedSession]) -> Vec<String> {
    let before = base.into_iter().flat_map(|base| &base.sessions);
    let told = before.filter_map(|before| {
        let now = MappedSession::named(sessions, &before.log.session)?;
        let (then, since) = (before.times?, now.times?);
        let apart = then.1 < since.0 || since.1 < then.0;
        (apart && share_files(before, now)).then(|| {
            format!(
                "session {} has another recording now, of {}: that of {} was overwritten in {}, and is no longer part of the map; give each recording a file of its own to keep both",
                now.log.session,
                in_words(since),
                in_words(then),
                files(now).join(", ")
            )
        })
    });
    told.collect()
}

/// From when to when, in UTC.
fn in_words((start, end): (i64, i64)) -> String {
    let [start, end] = [start, end].map(|ns| DateTime::from_timestamp_nanos(ns).to_rfc3339());
    format!("{start} to {end}")
}

/// That a log takes the place of another one.
fn replaces(now: &MappedSession, before: &MappedSession) -> Option<Replaced> {
    let same = now.log.content == before.log.content || share_files(before, now);
    (!same).then(|| Replaced {
        session: now.log.session.clone(),
        before: files(before).join(", "),
        now: files(now).join(", "),
    })
}

/// Where a session's log is.
fn files(session: &MappedSession) -> Vec<String> {
    let sessions = session.manifest.sessions.iter();
    sessions.flat_map(|session| session.files.clone()).collect()
}

fn share_files(one: &MappedSession, other: &MappedSession) -> bool {
    let others = files(other);
    files(one).iter().any(|file| others.contains(file))
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
