//! `label_views [JSON] [VIEWS]`: how long label panoramas of a street take, one thread.

use evermap_worlds::{LabelKind, Street, street_labels};
use std::io::Write;
use std::time::Instant;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let json = arguments.next().unwrap_or_else(|| "{}".to_owned());
    let world: Street = serde_json::from_str(&json)?;
    let views: usize = arguments.next().map_or(Ok(50), |text| text.parse())?;
    let mut stdout = std::io::stdout();
    let begun = Instant::now();
    let labels = street_labels(&world)?;
    writeln!(
        stdout,
        "a street of {} m: {:.2} s",
        world.length_m,
        begun.elapsed().as_secs_f64()
    )?;
    let step = (labels.len() / views.max(1)).max(1);
    for kind in [LabelKind::Exact, LabelKind::WithoutCars, LabelKind::Noisy] {
        let mut times: Vec<f64> = (0..labels.len())
            .step_by(step)
            .map(|index| {
                let begun = Instant::now();
                let view = labels.view(0, index, kind);
                std::hint::black_box(view);
                begun.elapsed().as_secs_f64() * 1e3
            })
            .collect();
        times.sort_by(f64::total_cmp);
        let (least, middle) = (times[0], times[times.len() / 2]);
        writeln!(
            stdout,
            "{kind:?}: median {middle:.1} ms, least {least:.1} ms a view"
        )?;
    }
    Ok(())
}
