//! The plan node that fetches images: references become image bytes just before a kernel that asks for them.

use std::fmt;
use std::sync::{Arc, Mutex};

use arrow::array::{BinaryBuilder, RecordBatch};
use arrow::datatypes::{DataType, Field, Schema};
use datafusion::error::Result as DataFusionResult;
use datafusion::execution::{SendableRecordBatchStream, TaskContext};
use datafusion::physical_expr::projection::ProjectionMapping;
use datafusion::physical_expr::{EquivalenceProperties, Partitioning};
use datafusion::physical_plan::metrics::{BaselineMetrics, Count, MetricBuilder, RecordOutput};
use datafusion::physical_plan::stream::RecordBatchStreamAdapter;
use datafusion::physical_plan::{ExecutionPlan, ExecutionPlanProperties};
use evermap_contract::{Losses, pixels_column};
use evermap_datasets::ImageReader;
use evermap_schemas::{Cell, Fault, ImageRef};
use evermap_video::Codec;
use futures::{StreamExt, TryStreamExt};

use crate::conform::{beside, convert};
use crate::error::{OrFault, external};
use crate::locked::locked;
use crate::nodes::node::{Duty, Need, Node, first};
use crate::nodes::raw::as_file;
use crate::nodes::weight::pieces;

/// Encoded image bytes that one batch may carry: bounds memory, whatever the batch size.
const SLICE_BYTES: u64 = 8 << 20;

/// What a frame of video counts as: a picture of 1280 by 960 pixels comes out of a few thousand bytes.
const VIDEO_BYTES: u64 = 4 << 20;

/// Batches whose images are fetched ahead of the kernel.
const AHEAD: usize = 2;

/// Puts the images of a column beside their references, in a column named by [`pixels_column`].
pub type PixelsExec = Node<Fetching>;

/// Which images are fetched, and for whom.
pub struct Fetching {
    /// The column of references.
    pub column: String,
    /// How the reader of the images needs the rows. They come so before their images are fetched, which are then
    /// neither sorted nor shuffled.
    pub need: Need,
    /// Fetches.
    pub reader: Arc<ImageReader>,
    /// Where images that cannot be fetched are counted.
    pub losses: Arc<Mutex<Losses>>,
}

impl fmt::Display for Fetching {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "column={}", self.column)
    }
}

impl Duty for Fetching {
    const NAME: &'static str = "PixelsExec";
    type Shared = ();

    fn needs(&self) -> Vec<Need> {
        vec![self.need.clone()]
    }

    /// All that is known of the child's rows holds for these, which have a column more.
    fn output(
        &self,
        children: &[Arc<dyn ExecutionPlan>],
    ) -> DataFusionResult<(EquivalenceProperties, Partitioning)> {
        let child = first(children)?;
        let schema = child.schema();
        let images = Field::new(pixels_column(&self.column), DataType::Binary, true);
        let mut fields = schema.fields().to_vec();
        fields.push(Arc::new(images));
        let kept: Vec<usize> = (0..schema.fields().len()).collect();
        let same = ProjectionMapping::from_indices(&kept, &schema)?;
        let output = Arc::new(Schema::new(fields));
        Ok((
            child.equivalence_properties().project(&same, output),
            child.output_partitioning().clone(),
        ))
    }

    fn keeps_order(&self) -> bool {
        true
    }

    fn execute(
        node: &PixelsExec,
        partition: usize,
        context: Arc<TaskContext>,
    ) -> DataFusionResult<SendableRecordBatchStream> {
        let input = first(&node.children)?.execute(partition, context)?;
        let fetcher = Arc::new(Fetcher {
            fetching: Arc::clone(&node.duty),
            baseline: BaselineMetrics::new(&node.metrics, partition),
            images: MetricBuilder::new(&node.metrics).counter("images", partition),
            bytes: MetricBuilder::new(&node.metrics).counter("image_bytes", partition),
            failures: MetricBuilder::new(&node.metrics).counter("failures", partition),
        });
        let slicer = Arc::clone(&fetcher);
        let slices = input
            .map(move |batch| {
                let pieces = slicer.slices(&batch.or_fault()?)?;
                let pieces = pieces.into_iter().map(Ok::<_, Fault>);
                Ok::<_, Fault>(futures::stream::iter(pieces))
            })
            .try_flatten();
        let fetched = slices
            .map(move |piece| {
                let fetcher = Arc::clone(&fetcher);
                async move { fetcher.fetch(piece?).await }
            })
            .buffered(AHEAD)
            .map_err(external);
        let schema = node.schema();
        Ok(Box::pin(RecordBatchStreamAdapter::new(schema, fetched)))
    }
}

/// The images of one partition.
struct Fetcher {
    fetching: Arc<Fetching>,
    baseline: BaselineMetrics,
    images: Count,
    bytes: Count,
    failures: Count,
}

impl Fetcher {
    /// The batch cut so that no piece carries more than a few megabytes of images.
    fn slices(&self, batch: &RecordBatch) -> Result<Vec<RecordBatch>, Fault> {
        let images = references(batch, &self.fetching.column)?;
        let lengths = images.into_iter().map(|image| {
            image.map_or(0, |image| match Codec::named(&image.format) {
                Some(_) => VIDEO_BYTES,
                None => image.length,
            })
        });
        Ok(pieces(batch, lengths, SLICE_BYTES))
    }

    /// The batch with the images beside it; what cannot be fetched is null and counted. Where there is no reference, there is
    /// no image either, and nothing to count.
    async fn fetch(&self, batch: RecordBatch) -> Result<RecordBatch, Fault> {
        let references = references(&batch, &self.fetching.column)?;
        let named: Vec<bool> = references.iter().map(Option::is_some).collect();
        let images: Vec<ImageRef> = references.into_iter().flatten().collect();
        let timer = self.baseline.elapsed_compute().timer();
        let fetched = self.fetching.reader.resolve(&images).await?;
        timer.done();
        let mut fetched = images.iter().zip(fetched);
        let mut bytes = BinaryBuilder::new();
        for is_named in named {
            let Some((image, fetched)) = is_named.then(|| fetched.next()).flatten() else {
                bytes.append_null();
                continue;
            };
            let file = match &fetched {
                Ok(fetched) => as_file(image, fetched),
                Err(fault) => Err(fault.message.clone()),
            };
            match file {
                Ok(file) => {
                    self.images.add(1);
                    self.bytes.add(file.len());
                    bytes.append_value(file);
                }
                Err(reason) => {
                    self.failures.add(1);
                    let reason = self.named(image, &reason).await;
                    locked(&self.fetching.losses).add(reason, 1);
                    bytes.append_null();
                }
            }
        }
        let name = pixels_column(&self.fetching.column);
        let batch = beside(&batch, &name, Arc::new(bytes.finish()))?;
        Ok(batch.record_output(&self.baseline))
    }

    /// Why an image is lost, with its topic, encoding and session.
    async fn named(&self, image: &ImageRef, reason: &str) -> String {
        let (encoding, session) = (&image.format, &image.session);
        match self.fetching.reader.topic(image).await {
            Some(topic) => format!("image of {topic} ({encoding}) in session {session}: {reason}"),
            None => format!("image ({encoding}) in session {session}: {reason}"),
        }
    }
}

fn references(batch: &RecordBatch, column: &str) -> Result<Vec<Option<ImageRef>>, Fault> {
    let found = batch
        .column_by_name(column)
        .ok_or_else(|| Fault::bug(format!("no image column {column}")))?;
    Option::<ImageRef>::decode(&convert(found, &ImageRef::data_type())?)
        .map_err(|fault| fault.at(format!("column {column}")))
}
