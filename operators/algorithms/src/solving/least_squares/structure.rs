//! Which blocks of a symmetric block matrix are not zero, and the order to eliminate them in.
//!
//! Decided once per structure: an approximate minimum degree ordering of the *blocks* (some D²
//! times fewer entries than the scalars, and never tearing a block apart), and the symbolic
//! Cholesky factorisation of the matrix in that order.

use faer::Side;
use faer::dyn_stack::{MemBuffer, MemStack};
use faer::sparse::linalg::amd;
use faer::sparse::linalg::cholesky::{
    CholeskySymbolicParams, SymbolicCholesky, SymbolicCholeskyRaw, SymmetricOrdering,
    factorize_symbolic_cholesky,
};
use faer::sparse::{FaerError, SymbolicSparseColMatRef};

/// Why a system cannot be set up.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum SystemError {
    /// More unknowns or factor entries than 32-bit indices can count.
    #[error("expected a system whose factor has fewer than 2^31 entries, found a larger one")]
    TooLarge,
    /// No memory for it.
    #[error("expected enough memory for the factor, found too little")]
    OutOfMemory,
}

impl From<FaerError> for SystemError {
    fn from(error: FaerError) -> Self {
        match error {
            FaerError::OutOfMemory => SystemError::OutOfMemory,
            _ => SystemError::TooLarge,
        }
    }
}

/// Where the block of two unknowns is stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Slot {
    /// Column block in elimination order.
    pub(super) column: u32,
    /// Place of the block within the column block, in blocks.
    pub(super) place: u32,
    /// Must the block be transposed before it is stored?
    pub(super) transposed: bool,
}

/// Pattern, order and symbolic factor of a symmetric matrix of D × D blocks.
#[derive(Debug)]
pub struct Structure<const D: usize> {
    /// Place of each unknown in elimination order.
    pub(super) place_of: Vec<u32>,
    /// Blocks of each column block: rows in ascending order, the diagonal included; only the
    /// triangle that is stored.
    columns: Vec<u32>,
    rows: Vec<u32>,
    /// The same for scalars, for faer.
    pub(super) col_ptr: Vec<u32>,
    pub(super) row_idx: Vec<u32>,
    pub(super) side: Side,
    pub(super) symbolic: SymbolicCholesky<u32>,
}

impl<const D: usize> Structure<D> {
    /// For `unknowns` blocks of D unknowns, where the `pairs` (in any order, repeated or not) have
    /// something to do with each other. Pairs that name no unknown are ignored.
    ///
    /// # Errors
    /// [`SystemError`] when it does not fit.
    pub fn new(
        unknowns: usize,
        pairs: impl IntoIterator<Item = (usize, usize)>,
    ) -> Result<Self, SystemError> {
        if unknowns
            .checked_mul(D)
            .is_none_or(|n| n > i32::MAX as usize)
        {
            return Err(SystemError::TooLarge);
        }
        let mut pairs: Vec<(u32, u32)> = pairs
            .into_iter()
            .filter(|(a, b)| a != b && *a < unknowns && *b < unknowns)
            .map(|(a, b)| (a.min(b) as u32, a.max(b) as u32))
            .collect();
        let place_of = elimination_order(unknowns, &mut pairs)?;
        for (a, b) in &mut pairs {
            let (p, q) = (place_of[*a as usize], place_of[*b as usize]);
            (*a, *b) = (p.min(q), p.max(q));
        }
        // The symbolic step reads the upper triangle; which triangle the numeric one wants is
        // known after it.
        let (mut columns, mut rows) = compress(unknowns, &mut pairs, true);
        let (mut col_ptr, mut row_idx) = scalars::<D>(&columns, &rows, Side::Upper);
        let n = unknowns * D;
        let symbolic = factorize_symbolic_cholesky(
            SymbolicSparseColMatRef::new_unsorted_checked(n, n, &col_ptr, None, &row_idx),
            Side::Upper,
            SymmetricOrdering::Identity,
            CholeskySymbolicParams::default(),
        )?;
        let side = match symbolic.raw() {
            SymbolicCholeskyRaw::Simplicial(_) => Side::Upper,
            SymbolicCholeskyRaw::Supernodal(_) => Side::Lower,
        };
        if side == Side::Lower {
            pairs.iter_mut().for_each(|(a, b)| (*a, *b) = (*b, *a));
            (columns, rows) = compress(unknowns, &mut pairs, true);
            (col_ptr, row_idx) = scalars::<D>(&columns, &rows, side);
        }
        Ok(Self {
            place_of,
            columns,
            rows,
            col_ptr,
            row_idx,
            side,
            symbolic,
        })
    }

    /// Number of block unknowns.
    pub fn unknowns(&self) -> usize {
        self.place_of.len()
    }

    /// Entries of the Cholesky factor.
    pub fn factor_entries(&self) -> usize {
        self.symbolic.len_val()
    }

    /// Where the block in row `row`, column `column` goes; `None` when the pair was not announced.
    pub fn slot(&self, row: usize, column: usize) -> Option<Slot> {
        let (p, q) = (*self.place_of.get(row)?, *self.place_of.get(column)?);
        let transposed = (self.side == Side::Upper) == (p > q) && p != q;
        let (p, q) = if transposed { (q, p) } else { (p, q) };
        let (from, to) = (self.columns[q as usize], self.columns[q as usize + 1]);
        let place = self.rows[from as usize..to as usize]
            .binary_search(&p)
            .ok()?;
        Some(Slot {
            column: q,
            place: place as u32,
            transposed,
        })
    }
}

/// Place of each block in an order that fills in little.
fn elimination_order(
    unknowns: usize,
    pairs: &mut Vec<(u32, u32)>,
) -> Result<Vec<u32>, SystemError> {
    let (columns, rows) = compress(unknowns, pairs, false);
    let mut order = vec![0u32; unknowns];
    let mut place_of = vec![0u32; unknowns];
    let scratch = amd::order_scratch::<u32>(unknowns, rows.len());
    let mut memory = MemBuffer::try_new(scratch).map_err(|_| SystemError::OutOfMemory)?;
    amd::order(
        &mut order,
        &mut place_of,
        SymbolicSparseColMatRef::new_checked(unknowns, unknowns, &columns, None, &rows),
        amd::Control::default(),
        MemStack::new(&mut memory),
    )?;
    Ok(place_of)
}

/// Sorted, unique (row, column) pairs as compressed columns.
fn compress(unknowns: usize, pairs: &mut Vec<(u32, u32)>, diagonal: bool) -> (Vec<u32>, Vec<u32>) {
    pairs.sort_unstable_by_key(|(row, column)| (*column, *row));
    pairs.dedup();
    let mut columns = Vec::with_capacity(unknowns + 1);
    let mut rows = Vec::with_capacity(pairs.len() + unknowns);
    let mut rest = pairs.iter().peekable();
    for column in 0..unknowns as u32 {
        columns.push(rows.len() as u32);
        let mut own = diagonal;
        while let Some((row, _)) = rest.next_if(|(_, at)| *at == column) {
            if own && *row > column {
                rows.push(column);
                own = false;
            }
            rows.push(*row);
        }
        if own {
            rows.push(column);
        }
    }
    columns.push(rows.len() as u32);
    (columns, rows)
}

/// The pattern of scalars of a pattern of blocks: whole blocks off the diagonal, one triangle of
/// those on it.
fn scalars<const D: usize>(columns: &[u32], rows: &[u32], side: Side) -> (Vec<u32>, Vec<u32>) {
    let d = D as u32;
    let mut col_ptr = vec![0u32];
    let mut row_idx = Vec::with_capacity(rows.len() * D * D);
    for (column, range) in columns.windows(2).enumerate() {
        for within in 0..d {
            let own = column as u32 * d + within;
            for block in &rows[range[0] as usize..range[1] as usize] {
                let (first, end) = (block * d, (block + 1) * d);
                row_idx.extend(match side {
                    Side::Upper => first..end.min(own + 1),
                    Side::Lower => first.max(own)..end,
                });
            }
            col_ptr.push(row_idx.len() as u32);
        }
    }
    (col_ptr, row_idx)
}
