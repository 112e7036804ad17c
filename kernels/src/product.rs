//! Matrix products. One kernel computes a linear layer's result and the gradients of its weights and of its input.
//!
//! Every element of a result is one chain of fused multiply-adds in the order of `k`. It therefore does not depend on
//! the tiling.

use core::marker::PhantomData;

use crate::buffer::stride;
use crate::simd::{LANES, Line, Operation, Simd};

/// The left operand, a strided matrix: element `(i, k)` is `data[i * outer + k * inner]`.
#[derive(Clone, Copy)]
pub(crate) struct Left<'a> {
    data: *const f32,
    outer: usize,
    inner: usize,
    rows: usize,
    depth: usize,
    borrowed: PhantomData<&'a [f32]>,
}

impl<'a> Left<'a> {
    /// `rows` rows of `depth` values, `stride` values apart.
    pub(crate) fn rows(data: &'a [f32], stride: usize, rows: usize, depth: usize) -> Self {
        assert!(rows > 0 && depth > 0 && depth <= stride, "{rows} rows of {depth} in {stride}");
        assert!((rows - 1) * stride + depth <= data.len(), "rows beyond the data");
        Self { data: data.as_ptr(), outer: stride, inner: 1, rows, depth, borrowed: PhantomData }
    }

    /// The transpose of [`Self::rows`]: `width` rows of `rows` values.
    pub(crate) fn columns(data: &'a [f32], stride: usize, rows: usize, width: usize) -> Self {
        let Self { data, outer, rows, depth, borrowed, .. } = Self::rows(data, stride, rows, width);
        Self { data, outer: 1, inner: outer, rows: depth, depth: rows, borrowed }
    }
}

/// The right operand: columns `16 g..16 (g + 1)` of row `k` are `lines[g * group + k * row]`.
#[derive(Clone, Copy)]
pub(crate) struct Right<'a> {
    lines: &'a [Line],
    group: usize,
    row: usize,
}

impl<'a> Right<'a> {
    /// Packed weights: all rows of one group of columns are adjacent.
    pub(crate) fn packed(lines: &'a [Line], depth: usize) -> Self {
        Self { lines, group: depth, row: 1 }
    }

    /// Rows of `stride` lines each.
    pub(crate) fn rows(lines: &'a [Line], stride: usize) -> Self {
        Self { lines, group: 1, row: stride }
    }
}

/// Maximum rows of a tile.
const TILE_ROWS: usize = 12;

/// Initial value of the chains of multiply-adds.
#[derive(Clone, Copy)]
pub(crate) enum InitialSum<'a> {
    Zero,
    /// One line per group of columns.
    Bias(&'a [Line]),
    /// The current contents of the result.
    Result,
}

/// `C = start + A B`. `C` has `columns` columns, and its rows are `stride` values apart.
pub(crate) struct Product<'a> {
    left: Left<'a>,
    right: Right<'a>,
    start: InitialSum<'a>,
    relu: bool,
    columns: usize,
    result: *mut f32,
    stride: usize,
    /// Whether the padding of the last group is also written.
    padded: bool,
    borrowed: PhantomData<&'a mut [f32]>,
}

impl<'a> Product<'a> {
    /// Into lines. Their padding is computed from the padding of the right operand.
    pub(crate) fn lines(
        left: Left<'a>,
        right: Right<'a>,
        result: &'a mut [Line],
        columns: usize,
        start: InitialSum<'a>,
    ) -> Self {
        let stride = stride(columns);
        assert!(left.rows * stride <= result.len(), "a result of {} rows", left.rows);
        let result = result.as_mut_ptr().cast::<f32>();
        Self { padded: true, ..Self::new(left, right, result, stride * LANES, columns, start) }
    }

    /// Into a dense matrix `[rows, columns]`.
    pub(crate) fn dense(
        left: Left<'a>,
        right: Right<'a>,
        result: &'a mut [f32],
        columns: usize,
        start: InitialSum<'a>,
    ) -> Self {
        assert_eq!(result.len(), left.rows * columns, "a result of {} rows", left.rows);
        Self::new(left, right, result.as_mut_ptr(), columns, columns, start)
    }

    fn new(
        left: Left<'a>,
        right: Right<'a>,
        result: *mut f32,
        stride: usize,
        columns: usize,
        start: InitialSum<'a>,
    ) -> Self {
        let groups = columns.div_ceil(LANES);
        let last = (groups.max(1) - 1) * right.group + (left.depth - 1) * right.row;
        assert!(columns > 0 && last < right.lines.len(), "columns or rows beyond the right side");
        if let InitialSum::Bias(bias) = start {
            assert!(groups <= bias.len(), "a bias of {} lines for {groups} groups", bias.len());
        }
        let relu = false;
        let padded = false;
        let borrowed = PhantomData;
        Self { left, right, start, relu, columns, result, stride, padded, borrowed }
    }

    /// The same product with `max(x, 0)` applied to every element.
    pub(crate) fn rectified(self) -> Self {
        Self { relu: true, ..self }
    }
}

/// Computes the product.
impl Operation for &Product<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let tiles = self.left.rows.div_ceil(S::TILE_SUMS.min(TILE_ROWS));
        let height = self.left.rows / tiles;
        let taller = self.left.rows % tiles;
        let groups = self.columns.div_ceil(LANES);
        let whole = if self.padded { groups } else { self.columns / LANES };
        let tallest = height + usize::from(taller > 0);
        let mut group = 0;
        while group < groups {
            // Several groups hide the latency of the multiply-adds and read each value of the left side once.
            let fits = |count: &usize| count * tallest <= S::TILE_SUMS && group + count <= whole;
            let count = [4, 2].into_iter().find(fits).unwrap_or(1);
            let mut row = 0;
            for tile in 0..tiles {
                let rows = height + usize::from(tile < taller);
                // SAFETY: `row + rows` is at most the number of rows and `group + count` the number of groups; several
                // groups are whole. `Product::new` and its callers checked the extents.
                unsafe { tile_of(simd, self, (group, count), (row, rows)) };
                row += rows;
            }
            group += count;
        }
    }
}

/// # Safety
/// Rows and groups are in the product, and several groups are whole.
#[inline(always)]
unsafe fn tile_of<S: Simd>(
    simd: S,
    product: &Product<'_>,
    (group, count): (usize, usize),
    (row, rows): (usize, usize),
) {
    macro_rules! by_shape {
        ($($height:literal x $groups:literal,)*) => {
            match (rows, count) {
                $(($height, $groups) if $height * $groups <= S::TILE_SUMS => {
                    // SAFETY: guaranteed by the caller.
                    unsafe { tile::<S, $height, $groups>(simd, product, group, row) }
                })*
                _ => unreachable!("a tile of {rows} rows and {count} groups"),
            }
        };
    }
    by_shape!(
        1 x 1, 2 x 1, 3 x 1, 4 x 1, 5 x 1, 6 x 1, 7 x 1, 8 x 1, 9 x 1, 10 x 1, 11 x 1, 12 x 1,
        1 x 2, 2 x 2, 3 x 2, 4 x 2, 5 x 2, 6 x 2, 7 x 2, 8 x 2, 9 x 2, 10 x 2, 11 x 2, 12 x 2,
        1 x 4, 2 x 4, 3 x 4, 4 x 4, 5 x 4, 6 x 4,
    );
}

/// `M` rows of `N` groups of sixteen columns.
///
/// # Safety
/// Rows and groups are in the product, and several groups are whole.
#[inline(always)]
unsafe fn tile<S: Simd, const M: usize, const N: usize>(
    simd: S,
    product: &Product<'_>,
    group: usize,
    row: usize,
) {
    let Product { left, right, stride, .. } = product;
    let whole = product.padded || (group + N) * LANES <= product.columns;
    let width = if whole { LANES } else { product.columns - group * LANES };
    let mut sums = [[simd.splat(0.0); N]; M];
    // SAFETY: rows and groups are in range by the contract of the caller; `Product::new` checked the extents.
    unsafe {
        let result = product.result.add(row * stride + group * LANES);
        for (m, sums) in sums.iter_mut().enumerate() {
            for (n, sum) in sums.iter_mut().enumerate() {
                *sum = match product.start {
                    InitialSum::Zero => *sum,
                    InitialSum::Bias(bias) => simd.load(bias.get_unchecked(group + n)),
                    InitialSum::Result if whole => {
                        simd.load_pointer(result.add(m * stride + n * LANES))
                    }
                    InitialSum::Result => load_part(simd, result.add(m * stride), width),
                };
            }
        }
        let mut a = left.data.add(row * left.outer);
        let mut b = right.lines.as_ptr().add(group * right.group).cast::<f32>();
        for _ in 0..left.depth {
            let mut lines = [simd.splat(0.0); N];
            for (n, line) in lines.iter_mut().enumerate() {
                *line = simd.load_pointer(b.add(n * right.group * LANES));
            }
            for (m, sums) in sums.iter_mut().enumerate() {
                let a = simd.splat(*a.add(m * left.outer));
                for (sum, line) in sums.iter_mut().zip(lines) {
                    *sum = simd.fma(a, line, *sum);
                }
            }
            a = a.wrapping_add(left.inner);
            b = b.wrapping_add(right.row * LANES);
        }
        for (m, sums) in sums.into_iter().enumerate() {
            for (n, mut sum) in sums.into_iter().enumerate() {
                if product.relu {
                    sum = simd.at_least(simd.splat(0.0), sum);
                }
                if whole {
                    simd.store_pointer(sum, result.add(m * stride + n * LANES))
                } else {
                    store_part(simd, sum, result.add(m * stride), width)
                }
            }
        }
    }
}

/// Loads `width` lanes; the others are 0.
///
/// # Safety
/// `from` is valid for reading `width` values.
#[inline(always)]
unsafe fn load_part<S: Simd>(simd: S, from: *const f32, width: usize) -> S::Vector {
    let mut line = Line::default();
    // SAFETY: guaranteed by the caller; a line has sixteen values.
    unsafe { core::ptr::copy_nonoverlapping(from, line.0.as_mut_ptr(), width) };
    simd.load(&line)
}

/// # Safety
/// `to` is valid for writing `width` values.
#[inline(always)]
unsafe fn store_part<S: Simd>(simd: S, x: S::Vector, to: *mut f32, width: usize) {
    let mut line = Line::default();
    simd.store(x, &mut line);
    // SAFETY: guaranteed by the caller; a line has sixteen values.
    unsafe { core::ptr::copy_nonoverlapping(line.0.as_ptr(), to, width) };
}
