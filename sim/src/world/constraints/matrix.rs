//! Vectors, and square matrices by rows, of which only the lower half is read.
//!
//! All sums have a fixed order and only use arithmetic and square roots, so that every platform finds the same bits.

/// Least part of a diagonal number that is left by the lines below it.
const LEAST_PIVOT: f64 = 1e-15;
/// Partial sums of a scalar product, which do not wait for each other.
const PARTS: usize = 4;

pub(super) fn dot(a: &[f64], b: &[f64]) -> f64 {
    let mut parts = [0.0; PARTS];
    let (whole, rest) = (a.chunks_exact(PARTS), b.chunks_exact(PARTS));
    let ends = whole.remainder().iter().zip(rest.remainder());
    for (a, b) in whole.zip(rest) {
        for part in 0..PARTS {
            parts[part] += a[part] * b[part];
        }
    }
    let sum = (parts[0] + parts[1]) + (parts[2] + parts[3]);
    ends.fold(sum, |sum, (a, b)| sum + a * b)
}

pub(super) fn add_scaled(out: &mut [f64], factor: f64, numbers: &[f64]) {
    out.iter_mut().zip(numbers).for_each(|(out, number)| *out += factor * number);
}

/// Product of a symmetric matrix, of which the lower half is read, with a vector.
pub(super) fn multiply(matrix: &[f64], vector: &[f64], out: &mut [f64]) {
    out.fill(0.0);
    for (index, line) in matrix.chunks_exact(vector.len()).enumerate() {
        out[index] += dot(&line[..=index], &vector[..=index]);
        add_scaled(&mut out[..index], vector[index], &line[..index]);
    }
}

/// A positive definite matrix `L^T L` with a lower half `L`. Lines are eliminated from the last to the first, so `L` has no
/// numbers where the matrix of a tree, parents before children, has none.
#[derive(Debug, Default)]
pub(super) struct Factor {
    /// The lower half of the matrix by rows, which [`Self::factorise`] uses up.
    pub(super) matrix: Vec<f64>,
    size: usize,
    /// For each line of `L` from the last, the columns of its numbers left of the diagonal, and the numbers.
    columns: Vec<usize>,
    numbers: Vec<f64>,
    /// For each line, its first column among all, and its inverse diagonal number.
    starts: Vec<usize>,
    inverses: Vec<f64>,
}

impl Factor {
    /// Computes `L`.
    pub(super) fn factorise(&mut self, size: usize) {
        let Self { matrix, columns, numbers, starts, inverses, .. } = self;
        self.size = size;
        columns.clear();
        numbers.clear();
        starts.clear();
        starts.resize(size + 1, 0);
        // Until a line is reached, the number on its diagonal.
        inverses.clear();
        inverses.extend((0..size).map(|index| matrix[index * size + index]));
        for index in (0..size).rev() {
            let (above, line) = matrix.split_at_mut(index * size);
            // Of a matrix that is all but singular, rounding would leave less than nothing.
            let pivot = line[index].max(LEAST_PIVOT * inverses[index]);
            let inverse = 1.0 / pivot.sqrt();
            inverses[index] = inverse;
            let start = columns.len();
            starts[index] = start;
            for (column, number) in line[..index].iter().enumerate() {
                if *number != 0.0 {
                    columns.push(column);
                    numbers.push(number * inverse);
                }
            }
            let (columns, numbers) = (&columns[start..], &numbers[start..]);
            for (count, (row, factor)) in columns.iter().zip(numbers).enumerate() {
                let above = &mut above[row * size..][..=*row];
                for (column, number) in columns[..=count].iter().zip(numbers) {
                    above[*column] -= factor * number;
                }
            }
        }
    }

    /// Columns and numbers of a line, left of the diagonal.
    fn line(&self, index: usize) -> impl Iterator<Item = (usize, f64)> {
        let end = if index == 0 { self.columns.len() } else { self.starts[index - 1] };
        let range = self.starts[index]..end;
        self.columns[range.clone()].iter().copied().zip(self.numbers[range].iter().copied())
    }

    /// Solves the system with this right-hand side, which is replaced by the solution.
    pub(super) fn solve(&self, vector: &mut [f64]) {
        for index in (0..self.size).rev() {
            vector[index] *= self.inverses[index];
            let number = vector[index];
            for (column, factor) in self.line(index) {
                vector[column] -= factor * number;
            }
        }
        for index in 0..self.size {
            let sum = self
                .line(index)
                .fold(vector[index], |sum, (column, factor)| sum - factor * vector[column]);
            vector[index] = sum * self.inverses[index];
        }
    }
}
