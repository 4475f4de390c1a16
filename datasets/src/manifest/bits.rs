//! How many bits the samples of raw images have, by topic.

use std::collections::BTreeMap;

use evermap_schemas::Fault;
use evermap_schemas::roles::SampleBits;
use schemars::{Schema, SchemaGenerator, json_schema};
use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// Where a manifest says them.
pub const BITS: &str = "bits";

/// Bits by topic, or by pattern of topics.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Bits(BTreeMap<String, SampleBits>);

/// Bits by topic of a session, as far as a manifest says them.
pub type TopicBits = BTreeMap<String, SampleBits>;

impl Bits {
    /// Those of just these topics.
    pub fn exactly(topics: &TopicBits) -> Self {
        let exact = |(topic, bits): (&String, &SampleBits)| (glob::Pattern::escape(topic), *bits);
        Self(topics.iter().map(exact).collect())
    }

    /// Whether nothing is said.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// The topics, or patterns, that something is said of.
    pub fn patterns(&self) -> impl Iterator<Item = &String> {
        self.0.keys()
    }

    /// What is said of some topics.
    ///
    /// # Errors
    /// A user fault where two patterns say different bits of a topic, and for a malformed pattern.
    pub fn of_topics<'t>(
        &self,
        topics: impl IntoIterator<Item = &'t String>,
    ) -> Result<TopicBits, Fault> {
        let compile =
            |(text, bits): (&String, &SampleBits)| pattern(text).map(|pattern| (pattern, *bits));
        let compiled: Result<Vec<_>, String> = self.0.iter().map(compile).collect();
        let compiled = compiled.map_err(|text| Fault::user(text).at(BITS))?;
        let mut found = TopicBits::new();
        for topic in topics {
            let said = compiled
                .iter()
                .filter(|(pattern, _)| pattern.matches(topic));
            for (_, bits) in said {
                let before = *found.entry(topic.clone()).or_insert(*bits);
                if before != *bits {
                    let fault = format!(
                        "expected one number of bits for {topic}, found {before} and {bits}"
                    );
                    return Err(Fault::user(fault).at(BITS));
                }
            }
        }
        Ok(found)
    }

    /// The schema of what a manifest says.
    pub(super) fn schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({
            "description": "How many bits the samples of raw images have, by topic, where a camera sends fewer than the 16 that hold each. A topic may be a pattern, in which `*` stands for anything.",
            "type": ["object", "null"],
            "additionalProperties": { "enum": SampleBits::ALL },
        })
    }
}

fn pattern(text: &str) -> Result<glob::Pattern, String> {
    glob::Pattern::new(text).map_err(|error| format!("the topic pattern {text}: {error}"))
}

impl Serialize for Bits {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_map(self.0.iter().map(|(topic, bits)| (topic, bits.get())))
    }
}

impl<'de> Deserialize<'de> for Bits {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let given = Option::<BTreeMap<String, u64>>::deserialize(deserializer)?;
        let read = |(topic, bits): (String, u64)| -> Result<_, D::Error> {
            let [ten, twelve, fourteen] = SampleBits::ALL;
            let known = SampleBits::new(bits).ok_or_else(|| {
                D::Error::custom(format!(
                    "expected {ten}, {twelve} or {fourteen} bits for {topic}, found {bits}"
                ))
            })?;
            pattern(&topic).map_err(D::Error::custom)?;
            Ok((topic, known))
        };
        let read = given.unwrap_or_default().into_iter().map(read);
        let read: Result<BTreeMap<_, _>, D::Error> = read.collect();
        read.map(Self)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::Manifest;

    fn bits(text: &str) -> Bits {
        Manifest::parse(text).unwrap().bits
    }

    #[test]
    fn what_is_said_of_patterns_is_kept_of_topics() {
        let said = bits("bits: { '/camera/*/image_raw': 12, '/front[1]': 10 }");
        let topics = [
            "/camera/a/image_raw",
            "/camera/b/image_raw",
            "/front1",
            "/rear",
        ];
        let topics = topics.map(str::to_owned);
        let found = said.of_topics(&topics).unwrap();
        let shown: Vec<_> = found
            .iter()
            .map(|(topic, bits)| (topic.as_str(), bits.get()))
            .collect();
        let expected = [
            ("/camera/a/image_raw", 12),
            ("/camera/b/image_raw", 12),
            ("/front1", 10),
        ];
        assert_eq!(shown, expected);
        // To open the same log again.
        let again = Bits::exactly(&found);
        assert_eq!(again.of_topics(&topics).unwrap(), found);
        let written = serde_json::to_string(&again).unwrap();
        assert_eq!(serde_json::from_str::<Bits>(&written).unwrap(), again);
        assert!(bits("bits:").is_empty());
    }

    #[test]
    fn what_no_camera_has_and_what_contradicts_itself_is_refused() {
        for (text, said) in [
            (
                "bits: { /front: 11 }",
                "expected 10, 12 or 14 bits for /front, found 11",
            ),
            ("bits: { '/front[': 12 }", "the topic pattern /front["),
            ("bits: 12", "bits"),
        ] {
            let fault = Manifest::parse(text).unwrap_err().to_string();
            assert!(fault.contains(said), "{fault}");
        }
        let twice = bits("bits: { '/fro*': 12, /front: 10 }");
        let fault = twice.of_topics(&["/front".to_owned()]).unwrap_err();
        assert_eq!(fault.place, BITS);
        let said = fault.to_string();
        assert!(said.contains("for /front, found 12 and 10"), "{said}");
    }
}
