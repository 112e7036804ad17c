//! Mutual information of discrete joint actions with few values, by counting.

use std::collections::BTreeMap;

use libm::log;

/// One joint action and its state. The numbers are ids without order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct JointSample {
    /// Id of `s^i`: equal for equal knowledge of the agent.
    pub state: u64,
    /// The agent's action `a^i`.
    pub own: u32,
    /// The other agents' joint action `a^-i`.
    pub others: u64,
}

/// Replaces `log 0`. `e^-700` is 1e-304, and products with its logarithm are finite.
const LOG_ZERO: f64 = -700.0;

/// Ids of `count` rows of equal length. Equal rows have equal ids; the first row has 0.
pub(crate) fn numbered(rows: &[f32], count: usize) -> Vec<u64> {
    let mut names = BTreeMap::new();
    let width = rows.len() / count;
    let name = |row: usize| {
        // Adding 0 turns -0 into 0, an equal number with other bits.
        let row = &rows[row * width..(row + 1) * width];
        let bits: Vec<u32> = row.iter().map(|x| (x + 0.0).to_bits()).collect();
        let next = names.len() as u64;
        *names.entry(bits).or_insert(next)
    };
    (0..count).map(name).collect()
}

/// Eq. (7): `q(a | a_n^-i, s) = N1(a, a_n^-i, s) / N2(a_n^-i, s)` of every sample `n`, for all choices `a`, as
/// log-probabilities `[R, choices]`, nats.
pub(crate) fn counted_conditional(samples: &[JointSample], choices: usize) -> Vec<f64> {
    let joint = counts(samples, |sample| (sample.state, sample.others));
    let row = |sample: &JointSample| {
        let own = &joint[&(sample.state, sample.others)];
        let of = total(own) as f64;
        let share = move |a: usize| own.get(&(a as u32)).map_or(LOG_ZERO, |&n| log(n as f64 / of));
        (0..choices).map(share)
    };
    samples.iter().flat_map(row).collect()
}

/// Counts of the agent's actions, per condition.
type Counts<Condition> = BTreeMap<Condition, BTreeMap<u32, u64>>;

/// Eq. (7): `I = 1/R sum_R KL[p(. | a_n^-i, s) || p(. | s)]` over `R` samples. The conditional is
/// `N1(a^i, a^-i, s) / N2(a^-i, s)`, the marginal `N(a^i, s) / N(s)`. Nats, never negative; `None` without samples. For
/// independent actions it exceeds 0 by about `(|A^i| - 1)(|A^-i| - 1) / (2 R)` per state.
pub(crate) fn counted_information(samples: &[JointSample]) -> Option<f64> {
    let joint = counts(samples, |sample| (sample.state, sample.others));
    let marginal = counts(samples, |sample| sample.state);
    // Rows with the same condition have the same divergence, so each condition has the weight `N2`.
    let weighted = |(&(state, _), own): (&(u64, u64), &BTreeMap<u32, u64>)| {
        total(own) as f64 * divergence(own, &marginal[&state])
    };
    let sum: f64 = joint.iter().map(weighted).sum();
    (!samples.is_empty()).then(|| sum / samples.len() as f64)
}

fn counts<Condition: Ord>(
    samples: &[JointSample],
    condition: impl Fn(&JointSample) -> Condition,
) -> Counts<Condition> {
    let mut counts = Counts::new();
    for sample in samples {
        *counts.entry(condition(sample)).or_default().entry(sample.own).or_default() += 1;
    }
    counts
}

fn total(counts: &BTreeMap<u32, u64>) -> u64 {
    counts.values().sum()
}

/// `KL[conditional || marginal]` of two tables of counts. The marginal contains all keys of the conditional.
fn divergence(conditional: &BTreeMap<u32, u64>, marginal: &BTreeMap<u32, u64>) -> f64 {
    let (n, of) = (total(conditional) as f64, total(marginal) as f64);
    let term = |(own, &count): (&u32, &u64)| {
        let p = count as f64 / n;
        let q = marginal[own] as f64 / of;
        p * log(p / q)
    };
    conditional.iter().map(term).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two coins that agree in `same` of 10 cases, in each state.
    fn coins(states: u64, same: u64) -> Vec<JointSample> {
        let toss = |state: u64| {
            (0..2_u32).flat_map(move |own| {
                (0..10_u64).map(move |n| {
                    let others = u64::from(if n < same { own } else { 1 - own });
                    JointSample { state, own, others }
                })
            })
        };
        (0..states).flat_map(toss).collect()
    }

    #[test]
    fn the_information_of_two_coins_that_agree_nine_times_of_ten_matches_its_closed_form() {
        // log 2 + .9 log .9 + .1 log .1
        let found = counted_information(&coins(3, 9)).unwrap();
        assert!((found - 0.368_064_2).abs() < 1e-6, "{found}");
        assert!((counted_information(&coins(1, 10)).unwrap() - log(2.0)).abs() < 1e-12);
        assert!(counted_information(&coins(2, 5)).unwrap().abs() < 1e-12);
        assert_eq!(counted_information(&[]), None);
    }

    #[test]
    fn counted_conditionals_are_frequencies_among_rows_with_the_same_condition() {
        let found = counted_conditional(&coins(1, 9), 3);
        // The other coin of the first sample shows 0: the agent's coin agrees 9 times and differs once.
        let by_hand = [log(0.9), log(0.1), LOG_ZERO];
        assert!(found[..3].iter().zip(by_hand).all(|(f, b)| (f - b).abs() < 1e-12), "{found:?}");
        assert_eq!(found.len(), 60);
    }

    #[test]
    fn equal_rows_have_the_same_id() {
        assert_eq!(numbered(&[0.0, 1.0, 5.0, 1.0, -0.0, 1.0], 3), vec![0, 1, 0]);
        assert_eq!(numbered(&[], 2), vec![0, 0]);
    }
}
