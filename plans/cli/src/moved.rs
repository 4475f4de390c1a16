//! What changed since an earlier version, to draw: the rows of `diff` of the layers that a picture shows; and labels as all
//! versions place them.

use evermap_engine::map::version::Version;
use evermap_engine::quoted;
use evermap_schemas::{Fault, Geometry, Wkb, record};

use crate::draw::{Changes, Placings};
use crate::reader::{MapReader, typed};

/// Layers that are compared: those that stand for what people and planners rely on.
const COMPARED: [&str; 5] = [
    "poses",
    "lanes",
    "intersections",
    "parking_spaces",
    "placed_labels",
];

record! {
    /// A row of `diff` that is not the same in both versions.
    #[layer("changed_rows", key(change))]
    pub struct ChangedRow {
        /// `added`, `removed` or `changed`.
        change: String,
        /// Where it is, or was.
        geometry: Option<Wkb>,
        /// Where it was; null where it is new.
        geometry_before: Option<Wkb>,
    }
}

/// What changed of a site since a version.
///
/// # Errors
/// A user fault for a version that there is not; what reading says.
pub async fn changes(reader: &MapReader, site: &str, since: u64) -> Result<Changes, Fault> {
    let version = reader.map.version.version;
    let mut changes = Changes {
        since,
        ..Changes::default()
    };
    for layer in COMPARED.into_iter().filter(|layer| reader.map.has(layer)) {
        let query = format!(
            "SELECT change, geometry, geometry_before FROM diff('{layer}', {since}, {version})
             WHERE change <> 'same' AND site = {}",
            quoted::text(site)
        );
        let rows = reader.ask(&query).await.map_err(|fault| fault.at(layer))?;
        for row in typed::<ChangedRow>(&rows)? {
            add(&mut changes, &row)?;
        }
    }
    Ok(changes)
}

/// Labels of a site as versions of the map at this address place them: from one of them on, else from the oldest, to the one
/// that is read.
///
/// # Errors
/// A user fault for a version that there is not; what reading says.
pub async fn placings(
    reader: &MapReader,
    address: &str,
    site: &str,
    since: Option<u64>,
) -> Result<Placings, Fault> {
    if since.is_some() {
        MapReader::open(address, since).await?;
    }
    let newest = reader.map.version.version;
    let numbers = Version::numbers(&reader.map.store).await?;
    let mut placings = Placings::new();
    for number in numbers {
        if (since.unwrap_or(0)..=newest).contains(&number) {
            let version = MapReader::open(address, Some(number)).await?;
            placings.insert(number, version.rows(Some(site)).await?);
        }
    }
    Ok(placings)
}

fn add(changes: &mut Changes, row: &ChangedRow) -> Result<(), Fault> {
    let (after, before) = (
        lines(row.geometry.as_ref())?,
        lines(row.geometry_before.as_ref())?,
    );
    match row.change.as_str() {
        "added" => changes.new.extend(after),
        "removed" => changes.gone.extend(before),
        _ if corners(&after) == corners(&before) => {
            let pairs = before.iter().flatten().zip(after.iter().flatten());
            changes.moved.extend(pairs.map(|(from, to)| [*from, *to]));
        }
        // No point of one is a point of the other.
        _ => {
            changes.gone.extend(before);
            changes.new.extend(after);
        }
    }
    Ok(())
}

/// How many points each line has.
fn corners(lines: &[Vec<[f64; 2]>]) -> Vec<usize> {
    lines.iter().map(Vec::len).collect()
}

fn lines(shape: Option<&Wkb>) -> Result<Vec<Vec<[f64; 2]>>, Fault> {
    let shape = shape.map(Wkb::geometry).transpose()?;
    let paths = shape.iter().flat_map(Geometry::paths);
    let lines = paths.map(|path| path.iter().map(|point| [point.x, point.y]).collect());
    Ok(lines.collect())
}
