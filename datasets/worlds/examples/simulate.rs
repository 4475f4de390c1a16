//! `simulate OUT [JSON]`: writes a car park; the parameters may be given as JSON.

use evermap_worlds::{CarPark, car_park};
use std::io::Write;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let out = arguments.next().ok_or("expected: simulate OUT [JSON]")?;
    let world: CarPark = match arguments.next() {
        Some(json) => serde_json::from_str(&json)?,
        None => CarPark::default(),
    };
    let begun = std::time::Instant::now();
    let mut shown = 0;
    let summary = car_park(&world, out.as_ref(), &mut |progress| {
        let percent = 100 * progress.all_images / progress.all_images_total.max(1);
        if percent > shown {
            shown = percent;
            let line = format!("\r{percent:3} % {}", progress.session);
            let _ = std::io::stderr().write_all(line.as_bytes());
        }
    })?;
    let mut stdout = std::io::stdout();
    writeln!(stdout)?;
    for session in &summary.sessions {
        writeln!(stdout, "{session:?}")?;
    }
    writeln!(stdout, "{:.1} s", begun.elapsed().as_secs_f64())?;
    Ok(())
}
