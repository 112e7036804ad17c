//! Vectors, and square matrices by rows, of which only the lower half is read.
//!
//! All sums have a fixed order and only use arithmetic and square roots, so that every platform finds the same bits.

/// Least part of a diagonal number that is left by the lines above it.
const LEAST_PIVOT: f64 = 1e-15;

pub(super) fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).fold(0.0, |sum, (a, b)| sum + a * b)
}

pub(super) fn add_scaled(out: &mut [f64], factor: f64, numbers: &[f64]) {
    out.iter_mut().zip(numbers).for_each(|(out, number)| *out += factor * number);
}

/// Adds `factor a b^T` to the lower half of a matrix.
pub(super) fn add_product(matrix: &mut [f64], factor: f64, a: &[f64], b: &[f64]) {
    for (index, (line, number)) in matrix.chunks_exact_mut(a.len()).zip(a).enumerate() {
        if *number != 0.0 {
            add_scaled(&mut line[..=index], factor * number, b);
        }
    }
}

/// Product of a symmetric matrix, of which the lower half is read, with a vector.
pub(super) fn multiply(matrix: &[f64], vector: &[f64], out: &mut [f64]) {
    out.fill(0.0);
    for (index, line) in matrix.chunks_exact(vector.len()).enumerate() {
        out[index] += dot(&line[..=index], vector);
        add_scaled(&mut out[..index], vector[index], line);
    }
}

/// Replaces the lower half of a positive definite matrix by its Cholesky factor.
pub(super) fn factorise(matrix: &mut [f64], size: usize) {
    for index in 0..size {
        let (done, rest) = matrix.split_at_mut(index * size);
        let line = &mut rest[..size];
        for column in 0..index {
            let other = &done[column * size..][..=column];
            line[column] = (line[column] - dot(&line[..column], other)) / other[column];
        }
        // Of a matrix that is all but singular, rounding would leave less than nothing.
        let least = LEAST_PIVOT * line[index];
        line[index] = (line[index] - dot(&line[..index], &line[..index])).max(least).sqrt();
    }
}

/// Solves a system with a Cholesky factor.
pub(super) fn substitute(factor: &[f64], vector: &mut [f64]) {
    let size = vector.len();
    for index in 0..size {
        let line = &factor[index * size..][..=index];
        vector[index] = (vector[index] - dot(&line[..index], vector)) / line[index];
    }
    for index in (0..size).rev() {
        let line = &factor[index * size..][..=index];
        vector[index] /= line[index];
        let number = vector[index];
        add_scaled(&mut vector[..index], -number, line);
    }
}
