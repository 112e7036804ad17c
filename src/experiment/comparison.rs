//! Comparison of each variant with the baseline over all tasks, aggregated as in Agarwal et al. (NeurIPS 2021): every
//! task has the same weight in the probability of improvement, and runs are exchanged within a task only. Pure.

use policy::{Draw, Purpose};

use super::results::{
    Estimate, IMPROVEMENT, Measured, PERMUTATION, areas, finals, found, grouped, tasks,
};
use crate::figures::statistics::{
    holm_adjusted, interquartile_mean, permutation_p_value, probability_of_improvement,
};

/// What a run is compared by.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Measure {
    /// Its final return.
    FinalReturn,
    /// Its mean return over training.
    MeanReturn,
}

impl Measure {
    /// Its name in tables.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::FinalReturn => "final return",
            Self::MeanReturn => "mean return over training",
        }
    }

    fn of(self, curves: &[&[(f64, f64)]]) -> Vec<f64> {
        match self {
            Self::FinalReturn => finals(curves),
            Self::MeanReturn => areas(curves),
        }
    }
}

/// A variant against the baseline, over the tasks that both have finished runs of.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Comparison {
    /// Variant.
    pub(crate) variant: String,
    /// Tasks.
    pub(crate) tasks: usize,
    /// Its finished runs on them.
    pub(crate) runs: usize,
    /// Interquartile mean over all runs of the measure in units of the baseline's interquartile mean on the task; NaN if
    /// that is not above 0 on every task.
    pub(crate) score: Estimate,
    /// Probability that a run of the variant is above one of the baseline, mean over tasks.
    pub(crate) improvement: Estimate,
    /// P-value of a two-sided permutation test of that probability.
    pub(crate) p_value: f64,
    /// The p-value after Holm's correction for all variants.
    pub(crate) adjusted_p_value: f64,
}

/// The measure of a variant's and of the baseline's runs on each task.
type Pairs = Vec<(Vec<f64>, Vec<f64>)>;

/// A comparison for each of `variants` that shares a task with the baseline, without the baseline itself.
pub(crate) fn comparisons(
    runs: &[Measured],
    variants: &[String],
    baseline: &str,
    measure: Measure,
) -> Vec<Comparison> {
    let groups = grouped(runs);
    let pairs = |variant: &String| -> Pairs {
        let of = |task, name| found(&groups, task, name).map(|curves| measure.of(curves));
        let shared = tasks(&groups).into_iter();
        shared.filter_map(|task| Some((of(task, variant)?, of(task, baseline)?))).collect()
    };
    let rivals = variants.iter().filter(|variant| *variant != baseline);
    let compared: Vec<(&String, Pairs)> = rivals
        .map(|variant| (variant, pairs(variant)))
        .filter(|(_, pairs)| !pairs.is_empty())
        .collect();
    let key = Draw::of(Purpose::Bootstrap).step(PERMUTATION);
    let raw: Vec<f64> = compared.iter().map(|(_, pairs)| permutation_p_value(pairs, key)).collect();
    let p_values = raw.iter().copied().zip(holm_adjusted(&raw));
    let judged = compared.iter().zip(p_values);
    judged.map(|((variant, pairs), p_values)| comparison(variant, pairs, p_values)).collect()
}

/// `p_values`: raw and adjusted.
fn comparison(variant: &str, pairs: &Pairs, p_values: (f64, f64)) -> Comparison {
    let samples: Vec<&[f64]> =
        pairs.iter().flat_map(|(own, rivals)| [own.as_slice(), rivals.as_slice()]).collect();
    let (p_value, adjusted_p_value) = p_values;
    Comparison {
        variant: variant.to_owned(),
        tasks: pairs.len(),
        runs: pairs.iter().map(|(own, _)| own.len()).sum(),
        score: Estimate::of(&samples, 3, normalised_score),
        improvement: Estimate::of(&samples, IMPROVEMENT, mean_improvement),
        p_value,
        adjusted_p_value,
    }
}

/// Interquartile mean of normalised returns; the samples are `[own, rivals, own, rivals, ..]`, a pair for each task.
fn normalised_score(samples: &[Vec<f64>]) -> f64 {
    let scores = samples.chunks_exact(2).flat_map(|pair| {
        let unit = interquartile_mean(&pair[1]);
        pair[0].iter().map(move |own| if unit > 0.0 { own / unit } else { f64::NAN })
    });
    let scores: Vec<f64> = scores.collect();
    if scores.iter().any(|score| score.is_nan()) {
        return f64::NAN;
    }
    interquartile_mean(&scores)
}

/// As [`normalised_score`].
fn mean_improvement(samples: &[Vec<f64>]) -> f64 {
    let tasks = samples.chunks_exact(2).map(|pair| probability_of_improvement(&pair[0], &pair[1]));
    tasks.sum::<f64>() / (samples.len() / 2) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(task: &str, variant: &str, last: f64) -> Measured {
        let returns = vec![(0.0, 0.0), (100.0, last)];
        Measured { task: task.into(), variant: variant.into(), returns }
    }

    #[test]
    fn tasks_count_alike_and_only_those_that_both_have_are_compared() {
        let mut runs = vec![run("walker2d-2x3", "new", 9.0)];
        for seed in 0..4 {
            runs.push(run("ant-4x2", "happo", 100.0));
            runs.push(run("ant-4x2", "new", 200.0 + f64::from(seed)));
            runs.push(run("halfcheetah-2x3", "happo", 10.0));
        }
        runs.push(run("halfcheetah-2x3", "new", 5.0));
        let variants = ["new".to_owned(), "happo".to_owned(), "absent".to_owned()];
        let found = comparisons(&runs, &variants, "happo", Measure::FinalReturn);
        let [new] = found.as_slice() else { panic!("{found:?}") };
        assert_eq!((new.tasks, new.runs), (2, 5));
        // All of four on one task, none of one on the other.
        assert_eq!(new.improvement.value, 0.5);
        // 0.5, 2.00, 2.01, 2.02, 2.03 in order: the third, and three quarters of each of its neighbours.
        assert!((new.score.value - 2.01).abs() < 1e-9, "{new:?}");
        assert_eq!(new.p_value, new.adjusted_p_value);
    }

    #[test]
    fn a_baseline_that_earns_nothing_is_no_unit_for_a_score() {
        let runs = [run("ant-4x2", "happo", -1.0), run("ant-4x2", "new", 5.0)];
        let found = comparisons(&runs, &["new".to_owned()], "happo", Measure::FinalReturn);
        assert!(found[0].score.value.is_nan() && found[0].improvement.value == 1.0, "{found:?}");
    }

    #[test]
    fn a_variant_that_learns_earlier_has_the_higher_mean_return_and_an_equal_final_return() {
        let curve = |variant: &str, middle: f64| Measured {
            returns: vec![(0.0, 0.0), (50.0, middle), (100.0, 40.0)],
            ..run("ant-4x2", variant, 0.0)
        };
        let runs = [curve("happo", 10.0), curve("early", 30.0)];
        let of = |measure| comparisons(&runs, &["early".to_owned()], "happo", measure).remove(0);
        let (last, mean) = (of(Measure::FinalReturn), of(Measure::MeanReturn));
        assert_eq!((last.score.value, last.improvement.value), (1.0, 0.5));
        // (0 + 30) / 4 + (30 + 40) / 4 = 25 against (0 + 10) / 4 + (10 + 40) / 4 = 15.
        assert!((mean.score.value - 25.0 / 15.0).abs() < 1e-12, "{mean:?}");
        assert_eq!(mean.improvement.value, 1.0);
    }

    #[test]
    fn a_variant_that_always_ends_higher_is_told_from_chance_and_one_that_is_the_same_is_not() {
        let mut runs = Vec::new();
        for (task, offset) in [("ant-4x2", 0.0), ("halfcheetah-2x3", 1000.0)] {
            for seed in 0..5 {
                let plain = offset + f64::from(seed);
                runs.push(run(task, "happo", plain));
                runs.push(run(task, "same", plain));
                runs.push(run(task, "better", plain + 10.0));
            }
        }
        let found = comparisons(
            &runs,
            &["same".to_owned(), "better".to_owned()],
            "happo",
            Measure::FinalReturn,
        );
        let [same, better] = found.as_slice() else { panic!("{found:?}") };
        assert_eq!((same.improvement.value, better.improvement.value), (0.5, 1.0));
        assert!(same.p_value > 0.9 && better.p_value < 0.005, "{found:?}");
        assert!((better.adjusted_p_value - 2.0 * better.p_value).abs() < 1e-12, "{found:?}");
    }
}
