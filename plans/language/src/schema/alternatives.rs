//! `oneOf`, `anyOf`, `allOf`: finding the alternative that was meant, and its faults.

use serde_json::Value;

use super::{Checker, equals, object, shown};
use crate::fault::Faults;
use crate::suggest::listed;
use crate::yaml::{Entry, Kind, Node};

impl<'s> Checker<'s> {
    /// The fixed values of an enumeration; `None` if the schema is more than that.
    pub(super) fn choices(self, schema: &'s Value) -> Option<Vec<&'s Value>> {
        self.choices_within(schema, 0)
    }

    fn choices_within(self, schema: &'s Value, depth: usize) -> Option<Vec<&'s Value>> {
        let schema = self.followed(schema);
        if let Some(only) = schema.get("const") {
            return Some(vec![only]);
        }
        if let Some(values) = schema.get("enum").and_then(Value::as_array) {
            return Some(values.iter().collect());
        }
        if schema.get("type").and_then(Value::as_str) == Some("null") {
            return Some(vec![&Value::Null]);
        }
        let branches = branches(schema)?;
        if depth > 8 || branches.is_empty() {
            return None;
        }
        let mut choices = Vec::new();
        for branch in branches {
            choices.extend(self.choices_within(branch, depth + 1)?);
        }
        Some(choices)
    }

    pub(super) fn alternatives(
        self,
        node: &Node,
        schema: &'s Value,
        what: &str,
        faults: &mut Faults,
    ) {
        let own_keys = schema.get("properties").is_some();
        let all = schema.get("allOf").and_then(Value::as_array);
        for branch in all.into_iter().flatten() {
            self.branch(
                node,
                branch,
                own_keys || all.is_some_and(|all| all.len() > 1),
                what,
                faults,
            );
        }
        let Some(branches) = branches(schema) else {
            return;
        };
        let mut candidates = Vec::new();
        for branch in branches {
            let mut trial = Faults::trial();
            self.branch(node, branch, own_keys, what, &mut trial);
            if trial.is_empty() {
                return;
            }
            if self.fits(node, branch) {
                candidates.push(trial);
            }
        }
        // One alternative was clearly meant: its faults are the faults.
        if candidates.len() == 1 {
            candidates
                .into_iter()
                .for_each(|meant| faults.append(meant));
            return;
        }
        self.none_fits(node, branches, what, faults);
    }

    /// Checks one alternative. With `shared` keys, the object around it knows other keys.
    fn branch(self, node: &Node, schema: &'s Value, shared: bool, what: &str, faults: &mut Faults) {
        let Kind::Mapping(entries) = &node.kind else {
            return self.value(node, schema, what, faults);
        };
        if !shared {
            return self.value(node, schema, what, faults);
        }
        let mut known = Vec::new();
        self.known_keys(schema, 0, &mut known);
        let ours = |entry: &&Entry| known.contains(&entry.key.as_str());
        let part = Node {
            place: node.place,
            kind: Kind::Mapping(entries.iter().filter(ours).cloned().collect()),
        };
        self.value(&part, schema, what, faults);
    }

    /// Whether the value looks like this alternative: its type, its tag, its required keys.
    fn fits(self, node: &Node, schema: &'s Value) -> bool {
        let schema = self.followed(schema);
        if self.choices(schema).is_some() {
            return false;
        }
        if !super::of_type(node, schema, "", &mut Faults::trial()) {
            return false;
        }
        let Kind::Mapping(entries) = &node.kind else {
            return true;
        };
        let value_of = |key: &str| entries.iter().find(|entry| entry.key == key);
        if let Some((tag, expected)) = self.tag(schema) {
            return value_of(tag).is_some_and(|entry| equals(&entry.value, expected));
        }
        object::required(schema).all(|key| value_of(key).is_some())
    }

    /// The property that tells a tagged alternative: one that is a constant.
    fn tag(self, schema: &'s Value) -> Option<(&'s str, &'s Value)> {
        let properties = self.followed(schema).get("properties")?.as_object()?;
        properties
            .iter()
            .find_map(|(key, schema)| Some((key.as_str(), self.followed(schema).get("const")?)))
    }

    /// Names what the alternatives are: by tag, by key or by fixed value.
    fn none_fits(self, node: &Node, branches: &'s [Value], what: &str, faults: &mut Faults) {
        let tags: Vec<(&str, &Value)> = branches.iter().filter_map(|b| self.tag(b)).collect();
        if let (Kind::Mapping(entries), Some((tag, _))) = (&node.kind, tags.first()) {
            let values: Vec<&Value> = tags.iter().map(|(_, value)| *value).collect();
            match entries.iter().find(|entry| entry.key == *tag) {
                Some(entry) => {
                    super::choice(&entry.value, &values, &format!("`{tag}` of {what}"), faults);
                }
                None => faults.error(node.place, format!("{what} lacks `{tag}`")),
            }
            return;
        }
        let mut names: Vec<String> = Vec::new();
        for branch in branches {
            let branch = self.followed(branch);
            match self.choices(branch) {
                Some(choices) => names.extend(choices.iter().map(|choice| shown(choice))),
                None => names.push(alternative_name(branch)),
            }
        }
        let known = names.iter().map(String::as_str);
        let message = format!(
            "{what} must be one of {}, found {}",
            listed(known.clone()),
            node.described()
        );
        match &node.kind {
            Kind::Text(text) => faults.unknown(node.place, message, text, known),
            Kind::Mapping(entries) if entries.len() == 1 => {
                let key = entries.first().map_or("", |entry| entry.key.as_str());
                faults.unknown(node.place, message, key, known);
            }
            _ => faults.error(node.place, message),
        }
    }
}

fn branches(schema: &Value) -> Option<&[Value]> {
    let branches = schema.get("oneOf").or_else(|| schema.get("anyOf"))?;
    branches.as_array().map(Vec::as_slice)
}

fn alternative_name(schema: &Value) -> String {
    let keys: Vec<&str> = object::required(schema).collect();
    let kind = schema.get("type").and_then(Value::as_str);
    match (keys.as_slice(), kind) {
        ([], Some(kind)) => super::type_noun(kind).to_owned(),
        ([], None) => "something else".to_owned(),
        (keys, _) => keys.join(" + "),
    }
}
