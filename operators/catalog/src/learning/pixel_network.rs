#![doc = include_str!("pixel_network.md")]

use evermap_algorithms::learning::perceptron::{NetworkOptions, Perceptron, train};
use evermap_contract::{Emit, Fault, Key, Operator, Port, Sides, Work};
use evermap_schemas::layers::{PixelPerceptron, PixelSamples};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::inputs::samples::SiteSamples;

/// See the module's page.
pub struct PixelNetwork;

/// How the network is learnt.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct PixelNetworkParams {
    /// How each member is learnt.
    #[serde(flatten)]
    pub network: NetworkOptions,
    /// Stretches of each session, of which each member holds one out; 1: none is held out.
    #[schemars(range(min = 1, max = 10_000))]
    pub blocks: u32,
}

impl Default for PixelNetworkParams {
    fn default() -> Self {
        let network = NetworkOptions::default();
        Self {
            network,
            blocks: network.members,
        }
    }
}

impl Operator for PixelNetwork {
    const NAME: &'static str = "pixel_network";
    const VERSION: u32 = 2;
    const PAGE: &'static str = include_str!("pixel_network.md");
    type Params = PixelNetworkParams;
    type Output = PixelPerceptron;

    fn work() -> Work<Self::Params> {
        let samples = Port::site::<PixelSamples>("samples");
        Work::group(samples, Key::SITE, vec![], network)
    }
}

fn network(
    params: &PixelNetworkParams,
    samples: Vec<PixelSamples>,
    _: Sides,
    emit: &mut Emit<'_>,
) -> Result<(), Fault> {
    let site = samples[0].site.clone();
    let all = SiteSamples::of(samples, params.blocks, emit);
    let priors = all.priors();
    let row = |(member, learnt): (usize, Perceptron)| PixelPerceptron {
        site: site.clone(),
        member: member as u32,
        classes: all.classes.clone(),
        features: all.features.clone(),
        hidden_weights: learnt.hidden,
        hidden_biases: learnt.hidden_biases,
        output_weights: learnt.output,
        output_biases: learnt.output_biases,
        priors: priors.clone(),
        held_out: all.parts(learnt.held_out),
    };
    let members = train(&all.samples(), &params.network);
    let rows: Vec<PixelPerceptron> = members.into_iter().enumerate().map(row).collect();
    emit.rows(rows)
}
