//! Two streams of rows merged in one pass. Of the right one no more is held than a batch and the rows that match those
//! of one batch of the left.

use std::cmp::Ordering;
use std::sync::Arc;

use arrow::array::{Array, AsArray, RecordBatch, RecordBatchOptions, UInt32Array, new_null_array};
use arrow::buffer::NullBuffer;
use arrow::compute::{interleave_record_batch, take_record_batch};
use arrow::datatypes::{Schema, SchemaRef};
use arrow::row::{OwnedRow, RowConverter, Rows, SortField};
use datafusion::common::Result;
use datafusion::execution::SendableRecordBatchStream;
use futures::{Stream, StreamExt};

use crate::sql::as_of::condition::{Condition, KEY_ORDER, Pair, Value};

/// Where a row is that matches: which of the pieces of the right table, and which row of it.
type RowIndex = (usize, usize);

/// The row of nulls, which is what there is where nothing matches.
const NOTHING: RowIndex = (0, 0);

/// A merge under way.
pub struct Merge {
    left: SendableRecordBatchStream,
    right: SendableRecordBatchStream,
    condition: Arc<Condition<Value>>,
    order: Order,
    schema: SchemaRef,
    /// The right table's columns, which may be null here.
    right_schema: SchemaRef,
    current: Option<Rank>,
    /// The first row of the current batch of the right table that was not passed.
    row: usize,
    /// Whether the right table has no more batches.
    ended: bool,
    last: Option<Last>,
    /// What rows of the right table matched in this batch of the left; the first is a row of nulls.
    pieces: Vec<RecordBatch>,
    /// Rows of the current batch that will be the next piece.
    picked: Vec<u32>,
}

/// The last row of the right table that was passed and matched the keys of its time.
enum Last {
    /// A row of the current batch.
    Current(usize),
    /// A row of a batch before, with its keys.
    Before(RowIndex, Option<OwnedRow>),
}

/// What makes values that compare as rows are ordered.
struct Order {
    keys: Option<RowConverter>,
    times: RowConverter,
}

/// A batch with the values that rank its rows.
struct Rank {
    batch: RecordBatch,
    keys: Option<Rows>,
    times: Rows,
    /// Which rows have a time and all keys; all where there is none.
    known: Option<NullBuffer>,
}

impl Rank {
    fn is_known(&self, row: usize) -> bool {
        self.known.as_ref().is_none_or(|known| known.is_valid(row))
    }

    fn by_keys(&self, row: usize, other: &Self, of: usize) -> Ordering {
        match (&self.keys, &other.keys) {
            (Some(own), Some(other)) => own.row(row).cmp(&other.row(of)),
            _ => Ordering::Equal,
        }
    }
}

impl Order {
    fn new(condition: &Condition<Value>, left: &Schema) -> Result<Self> {
        let field = |(of_left, _): &Pair, order| {
            Ok(SortField::new_with_options(of_left.data_type(left)?, order))
        };
        let keys = condition.keys.iter().map(|pair| field(pair, KEY_ORDER));
        let keys: Vec<_> = keys.collect::<Result<_>>()?;
        let times = field(&condition.times, condition.time_order())?;
        let keys = (!keys.is_empty()).then(|| RowConverter::new(keys));
        Ok(Self {
            keys: keys.transpose()?,
            times: RowConverter::new(vec![times])?,
        })
    }

    fn ranked(
        &mut self,
        batch: RecordBatch,
        condition: &Condition<Value>,
        of: fn(&Pair) -> &Value,
    ) -> Result<Rank> {
        let value = |pair| of(pair).evaluate(&batch)?.into_array(batch.num_rows());
        let keys = condition
            .keys
            .iter()
            .map(value)
            .collect::<Result<Vec<_>>>()?;
        let time = value(&condition.times)?;
        let nulls = keys.iter().map(|key| key.logical_nulls());
        let known = nulls.fold(time.logical_nulls(), |known, nulls| {
            NullBuffer::union(known.as_ref(), nulls.as_ref())
        });
        let keys = self.keys.as_mut().map(|order| order.convert_columns(&keys));
        Ok(Rank {
            keys: keys.transpose()?,
            times: self.times.convert_columns(&[time])?,
            batch,
            known,
        })
    }
}

impl Merge {
    /// A merge of two streams, each ordered by keys and time, into rows of this schema.
    ///
    /// # Errors
    /// When keys or times are of types without an order.
    pub fn new(
        left: SendableRecordBatchStream,
        right: SendableRecordBatchStream,
        condition: Arc<Condition<Value>>,
        schema: SchemaRef,
    ) -> Result<Self> {
        let width = left.schema().fields().len();
        let fields: Vec<_> = schema.fields().iter().skip(width).cloned().collect();
        Ok(Self {
            order: Order::new(&condition, &left.schema())?,
            left,
            right,
            condition,
            schema,
            right_schema: Arc::new(Schema::new(fields)),
            current: None,
            row: 0,
            ended: false,
            last: None,
            pieces: Vec::new(),
            picked: Vec::new(),
        })
    }

    /// The rows that come out, in the order of the left table.
    pub fn rows(self) -> impl Stream<Item = Result<RecordBatch>> + Send {
        futures::stream::try_unfold(self, async |mut merge| {
            let Some(batch) = merge.left.next().await.transpose()? else {
                return Ok(None);
            };
            let joined = merge.joined(batch).await?;
            Ok(Some((joined, merge)))
        })
    }

    async fn joined(&mut self, batch: RecordBatch) -> Result<RecordBatch> {
        let left = self.order.ranked(batch, &self.condition, |pair| &pair.0)?;
        self.begin()?;
        let mut places = Vec::with_capacity(left.batch.num_rows());
        for row in 0..left.batch.num_rows() {
            if !left.is_known(row) {
                places.push(NOTHING);
                continue;
            }
            while !self.passed(&left, row)? && self.next().await? {}
            places.push(self.place(&left, row));
        }
        self.pick_up()?;
        let joined = self.beside(&left.batch, &places)?;
        let joined = self.within_limit(joined, &left.batch, places)?;
        self.end();
        Ok(joined)
    }

    /// Forgets the pieces of the batch before, but for the row that may match again.
    fn begin(&mut self) -> Result<()> {
        let nulls = self.right_schema.fields().iter();
        let nulls = nulls.map(|field| new_null_array(field.data_type(), 1));
        let nothing = self.of_right(nulls.collect(), 1)?;
        let kept = match &self.last {
            Some(Last::Before((piece, row), _)) => Some(self.pieces[*piece].slice(*row, 1)),
            _ => None,
        };
        self.pieces = std::iter::once(nothing).chain(kept).collect();
        if let Some(Last::Before(place, _)) = &mut self.last {
            *place = (1, 0);
        }
        Ok(())
    }

    /// Passes the rows of the current batch that are not too late for a row of the left; whether that is all of them.
    fn passed(&mut self, left: &Rank, of: usize) -> Result<bool> {
        let Some(current) = &self.current else {
            return Ok(false);
        };
        let with_equal = self.condition.matching.with_equal();
        while self.row < current.batch.num_rows() {
            if current.is_known(self.row) {
                match current.by_keys(self.row, left, of) {
                    Ordering::Greater => return Ok(true),
                    Ordering::Less => {}
                    Ordering::Equal => match current.times.row(self.row).cmp(&left.times.row(of)) {
                        Ordering::Greater => return Ok(true),
                        Ordering::Equal if !with_equal => return Ok(true),
                        _ => self.last = Some(Last::Current(self.row)),
                    },
                }
            }
            self.row += 1;
        }
        Ok(false)
    }

    /// Goes on to the next batch of the right table; whether there is one.
    async fn next(&mut self) -> Result<bool> {
        if let (Some(current), Some(Last::Current(row))) = (&self.current, &self.last) {
            let (row, keys) = (*row, current.keys.as_ref());
            let keys = keys.map(|keys| keys.row(row).owned());
            self.last = Some(Last::Before(self.picked_place(row), keys));
        }
        self.pick_up()?;
        self.current = None;
        if self.ended {
            return Ok(false);
        }
        let Some(batch) = self.right.next().await.transpose()? else {
            self.ended = true;
            return Ok(false);
        };
        let ranked = self.order.ranked(batch, &self.condition, |pair| &pair.1)?;
        (self.current, self.row) = (Some(ranked), 0);
        Ok(true)
    }

    /// Where the row is that matches one of the left.
    fn place(&mut self, left: &Rank, of: usize) -> RowIndex {
        match (&self.last, &self.current) {
            (Some(Last::Current(row)), Some(current)) => {
                let row = *row;
                match current.by_keys(row, left, of) {
                    Ordering::Equal => self.picked_place(row),
                    _ => NOTHING,
                }
            }
            (Some(Last::Before(place, keys)), _) => {
                let same = match (keys, &left.keys) {
                    (Some(keys), Some(of_left)) => keys.row() == of_left.row(of),
                    _ => true,
                };
                if same { *place } else { NOTHING }
            }
            _ => NOTHING,
        }
    }

    /// Where a row of the current batch will be.
    fn picked_place(&mut self, row: usize) -> RowIndex {
        let row = row as u32;
        if self.picked.last() != Some(&row) {
            self.picked.push(row);
        }
        (self.pieces.len(), self.picked.len() - 1)
    }

    /// Makes a piece of the rows that were picked.
    fn pick_up(&mut self) -> Result<()> {
        let (Some(current), false) = (&self.current, self.picked.is_empty()) else {
            return Ok(());
        };
        let rows = UInt32Array::from(std::mem::take(&mut self.picked));
        let taken = take_record_batch(&current.batch, &rows)?;
        let piece = self.of_right(taken.columns().to_vec(), rows.len())?;
        self.pieces.push(piece);
        Ok(())
    }

    fn of_right(&self, columns: Vec<arrow::array::ArrayRef>, rows: usize) -> Result<RecordBatch> {
        let options = RecordBatchOptions::new().with_row_count(Some(rows));
        let schema = Arc::clone(&self.right_schema);
        Ok(RecordBatch::try_new_with_options(
            schema, columns, &options,
        )?)
    }

    /// Rows of the left with those of the right at these places beside them.
    fn beside(&self, left: &RecordBatch, places: &[RowIndex]) -> Result<RecordBatch> {
        let pieces: Vec<&RecordBatch> = self.pieces.iter().collect();
        let mut columns = left.columns().to_vec();
        if !self.right_schema.fields().is_empty() {
            let right = interleave_record_batch(&pieces, places)?;
            columns.extend_from_slice(right.columns());
        }
        let options = RecordBatchOptions::new().with_row_count(Some(places.len()));
        let schema = Arc::clone(&self.schema);
        Ok(RecordBatch::try_new_with_options(
            schema, columns, &options,
        )?)
    }

    /// The rows, without what is matched beyond the limit.
    fn within_limit(
        &self,
        joined: RecordBatch,
        left: &RecordBatch,
        mut places: Vec<RowIndex>,
    ) -> Result<RecordBatch> {
        let Some(limit) = &self.condition.limit else {
            return Ok(joined);
        };
        let within = limit.evaluate(&joined)?.into_array(joined.num_rows())?;
        let within = within.as_boolean();
        let is_within = |row: usize| within.is_valid(row) && within.value(row);
        let (all, mut beyond) = (places.len(), false);
        for row in (0..all).filter(|row| !is_within(*row)) {
            beyond |= places[row] != NOTHING;
            places[row] = NOTHING;
        }
        match beyond {
            true => self.beside(left, &places),
            false => Ok(joined),
        }
    }

    /// Keeps of the pieces what [`Merge::begin`] of the next batch takes over.
    fn end(&mut self) {
        if !matches!(self.last, Some(Last::Before(..))) {
            self.pieces.clear();
        }
    }
}
