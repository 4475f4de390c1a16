//! What a client keeps at a server: statements that it prepared, and portals, which are statements with what it bound to them.
//! The library keeps as many as a client likes.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use pgwire::api::portal::PortalExecutionState;
use pgwire::api::store::{MemPortalStore, PortalStore};
use pgwire::api::{DEFAULT_NAME, SessionExtensions};
use pgwire::error::PgWireResult;
use pgwire::messages::PgWireFrontendMessage;

use crate::serve::postgres::{Prepared, error};

/// Statements, and as many portals, that a client keeps at most. Those that keep many have fewer: ActiveRecord 1000, JDBC 256,
/// PgBouncer 200, psycopg 100.
const MOST: usize = 1024;

/// Bytes of their texts and of what was bound, at most: two of the largest messages.
const MOST_BYTES: usize = 16 << 20;

/// Statements or portals.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Kind {
    Statement,
    Portal,
}

/// The bytes of what a connection keeps, or kept, by name.
#[derive(Debug, Default)]
struct KeptBytes(Mutex<BTreeMap<(Kind, String), usize>>);

impl KeptBytes {
    fn of(extensions: &SessionExtensions) -> Arc<Self> {
        extensions.get_or_insert_with(Self::default)
    }

    fn held(&self) -> MutexGuard<'_, BTreeMap<(Kind, String), usize>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Sees to it that there is room for what a message asks to keep. Where there is none, portals that are read to their end go.
///
/// # Errors
/// Where there is none then.
pub fn make_room(
    extensions: &SessionExtensions,
    store: &MemPortalStore<Prepared>,
    message: &PgWireFrontendMessage,
) -> PgWireResult<()> {
    let Some((kind, name, bytes)) = asked(message) else {
        return Ok(());
    };
    let kept = KeptBytes::of(extensions);
    let mut held = kept.held();
    let key = (kind, name.to_owned());
    if !has_room(&held, &key, bytes) {
        held.retain(|(kind, name), _| is_kept(store, *kind, name));
    }
    if !has_room(&held, &key, bytes) {
        let (many, large) = (MOST, MOST_BYTES >> 20);
        let message = format!(
            "expected at most {many} prepared statements, and {many} portals, of {large} MiB together; close some first (DEALLOCATE)"
        );
        return Err(error("ERROR", "54000", &message));
    }
    held.insert(key, bytes);
    Ok(())
}

/// Forgets a statement, or all.
pub fn deallocate(
    extensions: &SessionExtensions,
    store: &MemPortalStore<Prepared>,
    name: Option<&str>,
) {
    let kept = KeptBytes::of(extensions);
    kept.held().retain(|(kind, known), _| {
        let goes = *kind == Kind::Statement && name.is_none_or(|name| name == known);
        if goes {
            store.rm_statement(known);
        }
        !goes
    });
}

/// What a message asks to keep: its name, and how many bytes it has.
fn asked(message: &PgWireFrontendMessage) -> Option<(Kind, &str, usize)> {
    match message {
        PgWireFrontendMessage::Parse(parse) => {
            Some((Kind::Statement, named(&parse.name), parse.query.len()))
        }
        PgWireFrontendMessage::Bind(bind) => {
            let bound = bind.parameters.iter().flatten();
            let bytes = bound.map(|value| value.len()).sum();
            Some((Kind::Portal, named(&bind.portal_name), bytes))
        }
        _ => None,
    }
}

fn named(name: &Option<String>) -> &str {
    name.as_deref().unwrap_or(DEFAULT_NAME)
}

fn has_room(held: &BTreeMap<(Kind, String), usize>, key: &(Kind, String), bytes: usize) -> bool {
    let others = || held.iter().filter(move |(other, _)| *other != key);
    let of_kind = others().filter(|((kind, _), _)| *kind == key.0).count();
    let bytes = others().map(|(_, bytes)| bytes).sum::<usize>() + bytes;
    of_kind < MOST && bytes <= MOST_BYTES
}

/// Whether the library still has it, and a client still reads it.
fn is_kept(store: &MemPortalStore<Prepared>, kind: Kind, name: &str) -> bool {
    if kind == Kind::Statement {
        return store.get_statement(name).is_some();
    }
    let Some(portal) = store.get_portal(name) else {
        return false;
    };
    let is_read = portal.value().is_some_and(|portal| {
        let state = portal.state.try_lock();
        matches!(state.as_deref(), Ok(PortalExecutionState::Finished))
    });
    if is_read {
        store.rm_portal(name);
    }
    !is_read
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use pgwire::api::portal::Portal;
    use pgwire::api::stmt::StoredStatement;
    use pgwire::messages::extendedquery::{Bind, Parse};

    use super::*;

    /// A connection.
    #[derive(Default)]
    struct Client {
        extensions: SessionExtensions,
        store: MemPortalStore<Prepared>,
    }

    impl Client {
        fn statement(name: &str) -> Arc<StoredStatement<Prepared>> {
            let prepared = (String::new(), None);
            Arc::new(StoredStatement::new(name.to_owned(), prepared, vec![]))
        }

        /// Whether it may prepare a statement, as it does then.
        fn prepares(&self, name: &str, query: &str) -> bool {
            let parse = Parse::new(Some(name.to_owned()), query.to_owned(), vec![]);
            let message = PgWireFrontendMessage::Parse(parse);
            let room = make_room(&self.extensions, &self.store, &message);
            if room.is_ok() {
                self.store.put_statement(Self::statement(name));
            }
            room.is_ok()
        }

        /// Whether it may bind a portal, as it does then.
        fn binds(&self, name: &str) -> bool {
            let name = name.to_owned();
            let bind = Bind::new(Some(name.clone()), None, vec![], vec![], vec![]);
            let message = PgWireFrontendMessage::Bind(bind);
            let room = make_room(&self.extensions, &self.store, &message);
            if room.is_ok() {
                let portal = Portal::new_cursor(name, Self::statement(""));
                self.store.put_portal(Arc::new(portal));
            }
            room.is_ok()
        }
    }

    #[test]
    fn a_client_keeps_so_many_statements_until_it_closes_some() {
        let client = Client::default();
        assert!((0..MOST).all(|at| client.prepares(&at.to_string(), "SELECT 1")));
        assert!(!client.prepares("one more", "SELECT 1"));
        assert!(client.prepares("0", "SELECT 2"), "in the place of another");
        client.store.rm_statement("1");
        assert!(client.prepares("one more", "SELECT 1"));
        deallocate(&client.extensions, &client.store, Some("2"));
        assert!(client.prepares("two more", "SELECT 1"));
        deallocate(&client.extensions, &client.store, None);
        assert!(client.store.get_statement("3").is_none());
        assert!((0..MOST).all(|at| client.prepares(&at.to_string(), "SELECT 1")));
    }

    #[test]
    fn a_client_keeps_texts_of_so_many_bytes() {
        let client = Client::default();
        let half = " ".repeat(MOST_BYTES / 2);
        assert!(client.prepares("a", &half) && client.prepares("b", &half));
        assert!(!client.prepares("c", "SELECT 1"));
        assert!(client.prepares("b", "SELECT 1") && client.prepares("c", "SELECT 1"));
    }

    #[tokio::test]
    async fn portals_that_are_read_to_their_end_make_room() {
        let client = Client::default();
        assert!((0..MOST).all(|at| client.binds(&at.to_string())));
        assert!(!client.binds("one more"));
        let portal = client.store.get_portal("7").unwrap();
        *portal.value().unwrap().state.lock().await = PortalExecutionState::Finished;
        assert!(client.binds("one more"));
        assert!(client.store.get_portal("7").is_none());
        assert!(!client.binds("two more"));
    }
}
