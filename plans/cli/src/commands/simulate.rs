//! `evermap simulate`.

use evermap_schemas::{Fault, LayerRow, batch, record};
use evermap_worlds::{CarPark, Progress as Images, Street, Summary, WorldError, car_park, street};
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::Value;
use std::path::Path;

use crate::arguments::SimulateArgs;
use crate::ending::{DONE, Ending, Failure};
use crate::output::{Format, print_batch};
use crate::progress::{Progress, line};

record! {
    /// One simulated session.
    pub struct Simulated {
        /// Session.
        session: String,
        /// File.
        path: String,
        /// Images of each camera.
        shots: u64,
        /// Messages.
        messages: u64,
        /// Size.
        bytes: u64 ["B"],
        /// Driven path.
        driven_m: f64 ["m"],
        /// Length.
        duration_s: f64 ["s"],
    }
}
impl LayerRow for Simulated {
    const NAME: &'static str = "simulated";
    const DOC: &'static str = "One simulated session.";
    const KEY: &'static [&'static str] = &["session"];
}

/// Writes a world.
///
/// # Errors
/// A user fault for parameters that make no world, a resource fault when files cannot be written.
pub async fn simulate(args: &SimulateArgs) -> Ending {
    let world = world(args)?;
    let mut progress = Progress::new(args.progress, 0);
    let mut total = None;
    // Rendering keeps every core busy for minutes: the runtime must know that this thread is taken.
    let summary = tokio::task::block_in_place(|| {
        world.write(&args.out, &mut |now| {
            if total.replace(now.all_images_total) != Some(now.all_images_total) {
                progress.expect(now.all_images_total as u64);
            }
            progress.at(now.all_images as u64, &now.session);
        })
    });
    progress.finish();
    let summary = summary.map_err(fault)?;
    line(&format!("the truth is in {}", summary.truth.display()));
    let rows = summary.sessions.into_iter().map(|session| Simulated {
        session: session.name,
        path: session.path.display().to_string(),
        shots: session.shots as u64,
        messages: session.messages,
        bytes: session.bytes,
        driven_m: (session.driven_m * 1e3).round() / 1e3,
        duration_s: (session.duration_s * 1e3).round() / 1e3,
    });
    let rows = batch(rows.collect::<Vec<_>>())?;
    print_batch(Format::Table, rows).await?;
    DONE
}

/// A world that can be simulated.
#[derive(Debug, PartialEq)]
enum World {
    CarPark(CarPark),
    Street(Street),
}

impl World {
    fn write(&self, out: &Path, progress: &mut dyn FnMut(Images)) -> Result<Summary, WorldError> {
        match self {
            Self::CarPark(world) => car_park(world, out, progress),
            Self::Street(world) => street(world, out, progress),
        }
    }
}

/// The world of this name with its parameters.
fn world(args: &SimulateArgs) -> Result<World, Failure> {
    let world = if args.world == "street" {
        World::Street(parameters(args)?)
    } else {
        World::CarPark(parameters(args)?)
    };
    let checked = match &world {
        World::CarPark(world) => world.check(),
        World::Street(world) => world.check(),
    };
    checked.map_err(fault)?;
    Ok(world)
}

/// A world's parameters: the defaults, with what the command line says in their place.
fn parameters<W: Default + Serialize + DeserializeOwned>(
    args: &SimulateArgs,
) -> Result<W, Failure> {
    let bug = |error: serde_json::Error| Fault::bug(error.to_string());
    let mut parameters = serde_json::to_value(W::default()).map_err(bug)?;
    let Some(fields) = parameters.as_object_mut() else {
        return Err(Fault::bug("a world without parameters").into());
    };
    let mut given = Vec::new();
    for setting in &args.set {
        let (name, value) = setting.split_once('=').ok_or_else(|| {
            Fault::user(format!("--set {setting} sets nothing")).next("write --set parameter=value")
        })?;
        let value = serde_json::from_str(value).unwrap_or_else(|_| Value::String(value.to_owned()));
        given.push((name, value));
    }
    given.extend(args.seed.map(|seed| ("seed", seed.into())));
    given.extend(args.revisits.map(|revisits| ("revisits", revisits.into())));
    given.extend(args.visits.map(|visits| ("visits", visits.into())));
    for (name, value) in given {
        let Some(field) = fields.get_mut(name) else {
            let known: Vec<_> = fields.keys().map(String::as_str).collect();
            return Err(
                Fault::user(format!("{} has no parameter {name}", args.world))
                    .next(format!("it has {}", known.join(", ")))
                    .into(),
            );
        };
        *field = value;
    }
    let world = serde_json::from_value(parameters)
        .map_err(|error| Fault::user(format!("parameters of {}: {error}", args.world)))?;
    Ok(world)
}

fn fault(error: WorldError) -> Fault {
    match &error {
        WorldError::Parameters { .. } => Fault::user(error.to_string()),
        WorldError::Io { .. } => Fault::resource(error.to_string()),
        _ => Fault::bug(error.to_string()),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::panic)]
    use super::*;
    use crate::progress::Show;

    fn args(set: &[&str]) -> SimulateArgs {
        SimulateArgs {
            world: "car_park".into(),
            out: "nowhere".into(),
            seed: Some(7),
            revisits: None,
            visits: None,
            set: set.iter().map(ToString::to_string).collect(),
            progress: Show::None,
        }
    }

    #[test]
    fn parameters_replace_the_defaults() {
        let found = world(&args(&["loops=0.5", "width_px=320"])).unwrap();
        assert_eq!(
            found,
            World::CarPark(CarPark {
                seed: 7,
                loops: 0.5,
                width_px: 320,
                ..CarPark::default()
            })
        );
    }

    #[test]
    fn each_world_has_parameters_of_its_own() {
        let street = SimulateArgs {
            world: "street".into(),
            visits: Some(3),
            ..args(&["length_m=120", "colour=false"])
        };
        assert_eq!(
            world(&street).unwrap(),
            World::Street(Street {
                seed: 7,
                visits: 3,
                length_m: 120.0,
                colour: false,
                ..Street::default()
            })
        );
        let revisited = SimulateArgs {
            revisits: Some(1),
            ..street
        };
        let Err(Failure::Fault(fault)) = world(&revisited) else {
            panic!()
        };
        assert!(
            fault
                .to_string()
                .contains("street has no parameter revisits")
        );
    }

    #[test]
    fn parameters_that_make_no_sense_are_refused() {
        for (setting, says) in [
            ("lops=1", "no parameter lops"),
            ("loops", "sets nothing"),
            ("loops=x", "parameters of"),
            ("occupancy=2", "expected 0 to 1"),
        ] {
            let Err(Failure::Fault(fault)) = world(&args(&[setting])) else {
                panic!("{setting}")
            };
            assert!(fault.to_string().contains(says), "{fault}");
        }
    }
}
