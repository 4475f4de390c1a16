//! The sessions of a run and of its map, and which roles each plays.

use std::collections::{BTreeMap, BTreeSet};

use evermap_datasets::{Dataset, Manifest};

use crate::preflight::{Roles, is_shared};

/// A session, as far as it matters here.
pub struct Player {
    /// Its site.
    pub site: String,
    /// The roles that it plays.
    pub plays: Roles,
}

/// Sessions by name.
pub struct Players(pub(super) BTreeMap<String, Player>);

impl Players {
    /// The sessions given, and those of the coming version, among which they may be, each by name with its manifest and site.
    pub fn of<'a>(
        given: &Dataset,
        coming: impl Iterator<Item = (&'a str, &'a Manifest, &'a str)>,
    ) -> Self {
        let coming = coming.map(|(name, manifest, site)| {
            let player = Player {
                site: site.to_owned(),
                plays: manifest.roles.keys().cloned().collect(),
            };
            (name.to_owned(), player)
        });
        let mut players: BTreeMap<_, _> = coming.collect();
        for session in &given.sessions {
            let name = session.name.to_string();
            let player = players.entry(name).or_insert_with(|| Player {
                site: session.site.to_string(),
                plays: Roles::new(),
            });
            // Of logs at hand it is known which topics have no messages.
            player.plays = session.played();
        }
        Self(players)
    }

    /// The session of a name.
    pub fn named(&self, name: &str) -> Option<&Player> {
        self.0.get(name)
    }

    /// Each of them.
    pub fn each(&self) -> impl Iterator<Item = &Player> {
        self.0.values()
    }

    /// Their sites.
    pub fn sites(&self) -> BTreeSet<&str> {
        self.each().map(|player| player.site.as_str()).collect()
    }

    /// The roles that any of them plays.
    pub fn all(&self) -> Roles {
        let plays = self.each().flat_map(|player| &player.plays);
        plays.cloned().collect()
    }

    /// What sessions play for all of their site, by site.
    pub(super) fn shared(&self) -> BTreeMap<&str, Roles> {
        let mut shared = BTreeMap::<&str, Roles>::new();
        for player in self.each() {
            let plays = player.plays.iter().filter(|role| is_shared(role));
            let site = shared.entry(&player.site).or_default();
            site.extend(plays.cloned());
        }
        shared
    }
}
