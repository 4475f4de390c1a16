//! Sums over boxes by running sums: exact integers, any number of values per pixel.

/// Where the neighbours of the first and last pixel are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Edge {
    /// The outermost pixel goes on.
    Repeat,
    /// On the other side.
    Wrap,
}

impl Edge {
    pub(super) fn of(wraps: bool) -> Self {
        if wraps { Self::Wrap } else { Self::Repeat }
    }

    /// The index that stands for `at` in a line of `length` pixels.
    pub(super) fn index(self, at: isize, length: usize) -> usize {
        match self {
            Self::Repeat => at.clamp(0, length as isize - 1) as usize,
            Self::Wrap => at.rem_euclid(length as isize) as usize,
        }
    }
}

/// Sums of each line over `box_px` pixels, from `before` pixels before to `box_px - 1 - before` after.
///
/// Sums wrap at 2³²; as running sums only add and subtract, results that fit are exact all the same.
fn lines<const N: usize>(
    plane: &mut [[u32; N]],
    line: &mut Vec<[u32; N]>,
    (starts, length, step): (impl Iterator<Item = usize>, usize, usize),
    (before, box_px): (usize, usize),
    edge: Edge,
) {
    for start in starts {
        line.clear();
        line.extend((0..length).map(|i| plane[start + i * step]));
        let at = |i: isize| line[edge.index(i, length)];
        let mut sum = [0_u32; N];
        for i in 0..box_px {
            add(&mut sum, &at(i as isize - before as isize));
        }
        for i in 0..length {
            plane[start + i * step] = sum;
            let first = i as isize - before as isize;
            add(&mut sum, &at(first + box_px as isize));
            subtract(&mut sum, &at(first));
        }
    }
}

fn add<const N: usize>(sum: &mut [u32; N], value: &[u32; N]) {
    for (sum, value) in sum.iter_mut().zip(value) {
        *sum = sum.wrapping_add(*value);
    }
}

fn subtract<const N: usize>(sum: &mut [u32; N], value: &[u32; N]) {
    for (sum, value) in sum.iter_mut().zip(value) {
        *sum = sum.wrapping_sub(*value);
    }
}

/// Sums of columns, a whole row at a time, as a column is slow to walk.
fn columns<const N: usize>(
    plane: &mut Vec<[u32; N]>,
    [width, height]: [usize; 2],
    (before, box_px): (usize, usize),
) {
    let row = |v: isize| {
        let v = Edge::Repeat.index(v, height);
        v * width..(v + 1) * width
    };
    let mut sums = vec![[0_u32; N]; width];
    for v in 0..box_px {
        let source = &plane[row(v as isize - before as isize)];
        sums.iter_mut()
            .zip(source)
            .for_each(|(sum, value)| add(sum, value));
    }
    let mut result = Vec::with_capacity(plane.len());
    for v in 0..height {
        result.extend_from_slice(&sums);
        let first = v as isize - before as isize;
        let entering = &plane[row(first + box_px as isize)];
        let leaving = &plane[row(first)];
        for ((sum, entering), leaving) in sums.iter_mut().zip(entering).zip(leaving) {
            add(sum, entering);
            subtract(sum, leaving);
        }
    }
    *plane = result;
}

/// Twice a box sum of `box_px` along both axes: a tent that reaches `box_px` to each side, with `box_px⁴` as the sum of
/// its weights. `box_px` is at least 1.
pub(super) fn tent<const N: usize>(
    plane: &mut Vec<[u32; N]>,
    [width, height]: [usize; 2],
    box_px: usize,
    edge: Edge,
) {
    if width == 0 || height == 0 {
        return;
    }
    let mut line = Vec::new();
    // Of an even box, one pass leans to either side.
    for before in [box_px / 2, (box_px - 1) / 2] {
        let rows = ((0..height).map(|v| v * width), width, 1);
        lines(plane, &mut line, rows, (before, box_px), edge);
        columns(plane, [width, height], (before, box_px));
    }
}
