//! `simulate WORLD OUT [JSON]`: writes a `car_park` or a `street`; the parameters may be given as JSON.

use evermap_worlds::{Progress, car_park, street};
use std::io::Write;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    const USAGE: &str = "expected: simulate car_park|street OUT [JSON]";
    let mut arguments = std::env::args().skip(1);
    let world = arguments.next().ok_or(USAGE)?;
    let out = std::path::PathBuf::from(arguments.next().ok_or(USAGE)?);
    let json = arguments.next().unwrap_or_else(|| "{}".to_owned());
    let begun = std::time::Instant::now();
    let mut shown = 0;
    let mut tell = |progress: Progress| {
        let percent = 100 * progress.all_images / progress.all_images_total.max(1);
        if percent > shown {
            shown = percent;
            let line = format!("\r{percent:3} % {}", progress.session);
            let _ = std::io::stderr().write_all(line.as_bytes());
        }
    };
    let summary = match world.as_str() {
        "car_park" => car_park(&serde_json::from_str(&json)?, &out, &mut tell)?,
        "street" => street(&serde_json::from_str(&json)?, &out, &mut tell)?,
        _ => return Err(USAGE.into()),
    };
    let mut stdout = std::io::stdout();
    writeln!(stdout)?;
    for session in &summary.sessions {
        writeln!(stdout, "{session:?}")?;
    }
    writeln!(stdout, "{:.1} s", begun.elapsed().as_secs_f64())?;
    Ok(())
}
