//! A session manifest that says what is known of some logs, ready to edit.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use askama::Template;
use datafusion::prelude::SessionContext;
use evermap_catalog::MASK;
use evermap_contract::Registry;
use evermap_datasets::{Dataset, Session};
use evermap_language::wrapped;
use evermap_schemas::{Fault, roles};

use crate::coordinate_frames::{CoordinateFrames, image_size};
use crate::operators;

/// Parameters that are about the vehicle and not about a plan, each with an example where its default is none.
const OF_VEHICLE: [(&str, Option<&str>); 5] = [
    (MASK, Some("")),
    ("odometry_scale_sigma", None),
    ("max_speed_mps", None),
    ("max_acceleration_mps2", None),
    ("max_yaw_rate_radps", None),
];

/// Letters of a line of comment.
const WIDTH: usize = 110;

#[derive(Template)]
#[template(path = "manifest.yaml", escape = "none")]
struct ManifestText {
    sessions: Vec<WrittenSession>,
    roles: Vec<WrittenRole>,
    vehicle: Option<String>,
    vehicle_doc: Vec<String>,
    names: Vec<String>,
    /// Frames of robots of which one may be the vehicle.
    robots: Vec<String>,
    parameters: Vec<Parameter>,
}

struct WrittenSession {
    name: String,
    files: Vec<String>,
}

struct WrittenRole {
    name: &'static str,
    single: bool,
    topics: Vec<WrittenTopic>,
    /// Message types that play it.
    types: String,
}

struct WrittenTopic {
    name: String,
    kind: String,
}

struct Parameter {
    name: &'static str,
    doc: Vec<String>,
    example: String,
}

/// The manifest of sessions.
///
/// # Errors
/// A bug fault, should it not be written.
pub async fn written(
    dataset: &Dataset,
    frames: &CoordinateFrames,
    context: &SessionContext,
) -> Result<String, Fault> {
    let registry = operators::registry();
    let mask = mask(dataset, frames, context).await;
    let named = |(name, example): (&'static str, Option<&str>)| {
        let (doc, default) = parameter(&registry, name)?;
        Some(Parameter {
            name,
            doc: wrapped(&doc, WIDTH),
            example: match (name, example) {
                (MASK, _) => mask.clone(),
                (_, example) => example.map_or(default, str::to_owned),
            },
        })
    };
    let vehicle_doc = parameter(&registry, "vehicle_frame");
    let written = ManifestText {
        sessions: dataset.sessions.iter().map(session).collect(),
        roles: roles_of(dataset),
        vehicle: frames.vehicle().map(yaml),
        vehicle_doc: wrapped(&vehicle_doc.unwrap_or_default().0, WIDTH),
        names: frames.names().into_iter().map(str::to_owned).collect(),
        robots: frames.robots.iter().map(|frame| yaml(frame)).collect(),
        parameters: OF_VEHICLE.into_iter().filter_map(named).collect(),
    };
    let text = written.render();
    text.map_err(|error| Fault::bug(error.to_string()))
}

/// A mask of the first camera: the lowest quarter of its images, where calibrations say how large they are.
async fn mask(dataset: &Dataset, frames: &CoordinateFrames, context: &SessionContext) -> String {
    let Some(first) = frames.cameras.first() else {
        return mask_of("front", [1280, 960]);
    };
    let sessions = dataset.sessions.iter();
    let calibrations = sessions.flat_map(|session| session.roles.topics("calibration"));
    let calibrations: BTreeSet<&String> = calibrations.collect();
    let size = image_size(context, &first.camera, calibrations).await;
    mask_of(&first.camera, size.unwrap_or([1280, 960]))
}

fn mask_of(camera: &str, [width, height]: [u32; 2]) -> String {
    let top = height - height / 4;
    let camera = yaml(camera);
    format!("{{ {camera}: [[[0, {top}], [{width}, {top}], [{width}, {height}], [0, {height}]]] }}")
}

fn session(session: &Session) -> WrittenSession {
    let files = session.parts.iter().map(|part| yaml(&absolute(&part.url)));
    WrittenSession {
        name: yaml(&session.name),
        files: files.collect(),
    }
}

/// A manifest may be kept anywhere.
fn absolute(url: &str) -> String {
    match std::path::absolute(Path::new(url)) {
        Ok(path) if !url.contains("://") => path.to_string_lossy().into_owned(),
        _ => url.to_owned(),
    }
}

fn roles_of(dataset: &Dataset) -> Vec<WrittenRole> {
    let kinds: BTreeMap<String, String> = dataset
        .sessions
        .iter()
        .flat_map(Session::message_types)
        .collect();
    let written = roles::ALL.iter().filter_map(|role| {
        let messages = role.messages()?;
        let sessions = dataset.sessions.iter();
        let topics: BTreeSet<&String> = sessions
            .flat_map(|session| session.roles.topics(role.name))
            .collect();
        let topics = topics.into_iter().map(|topic| WrittenTopic {
            name: yaml(topic),
            kind: kinds.get(topic).cloned().unwrap_or_default(),
        });
        let topics: Vec<WrittenTopic> = topics.collect();
        Some(WrittenRole {
            name: role.name,
            single: messages.single && topics.len() == 1,
            topics,
            types: messages.types.join(", "),
        })
    });
    written.collect()
}

/// Meaning and default of a parameter, as the first operator says that has it.
fn parameter(registry: &Registry, name: &str) -> Option<(String, String)> {
    registry.entries().find_map(|entry| {
        let parameter = entry.params_schema.get("properties")?.get(name)?;
        let doc = parameter.get("description")?.as_str()?;
        let default = parameter.get("default").map(ToString::to_string);
        Some((doc.to_owned(), default.unwrap_or_default()))
    })
}

/// Text as YAML takes it for text: as it is where nothing in it could mean anything else, else as JSON has it.
fn yaml(text: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "/_.-:".contains(c);
    let begins = text.starts_with(|c: char| c.is_ascii_alphabetic() || c == '/');
    let means = ["true", "false", "null", "yes", "no", "on", "off", "y", "n"];
    let is_word = means.contains(&text.to_ascii_lowercase().as_str());
    match begins && text.chars().all(plain) && !text.ends_with(':') && !is_word {
        true => text.to_owned(),
        false => serde_json::Value::from(text).to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_yaml_would_take_for_something_else_is_quoted() {
        for text in [
            "/odom",
            "base_link",
            "2024-01-01",
            "no",
            "a: b",
            "#1",
            "",
            "a b",
            "ü",
            "x:",
            "-",
        ] {
            let written = format!("site: {}", yaml(text));
            let read = evermap_datasets::Manifest::parse(&written).map(|manifest| manifest.site);
            assert_eq!(read.ok().flatten().as_deref(), Some(text), "{written}");
        }
        assert_eq!(yaml("/odom"), "/odom");
    }

    #[test]
    fn the_example_of_a_mask_is_one_of_the_camera_and_its_size() {
        let said = "{ front_left: [[[0, 360], [640, 360], [640, 480], [0, 480]]] }";
        assert_eq!(mask_of("front_left", [640, 480]), said);
        assert!(mask_of("a: b", [4, 4]).starts_with("{ \"a: b\": [[[0, 3]"));
    }

    #[test]
    fn every_parameter_of_a_vehicle_is_one_of_an_operator() {
        let registry = operators::registry();
        for (name, example) in OF_VEHICLE {
            let found = parameter(&registry, name);
            assert!(
                found.is_some_and(|(_, default)| example.is_some() || !default.is_empty()),
                "{name}"
            );
        }
    }

    #[test]
    fn text_is_folded_between_words() {
        let words = "word ".repeat(60);
        let lines = wrapped(&words, WIDTH);
        assert_eq!(lines.len(), 3);
        assert_eq!(lines.join(" "), words.trim());
    }
}
