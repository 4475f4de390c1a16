//! Roles that a query reads and that a session plays with no topic, though it has some of their types.

use datafusion::common::TableReference;
use evermap_datasets::{Dataset, Session};
use evermap_schemas::roles::{self, Role, Topic};

/// What a person is told of the roles among the tables of a query whose rows lack those of a session, and why.
pub(super) fn notes(dataset: &Dataset, tables: &[TableReference]) -> Vec<String> {
    let is_read = |role: &&Role| tables.iter().any(|table| table.table() == role.name);
    let read = roles::ALL.iter().filter(is_read);
    let notes = read.flat_map(|role| {
        let sessions = dataset.sessions.iter();
        sessions.filter_map(move |session| note(session, role))
    });
    notes.collect()
}

fn note(session: &Session, role: &Role) -> Option<String> {
    let types = role.messages()?.types;
    if !session.roles.topics(role.name).is_empty() {
        return None;
    }
    let topics = session.message_types().into_iter();
    let unfit = topics.filter_map(|(topic, kind)| {
        let is_of_role = types.contains(&Topic::new(&topic, &kind, 1).message_type.as_str());
        let why = session.unfit(&topic).filter(|_| is_of_role)?;
        Some(format!("{topic} ({kind}, {why})"))
    });
    let unfit: Vec<String> = unfit.collect();
    (!unfit.is_empty()).then(|| {
        let (name, role, topics) = (&session.name, role.name, unfit.join(", "));
        format!("session {name} has no {role}, which these topics do not play: {topics}")
    })
}
