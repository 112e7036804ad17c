//! Statistics of runs with several seeds: robust means, their uncertainty, learning speed, comparison of variants. Pure
//! functions of the runs' numbers; resampling draws from a keyed generator.

use policy::randomness::uniform;
use policy::{Draw, Purpose, RunSeed, generator};

/// Resamplings of a bootstrap whose interval is drawn.
pub(crate) const DRAWN_RESAMPLES: usize = 2_000;

/// Resamplings of a bootstrap whose interval is printed, with digits that more resamplings hardly change.
pub(crate) const PRINTED_RESAMPLES: usize = 20_000;

/// Random exchanges of a permutation test.
const PERMUTATIONS: usize = 100_000;

/// Share of a bootstrap's resamplings inside its interval.
const CONFIDENCE: f64 = 0.95;

/// From one value to another.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Interval {
    /// Lower end.
    pub(crate) low: f64,
    /// Upper end.
    pub(crate) high: f64,
}

/// `IQM(x) = 2 * integral of Q(u) du, u from 1/4 to 3/4`, with the quantile function `Q` of values of weight
/// `1 / n` each: the mean of the middle half. NaN without values.
pub(crate) fn interquartile_mean(values: &[f64]) -> f64 {
    if values.is_empty() {
        return f64::NAN;
    }
    let sorted = sorted(values);
    let n = values.len() as f64;
    let in_the_middle = |rank: usize| {
        let from = rank as f64 / n;
        let to = (rank + 1) as f64 / n;
        (to.min(0.75) - from.max(0.25)).max(0.0)
    };
    sorted.iter().enumerate().map(|(rank, value)| 2.0 * in_the_middle(rank) * value).sum()
}

/// `Q(share)`, between neighbouring values by a straight line: the value of rank `share * (n - 1)`. NaN
/// without values.
pub(crate) fn quantile(values: &[f64], share: f64) -> f64 {
    let sorted = sorted(values);
    let rank = share * values.len().saturating_sub(1) as f64;
    let below = rank.floor() as usize;
    let part = rank.fract();
    match (sorted.get(below), sorted.get(below + 1)) {
        (Some(low), Some(high)) if part > 0.0 => low + part * (high - low),
        (Some(only), _) => *only,
        (None, _) => f64::NAN,
    }
}

/// The quartiles: the middle half of the values is between them.
pub(crate) fn interquartile_range(values: &[f64]) -> Interval {
    Interval { low: quantile(values, 0.25), high: quantile(values, 0.75) }
}

/// The 95 % interval of `statistic` by the percentile bootstrap: every sample is resampled with replacement,
/// `resamples` times. The draws depend on `key` alone. NaN if some resamples lack the statistic.
pub(crate) fn bootstrap_interval(
    samples: &[&[f64]],
    resamples: usize,
    key: Draw,
    statistic: impl Fn(&[Vec<f64>]) -> f64,
) -> Interval {
    let mut rng = generator(RunSeed(0), Draw { purpose: Purpose::Bootstrap, ..key });
    let mut resampled = |sample: &&[f64]| -> Vec<f64> {
        let drawn = |_| (f64::from(uniform(&mut rng)) * sample.len() as f64) as usize;
        (0..sample.len()).map(drawn).map(|index| sample[index]).collect()
    };
    let statistics: Vec<f64> = (0..resamples)
        .map(|_| statistic(&samples.iter().map(&mut resampled).collect::<Vec<_>>()))
        .collect();
    if statistics.iter().any(|value| value.is_nan()) {
        return Interval { low: f64::NAN, high: f64::NAN };
    }
    let outside = (1.0 - CONFIDENCE) / 2.0;
    Interval { low: quantile(&statistics, outside), high: quantile(&statistics, 1.0 - outside) }
}

/// The bootstrap's interval of the interquartile mean.
pub(crate) fn interquartile_mean_interval(values: &[f64], resamples: usize, key: Draw) -> Interval {
    let mean = |samples: &[Vec<f64>]| interquartile_mean(&samples[0]);
    match values {
        [only] => Interval { low: *only, high: *only },
        _ => bootstrap_interval(&[values], resamples, key, mean),
    }
}

/// `integral of y dx / (x_last - x_first)` by trapezia: the mean height of a curve. Of one point its height;
/// NaN without points.
pub(crate) fn area_under_curve(points: &[(f64, f64)]) -> f64 {
    let (Some(first), Some(last)) = (points.first(), points.last()) else { return f64::NAN };
    if last.0 <= first.0 {
        return first.1;
    }
    let trapezium = |pair: &[(f64, f64)]| (pair[1].0 - pair[0].0) * (pair[0].1 + pair[1].1) / 2.0;
    points.windows(2).map(trapezium).sum::<f64>() / (last.0 - first.0)
}

/// The first `x` at which the curve is at least `threshold`, if it ever is.
pub(crate) fn first_reaching(points: &[(f64, f64)], threshold: f64) -> Option<f64> {
    points.iter().find(|point| point.1 >= threshold).map(|point| point.0)
}

/// `P(X > Y) + P(X = Y) / 2` over all pairs of a run of one variant and a run of the other: 1/2 says that neither
/// is better. NaN if one has no runs.
pub(crate) fn probability_of_improvement(runs: &[f64], baseline: &[f64]) -> f64 {
    let score = |x: f64, y: f64| match x.total_cmp(&y) {
        _ if x == y => 0.5,
        std::cmp::Ordering::Greater => 1.0,
        _ => 0.0,
    };
    let scores = runs.iter().flat_map(|x| baseline.iter().map(move |y| score(*x, *y)));
    scores.sum::<f64>() / (runs.len() * baseline.len()) as f64
}

/// Two-sided p-value of the mean over strata of [`probability_of_improvement`]. The hypothesis is that both samples of
/// a stratum have one distribution. The p-value is the share of the observed assignment and 100,000 random exchanges
/// within strata whose mean is at least as far from 1/2. The draws depend on `key` alone.
pub(crate) fn permutation_p_value(strata: &[(Vec<f64>, Vec<f64>)], key: Draw) -> f64 {
    let mut rng = generator(RunSeed(0), Draw { purpose: Purpose::Bootstrap, ..key });
    let improvement =
        |(own, rivals): &(Vec<f64>, Vec<f64>)| probability_of_improvement(own, rivals);
    let distance = |strata: &[(Vec<f64>, Vec<f64>)]| {
        (strata.iter().map(improvement).sum::<f64>() / strata.len() as f64 - 0.5).abs()
    };
    let found = distance(strata);
    let mut exchanged = |(own, rivals): &(Vec<f64>, Vec<f64>)| {
        let mut all = [own.as_slice(), rivals.as_slice()].concat();
        for last in (1..all.len()).rev() {
            all.swap(last, (f64::from(uniform(&mut rng)) * (last + 1) as f64) as usize);
        }
        let rivals = all.split_off(own.len());
        (all, rivals)
    };
    let as_far = (0..PERMUTATIONS)
        .filter(|_| {
            distance(&strata.iter().map(&mut exchanged).collect::<Vec<_>>()) >= found - 1e-12
        })
        .count();
    (as_far + 1) as f64 / (PERMUTATIONS + 1) as f64
}

/// Holm's correction of the p-values of several tests, which bounds the probability of any false rejection by the level
/// of the tests. In the order given.
pub(crate) fn holm_adjusted(p_values: &[f64]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..p_values.len()).collect();
    order.sort_by(|&left, &right| p_values[left].total_cmp(&p_values[right]));
    let mut adjusted = vec![0.0; p_values.len()];
    let mut largest = 0.0_f64;
    for (rank, &index) in order.iter().enumerate() {
        largest = largest.max((p_values.len() - rank) as f64 * p_values[index]).min(1.0);
        adjusted[index] = largest;
    }
    adjusted
}

fn sorted(values: &[f64]) -> Vec<f64> {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted
}

#[cfg(test)]
mod tests {
    use super::*;

    fn key() -> Draw {
        Draw::of(Purpose::Bootstrap)
    }

    #[test]
    fn the_interquartile_mean_of_eight_is_the_mean_of_the_middle_four() {
        let values = [900.0, 1.0, 5.0, 4.0, 3.0, 2.0, -700.0, 6.0];
        assert_eq!(interquartile_mean(&values), (2.0 + 3.0 + 4.0 + 5.0) / 4.0);
    }

    #[test]
    fn the_permutation_test_meets_the_exact_share_of_exchanges() {
        // Of the 20 ways to part six numbers in two halves, two are as uneven as this one.
        let strata = [(vec![4.0, 5.0, 6.0], vec![1.0, 2.0, 3.0])];
        assert!((permutation_p_value(&strata, key()) - 0.1).abs() < 0.003);
        let level = [(vec![1.0, 2.0], vec![1.0, 2.0])];
        assert_eq!(permutation_p_value(&level, key()), 1.0);
    }

    #[test]
    fn holms_correction_meets_a_case_worked_by_hand() {
        // In order .01, .02, .04: 3 * .01, then 2 * .02, then .04, never less than the one before.
        assert_eq!(holm_adjusted(&[0.04, 0.01, 0.02]), [0.04, 0.03, 0.04]);
        assert_eq!(holm_adjusted(&[0.6, 0.7]), [1.0, 1.0]);
    }

    #[test]
    fn where_the_quarter_cuts_a_value_it_counts_in_part() {
        // Of three runs the outer ones keep 1/3 - 1/4 = 1/12 each, the middle one 1/3: 1/6, 2/3 and 1/6 of the half.
        let mean = interquartile_mean(&[0.0, 6.0, 18.0]);
        assert!((mean - (6.0 * 2.0 / 3.0 + 18.0 / 6.0)).abs() < 1e-12, "{mean}");
        assert_eq!(interquartile_mean(&[7.0]), 7.0);
        assert!(interquartile_mean(&[]).is_nan());
    }

    #[test]
    fn quartiles_lie_between_neighbours_by_a_straight_line() {
        let range = interquartile_range(&[4.0, 1.0, 2.0, 3.0]);
        assert_eq!(range, Interval { low: 1.75, high: 3.25 });
        assert_eq!(quantile(&[5.0], 0.9), 5.0);
        // Where a rank is met exactly, its neighbour counts for nothing, not even an infinite one.
        assert_eq!(quantile(&[1.0, 2.0, f64::INFINITY], 0.5), 2.0);
    }

    #[test]
    fn the_bootstrap_of_a_mean_meets_the_interval_of_the_normal_distribution() {
        // 100 values of mean 0 and deviation 1: the mean's interval is 0 +- 1.96 / sqrt(100).
        let values: Vec<f64> = (0..100).map(|i| (f64::from(i) - 49.5) / 28.866).collect();
        let mean = |samples: &[Vec<f64>]| samples[0].iter().sum::<f64>() / 100.0;
        let interval_of = |key| bootstrap_interval(&[&values], PRINTED_RESAMPLES, key, mean);
        let interval = interval_of(key());
        assert!((interval.low + 0.196).abs() < 0.025, "{interval:?}");
        assert!((interval.high - 0.196).abs() < 0.025, "{interval:?}");
        assert_eq!(interval, interval_of(key()));
        assert_ne!(interval, interval_of(key().step(1)));
    }

    #[test]
    fn a_statistic_that_a_few_resamples_lack_has_no_interval() {
        let values: Vec<f64> = (0..100).map(f64::from).collect();
        let lacking = |samples: &[Vec<f64>]| if samples[0][0] == 0.0 { f64::NAN } else { 1.0 };
        let interval = bootstrap_interval(&[&values], DRAWN_RESAMPLES, key(), lacking);
        assert!(interval.low.is_nan() && interval.high.is_nan(), "{interval:?}");
    }

    #[test]
    fn equal_values_leave_nothing_uncertain() {
        let same = Interval { low: 3.0, high: 3.0 };
        assert_eq!(interquartile_mean_interval(&[3.0; 5], DRAWN_RESAMPLES, key()), same);
        assert_eq!(interquartile_mean_interval(&[3.0], DRAWN_RESAMPLES, key()), same);
    }

    #[test]
    fn the_area_is_the_mean_height_whatever_the_spacing() {
        // A rise from 0 to 2 over 1, then 2 over 3: (1 + 6) / 4.
        assert_eq!(area_under_curve(&[(0.0, 0.0), (1.0, 2.0), (4.0, 2.0)]), 1.75);
        assert_eq!(area_under_curve(&[(5.0, 2.5)]), 2.5);
    }

    #[test]
    fn the_threshold_is_reached_at_the_first_point_on_it() {
        let points = [(0.0, 1.0), (10.0, 4.0), (20.0, 3.0), (30.0, 5.0)];
        assert_eq!(first_reaching(&points, 4.0), Some(10.0));
        assert_eq!(first_reaching(&points, 6.0), None);
    }

    #[test]
    fn improvement_counts_pairs_and_halves_ties() {
        // Of 6 pairs: 3 > 1, 3 > 2, 2 > 1 win, 2 = 2 is a tie, 3 < 4 and 2 < 4 lose.
        let probability = probability_of_improvement(&[3.0, 2.0], &[1.0, 2.0, 4.0]);
        assert!((probability - 3.5 / 6.0).abs() < 1e-12, "{probability}");
        assert_eq!(probability_of_improvement(&[5.0, 6.0], &[1.0]), 1.0);
    }
}
