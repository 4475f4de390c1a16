//! The rows of a map's files.

use std::collections::BTreeMap;
use std::sync::Arc;

use arrow::datatypes::{Schema, SchemaRef};
use datafusion::datasource::listing::ListingTableUrl;
use datafusion::datasource::physical_plan::parquet::metadata::DFParquetMetadata;
use datafusion::datasource::source_as_provider;
use datafusion::logical_expr::LogicalPlan;
use datafusion::prelude::{DataFrame, ParquetReadOptions, SessionContext};
use evermap_schemas::Fault;

use crate::error::OrFault;
use crate::map::receipt::Artifact;
use crate::map::repeated::Repeated;
use crate::map::store::{Store, each};
use crate::sql::{Limits, context};

/// The rows of some Parquet files of a map, as one table: of this schema, or, where none is given, of the files' own. A file
/// is read as often as it is named.
///
/// # Errors
/// When a file is missing or is no Parquet.
pub async fn read_files(
    context: &SessionContext,
    store: &Store,
    names: impl IntoIterator<Item = String>,
    schema: Option<&Schema>,
) -> Result<DataFrame, Fault> {
    let mut times = BTreeMap::new();
    for name in names {
        let url = store.url_of(&name)?.to_string();
        *times.entry(url).or_insert(0) += 1;
    }
    let urls: Vec<String> = times.keys().cloned().collect();
    let options = ParquetReadOptions {
        schema,
        ..ParquetReadOptions::default()
    };
    let rows = context.read_parquet(urls, options).await.or_fault()?;
    match times.values().all(|times| *times == 1) {
        true => Ok(rows),
        false => repeated(context, &rows, &times),
    }
}

/// The rows of a table of files, those of each as often as is said of its URL.
fn repeated(
    context: &SessionContext,
    rows: &DataFrame,
    times: &BTreeMap<String, usize>,
) -> Result<DataFrame, Fault> {
    let LogicalPlan::TableScan(scan) = rows.logical_plan() else {
        return Err(Fault::bug("expected a scan of files, found another plan"));
    };
    let times = times.iter().map(|(url, times)| {
        let url = ListingTableUrl::parse(url).or_fault()?;
        Ok((url.prefix().clone(), *times))
    });
    let repeated = Repeated {
        files: source_as_provider(&scan.source).or_fault()?,
        times: times.collect::<Result<_, Fault>>()?,
    };
    context.read_table(Arc::new(repeated)).or_fault()
}

/// The columns of an artifact as its file describes them, with units and frames. What reads its rows leaves these out.
///
/// # Errors
/// As [`read_files`].
pub async fn described(
    context: &SessionContext,
    store: &Store,
    artifact: &Artifact,
) -> Result<SchemaRef, Fault> {
    let url = store.url_of(&artifact.name())?.to_string();
    let options = ParquetReadOptions::default().skip_metadata(false);
    let rows = context.read_parquet(url, options).await.or_fault()?;
    Ok(Arc::clone(rows.schema().inner()))
}

/// The columns of an artifact with what its file says of itself: its end alone is read.
///
/// # Errors
/// A data fault for a file that is no Parquet.
pub async fn columns_of(store: &Store, artifact: &Artifact) -> Result<SchemaRef, Fault> {
    let name = artifact.name();
    let missing = || Fault::data("expected a file, found nothing").at(name.clone());
    let meta = store.meta(&name).await?.ok_or_else(missing)?;
    let objects = store.objects();
    let end = DFParquetMetadata::new(objects.as_ref(), &meta);
    let read = end.fetch_schema().await;
    let read = read.map_err(|error| Fault::data(error.to_string()).at(name))?;
    Ok(Arc::new(read))
}

/// The rows of artifacts, as one table.
///
/// # Errors
/// As [`read_files`], and a data fault where one is missing or not as large as it was written.
pub async fn read_artifacts(
    context: &SessionContext,
    store: &Store,
    artifacts: &[Artifact],
) -> Result<DataFrame, Fault> {
    let damages = artifacts.iter().map(|artifact| artifact.size_damage(store));
    if let Some(damage) = each(damages).await?.into_iter().flatten().next() {
        return Err(damage.into());
    }
    read_files(context, store, artifacts.iter().map(Artifact::name), None).await
}

/// The rows of artifacts in the order that they are kept in.
///
/// # Errors
/// As [`read_files`].
pub async fn read_in_order(store: &Store, artifacts: &[Artifact]) -> Result<DataFrame, Fault> {
    let context = context(Limits::one_partition())?;
    context.register_object_store(store.url(), store.objects());
    read_files(&context, store, artifacts.iter().map(Artifact::name), None).await
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use arrow::array::{ArrayRef, AsArray, Int64Array, RecordBatch};
    use arrow::datatypes::Int64Type;
    use parquet::arrow::ArrowWriter;

    use super::*;
    use crate::digest::digest;
    use crate::map::receipt::Extent;

    /// A file of these numbers, which are of a session.
    async fn stored(store: &Store, session: &str, numbers: Vec<i64>) -> Artifact {
        let numbers: ArrayRef = Arc::new(Int64Array::from(numbers));
        let table = RecordBatch::try_from_iter([("n", numbers)]).unwrap();
        let mut bytes = Vec::new();
        let mut writer = ArrowWriter::try_new(&mut bytes, table.schema(), None).unwrap();
        writer.write(&table).unwrap();
        writer.close().unwrap();
        let artifact = Artifact {
            content: digest(&bytes),
            rows: table.num_rows() as u64,
            bytes: bytes.len() as u64,
            extent: Extent {
                session: Some(session.to_owned()),
                site: None,
            },
        };
        store.write(&artifact.name(), bytes).await.unwrap();
        artifact
    }

    #[tokio::test]
    async fn units_of_equal_rows_have_one_file_that_is_read_for_each() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path().to_str().unwrap(), true).unwrap();
        let [monday, tuesday] = ["monday", "tuesday"];
        let artifacts = [
            stored(&store, monday, vec![1, 2, 3]).await,
            stored(&store, tuesday, vec![1, 2, 3]).await,
            stored(&store, "friday", vec![4, 5]).await,
        ];
        assert_eq!(artifacts[0].name(), artifacts[1].name());
        for partitions in [1, 4] {
            let limits = Limits {
                partitions,
                ..Limits::one_partition()
            };
            let context = context(limits).unwrap();
            context.register_object_store(store.url(), store.objects());
            let rows = read_artifacts(&context, &store, &artifacts).await;
            let rows = rows.unwrap().into_view();
            context.register_table("numbers", rows).unwrap();
            let asked = async |query: &str| -> Vec<i64> {
                let batches = context.sql(query).await.unwrap().collect().await.unwrap();
                let values = batches.iter().flat_map(|batch| {
                    let column = batch.column(0).as_primitive::<Int64Type>();
                    column.values().to_vec()
                });
                values.collect()
            };
            assert_eq!(asked("SELECT count(*) FROM numbers").await, [8]);
            assert_eq!(asked("SELECT sum(n) FROM numbers").await, [21]);
            assert_eq!(asked("SELECT min(n) FROM numbers").await, [1]);
            let filtered = "SELECT count(*) FROM numbers WHERE n = 2";
            assert_eq!(asked(filtered).await, [2]);
            let sorted = "SELECT n FROM numbers ORDER BY n";
            assert_eq!(asked(sorted).await, [1, 1, 2, 2, 3, 3, 4, 5]);
            for limit in [1, 7, 9] {
                let some = asked(&format!("SELECT n FROM numbers LIMIT {limit}")).await;
                assert_eq!(some.len(), limit.min(8));
            }
        }
        let both = read_in_order(&store, &artifacts[..2]).await.unwrap();
        assert_eq!(both.count().await.unwrap(), 6);
    }
}
