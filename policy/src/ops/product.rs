//! Matrix products into our own buffers.

use crate::math::Real;

/// A row-major matrix `[rows, columns]`, or the transpose of one.
#[derive(Clone, Copy)]
pub(super) struct Matrix<'a, T> {
    data: &'a [T],
    rows: usize,
    columns: usize,
    transposed: bool,
}

impl<'a, T> Matrix<'a, T> {
    /// `data` as `[rows, columns]`.
    pub(super) fn new(data: &'a [T], rows: usize, columns: usize) -> Self {
        assert_eq!(data.len(), rows * columns, "a matrix of {rows} x {columns}");
        Self { data, rows, columns, transposed: false }
    }

    /// Its transpose, `[columns, rows]`.
    pub(super) fn t(self) -> Self {
        Self { rows: self.columns, columns: self.rows, transposed: !self.transposed, ..self }
    }

    /// Strides along columns and rows, in elements.
    fn strides(&self) -> (isize, isize) {
        if self.transposed { (self.rows as isize, 1) } else { (1, self.columns as isize) }
    }
}

/// `into += left right` for a row-major `into` of `[left.rows, right.columns]`, on this thread.
pub(super) fn add_product<T: Real>(into: &mut [T], left: Matrix<'_, T>, right: Matrix<'_, T>) {
    let (rows, inner, columns) = (left.rows, left.columns, right.columns);
    assert_eq!(inner, right.rows, "inner axes of a matrix product");
    assert_eq!(into.len(), rows * columns, "result of a matrix product");
    let (left_cs, left_rs) = left.strides();
    let (right_cs, right_rs) = right.strides();
    #[expect(unsafe_code, reason = "gemm takes raw pointers; the lengths are asserted above")]
    // SAFETY: every pointer is that of a slice whose length the strides and sizes stay within.
    unsafe {
        gemm::gemm(
            rows,
            columns,
            inner,
            into.as_mut_ptr(),
            1,
            columns as isize,
            true,
            left.data.as_ptr(),
            left_cs,
            left_rs,
            right.data.as_ptr(),
            right_cs,
            right_rs,
            T::one(),
            T::one(),
            false,
            false,
            false,
            gemm::Parallelism::None,
        );
    }
}

/// Adds every row of `rows`, `[R, W]`, to `into`, `[W]`.
pub(super) fn add_rows<T: Real>(into: &mut [T], rows: &[T]) {
    for row in rows.chunks_exact(into.len()) {
        for (sum, &value) in into.iter_mut().zip(row) {
            *sum += value;
        }
    }
}

/// `count` copies of `row`, one after another.
pub(super) fn repeated<T: Real>(row: &[T], count: usize) -> Vec<T> {
    let mut all = Vec::with_capacity(row.len() * count);
    for _ in 0..count {
        all.extend_from_slice(row);
    }
    all
}
