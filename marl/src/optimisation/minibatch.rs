//! Random minibatches, and splits in fixed order.

use std::ops::Range;

use policy::randomness::{Draw, RunSeed, generator};
use rand::RngCore;

/// A random permutation of `0..count` (Fisher-Yates).
pub(crate) fn permutation(count: usize, rng: &mut impl RngCore) -> Vec<usize> {
    let mut order: Vec<usize> = (0..count).collect();
    for last in (1..count).rev() {
        order.swap(last, below(last + 1, rng));
    }
    order
}

/// A uniform integer below `bound`: the high half of a 64-bit product, with a bias below `bound / 2^64`.
pub(crate) fn below(bound: usize, rng: &mut impl RngCore) -> usize {
    ((u128::from(rng.next_u64()) * bound as u128) >> 64) as usize
}

/// Splits `0..count` into `parts` ranges whose lengths differ by at most one; empty ranges are omitted.
pub(crate) fn split(count: usize, parts: usize) -> Vec<Range<usize>> {
    let edge = |part: usize| part * count / parts;
    (0..parts).map(|part| edge(part)..edge(part + 1)).filter(|range| !range.is_empty()).collect()
}

/// The minibatches of one epoch over `0..count`; together they contain every index. A single minibatch is not shuffled,
/// because its order would only affect the order of summation.
pub(crate) fn minibatches(
    count: usize,
    parts: usize,
    seed: RunSeed,
    draw: Draw,
) -> Vec<Vec<usize>> {
    if parts == 1 {
        return vec![(0..count).collect()];
    }
    let order = permutation(count, &mut generator(seed, draw));
    split(count, parts).into_iter().map(|range| order[range].to_vec()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use policy::randomness::Purpose;

    #[test]
    fn parts_cover_every_index_once_and_differ_by_at_most_one() {
        assert_eq!(split(10, 4), vec![0..2, 2..5, 5..7, 7..10]);
        assert_eq!(split(2, 3), vec![0..1, 1..2]);
        let draw = Draw::of(Purpose::Minibatch).iteration(3);
        let mut all = minibatches(11, 3, RunSeed(1), draw).concat();
        all.sort_unstable();
        assert_eq!(all, (0..11).collect::<Vec<_>>());
    }

    #[test]
    fn permutations_of_three_are_equally_likely() {
        let mut rng = generator(RunSeed(5), Draw::of(Purpose::AgentOrder));
        let mut counts = std::collections::BTreeMap::new();
        for _ in 0..6000 {
            *counts.entry(permutation(3, &mut rng)).or_insert(0_i32) += 1;
        }
        assert_eq!(counts.len(), 6);
        assert!(counts.values().all(|&count| (count - 1000).abs() < 150), "{counts:?}");
    }
}
