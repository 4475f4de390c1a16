//! From parser events to the positioned tree, with bounded depth and size.

use std::collections::BTreeMap;

use saphyr_parser::{Event, Marker, Parser, ScalarStyle, ScanError, Span, Tag};

use super::{DEEPEST, Entry, Kind, LONGEST_TEXT, MOST_NODES, Node, scalar};
use crate::fault::{Location, PlanFaults, Position, Source};
use crate::suggest::quoted;

/// Reads the one YAML document in a text, which faults can point to from now on. `None` means it
/// has no tree; the faults say why.
///
/// Syntax faults, duplicate keys, and what is beyond the limits of [`crate::yaml`] are
/// recorded. After a syntax fault there is no tree: what follows it would be guesswork.
pub(crate) fn read(source: &Source, faults: &mut PlanFaults) -> Option<Node> {
    let number = faults.open(source.clone());
    let start = Location::Text(Position::start_of(number));
    read_from(start, &source.text, faults)
}

/// Reads a text that starts at a location. All of a text in a setting is at the setting.
pub(crate) fn read_from(start: Location, text: &str, faults: &mut PlanFaults) -> Option<Node> {
    if text.len() > LONGEST_TEXT {
        let (length, most) = (text.len(), LONGEST_TEXT);
        faults.error(
            start,
            format!("the text has {length} bytes; at most {most} are read"),
        );
        return None;
    }
    let mut builder = Builder::new(start, faults);
    let mut parser = Parser::new_from_str(text);
    while let Some(event) = parser.next_event() {
        let step = match event {
            Ok((event, span)) => builder.event(event, span),
            Err(error) => {
                builder.syntax(&error);
                Err(Stop)
            }
        };
        if step.is_err() {
            return None;
        }
    }
    let root = builder.root;
    if root.is_none() {
        faults.error(start, "the text is empty");
    }
    root
}

/// Reading cannot go on; the fault is recorded.
struct Stop;

fn too_deep() -> String {
    format!("nested deeper than {DEEPEST} levels")
}

/// A finished node with what its parent needs to know.
#[derive(Clone)]
struct Finished {
    node: Node,
    /// The text of a scalar as written, should it be a key.
    written: Option<String>,
    /// Nodes in it, itself included.
    size: usize,
    /// Levels of collections in it.
    height: usize,
}

enum Content {
    Sequence(Vec<Node>),
    Mapping {
        entries: Vec<Entry>,
        first: BTreeMap<String, Location>,
        pending: Pending,
    },
}

/// Where a mapping stands.
enum Pending {
    Key,
    Value(String, Location),
    /// The value of a key that is at fault.
    Discard,
}

/// A collection that is still open.
struct OpenCollection {
    location: Location,
    anchor: usize,
    content: Content,
    size: usize,
    height: usize,
}

struct Builder<'f> {
    start: Location,
    faults: &'f mut PlanFaults,
    open: Vec<OpenCollection>,
    anchors: BTreeMap<usize, Finished>,
    nodes: usize,
    documents: usize,
    root: Option<Node>,
}

impl<'f> Builder<'f> {
    fn new(start: Location, faults: &'f mut PlanFaults) -> Self {
        Self {
            start,
            faults,
            open: Vec::new(),
            anchors: BTreeMap::new(),
            nodes: 0,
            documents: 0,
            root: None,
        }
    }

    fn location(&self, marker: Marker) -> Location {
        match self.start {
            Location::Text(start) => Location::Text(Position {
                source: start.source,
                line: marker.line().max(1),
                column: marker.col() + 1,
            }),
            setting @ Location::Setting(_) => setting,
        }
    }

    fn event(&mut self, event: Event<'_>, span: Span) -> Result<(), Stop> {
        let location = self.location(span.start);
        match event {
            Event::DocumentStart(_) => self.document(location),
            Event::SequenceStart(anchor, tag) => {
                self.check_tag(tag.as_deref(), "seq", location);
                self.start(location, anchor, Content::Sequence(Vec::new()))
            }
            Event::MappingStart(anchor, tag) => {
                self.check_tag(tag.as_deref(), "map", location);
                let content = Content::Mapping {
                    entries: Vec::new(),
                    first: BTreeMap::new(),
                    pending: Pending::Key,
                };
                self.start(location, anchor, content)
            }
            Event::SequenceEnd | Event::MappingEnd => self.end(),
            Event::Scalar(text, style, anchor, tag) => {
                let kind = match tag {
                    Some(tag) => scalar::tagged(&text, &tag, location, self.faults),
                    None if style == ScalarStyle::Plain => {
                        // A key such as `007` is kept as written and cannot be at fault.
                        if self.wants_key() {
                            Kind::Text(text.to_string())
                        } else {
                            scalar::plain(&text)
                        }
                    }
                    None => Kind::Text(text.to_string()),
                };
                self.finish(
                    anchor,
                    Finished {
                        node: Node { location, kind },
                        written: Some(text.into_owned()),
                        size: 1,
                        height: 0,
                    },
                )
            }
            Event::Alias(anchor) => self.alias(anchor, location),
            Event::Nothing | Event::StreamStart | Event::StreamEnd | Event::DocumentEnd => Ok(()),
        }
    }

    fn syntax(&mut self, error: &ScanError) {
        let location = self.location(*error.marker());
        let message = match error.info() {
            // The scanner looks ahead and has a limit of its own, above ours.
            "recursion limit exceeded" => too_deep(),
            info => format!("not YAML: {info}"),
        };
        self.faults.error(location, message);
    }

    fn wants_key(&self) -> bool {
        matches!(
            self.open.last(),
            Some(OpenCollection {
                content: Content::Mapping {
                    pending: Pending::Key,
                    ..
                },
                ..
            })
        )
    }

    fn document(&mut self, location: Location) -> Result<(), Stop> {
        self.documents += 1;
        if self.documents > 1 {
            self.faults
                .error(location, "a second document starts here; only one is read");
            return Err(Stop);
        }
        Ok(())
    }

    fn check_tag(&mut self, tag: Option<&Tag>, expected: &str, location: Location) {
        if let Some(tag) = tag
            && !(tag.is_yaml_core_schema() && tag.suffix == expected)
        {
            self.faults.error(location, scalar::unsupported(tag));
        }
    }

    fn start(&mut self, location: Location, anchor: usize, content: Content) -> Result<(), Stop> {
        self.open.push(OpenCollection {
            location,
            anchor,
            content,
            size: 1,
            height: 1,
        });
        self.check_depth(0, location)
    }

    fn check_depth(&mut self, more: usize, location: Location) -> Result<(), Stop> {
        if self.open.len() + more <= DEEPEST {
            return Ok(());
        }
        self.faults.error(location, too_deep());
        Err(Stop)
    }

    fn end(&mut self) -> Result<(), Stop> {
        let Some(open) = self.open.pop() else {
            return Ok(());
        };
        let kind = match open.content {
            Content::Sequence(items) => Kind::Sequence(items),
            Content::Mapping { entries, .. } => Kind::Mapping(entries),
        };
        // The nodes within were counted when they finished.
        self.nodes = self.nodes.saturating_sub(open.size - 1);
        let node = Node {
            location: open.location,
            kind,
        };
        self.finish(
            open.anchor,
            Finished {
                node,
                written: None,
                size: open.size,
                height: open.height,
            },
        )
    }

    fn alias(&mut self, anchor: usize, location: Location) -> Result<(), Stop> {
        let Some(target) = self.anchors.get(&anchor) else {
            self.faults
                .error(location, "this alias stands inside the value it refers to");
            return Err(Stop);
        };
        // Checked before the copy is made: aliases of aliases grow exponentially.
        let (size, height) = (target.size, target.height);
        self.check_depth(height, location)?;
        self.check_nodes(size, location)?;
        if let Some(target) = self.anchors.get(&anchor).cloned() {
            return self.finish(0, target);
        }
        Ok(())
    }

    fn check_nodes(&mut self, more: usize, location: Location) -> Result<(), Stop> {
        if self.nodes + more <= MOST_NODES {
            return Ok(());
        }
        self.faults
            .error(location, format!("more than {MOST_NODES} values"));
        Err(Stop)
    }

    /// Hands a finished node to the collection it is in.
    fn finish(&mut self, anchor: usize, finished: Finished) -> Result<(), Stop> {
        self.check_nodes(finished.size, finished.node.location)?;
        self.nodes += finished.size;
        if anchor > 0 {
            self.anchors.insert(anchor, finished.clone());
        }
        let Some(parent) = self.open.last_mut() else {
            self.root = Some(finished.node);
            return Ok(());
        };
        parent.size += finished.size;
        parent.height = parent.height.max(finished.height + 1);
        match &mut parent.content {
            Content::Sequence(items) => items.push(finished.node),
            Content::Mapping {
                entries,
                first,
                pending,
            } => match std::mem::replace(pending, Pending::Key) {
                Pending::Key => *pending = key(finished, first, self.faults),
                Pending::Value(key, location) => entries.push(Entry {
                    key,
                    location,
                    value: finished.node,
                }),
                Pending::Discard => {}
            },
        }
        Ok(())
    }
}

/// Takes a finished node as the next key of a mapping.
fn key(
    finished: Finished,
    first: &mut BTreeMap<String, Location>,
    faults: &mut PlanFaults,
) -> Pending {
    let location = finished.node.location;
    let Some(key) = finished.written else {
        faults.error(location, "a key must be a single word or quoted text");
        return Pending::Discard;
    };
    if key == "<<" {
        faults.error_with(
            location,
            "merge keys (`<<`) are not part of YAML 1.2",
            "write the keys out",
        );
        return Pending::Discard;
    }
    if let Some(earlier) = first.get(&key) {
        let line = earlier.position().line;
        faults.error(
            location,
            format!("{} is given twice, first on line {line}", quoted(&key)),
        );
        return Pending::Discard;
    }
    first.insert(key.clone(), location);
    Pending::Value(key, location)
}
