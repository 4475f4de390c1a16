//! The descriptor of a role, and which topics play it where nobody says.

use std::cmp::Reverse;

use crate::roles::message::{MetadataReader, Reader};
use crate::roles::{FromMessage, Message, Mount};
use crate::{Layer, LayerRow};

/// A part that a log's messages play, and the table of its rows.
#[derive(Debug, Clone, Copy)]
pub struct Role {
    /// Name: of the table, and of the key in a session manifest.
    pub name: &'static str,
    /// What one row is.
    pub doc: &'static str,
    /// Where its rows come from.
    pub source: Source,
    row: fn() -> Layer,
}

/// Where a role's rows come from.
#[derive(Debug, Clone, Copy)]
pub enum Source {
    /// The messages of the topics that play the role.
    Messages(Messages),
    /// The log's metadata records of one name.
    Metadata(Metadata),
}

/// How messages are chosen and become rows.
#[derive(Debug, Clone, Copy)]
pub struct Messages {
    /// Message types that may play the role, as [`Topic::message_type`] spells them.
    pub types: &'static [&'static str],
    /// Which topics of these types do where nobody says.
    pub choose: fn(&[Topic]) -> Vec<Choice>,
    /// Whether it is played by one topic at most.
    pub single: bool,
    /// Members of a message that are decoded, where it has them.
    pub members: &'static [&'static str],
    /// The member that holds an image, for roles whose rows refer to one; it is located, not decoded.
    pub image: Option<&'static str>,
    /// Whether its images are pictures, of which a person may say how many bits their samples have.
    pub pictures: bool,
    /// Whether a row is left out that, but for its stamp, says what the row of its key before it in time says.
    pub drop_repeats: bool,
    /// Whether it says what a vehicle is like, and not what a drive was: nothing is made of it alone.
    pub lasting: bool,
    /// Whether one session that plays it does so for all of its site: what people say of a map or of images, where the site
    /// lies on earth. The others can do without, and it says of no session that it is a drive.
    pub shared: bool,
    /// Where its topics may tell of several robots and the table is of one: how messages become
    /// [`Motion`](super::Motion)s.
    pub robots: Option<&'static Messages>,
    /// Where rows of topics that may move are of what never does in a session: how messages become
    /// [`SentTransform`](super::SentTransform)s, which tell.
    pub still: Option<&'static Messages>,
    /// Where messages may name the vehicle that all of their topic are of: how they become
    /// [`Motion`](super::Motion)s.
    pub vehicle: Option<&'static Messages>,
    /// The frames that a message says are fixed, which the others of its session must not contradict.
    pub mounts: Option<fn(&Message<'_>) -> Vec<Mount>>,
    /// From messages to rows.
    pub read: Reader,
}

impl Messages {
    /// Every topic of these types, messages as the row type reads them.
    pub const fn of<T: FromMessage>(types: &'static [&'static str]) -> Self {
        Self {
            types,
            choose: every,
            single: false,
            members: T::MEMBERS,
            image: None,
            pictures: false,
            drop_repeats: false,
            lasting: false,
            shared: false,
            robots: None,
            still: None,
            vehicle: None,
            mounts: None,
            read: crate::roles::message::read::<T>,
        }
    }

    /// Whether nothing is read of messages whose schema names no fields: an image is found without.
    pub fn need_fields(&self) -> bool {
        self.image.is_none()
    }
}

/// Which metadata records become rows, and how.
#[derive(Debug, Clone, Copy)]
pub struct Metadata {
    /// Name of the records.
    pub record: &'static str,
    /// From a record to rows.
    pub read: MetadataReader,
}

impl Role {
    /// A role with the name and meaning of its rows' layer, played by messages.
    pub const fn of<T: FromMessage>(messages: Messages) -> Self {
        Self::with::<T>(Source::Messages(messages))
    }

    /// A role with the name and meaning of its rows' layer, played by metadata records of a name, which are read so.
    pub const fn of_metadata<T: LayerRow>(record: &'static str, read: MetadataReader) -> Self {
        Self::with::<T>(Source::Metadata(Metadata { record, read }))
    }

    const fn with<T: LayerRow>(source: Source) -> Self {
        Self {
            name: T::NAME,
            doc: T::DOC,
            source,
            row: T::layer,
        }
    }

    /// The same rows under another name.
    #[must_use]
    pub const fn named(self, name: &'static str, doc: &'static str) -> Self {
        Self { name, doc, ..self }
    }

    /// The declaration of its table.
    pub fn layer(&self) -> Layer {
        Layer {
            name: self.name,
            doc: self.doc,
            ..(self.row)()
        }
    }

    /// How it reads messages; `None` for a role of metadata.
    pub fn messages(&self) -> Option<&Messages> {
        match &self.source {
            Source::Messages(messages) => Some(messages),
            Source::Metadata(_) => None,
        }
    }

    /// What keeps a topic from playing it, whoever says that it does: its rows are read by fields, and it has none.
    pub fn unfit(&self, topic: &Topic) -> Option<&'static str> {
        let reads_fields = self.messages().is_some_and(Messages::need_fields);
        (topic.untyped && reads_fields).then_some(UNTYPED)
    }

    /// The topics, of those of a session by name, that play it where nobody says; ascending.
    pub fn infer(&self, topics: &[Topic]) -> Vec<Choice> {
        let Some(messages) = self.messages() else {
            return Vec::new();
        };
        let readable = |topic: &&Topic| self.unfit(topic).is_none();
        let typed = |topic: &&Topic| messages.types.contains(&topic.message_type.as_str());
        let candidates: Vec<Topic> = topics
            .iter()
            .filter(typed)
            .filter(readable)
            .cloned()
            .collect();
        let mut chosen = (messages.choose)(&candidates);
        chosen.sort_by(|a, b| a.topic.cmp(&b.topic));
        chosen
    }
}

/// Why nothing but images is read of a topic whose schema names no fields.
pub const UNTYPED: &str = "JSON whose schema names no fields";

/// What inference knows of a topic.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Topic {
    /// Its name.
    pub name: String,
    /// Its message type: `sensor_msgs/Image`, `foxglove.RawImage`.
    pub message_type: String,
    /// Number of messages: 0 where there are none, and at least 1 where it is not known.
    pub messages: u64,
    /// Whether its schema names no fields.
    pub untyped: bool,
}

impl Topic {
    /// A topic whose message type is spelt as in a log: `sensor_msgs/msg/Image` (ROS 2) and `sensor_msgs/Image` (ROS 1)
    /// are the same.
    pub fn new(name: &str, schema: &str, messages: u64) -> Self {
        let plain = schema.replace("/msg/", "/");
        Self {
            name: name.to_owned(),
            message_type: plain.replace("foxglove_msgs/", "foxglove."),
            messages,
            untyped: false,
        }
    }
}

/// A topic that plays a role.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Choice {
    /// Its name.
    pub topic: String,
    /// Topics that another reader might have taken instead.
    pub passed_over: Vec<String>,
    /// Why they were not, where it is not for their names or numbers of messages.
    pub why: Option<&'static str>,
}

impl Choice {
    /// The first of some topics, instead of the others; `None` where there is none.
    pub fn first_of<'a>(topics: impl IntoIterator<Item = &'a Topic>) -> Option<Self> {
        let mut names = topics.into_iter().map(|topic| topic.name.clone());
        Some(Self {
            topic: names.next()?,
            passed_over: names.collect(),
            why: None,
        })
    }
}

/// The topic with most messages plays the role: the first by name, where several have as many.
pub(super) fn fullest(topics: &[Topic]) -> Vec<Choice> {
    let mut candidates: Vec<&Topic> = topics.iter().collect();
    candidates.sort_by_key(|topic| (Reverse(topic.messages), &topic.name));
    Choice::first_of(candidates).into_iter().collect()
}

/// Every topic plays the role.
pub fn every(topics: &[Topic]) -> Vec<Choice> {
    topics
        .iter()
        .filter_map(|topic| Choice::first_of([topic]))
        .collect()
}

/// Whether a name has one of these words in it, in capitals or not.
pub fn in_words(name: &str, words: &[&str]) -> bool {
    let name = name.to_lowercase();
    words.iter().any(|word| name.contains(word))
}
