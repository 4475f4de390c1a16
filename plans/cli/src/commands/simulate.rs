//! `evermap simulate`.

use evermap_engine::sql::Term;
use evermap_schemas::{Fault, batch, record};
use evermap_worlds::{
    CarPark, Progress as Images, RecordingError, Stopped, Street, Summary, WorldError, car_park,
    street,
};
use serde::de::DeserializeOwned;
use serde_json::{Map, Value};
use std::path::Path;

use crate::arguments::SimulateArgs;
use crate::ending::{DONE, Ending, Failure};
use crate::output::{Format, outside_of_maps, print_batch};
use crate::progress::{Progress, line};

record! {
    /// One simulated session.
    #[layer("simulated", key(session))]
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

/// Writes a world.
///
/// # Errors
/// A user fault for parameters that make no world, a resource fault when files cannot be written.
pub async fn simulate(args: &SimulateArgs) -> Ending {
    let write = writer(args)?;
    outside_of_maps(&args.out)?;
    let mut progress = Progress::new(args.progress);
    let mut total = None;
    // Rendering keeps every core busy for minutes: the runtime must know that this thread is taken.
    // So it does not pause either, and asks whether it was stopped.
    let term = Term::of_task();
    let summary = tokio::task::block_in_place(|| {
        let tell = &mut |now: Images| {
            if total.replace(now.all_images_total) != Some(now.all_images_total) {
                progress.expect(now.all_images_total as u64);
            }
            progress.at(now.all_images as u64, &now.session);
        };
        write(&args.out, tell, &|| term.is_over())
    });
    progress.finish();
    let summary = summary.map_err(fault)?;
    line(&format!("the truth is in {}", summary.truth.display()));
    if let Some(annotations) = &summary.annotations {
        line(&format!("the annotations are in {}", annotations.display()));
    }
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

/// Writes a world into a folder.
type Writer =
    Box<dyn FnOnce(&Path, &mut dyn FnMut(Images), &Stopped<'_>) -> Result<Summary, WorldError>>;

/// What writes the world of this name with its parameters.
fn writer(args: &SimulateArgs) -> Result<Writer, Failure> {
    Ok(if args.world == "street" {
        let world: Street = parameters(args)?;
        Box::new(move |out, progress, is_stopped| street(&world, out, progress, is_stopped))
    } else {
        let world: CarPark = parameters(args)?;
        Box::new(move |out, progress, is_stopped| car_park(&world, out, progress, is_stopped))
    })
}

/// A world's parameters: the defaults, with what the command line says in their place. The world itself holds the
/// values to their ranges.
fn parameters<W: DeserializeOwned>(args: &SimulateArgs) -> Result<W, Failure> {
    let mut given = Map::new();
    for setting in &args.set {
        let (name, value) = setting.split_once('=').ok_or_else(|| {
            Fault::user(format!("--set {setting} sets nothing")).next("write --set parameter=value")
        })?;
        let value = serde_json::from_str(value).unwrap_or_else(|_| Value::String(value.to_owned()));
        given.insert(name.to_owned(), value);
    }
    let counts = [("revisits", args.revisits), ("visits", args.visits)];
    let counts = counts.map(|(name, count)| (name, count.map(|count| count as u64)));
    for (name, number) in counts.into_iter().chain([("seed", args.seed)]) {
        given.extend(number.map(|number| (name.to_owned(), number.into())));
    }
    // One by one, so that a fault tells which one is wrong.
    for (name, value) in &given {
        let alone = Map::from_iter([(name.clone(), value.clone())]);
        serde_json::from_value::<W>(alone.into()).map_err(|error| {
            Fault::user(error.to_string()).at(format!("{} of {}", name, args.world))
        })?;
    }
    let world = serde_json::from_value(given.into());
    Ok(world.map_err(|error| Fault::bug(error.to_string()))?)
}

fn fault(error: WorldError) -> Fault {
    match &error {
        WorldError::Parameters { .. }
        | WorldError::Stopped
        | WorldError::File(RecordingError::Kept { .. } | RecordingError::Folder { .. }) => {
            Fault::user(error.to_string())
        }
        WorldError::File(RecordingError::Io { .. }) => Fault::resource(error.to_string()),
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
        let found: CarPark = parameters(&args(&["loops=0.5", "width_px=320"])).unwrap();
        let expected = CarPark {
            seed: 7,
            loops: 0.5,
            width_px: 320,
            ..CarPark::default()
        };
        assert_eq!(found, expected);
    }

    #[test]
    fn each_world_has_parameters_of_its_own() {
        let three = SimulateArgs {
            visits: Some(3),
            ..args(&["length_m=120", "colour=false"])
        };
        let expected = Street {
            seed: 7,
            visits: 3,
            length_m: 120.0,
            colour: false,
            ..Street::default()
        };
        assert_eq!(parameters::<Street>(&three).unwrap(), expected);
        let revisited = SimulateArgs {
            world: "street".into(),
            revisits: Some(1),
            ..three
        };
        let Err(Failure::Fault(fault)) = writer(&revisited) else {
            panic!()
        };
        let fault = fault.to_string();
        assert!(fault.contains("unknown field `revisits`"), "{fault}");
    }

    #[test]
    fn parameters_that_make_no_sense_are_refused() {
        for (setting, says) in [
            ("lops=1", "unknown field `lops`, expected one of `seed`"),
            ("loops", "sets nothing"),
            ("loops=x", "expected f64 (at loops of car_park)"),
            ("occupancy=2", "expected 0 to 1"),
        ] {
            let folder = Path::new("nowhere");
            let refused = match writer(&args(&[setting])) {
                Err(Failure::Fault(fault)) => fault,
                Ok(write) => fault(write(folder, &mut |_| {}, &|| false).unwrap_err()),
                Err(_) => panic!("{setting}"),
            };
            assert!(refused.to_string().contains(says), "{refused}");
            assert!(!folder.exists());
        }
    }
}
