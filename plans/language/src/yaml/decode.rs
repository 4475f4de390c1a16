//! Decoding the tree: each function returns what it found, or records what was expected.

use serde_json::{Map, Number, Value};

use super::{Entry, Kind, Node};
use crate::fault::{Location, PlanFaults};
use crate::suggest::{listed, quoted};

impl Node {
    /// What the value is, for messages: "the number 3", "a mapping".
    #[must_use]
    pub(crate) fn described(&self) -> String {
        match &self.kind {
            Kind::Null => "nothing".to_owned(),
            Kind::Bool(value) => value.to_string(),
            Kind::Integer(value) => format!("the integer {value}"),
            Kind::Float(value) => format!("the number {value:?}"),
            Kind::Text(text) => format!("the text {}", quoted(text)),
            Kind::Sequence(_) => "a list".to_owned(),
            Kind::Mapping(_) => "a mapping".to_owned(),
        }
    }

    fn expected<T>(&self, what: &str, expected: &str, faults: &mut PlanFaults) -> Option<T> {
        let message = format!("{what} must be {expected}, found {}", self.described());
        let scalar = matches!(self.kind, Kind::Bool(_) | Kind::Integer(_) | Kind::Float(_));
        if scalar && expected == "text" {
            faults.error_with(self.location, message, "quote it");
        } else {
            faults.error(self.location, message);
        }
        None
    }

    /// The text. `what` names the value in the fault recorded otherwise.
    pub(crate) fn text(&self, what: &str, faults: &mut PlanFaults) -> Option<&str> {
        match &self.kind {
            Kind::Text(text) => Some(text),
            _ => self.expected(what, "text", faults),
        }
    }

    /// The number, whole or not, finite or not.
    pub(crate) fn number(&self, what: &str, faults: &mut PlanFaults) -> Option<f64> {
        match self.kind {
            Kind::Integer(value) => Some(value as f64),
            Kind::Float(value) => Some(value),
            _ => self.expected(what, "a number", faults),
        }
    }

    /// True or false.
    pub(crate) fn boolean(&self, what: &str, faults: &mut PlanFaults) -> Option<bool> {
        match self.kind {
            Kind::Bool(value) => Some(value),
            _ => self.expected(what, "true or false", faults),
        }
    }

    /// The items of a list.
    pub(crate) fn sequence(&self, what: &str, faults: &mut PlanFaults) -> Option<&[Node]> {
        match &self.kind {
            Kind::Sequence(items) => Some(items),
            _ => self.expected(what, "a list", faults),
        }
    }

    /// The entries of a mapping, in written order.
    pub(crate) fn mapping(&self, what: &str, faults: &mut PlanFaults) -> Option<&[Entry]> {
        match &self.kind {
            Kind::Mapping(entries) => Some(entries),
            _ => self.expected(what, "a mapping", faults),
        }
    }

    /// The entry of a key, if this is a mapping that has it.
    pub(crate) fn get(&self, key: &str) -> Option<&Entry> {
        match &self.kind {
            Kind::Mapping(entries) => entries.iter().find(|entry| entry.key == key),
            _ => None,
        }
    }

    /// As [`Node::get`], to be changed.
    pub(crate) fn get_mut(&mut self, key: &str) -> Option<&mut Entry> {
        self.entries_mut()?
            .iter_mut()
            .find(|entry| entry.key == key)
    }

    /// Takes the entry of a key out of a mapping.
    pub(crate) fn take(&mut self, key: &str) -> Option<Entry> {
        let entries = self.entries_mut()?;
        let index = entries.iter().position(|entry| entry.key == key)?;
        Some(entries.remove(index))
    }

    /// The entries of a mapping, to be changed.
    pub(crate) fn entries_mut(&mut self) -> Option<&mut Vec<Entry>> {
        match &mut self.kind {
            Kind::Mapping(entries) => Some(entries),
            _ => None,
        }
    }

    /// The value as JSON. Numbers that JSON has not (`.inf`, `.nan`) are faults and null.
    pub(crate) fn json(&self, faults: &mut PlanFaults) -> Value {
        match &self.kind {
            Kind::Null => Value::Null,
            Kind::Bool(value) => Value::Bool(*value),
            Kind::Text(text) => Value::String(text.clone()),
            Kind::Integer(value) => Number::from_i128(*value).map_or(Value::Null, Value::Number),
            Kind::Float(value) => match Number::from_f64(*value) {
                Some(number) => Value::Number(number),
                None => {
                    let found = self.described();
                    faults.error(
                        self.location,
                        format!("expected a finite number, found {found}"),
                    );
                    Value::Null
                }
            },
            Kind::Sequence(items) => {
                Value::Array(items.iter().map(|item| item.json(faults)).collect())
            }
            Kind::Mapping(entries) => Value::Object(json_object(entries, faults)),
        }
    }
}

/// The entries of a mapping as a JSON object, in written order.
pub(crate) fn json_object(entries: &[Entry], faults: &mut PlanFaults) -> Map<String, Value> {
    let json = |entry: &Entry| (entry.key.clone(), entry.value.json(faults));
    entries.iter().map(json).collect()
}

/// Puts entries in a mapping, in place of those with the same keys.
pub(crate) fn merge(entries: &mut Vec<Entry>, changes: Vec<Entry>) {
    for change in changes {
        match entries.iter_mut().find(|entry| entry.key == change.key) {
            Some(entry) => *entry = change,
            None => entries.push(change),
        }
    }
}

/// A mapping with a fixed set of keys, such as a step or a whole plan.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Fields<'n> {
    entries: &'n [Entry],
    location: Location,
}

impl<'n> Fields<'n> {
    /// Reads `node` as a mapping with no keys but `known`; every other key is a fault with
    /// a suggestion. `what` names the mapping in messages: "the plan", "step `lanes`".
    pub(crate) fn of(
        node: &'n Node,
        what: &str,
        known: &[&str],
        faults: &mut PlanFaults,
    ) -> Option<Self> {
        let entries = node.mapping(what, faults)?;
        for entry in entries {
            if !known.contains(&entry.key.as_str()) {
                let key = quoted(&entry.key);
                let keys = listed(known.iter().copied());
                let message = format!("unknown key {key} in {what}; its keys are {keys}");
                if entry.key.contains(char::is_whitespace) {
                    let next = "between braces, quote a text that has a comma or a colon";
                    faults.error_with(entry.location, message, next);
                    continue;
                }
                faults.unknown(entry.location, message, &entry.key, known.iter().copied());
            }
        }
        Some(Self {
            entries,
            location: node.location,
        })
    }

    /// The entry of a key, if given. An entry of the value null counts as given.
    #[must_use]
    pub(crate) fn get(&self, key: &str) -> Option<&'n Entry> {
        self.entries.iter().find(|entry| entry.key == key)
    }

    /// The entry of a key; its absence from `what` is a fault at the mapping's start.
    pub(crate) fn require(
        &self,
        key: &str,
        what: &str,
        faults: &mut PlanFaults,
    ) -> Option<&'n Entry> {
        let entry = self.get(key);
        if entry.is_none() {
            faults.error(self.location, format!("{what} lacks {}", quoted(key)));
        }
        entry
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

    use super::super::read;
    use super::*;
    use crate::fault::Source;

    fn read_text(text: &str) -> (Option<Node>, PlanFaults) {
        let source = Source {
            origin: "x.yaml".to_owned(),
            text: text.to_owned(),
        };
        let mut faults = PlanFaults::default();
        (read(&source, &mut faults), faults)
    }

    fn tree(text: &str) -> Node {
        let (node, faults) = read_text(text);
        assert!(faults.is_empty(), "{faults}");
        node.unwrap()
    }

    fn fault(text: &str) -> String {
        read_text(text).1.to_string()
    }

    fn json(text: &str) -> Value {
        tree(text).json(&mut PlanFaults::default())
    }

    fn position(node: &Node) -> (usize, usize) {
        let position = node.location.position();
        (position.line, position.column)
    }

    #[test]
    fn values_know_where_they_are() {
        let root = tree("a: 1\nbé: { ü: [x, 'y'] }\nc:\n  - d\n  - e: |\n      f\n");
        assert_eq!(position(&root), (1, 1));
        let entries = root.mapping("", &mut PlanFaults::default()).unwrap();
        assert_eq!(entries[1].location.position().line, 2);
        let Kind::Mapping(inner) = &entries[1].value.kind else {
            panic!("{:?}", entries[1])
        };
        assert_eq!(position(&entries[1].value), (2, 5));
        assert_eq!(position(&inner[0].value), (2, 10));
        let Kind::Sequence(items) = &entries[2].value.kind else {
            panic!("{:?}", entries[2])
        };
        assert_eq!(position(&items[0]), (4, 5));
        assert_eq!(position(&items[1]), (5, 5));
        let Kind::Mapping(last) = &items[1].kind else {
            panic!("{:?}", items[1])
        };
        // Block text starts where its first line does.
        assert_eq!(position(&last[0].value), (6, 7));
    }

    #[test]
    fn anchors_scalars_and_tags() {
        assert_eq!(
            json("a: &x {b: [1, 2.5]}\nc: *x\n007: !!str 5\n? k\n: >\n  two\n  lines\n"),
            serde_json::json!({
                "a": {"b": [1, 2.5]}, "c": {"b": [1, 2.5]}, "007": "5", "k": "two lines\n"
            })
        );
    }

    #[test]
    fn what_is_refused_says_why() {
        let cases = [
            ("", "1:1: the text is empty"),
            (
                "a: 1\nb: 2\na: 3",
                "3:1: `a` is given twice, first on line 1",
            ),
            ("[1]: 2", "1:1: a key must be a single word or quoted text"),
            (
                "a: &x\n  - *x",
                "2:5: this alias stands inside the value it refers to",
            ),
            ("a: !car {}", "1:4: the tag `!car` means nothing here"),
            ("a: !!int b", "1:4: `b` is not of `!!int`"),
            (
                "--- 1\n--- 2",
                "2:1: a second document starts here; only one is read",
            ),
        ];
        for (text, expected) in cases {
            assert_eq!(fault(text), format!("x.yaml:{expected}\n"), "{text}");
        }
        assert!(fault("a: {x: 1}\nb: {<<: *c}").contains("x.yaml:2:9: not YAML"));
        assert!(fault("a: &c {x: 1}\nb: {<<: *c}").contains("merge keys"));
        assert!(fault("a: [1, 2").contains("not YAML"));
    }

    #[test]
    fn depth_and_size_are_bounded() {
        assert!(fault(&"[".repeat(100_000)).contains("nested deeper than 64"));
        assert!(fault(&"- ".repeat(100_000)).contains("nested deeper than 64"));
        let mut laughs = String::from("a0: &a0 [x,x,x,x,x,x,x,x,x,x]\n");
        for level in 1..20 {
            let below = format!("*a{},", level - 1).repeat(10);
            laughs.push_str(&format!("a{level}: &a{level} [{below}]\n"));
        }
        assert!(fault(&laughs).contains("more than 500000 values"));
        let mut chain = String::from("a0: &a0 [x]\n");
        for level in 1..100 {
            chain.push_str(&format!("a{level}: &a{level} [*a{}]\n", level - 1));
        }
        assert!(fault(&chain).contains("nested deeper than 64"));
        assert!(fault(&"x".repeat(5 << 20)).contains("at most"));
    }
}
