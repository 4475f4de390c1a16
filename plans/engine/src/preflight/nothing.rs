//! That a plan makes nothing of any session that it is given.

use std::collections::BTreeSet;

use evermap_datasets::Session;
use evermap_schemas::{Fault, roles};

use super::{Lacks, Needs, few, in_words};

/// That a plan makes nothing of a session and `others`: what is lacking, what is there, what would help.
pub(super) fn to_make(needs: &Needs, session: &Session, lacks: &Lacks, others: usize) -> Fault {
    let read = needs.sources();
    if read.is_empty() {
        return reads_nothing();
    }
    let name = &session.name;
    let others = match others {
        0 => String::new(),
        others => format!(", nor of {others} more"),
    };
    Fault::user(format!(
        "the plan cannot use session {name}{others}: expected {}, found topics {}",
        expected(lacks, &read),
        topics(session)
    ))
    .next(what_helps(lacks, &read))
}

/// That no step reads what sessions have.
fn reads_nothing() -> Fault {
    let fault = "the plan cannot use any session: expected a step that reads a role or a topic of sessions, found none";
    Fault::user(fault).next(
        "let a step read one, as `evermap inspect` lists them; without --sessions the plan runs on a map that has sessions",
    )
}

/// What is lacking; where nothing is that a step cannot do without, any of what is read.
fn expected(lacks: &Lacks, read: &BTreeSet<&str>) -> String {
    match lacks.is_empty() {
        true => read.iter().copied().collect::<Vec<_>>().join(" or "),
        false => in_words(lacks),
    }
}

fn topics(session: &Session) -> String {
    let topics = session.message_types();
    let topics: Vec<_> = topics
        .iter()
        .map(|(topic, kind)| match session.unfit(topic) {
            Some(reason) => format!("{topic} ({kind}, {reason})"),
            None => format!("{topic} ({kind})"),
        })
        .collect();
    match topics.is_empty() {
        true => "none".to_owned(),
        false => few(topics),
    }
}

/// Which messages play what is lacking, or what is read; of roles that messages play.
fn what_helps(lacks: &Lacks, read: &BTreeSet<&str>) -> String {
    let helps = |role: &&roles::Role| match lacks.is_empty() {
        true => read.contains(role.name),
        false => lacks.contains_key(role.name),
    };
    let types = roles::ALL.iter().filter(helps).filter_map(|role| {
        let types = role.messages()?.types.join(", ");
        Some(format!("{}: {types}", role.name))
    });
    let types: Vec<_> = types.collect();
    match types.is_empty() {
        true => "give logs that have them".to_owned(),
        false => format!(
            "give logs that have them, or say in a manifest which topic plays the role; message types that do: {}",
            types.join("; ")
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn where_steps_do_without_all_that_they_read_it_is_named_all_the_same() {
        let read = BTreeSet::from(["frames", "imu", "label_classes"]);
        let nothing = Lacks::new();
        assert_eq!(expected(&nothing, &read), "frames or imu or label_classes");
        let helps = what_helps(&nothing, &read);
        assert!(helps.contains("do: frames: sensor_msgs/"), "{helps}");
        assert!(helps.contains("; imu: sensor_msgs/Imu"), "{helps}");
        assert!(!helps.contains("label_classes"), "{helps}");
        let lacks = Lacks::from([("imu".to_owned(), "gravity".to_owned())]);
        assert_eq!(expected(&lacks, &read), "imu (step gravity)");
        let helps = what_helps(&lacks, &read);
        assert!(!helps.contains("frames"), "{helps}");
        assert_eq!(
            what_helps(&nothing, &BTreeSet::from(["label_classes"])),
            "give logs that have them"
        );
    }
}
