//! The Jacobian of all constraints. A constraint moves few links, so only the columns in which it has numbers are kept.

use super::problem::{Kind, MOST_ROWS};

/// A constraint: its kind and its rows.
#[derive(Clone, Copy, Debug)]
pub(super) struct Constraint {
    pub(super) kind: Kind,
    /// Its first row among all, and their number.
    pub(super) first: usize,
    pub(super) count: usize,
    /// The range of its columns among all.
    columns: [usize; 2],
    /// The first number of its rows among all.
    numbers: usize,
}

/// The constraints with the Jacobian: of each, the columns in which a row has a number, and these numbers by rows.
#[derive(Debug, Default)]
pub(super) struct Rows {
    pub(super) constraints: Vec<Constraint>,
    columns: Vec<usize>,
    numbers: Vec<f64>,
}

/// The rows of one constraint.
pub(super) struct Jacobian<'a> {
    columns: &'a [usize],
    /// By rows.
    numbers: &'a [f64],
}

impl Rows {
    /// Removes all constraints.
    pub(super) fn clear(&mut self) {
        self.constraints.clear();
        self.columns.clear();
        self.numbers.clear();
    }

    /// Adds a constraint whose first row is the row `first` of all, with its rows in full.
    pub(super) fn add(&mut self, kind: Kind, first: usize, (rows, size): (&[f64], usize)) {
        let (start, numbers) = (self.columns.len(), self.numbers.len());
        let count = rows.len() / size;
        let has_number = |column: &usize| (0..count).any(|row| rows[row * size + column] != 0.0);
        self.columns.extend((0..size).filter(has_number));
        for row in rows.chunks_exact(size) {
            self.numbers.extend(self.columns[start..].iter().map(|column| row[*column]));
        }
        let columns = [start, self.columns.len()];
        self.constraints.push(Constraint { kind, first, count, columns, numbers });
    }

    pub(super) fn of(&self, constraint: &Constraint) -> Jacobian<'_> {
        let [start, end] = constraint.columns;
        let numbers = constraint.numbers..constraint.numbers + constraint.count * (end - start);
        Jacobian { columns: &self.columns[start..end], numbers: &self.numbers[numbers] }
    }

    /// Product of all rows with a vector.
    pub(super) fn multiply(&self, vector: &[f64], out: &mut Vec<f64>) {
        out.clear();
        for constraint in &self.constraints {
            let jacobian = self.of(constraint);
            for row in 0..constraint.count {
                let numbers = jacobian.row(row).iter().zip(jacobian.columns);
                out.push(numbers.fold(0.0, |sum, (number, column)| sum + number * vector[*column]));
            }
        }
    }
}

impl Jacobian<'_> {
    fn row(&self, row: usize) -> &[f64] {
        &self.numbers[row * self.columns.len()..][..self.columns.len()]
    }

    /// Subtracts the product of the transposed rows with the forces.
    pub(super) fn subtract(&self, forces: &[f64], out: &mut [f64]) {
        for (index, force) in forces.iter().enumerate().filter(|(_, force)| **force != 0.0) {
            for (column, number) in self.columns.iter().zip(self.row(index)) {
                out[*column] -= force * number;
            }
        }
    }

    /// Adds `J^T C J` to the lower half of a matrix with `size` columns.
    pub(super) fn add_curvature(
        &self,
        curvature: &[[f64; MOST_ROWS]; MOST_ROWS],
        out: &mut [f64],
        size: usize,
    ) {
        let count = self.numbers.len() / self.columns.len().max(1);
        for (index, factors) in curvature.iter().enumerate().take(count) {
            let second = self.row(index);
            for (place, column) in self.columns.iter().enumerate() {
                let parts = factors[..count].iter().enumerate();
                let scaled = parts.fold(0.0, |sum, (k, factor)| sum + factor * self.row(k)[place]);
                let line = &mut out[column * size..][..size];
                for (other, number) in self.columns[..=place].iter().zip(second) {
                    line[*other] += scaled * number;
                }
            }
        }
    }
}
