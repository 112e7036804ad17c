//! Rows computed side by side, and the fixed tree in which what they give is added.

use std::ops::Range;

use rayon::prelude::*;

use crate::error::MarlError;
use crate::optimisation::gradient::Gradients;
use crate::optimisation::minibatch::split;

/// The most shards of a minibatch. With [`ROWS`] it decides the order of sums, and so the bits of every run.
const MOST: usize = 16;

/// Rows of a shard on average, if there is more than one: fewer would leave the kernels waiting.
const ROWS: usize = 64;

/// `0..count` in shards, for `count` sequences of `steps` rows each.
pub(crate) fn shards(count: usize, steps: usize) -> Vec<Range<usize>> {
    split(count, (count * steps / ROWS).clamp(1, MOST))
}

/// Figures that shares of a minibatch add up to.
pub(crate) trait Share: Send {
    /// Adds what the shard after gives.
    fn add_share(&mut self, next: &Self);
}

impl Share for f64 {
    fn add_share(&mut self, next: &Self) {
        *self += next;
    }
}

/// What every shard gives, in their order.
pub(crate) fn of_each<T: Send>(
    shards: &[Range<usize>],
    one: impl Fn(Range<usize>) -> Result<T, MarlError> + Sync,
) -> Result<Vec<T>, MarlError> {
    shards.par_iter().map(|range| one(range.clone())).collect()
}

/// Figures and gradients of all shards, added in a binary tree whose shape depends on their number alone.
///
/// # Errors
/// Passes on the first shard's error.
///
/// # Panics
/// Without a shard.
pub(crate) fn sum<F: Share>(
    shards: &[Range<usize>],
    one: &(impl Fn(Range<usize>) -> Result<(F, Gradients), MarlError> + Sync),
) -> Result<(F, Gradients), MarlError> {
    assert!(!shards.is_empty(), "a sum of no shards");
    if let [only] = shards {
        return one(only.clone());
    }
    let (first, last) = shards.split_at(shards.len() / 2);
    let (first, last) = rayon::join(|| sum(first, one), || sum(last, one));
    let ((mut figures, mut gradients), (next, others)) = (first?, last?);
    figures.add_share(&next);
    gradients.add(&others);
    Ok((figures, gradients))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optimisation::reals::Reals;

    #[test]
    fn shards_have_sixty_four_rows_on_average_and_are_at_most_sixteen() {
        assert_eq!(shards(400, 10).len(), 16);
        assert_eq!(shards(10, 10).len(), 1);
        assert_eq!(shards(300, 1).len(), 4);
        assert_eq!(shards(1, 1), vec![0..1]);
    }

    #[test]
    fn the_tree_adds_neighbours_first_on_any_number_of_threads() {
        // In single precision 1e8 + 1 is 1e8: both pairs lose their 1, which a sum from first to last would keep once.
        let numbers = [1e8_f32, 1.0, -1e8, 1.0];
        let one = |range: Range<usize>| {
            Ok((range.len() as f64, Gradients(vec![Reals::Single(vec![numbers[range.start]])])))
        };
        for threads in [1, 3] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let (count, total) = pool.install(|| sum(&[0..1, 1..2, 2..3, 3..4], &one)).unwrap();
            assert_eq!((count, total.0[0].numbers()), (4.0, vec![0.0]));
        }
    }
}
