//! Initial weights, drawn from a given generator.

use rand::RngCore;

use crate::randomness::standard_normal;

/// An orthogonal `[rows, columns]` matrix times `gain`, row-major: orthonormal rows, or columns if
/// there are more rows than columns. Gram-Schmidt, twice, on normal draws in f64.
pub(crate) fn orthogonal(
    rng: &mut impl RngCore,
    rows: usize,
    columns: usize,
    gain: f64,
) -> Vec<f32> {
    let (count, length) = (rows.min(columns), rows.max(columns));
    let mut basis: Vec<Vec<f64>> = Vec::with_capacity(count);
    while basis.len() < count {
        let draw = (0..length).map(|_| f64::from(standard_normal(rng))).collect();
        // A draw in the span of the others leaves no direction; draw again.
        if let Some(vector) = orthonormalised(draw, &basis) {
            basis.push(vector);
        }
    }
    let element = |row: usize, column: usize| {
        if rows <= columns { basis[row][column] } else { basis[column][row] }
    };
    let all = (0..rows).flat_map(|row| (0..columns).map(move |column| (row, column)));
    all.map(|(row, column)| (gain * element(row, column)) as f32).collect()
}

fn orthonormalised(mut vector: Vec<f64>, basis: &[Vec<f64>]) -> Option<Vec<f64>> {
    for _ in 0..2 {
        for other in basis {
            let along = dot(&vector, other);
            vector.iter_mut().zip(other).for_each(|(x, o)| *x -= along * o);
        }
    }
    let norm = libm::sqrt(dot(&vector, &vector));
    vector.iter_mut().for_each(|x| *x /= norm);
    (norm > 1e-6).then_some(vector)
}

fn dot(left: &[f64], right: &[f64]) -> f64 {
    left.iter().zip(right).map(|(l, r)| l * r).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::randomness::{Draw, Purpose, RunSeed, generator};

    fn gram(matrix: &[f32], rows: usize, columns: usize, i: usize, j: usize) -> f64 {
        let at = |row: usize, column: usize| f64::from(matrix[row * columns + column]);
        if rows <= columns {
            (0..columns).map(|k| at(i, k) * at(j, k)).sum()
        } else {
            (0..rows).map(|k| at(k, i) * at(k, j)).sum()
        }
    }

    #[test]
    fn rows_or_columns_are_orthonormal_times_the_gain() {
        let mut rng = generator(RunSeed(1), Draw::of(Purpose::Initialisation));
        for (rows, columns) in [(1, 5), (5, 1), (4, 7), (7, 4), (64, 64)] {
            let matrix = orthogonal(&mut rng, rows, columns, 2.0);
            for i in 0..rows.min(columns) {
                for j in 0..rows.min(columns) {
                    let expected = if i == j { 4.0 } else { 0.0 };
                    let found = gram(&matrix, rows, columns, i, j);
                    assert!((found - expected).abs() < 1e-5, "{rows}x{columns} ({i},{j}): {found}");
                }
            }
        }
    }

    #[test]
    fn elements_have_the_mean_and_variance_of_a_random_rotation() {
        let mut rng = generator(RunSeed(2), Draw::of(Purpose::Initialisation));
        let matrix = orthogonal(&mut rng, 100, 100, 1.0);
        let mean = matrix.iter().map(|&x| f64::from(x)).sum::<f64>() / 1e4;
        let square = matrix.iter().map(|&x| f64::from(x) * f64::from(x)).sum::<f64>() / 1e4;
        assert!(mean.abs() < 4e-3 && (square - 0.01).abs() < 1e-6, "mean {mean}, square {square}");
    }
}
