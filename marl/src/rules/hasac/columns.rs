//! Batch statistics of the columns of a layer's input, and the normalisation of its rows by them.

use libm::sqrt;

/// Added to variances before the square root, as in PyTorch.
const EPSILON: f64 = 1e-5;

/// Mean and variance of every column.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct ColumnMoments {
    pub(super) mean: Vec<f64>,
    pub(super) variance: Vec<f64>,
}

impl ColumnMoments {
    /// Mean 0 and variance 1 of `columns` columns.
    pub(super) fn standard(columns: usize) -> Self {
        Self { mean: vec![0.0; columns], variance: vec![1.0; columns] }
    }

    /// Moments of all rows, from the sums of their shards in order; the variance is the biased one.
    pub(super) fn of(shards: &[ColumnSums], rows: usize) -> Self {
        let share = 1.0 / rows as f64;
        let total = |sums: fn(&ColumnSums) -> &[f64], column: usize| {
            shards.iter().map(|shard| sums(shard)[column]).sum::<f64>()
        };
        let columns = shards[0].plain.len();
        let mean: Vec<f64> =
            (0..columns).map(|column| share * total(|sums| &sums.plain, column)).collect();
        let variance = |(column, mean): (usize, &f64)| {
            (share * total(|sums| &sums.squares, column) - mean * mean).max(0.0)
        };
        let variance = mean.iter().enumerate().map(variance).collect();
        Self { mean, variance }
    }

    /// Moves running statistics towards those of a batch of `rows` rows: `r += momentum (batch - r)` with the unbiased
    /// variance. Statistics that are not finite change nothing.
    pub(super) fn follow(&mut self, batch: &Self, rows: usize, momentum: f64) {
        let unbiased = rows as f64 / (rows as f64 - 1.0);
        let pairs = self.mean.iter_mut().zip(&mut self.variance);
        for ((mean, variance), (&new_mean, &new_variance)) in
            pairs.zip(batch.mean.iter().zip(&batch.variance))
        {
            if new_mean.is_finite() && new_variance.is_finite() {
                *mean += momentum * (new_mean - *mean);
                *variance += momentum * (unbiased * new_variance - *variance);
            }
        }
    }

    /// `1 / sqrt(variance + epsilon)` of every column.
    pub(super) fn inverse_deviations(&self) -> Vec<f32> {
        self.variance.iter().map(|variance| (1.0 / sqrt(variance + EPSILON)) as f32).collect()
    }
}

/// Sums over the rows of a shard, of every column.
pub(super) struct ColumnSums {
    plain: Vec<f64>,
    squares: Vec<f64>,
}

impl ColumnSums {
    /// Sums of `rows` `[R, columns]`, in the order of rows.
    pub(super) fn of(rows: &[f32], columns: usize) -> Self {
        let (mut plain, mut squares) = (vec![0.0; columns], vec![0.0; columns]);
        for row in rows.chunks_exact(columns) {
            for ((plain, square), &x) in plain.iter_mut().zip(&mut squares).zip(row) {
                let x = f64::from(x);
                *plain += x;
                *square += x * x;
            }
        }
        Self { plain, squares }
    }
}

/// The normalisation of rows by the moments of their batch, and its gradient.
#[derive(Clone, Debug, Default)]
pub(super) struct Normalisation {
    mean: Vec<f32>,
    inverse: Vec<f32>,
}

impl Normalisation {
    pub(super) fn by(moments: &ColumnMoments) -> Self {
        let mean = moments.mean.iter().map(|&mean| mean as f32).collect();
        Self { mean, inverse: moments.inverse_deviations() }
    }

    /// Replaces rows `x` by `n = (x - mean) / deviation`.
    pub(super) fn apply(&self, rows: &mut [f32]) {
        for row in rows.chunks_exact_mut(self.mean.len()) {
            for ((x, mean), inverse) in row.iter_mut().zip(&self.mean).zip(&self.inverse) {
                *x = (*x - mean) * inverse;
            }
        }
    }

    /// Replaces the gradient `g` of the normalised rows `n` by that of `x`, also through the moments of the batch:
    /// `(g - mean(g) - n mean(g n)) / deviation`. The means over the batch are given for every column.
    pub(super) fn gradient(
        &self,
        rows: &mut [f32],
        normal: &[f32],
        [plain, products]: [&[f32]; 2],
    ) {
        let columns = self.mean.len();
        for (row, normal) in rows.chunks_exact_mut(columns).zip(normal.chunks_exact(columns)) {
            let means = plain.iter().zip(products).zip(&self.inverse);
            for ((g, n), ((plain, products), inverse)) in row.iter_mut().zip(normal).zip(means) {
                *g = (*g - plain - n * products) * inverse;
            }
        }
    }
}
