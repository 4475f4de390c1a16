//! The vocabulary the tests write plans with: parameters of every kind schemars derives.
#![allow(dead_code, clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use evermap_language::{
    Host, OperatorSpec, ParameterFault, PortSpec, QueryFault, Source, Vocabulary,
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;

/// A frame every so many metres.
#[derive(Debug, Serialize, Deserialize, JsonSchema, PartialEq)]
#[serde(default, deny_unknown_fields)]
pub struct Keyframes {
    /// Driven path between keyframes, m.
    #[schemars(extend("exclusiveMinimum" = 0.0, "maximum" = 100.0))]
    pub baseline_m: f64,
    pub most_frames: Option<u32>,
    pub cameras: Vec<String>,
}

impl Default for Keyframes {
    fn default() -> Self {
        Self {
            baseline_m: 0.2,
            most_frames: None,
            cameras: Vec::new(),
        }
    }
}

#[derive(Debug, Serialize, Deserialize, JsonSchema, PartialEq, Default)]
#[serde(rename_all = "snake_case")]
pub enum Weighting {
    /// All pixels alike.
    #[default]
    Uniform,
    /// By the angle of view.
    ViewingAngle,
}

#[derive(Debug, Serialize, Deserialize, JsonSchema, PartialEq)]
#[serde(tag = "model", rename_all = "snake_case")]
pub enum Camera {
    Pinhole { fx_px: f64, fy_px: f64 },
    Equirectangular { width_px: u16 },
}

#[derive(Debug, Serialize, Deserialize, JsonSchema, PartialEq)]
#[serde(rename_all = "snake_case")]
pub enum Grid {
    Square { cell_m: f64 },
    Hexagonal(f64),
    None,
}

#[derive(Debug, Serialize, Deserialize, JsonSchema, PartialEq, Default)]
#[serde(default, deny_unknown_fields)]
pub struct Tiles {
    pub weighting: Weighting,
    pub camera: Option<Camera>,
    pub grid: Option<Grid>,
    pub extent: Extent,
    pub origin_m: [f64; 3],
    pub zooms: Vec<u8>,
}

#[derive(Debug, Serialize, Deserialize, JsonSchema, PartialEq, Default)]
#[serde(default, deny_unknown_fields)]
pub struct Extent {
    pub width_m: f64,
    pub height_m: f64,
    pub clip: bool,
}

/// Lanes from poses.
#[derive(Debug, Serialize, Deserialize, JsonSchema, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct Roads {
    #[schemars(range(min = 0.1))]
    pub connect_m: f64,
    #[serde(default = "three")]
    pub prune_loops: u32,
}

fn three() -> u32 {
    3
}

fn operator<P: JsonSchema>(name: &str, ports: &[(&str, bool)]) -> OperatorSpec {
    let port = |(name, optional): &(&str, bool)| PortSpec {
        name: (*name).to_owned(),
        optional: *optional,
    };
    OperatorSpec {
        name: name.to_owned(),
        ports: ports.iter().map(port).collect(),
        params: schemars::schema_for!(P).to_value(),
    }
}

pub fn vocabulary() -> Vocabulary {
    let names = ["frames", "odometry", "calibration", "sessions", "poses"];
    Vocabulary {
        operators: vec![
            operator::<Keyframes>("keyframes", &[("odometry", false), ("frames", false)]),
            operator::<Tiles>(
                "overhead_tiles",
                &[("patches", false), ("calibration", true)],
            ),
            operator::<Roads>("road_network", &[("poses", false), ("lanes", true)]),
        ],
        sources: names.map(str::to_owned).to_vec(),
        open_sources: true,
        map_tables: vec!["columns".to_owned(), "runs".to_owned()],
    }
}

/// Stands for a SQL parser: the word after each FROM or JOIN.
pub fn sql_tables(query: &str) -> Result<Vec<String>, QueryFault> {
    let words: Vec<&str> = query.split_whitespace().collect();
    if !words
        .first()
        .is_some_and(|word| word.eq_ignore_ascii_case("select"))
    {
        return Err(QueryFault {
            message: "SQL: expected SELECT\nat the start".to_owned(),
            at: Some((1, 1)),
        });
    }
    Ok(words
        .windows(2)
        .filter(|pair| pair[0] == "FROM" || pair[0] == "JOIN")
        .map(|pair| pair[1].trim_matches(['"', ',', ';']).to_owned())
        .collect())
}

/// Plans by name and text; none lies beside another.
#[derive(Default)]
pub struct Plans<'p>(pub Vec<(&'p str, &'p str)>);

impl Host for Plans<'_> {
    fn tables(&self, query: &str) -> Result<Vec<String>, QueryFault> {
        sql_tables(query)
    }

    /// Types and least values, of parameters that are there.
    fn parameter_faults(&self, operator: &str, params: &Value) -> Vec<ParameterFault> {
        let schema = vocabulary().operator(operator).unwrap().params.clone();
        let fault = |(name, value): (&String, &Value)| {
            let message = match schema["properties"].get(name) {
                None => format!("no parameter `{name}`"),
                Some(schema) => {
                    let expected = expected(schema, value)?;
                    format!("expected `{name}` {expected}, found {value}")
                }
            };
            Some(ParameterFault {
                parameter: name.clone(),
                entry: String::new(),
                message,
            })
        };
        let params = params.as_object().unwrap();
        params.iter().filter_map(fault).collect()
    }

    fn plan(&self, name: &str, extended_by: &str) -> Result<Source, String> {
        let found = self.0.iter().find(|(known, _)| *known == name);
        let (name, text) =
            found.ok_or(format!("{extended_by} extends {name}, which is nowhere"))?;
        let (origin, text) = (format!("{name}.yaml"), (*text).to_owned());
        Ok(Source { origin, text })
    }

    fn code(&self, path: &str, named_by: &str) -> Result<String, String> {
        match path {
            "steps.py" => Ok("def whole(poses):\n    return poses\n".to_owned()),
            _ => Err(format!("cannot read {path} beside {named_by}")),
        }
    }
}

/// What a schema asks for that a value is not.
fn expected(schema: &Value, value: &Value) -> Option<String> {
    if schema["type"] == "number" && !value.is_number() {
        return Some("number".to_owned());
    }
    let above = |key: &str| schema[key].as_f64().zip(value.as_f64());
    if let Some((least, _)) = above("minimum").filter(|(least, value)| value < least) {
        return Some(format!("from {least}"));
    }
    let least = above("exclusiveMinimum").filter(|(least, value)| value <= least);
    least.map(|(least, _)| format!("above {least}"))
}

pub fn source(origin: &str, text: &str) -> Source {
    Source {
        origin: origin.to_owned(),
        text: text.to_owned(),
    }
}
