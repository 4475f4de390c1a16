#![doc = include_str!("danger_settings.md")]

use std::collections::BTreeMap;

use evermap_contract::{Emit, Fault, Key, Operator, Port, Sides, Work};
use evermap_schemas::layers::{DangerSetting, Exposure, GroundPrior};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::inputs::danger::{LANE, OTHER, ports, site_ground, too_large};

/// See the module's page.
pub struct DangerSettings;

/// What is thought of ground before anybody was seen on it.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct DangerSettingsParams {
    /// Probability that somebody is in one cell in one look, by kind of ground: kinds of labels, `lane`, and `other` for all
    /// the rest.
    pub expected: BTreeMap<String, f64>,
}

impl Default for DangerSettingsParams {
    fn default() -> Self {
        let expected = [
            ("crossing", 0.02),
            (LANE, 5e-4),
            (OTHER, 5e-4),
            ("parking_space", 2e-4),
        ];
        let named = |(kind, probability): (&str, f64)| (kind.to_owned(), probability);
        Self {
            expected: expected.into_iter().map(named).collect(),
        }
    }
}

impl Operator for DangerSettings {
    const NAME: &'static str = "danger_settings";
    const VERSION: u32 = 1;
    const PAGE: &'static str = include_str!("danger_settings.md");
    type Params = DangerSettingsParams;
    type Output = DangerSetting;

    fn work() -> Work<Self::Params> {
        let exposure = Port::site::<Exposure>("exposure");
        Work::group(exposure, Key::SITE, ports(), settings)
    }

    fn check(params: &Self::Params) -> Result<(), Fault> {
        let wrong = |message: String| Err(Fault::user(message));
        if !params.expected.contains_key(OTHER) {
            return wrong(format!("`expected` must have the kind {OTHER}"));
        }
        let outside = |probability: &f64| !(*probability > 0.0 && *probability < 1.0);
        match params.expected.iter().find(|(_, found)| outside(found)) {
            Some((kind, found)) => wrong(format!(
                "`expected.{kind}` must be above 0 and below 1, found {found}"
            )),
            None => Ok(()),
        }
    }
}

fn settings(
    params: &DangerSettingsParams,
    exposure: Vec<Exposure>,
    sides: Sides,
    emit: &mut Emit<'_>,
) -> Result<(), Fault> {
    let of_site = site_ground(&params.expected, exposure, &sides, emit)?;
    let mut ground = of_site.ground;
    let learnt = ground.learn().map_err(too_large)?;
    let all = ground.all();
    let with_people = all.iter().filter(|visit| ground.peopled(&[**visit]));
    let priors = of_site.names.into_iter().zip(params.expected.values());
    let prior = |((kind, expected), probability): ((_, &f64), f64)| GroundPrior {
        kind,
        expected: *expected,
        probability,
    };
    let foretold = learnt.foretold;
    let setting = DangerSetting {
        site: of_site.site,
        visits: all.len() as u32,
        visits_with_people: with_people.count() as u32,
        priors: priors.zip(learnt.priors).map(prior).collect(),
        prior_looks: learnt.weights.prior_looks,
        tie_looks: learnt.weights.tie_looks,
        foretold_looks: foretold.map_or(0.0, |found| found.looks),
        log_likelihood: foretold.map(|found| found.map),
        log_likelihood_of_expected: foretold.map(|found| found.prior),
        log_likelihood_of_kinds: foretold.map(|found| found.kinds),
        log_likelihood_of_counts: foretold.map(|found| found.counts),
    };
    emit.rows(vec![setting])
}
