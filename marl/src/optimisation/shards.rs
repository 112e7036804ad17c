//! Parallel computation over shards of rows, whose results are added in a fixed tree.

use std::ops::Range;

use rayon::prelude::*;

use crate::error::MarlError;
use crate::optimisation::gradient::Gradients;
use crate::optimisation::minibatch::split;

/// Maximum number of shards of a minibatch. With [`ROWS_PER_SHARD`] it determines the order of sums, and so the bits of
/// every run.
const MAX_SHARDS: usize = 16;

/// Rows per shard on average, if there is more than one. Smaller shards would leave the kernels idle.
const ROWS_PER_SHARD: usize = 64;

/// Shards of `0..count`, for `count` sequences of `steps` rows each.
pub(crate) fn shards(count: usize, steps: usize) -> Vec<Range<usize>> {
    split(count, (count * steps / ROWS_PER_SHARD).clamp(1, MAX_SHARDS))
}

/// Figures of parts of a minibatch, which add up to those of the whole.
pub(crate) trait Accumulate: Send {
    /// Adds the figures of the next shard.
    fn accumulate(&mut self, next: &Self);
}

impl Accumulate for f64 {
    fn accumulate(&mut self, next: &Self) {
        *self += next;
    }
}

/// Results of all shards, in order.
pub(crate) fn of_each<T: Send>(
    shards: &[Range<usize>],
    one: impl Fn(Range<usize>) -> Result<T, MarlError> + Sync,
) -> Result<Vec<T>, MarlError> {
    shards.par_iter().map(|range| one(range.clone())).collect()
}

/// Figures and gradients of all shards, added in a binary tree whose shape depends only on the number of shards.
///
/// # Errors
/// Returns the error of the first failed shard.
///
/// # Panics
/// If there are no shards.
pub(crate) fn sum<F: Accumulate>(
    shards: &[Range<usize>],
    one: &(impl Fn(Range<usize>) -> Result<(F, Gradients), MarlError> + Sync),
) -> Result<(F, Gradients), MarlError> {
    assert!(!shards.is_empty(), "no shards to add");
    if let [only] = shards {
        return one(only.clone());
    }
    let (first, last) = shards.split_at(shards.len() / 2);
    let (first, last) = rayon::join(|| sum(first, one), || sum(last, one));
    let ((mut figures, mut gradients), (next, others)) = (first?, last?);
    figures.accumulate(&next);
    gradients.add(&others);
    Ok((figures, gradients))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shards_have_sixty_four_rows_on_average_and_are_at_most_sixteen() {
        assert_eq!(shards(400, 10).len(), 16);
        assert_eq!(shards(10, 10).len(), 1);
        assert_eq!(shards(300, 1).len(), 4);
        assert_eq!(shards(1, 1), vec![0..1]);
    }

    #[test]
    fn the_tree_adds_neighbours_first_on_any_number_of_threads() {
        // In single precision 1e8 + 1 is 1e8. Both pairs lose their 1; a sequential sum would keep one of them.
        let numbers = [1e8_f32, 1.0, -1e8, 1.0];
        let one = |range: Range<usize>| {
            Ok((range.len() as f64, Gradients(vec![vec![numbers[range.start]]])))
        };
        for threads in [1, 3] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let (count, total) = pool.install(|| sum(&[0..1, 1..2, 2..3, 3..4], &one)).unwrap();
            assert_eq!((count, total.0), (4.0, vec![vec![0.0]]));
        }
    }
}
