//! What the values of label images mean, from the log's metadata record `label_classes`: `{"0": "tree", "1": "sky"}`.

use std::sync::Arc;

use datafusion::catalog::TableProvider;
use evermap_schemas::Fault;

use crate::dataset::Dataset;
use crate::listing;
use crate::roles::view;
use crate::scan::{LogTable, McapTable};

/// Entries whose key is no pixel value are left out.
const CLASSES: &str = "
    SELECT s.site, m.session, TRY_CAST(m.key AS TINYINT UNSIGNED) AS value, m.class
    FROM (
        SELECT session, unnest(map_keys(metadata)) AS key, unnest(map_values(metadata)) AS class
        FROM metadata
        WHERE name = 'label_classes'
    ) m
    JOIN sessions s ON s.session = m.session
    WHERE TRY_CAST(m.key AS TINYINT UNSIGNED) IS NOT NULL AND m.class IS NOT NULL";

/// The table of label classes.
pub(crate) fn classes(dataset: &Dataset) -> Result<Arc<dyn TableProvider>, Fault> {
    let metadata = McapTable::new(LogTable::Metadata, &dataset.parts(), dataset.losses.clone())?;
    view(
        CLASSES,
        [
            ("metadata", Arc::new(metadata)),
            ("sessions", listing::sessions(&dataset.sessions)?),
        ],
    )
}
