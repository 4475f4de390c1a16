//! What an operator does with its rows: one of three shapes, made by constructors that know the types of the rows.
//!
//! Every function here is handed rows of one site only. They are plain functions: a kernel keeps nothing between calls
//! but what it prepared or what it declares as its state.

use std::borrow::Cow;

use arrow::array::RecordBatch;
use evermap_schemas::{Fault, LayerRow, Record, rows};
use rayon::prelude::*;

use crate::fold::{Fold, Folded};
use crate::kernel::{Kernel, Mapper, Rows};
use crate::{Emit, Key, Pixels, Port, Reach, Sides};

/// Why a row is skipped: a short phrase, such as `image does not decode`, under which it is counted. It may name cameras
/// and frames, of which a log has few, and no instants or values, of which it has many. Whoever leaves the same thing out says
/// so in the same words: a run tells what several steps say once.
pub type Reason = Cow<'static, str>;

/// How much a kernel must see at once. It says *where data must be*, not what is computed; the engine turns it into
/// partitioning and order.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Shape {
    /// Any rows, in any split.
    Map,
    /// All rows of a key together, in order.
    Group(Key),
    /// Any rows to states; all states of a key to its row.
    Fold,
}

/// Work with parameters `P`.
pub struct Work<P> {
    pub(crate) shape: Shape,
    /// The driving port first.
    pub(crate) ports: Vec<Port>,
    pub(crate) kernel: Box<dyn Fn(P) -> Kernel + Send + Sync>,
}

impl<P: Clone + Send + Sync + 'static> Work<P> {
    /// Each row by itself to any number of rows, side by side. `prepare` runs once for the rows of a site: look-up
    /// tables are made there. A row that fails is skipped and counted.
    pub fn each_row<S, T, I>(
        driving: Port,
        sides: Vec<Port>,
        prepare: fn(&P, &Sides) -> Result<S, Fault>,
        each: fn(&S, T) -> Result<I, Reason>,
    ) -> Self
    where
        S: Send + Sync + 'static,
        T: Record + Send + 'static,
        I: IntoIterator<Item: LayerRow> + Send + 'static,
    {
        Self::map(driving, sides, prepare, move |prepared, batch, emit| {
            let made = rows::<T>(batch)?.into_par_iter();
            emit.made(made.map(|row| each(prepared, row)).collect())
        })
    }

    /// Each row and its image to any number of rows, side by side; the driving port asks for the pixels of one column.
    /// `Room` is room for decoding, used again for the next image. A row without its image is passed over: whoever
    /// could not fetch the image has counted it.
    pub fn each_image<S, T, Room, I>(
        driving: Port,
        sides: Vec<Port>,
        prepare: fn(&P, &Sides) -> Result<S, Fault>,
        each: fn(&S, T, &[u8], &mut Room) -> Result<I, Reason>,
    ) -> Self
    where
        S: Send + Sync + 'static,
        T: Record + Send + 'static,
        Room: Default + 'static,
        I: IntoIterator<Item: LayerRow> + Send + 'static,
    {
        let column = driving.pixels;
        Self::map(driving, sides, prepare, move |prepared, batch, emit| {
            let pixels = Pixels::of(std::slice::from_ref(batch), column)?;
            let made = rows::<T>(batch)?.into_par_iter().enumerate();
            let fetched = made.filter_map(|(row, value)| Some((value, pixels.get(row)?)));
            let made = fetched.map_init(Room::default, |room, (value, image)| {
                each(prepared, value, image, room)
            });
            emit.made(made.collect())
        })
    }

    /// Any rows to rows: the general Map, for work that shares something among the rows of a batch. No result may
    /// depend on how rows are dealt out to batches.
    pub fn batches<S, T>(
        driving: Port,
        sides: Vec<Port>,
        prepare: fn(&P, &Sides) -> Result<S, Fault>,
        work: fn(&S, Vec<T>, &Pixels, &mut Emit<'_>) -> Result<(), Fault>,
    ) -> Self
    where
        S: Send + Sync + 'static,
        T: Record + 'static,
    {
        let column = driving.pixels;
        Self::map(driving, sides, prepare, move |prepared, batch, emit| {
            let pixels = Pixels::of(std::slice::from_ref(batch), column)?;
            work(prepared, rows::<T>(batch)?, &pixels, emit)
        })
    }

    /// All rows of a key at once, of which there is at least one, to rows. The sides are the key's own: what was taken
    /// from them with [`Sides::take`] is held no longer.
    pub fn group<T: Record + Send + 'static>(
        driving: Port,
        key: Key,
        sides: Vec<Port>,
        work: fn(&P, Vec<T>, Sides, &mut Emit<'_>) -> Result<(), Fault>,
    ) -> Self {
        Self::keyed(driving, key, sides, move |params, sides, _| {
            Ok(Box::new(Collected {
                params: params.clone(),
                sides,
                rows: Vec::<T>::new(),
                work,
            }))
        })
    }

    /// The rows of a key as they come, to rows at any time.
    pub fn stream<G: Stream<Params = P>>(driving: Port, key: Key, sides: Vec<Port>) -> Self {
        Self::keyed(driving, key, sides, |params, sides, column| {
            Ok(Box::new(Streaming {
                stream: G::open(params, &sides)?,
                column,
            }))
        })
    }

    /// States by key: see [`Fold`].
    pub fn fold<F: Fold<Params = P>>(driving: Port, sides: Vec<Port>) -> Self {
        let kernel = |params: P| {
            Kernel::Fold(Box::new(move |sides| {
                Ok(Box::new(Folded(F::prepare(&params, sides)?)))
            }))
        };
        Self::new(Shape::Fold, driving, sides, kernel)
    }

    fn map<S: Send + Sync + 'static>(
        driving: Port,
        sides: Vec<Port>,
        prepare: fn(&P, &Sides) -> Result<S, Fault>,
        work: impl Fn(&S, &RecordBatch, &mut Emit<'_>) -> Result<(), Fault>
        + Clone
        + Send
        + Sync
        + 'static,
    ) -> Self {
        Self::new(Shape::Map, driving, sides, move |params: P| {
            let work = work.clone();
            Kernel::Map(Box::new(move |sides| {
                let prepared = prepare(&params, sides)?;
                let work = work.clone();
                let mapper: Mapper = Box::new(move |batch, emit| work(&prepared, batch, emit));
                Ok(mapper)
            }))
        })
    }

    fn keyed(
        mut driving: Port,
        key: Key,
        sides: Vec<Port>,
        open: impl Fn(&P, Sides, Option<&'static str>) -> Result<Box<dyn Rows>, Fault>
        + Clone
        + Send
        + Sync
        + 'static,
    ) -> Self {
        driving.reach = key.reach();
        let column = driving.pixels;
        Self::new(Shape::Group(key), driving, sides, move |params: P| {
            let open = open.clone();
            Kernel::Group(Box::new(move |sides| open(&params, sides, column)))
        })
    }

    fn new(
        shape: Shape,
        mut driving: Port,
        sides: Vec<Port>,
        kernel: impl Fn(P) -> Kernel + Send + Sync + 'static,
    ) -> Self {
        if !matches!(shape, Shape::Group(_)) {
            driving.reach = Reach::Session;
        }
        let mut ports = vec![driving];
        ports.extend(sides);
        Self {
            shape,
            ports,
            kernel: Box::new(kernel),
        }
    }
}

/// A Group that emits while it reads. Rows arrive in order, in batches of any size.
pub trait Stream: Send + Sized + 'static {
    /// The operator's parameters.
    type Params;
    /// A driving row.
    type Row: Record;

    /// Begins with a key, given its sides.
    ///
    /// # Errors
    /// A data fault when the sides make no sense.
    fn open(params: &Self::Params, sides: &Sides) -> Result<Self, Fault>;

    /// Takes the next rows of the key, with their images where the port asks for them.
    ///
    /// # Errors
    /// Only for what makes the whole run senseless; a bad row is skipped with [`Emit::skip`].
    fn push(
        &mut self,
        rows: Vec<Self::Row>,
        pixels: &Pixels,
        emit: &mut Emit<'_>,
    ) -> Result<(), Fault>;

    /// The key's rows have all been pushed.
    ///
    /// # Errors
    /// As [`Stream::push`].
    fn close(self, emit: &mut Emit<'_>) -> Result<(), Fault>;
}

struct Streaming<G> {
    stream: G,
    /// The column whose images are wanted.
    column: Option<&'static str>,
}

impl<G: Stream> Rows for Streaming<G> {
    fn push(&mut self, batch: &RecordBatch, emit: &mut Emit<'_>) -> Result<(), Fault> {
        let pixels = Pixels::of(std::slice::from_ref(batch), self.column)?;
        self.stream.push(rows(batch)?, &pixels, emit)
    }

    fn close(self: Box<Self>, emit: &mut Emit<'_>) -> Result<(), Fault> {
        self.stream.close(emit)
    }
}

struct Collected<P, T> {
    params: P,
    sides: Sides,
    rows: Vec<T>,
    work: fn(&P, Vec<T>, Sides, &mut Emit<'_>) -> Result<(), Fault>,
}

impl<P: Send, T: Record + Send> Rows for Collected<P, T> {
    fn push(&mut self, batch: &RecordBatch, _: &mut Emit<'_>) -> Result<(), Fault> {
        self.rows.extend(rows::<T>(batch)?);
        Ok(())
    }

    fn held(&self) -> usize {
        self.rows.len()
    }

    fn close(self: Box<Self>, emit: &mut Emit<'_>) -> Result<(), Fault> {
        (self.work)(&self.params, self.rows, self.sides, emit)
    }
}
