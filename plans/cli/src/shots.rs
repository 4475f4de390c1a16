//! Single images of cameras: what a map and its logs have of them.

use evermap_datasets::ImageReader;
use evermap_engine::map::Map;
use evermap_engine::quoted;
use evermap_engine::sql::{Limits, context};
use evermap_schemas::{Cell, Fault, ImageRef, LayerRow};

use crate::reader::{MapReader, answered, typed};
use crate::shown::Shot;

/// Views that a picture shows.
const VIEWS: usize = 3;

/// As many of a list as a picture shows, the same distance apart.
pub fn spread<T>(list: Vec<T>) -> impl Iterator<Item = T> {
    let step = list.len().div_ceil(VIEWS).max(1);
    list.into_iter().skip(step / 2).step_by(step)
}

/// What a layer of the map says of a shot; `None` where it has no such row.
///
/// # Errors
/// As [`MapReader::ask`].
pub async fn row<T: LayerRow>(reader: &MapReader, shot: &Shot) -> Result<Option<T>, Fault> {
    let Some(layer) = reader.layer_of::<T>() else {
        return Ok(None);
    };
    let (layer, condition) = (quoted::name(&layer), condition(shot));
    let query = format!("SELECT * FROM {layer} WHERE {condition}");
    let found = typed(&reader.ask(&query).await?)?;
    Ok(found.into_iter().next())
}

/// The condition for the rows of a shot.
fn condition(shot: &Shot) -> String {
    let [session, camera] = [&shot.session, &shot.camera].map(|name| quoted::text(name));
    let stamp = shot.stamp.0;
    format!("session = {session} AND camera = {camera} AND CAST(stamp AS BIGINT) = {stamp}")
}

/// The image from its log, if that is still where it was.
pub async fn image(map: &Map, shot: &Shot) -> Option<Vec<u8>> {
    match fetched(map, shot).await {
        Ok(image) => image,
        Err(fault) => {
            tracing::info!(%fault, session = shot.session, stamp = shot.stamp.0, "drawn without its image");
            None
        }
    }
}

async fn fetched(map: &Map, shot: &Shot) -> Result<Option<Vec<u8>>, Fault> {
    let context = context(Limits::default())?;
    let Some(dataset) = map.log(&shot.session, &context.runtime_env()).await? else {
        return Ok(None);
    };
    dataset.register(&context)?;
    let query = format!("SELECT image FROM frames WHERE {}", condition(shot));
    let batches = answered(&context, &query).await?;
    let Some(batch) = batches.iter().find(|batch| batch.num_rows() > 0) else {
        return Ok(None);
    };
    let images = ImageRef::decode(batch.column(0))?;
    let reader = ImageReader::new(&dataset, ImageReader::CACHE_BYTES);
    let mut bytes = reader.resolve(&images[..1]).await?;
    Ok(bytes.pop().transpose()?.map(|bytes| bytes.to_vec()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_few_are_spread_over_all() {
        assert_eq!(spread((0..9).collect()).collect::<Vec<_>>(), [1, 4, 7]);
        assert_eq!(spread(vec![5]).collect::<Vec<_>>(), [5]);
    }
}
