//! `evermap simulate`.

use evermap_schemas::{Fault, LayerRow, batch, record};
use evermap_worlds::{CarPark, WorldError, car_park};
use serde_json::Value;

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
        car_park(&world, &args.out, &mut |now| {
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

/// The world's parameters: the defaults, with what the command line says in their place.
fn world(args: &SimulateArgs) -> Result<CarPark, Failure> {
    let bug = |error: serde_json::Error| Fault::bug(error.to_string());
    let mut parameters = serde_json::to_value(CarPark::default()).map_err(bug)?;
    let Some(fields) = parameters.as_object_mut() else {
        return Err(Fault::bug("a world without parameters").into());
    };
    for setting in &args.set {
        let (name, value) = setting.split_once('=').ok_or_else(|| {
            Fault::user(format!("--set {setting} sets nothing")).next("write --set parameter=value")
        })?;
        if !fields.contains_key(name) {
            let known: Vec<_> = fields.keys().map(String::as_str).collect();
            return Err(
                Fault::user(format!("{} has no parameter {name}", args.world))
                    .next(format!("it has {}", known.join(", ")))
                    .into(),
            );
        }
        let value = serde_json::from_str(value).unwrap_or_else(|_| Value::String(value.to_owned()));
        fields.insert(name.to_owned(), value);
    }
    let given = [
        ("seed", args.seed.map(Value::from)),
        ("revisits", args.revisits.map(Value::from)),
    ];
    fields.extend(
        given
            .into_iter()
            .filter_map(|(name, value)| Some((name.to_owned(), value?))),
    );
    let world: CarPark = serde_json::from_value(parameters)
        .map_err(|error| Fault::user(format!("parameters of {}: {error}", args.world)))?;
    world.check().map_err(fault)?;
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
            set: set.iter().map(ToString::to_string).collect(),
            progress: Show::None,
        }
    }

    #[test]
    fn parameters_replace_the_defaults() {
        let found = world(&args(&["loops=0.5", "width_px=320"])).unwrap();
        assert_eq!(
            found,
            CarPark {
                seed: 7,
                loops: 0.5,
                width_px: 320,
                ..CarPark::default()
            }
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
