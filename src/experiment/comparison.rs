//! Comparison of each variant with the baseline over all tasks, aggregated as in Agarwal et al. (NeurIPS 2021): every
//! task has the same weight in the probability of improvement, and runs are exchanged within a task only. Pure.

use super::results::{
    Estimate, Improvement, Measured, Pair, areas, finals, found, grouped, samples, tasks,
};
use crate::figures::statistics::{holm_adjusted, interquartile_mean};

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
    /// Against the baseline's runs.
    pub(crate) improvement: Improvement,
    /// Its p-value after Holm's correction for all variants.
    pub(crate) adjusted_p_value: f64,
}

/// A comparison for each of `variants` that shares a task with the baseline, without the baseline itself.
pub(crate) fn comparisons(
    runs: &[Measured],
    variants: &[String],
    baseline: &str,
    measure: Measure,
) -> Vec<Comparison> {
    let groups = grouped(runs);
    let pairs = |variant: &String| -> Vec<Pair> {
        let of = |task, name| found(&groups, task, name).map(|curves| measure.of(curves));
        let shared = tasks(&groups).into_iter();
        shared.filter_map(|task| Some((of(task, variant)?, of(task, baseline)?))).collect()
    };
    let rivals = variants.iter().filter(|variant| *variant != baseline);
    let compared = rivals.map(|variant| (variant, pairs(variant)));
    let compared = compared.filter(|(_, pairs)| !pairs.is_empty());
    let mut all: Vec<Comparison> =
        compared.map(|(variant, pairs)| comparison(variant, &pairs)).collect();
    let raw: Vec<f64> = all.iter().map(|comparison| comparison.improvement.p_value).collect();
    for (comparison, adjusted) in all.iter_mut().zip(holm_adjusted(&raw)) {
        comparison.adjusted_p_value = adjusted;
    }
    all
}

/// A comparison without correction.
fn comparison(variant: &str, pairs: &[Pair]) -> Comparison {
    let improvement = Improvement::of(pairs);
    Comparison {
        variant: variant.to_owned(),
        tasks: pairs.len(),
        runs: pairs.iter().map(|(own, _)| own.len()).sum(),
        score: Estimate::of(&samples(pairs), 3, normalised_score),
        improvement,
        adjusted_p_value: improvement.p_value,
    }
}

/// Interquartile mean of normalised returns; the samples are those of [`samples`].
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
        assert_eq!(new.improvement.probability.value, 0.5);
        // 0.5, 2.00, 2.01, 2.02, 2.03 in order: the third, and three quarters of each of its neighbours.
        assert!((new.score.value - 2.01).abs() < 1e-9, "{new:?}");
        assert_eq!(new.improvement.p_value, new.adjusted_p_value);
    }

    #[test]
    fn a_baseline_that_earns_nothing_is_no_unit_for_a_score() {
        let runs = [run("ant-4x2", "happo", -1.0), run("ant-4x2", "new", 5.0)];
        let found = comparisons(&runs, &["new".to_owned()], "happo", Measure::FinalReturn);
        assert!(
            found[0].score.value.is_nan() && found[0].improvement.probability.value == 1.0,
            "{found:?}"
        );
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
        assert_eq!((last.score.value, last.improvement.probability.value), (1.0, 0.5));
        // (0 + 30) / 4 + (30 + 40) / 4 = 25 against (0 + 10) / 4 + (10 + 40) / 4 = 15.
        assert!((mean.score.value - 25.0 / 15.0).abs() < 1e-12, "{mean:?}");
        assert_eq!(mean.improvement.probability.value, 1.0);
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
        assert_eq!(
            (same.improvement.probability.value, better.improvement.probability.value),
            (0.5, 1.0)
        );
        assert!(same.improvement.p_value > 0.9 && better.improvement.p_value < 0.005, "{found:?}");
        assert!(
            (better.adjusted_p_value - 2.0 * better.improvement.p_value).abs() < 1e-12,
            "{found:?}"
        );
    }
}
