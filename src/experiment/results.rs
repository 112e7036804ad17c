//! The results of an experiment's finished runs: a row for each variant on each task. Pure.

use std::collections::{BTreeMap, BTreeSet};

use policy::{Draw, Purpose};

use crate::figures::statistics::{
    Interval, PRINTED_RESAMPLES, area_under_curve, bootstrap_interval, first_reaching,
    interquartile_mean, interquartile_mean_interval, permutation_p_value,
    probability_of_improvement, quantile,
};

/// Draws of a mean over tasks of P, and of the permutations of runs.
const IMPROVEMENT: u32 = 4;
const PERMUTATION: u32 = 5;

/// A figure and its 95 % confidence interval.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Estimate {
    /// The figure.
    pub(crate) value: f64,
    /// Its interval by bootstrap over runs.
    pub(crate) interval: Interval,
}

impl Estimate {
    /// The statistic `of` the samples, with an interval from resampling each sample; `figure` separates the draws of
    /// different figures.
    pub(super) fn of(samples: &[&[f64]], figure: u32, of: impl Fn(&[Vec<f64>]) -> f64) -> Self {
        let whole: Vec<Vec<f64>> = samples.iter().map(|sample| sample.to_vec()).collect();
        let key = Draw::of(Purpose::Bootstrap).step(figure);
        let interval = bootstrap_interval(samples, PRINTED_RESAMPLES, key, &of);
        Self { value: of(&whole), interval }
    }
}

/// One finished run.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Measured {
    /// Task.
    pub(crate) task: String,
    /// Name of the variant.
    pub(crate) variant: String,
    /// Env steps and evaluation return, in order of env steps; at least one.
    pub(crate) returns: Vec<(f64, f64)>,
}

/// A variant on a task.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct ResultRow {
    /// Task.
    pub(crate) task: String,
    /// Variant.
    pub(crate) variant: String,
    /// Finished runs.
    pub(crate) runs: usize,
    /// Environment steps of the longest of them.
    pub(crate) env_steps: f64,
    /// Interquartile mean of the runs' final returns.
    pub(crate) final_return: Estimate,
    /// Interquartile mean of the areas under the curves, per environment step: the mean return over training.
    pub(crate) area: Estimate,
    /// Median over the runs of the environment steps to the threshold; `None` if half of the runs never reach it.
    pub(crate) steps_to_threshold: Option<f64>,
    /// Runs that reach the threshold.
    pub(crate) runs_at_threshold: usize,
    /// Against the baseline; `None` for the baseline itself.
    pub(crate) improvement: Option<Improvement>,
}

/// A measure of a variant's and of the baseline's runs on a task.
pub(super) type Pair = (Vec<f64>, Vec<f64>);

/// How a variant's runs compare with the baseline's, on one task or more.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Improvement {
    /// Probability that a run of the variant is above one of the baseline, mean over tasks.
    pub(crate) probability: Estimate,
    /// P-value of a two-sided permutation test of that probability.
    pub(crate) p_value: f64,
}

impl Improvement {
    /// That of the pairs, one for each task.
    pub(super) fn of(pairs: &[Pair]) -> Self {
        let key = Draw::of(Purpose::Bootstrap).step(PERMUTATION);
        Self {
            probability: Estimate::of(&samples(pairs), IMPROVEMENT, mean_improvement),
            p_value: permutation_p_value(pairs, key),
        }
    }
}

/// The runs `[own, rivals, own, rivals, ..]`, a pair for each task.
pub(super) fn samples(pairs: &[Pair]) -> Vec<&[f64]> {
    pairs.iter().flat_map(|(own, rivals)| [own.as_slice(), rivals.as_slice()]).collect()
}

/// Mean over tasks of P; the samples are those of [`samples`].
fn mean_improvement(samples: &[Vec<f64>]) -> f64 {
    let tasks = samples.chunks_exact(2).map(|pair| probability_of_improvement(&pair[0], &pair[1]));
    tasks.sum::<f64>() / (samples.len() / 2) as f64
}

/// The curves of each variant on each task, by task and variant.
pub(super) type Groups<'a> = BTreeMap<(&'a str, &'a str), Vec<&'a [(f64, f64)]>>;

/// A row for each variant on each task, in the order of `variants` within a task. The threshold of a task is `share` of
/// the way from the return at the start of its runs to the highest final return among its variants.
pub(crate) fn rows(
    runs: &[Measured],
    variants: &[String],
    baseline: &str,
    share: f64,
) -> Vec<ResultRow> {
    let groups = grouped(runs);
    let mut rows = Vec::new();
    for task in tasks(&groups) {
        let of_task = |variant| found(&groups, task, variant);
        let bests = variants.iter().filter_map(|v| Some(interquartile_mean(&finals(of_task(v)?))));
        let best = bests.fold(f64::NEG_INFINITY, f64::max);
        let start = start(variants.iter().filter_map(|v| of_task(v)));
        let threshold = (best > start).then_some(start + share * (best - start));
        let rivals = of_task(baseline).map(finals);
        for variant in variants {
            let Some(curves) = of_task(variant) else { continue };
            let rivals = rivals.as_deref().filter(|_| variant != baseline);
            rows.push(row(task, variant, curves, threshold, rivals));
        }
    }
    rows
}

pub(super) fn grouped(runs: &[Measured]) -> Groups<'_> {
    let mut groups = Groups::new();
    for run in runs {
        groups.entry((&run.task, &run.variant)).or_default().push(&run.returns);
    }
    groups
}

pub(super) fn tasks<'a>(groups: &Groups<'a>) -> BTreeSet<&'a str> {
    groups.keys().map(|(task, _)| *task).collect()
}

pub(super) fn found<'a>(
    groups: &'a Groups<'a>,
    task: &'a str,
    variant: &'a str,
) -> Option<&'a [&'a [(f64, f64)]]> {
    groups.get(&(task, variant)).map(Vec::as_slice)
}

fn row(
    task: &str,
    variant: &str,
    curves: &[&[(f64, f64)]],
    threshold: Option<f64>,
    baseline: Option<&[f64]>,
) -> ResultRow {
    let finals = finals(curves);
    let areas = areas(curves);
    // Without the start: an untrained policy has learnt nothing, whatever its return.
    let reach = |curve: &&[(f64, f64)]| first_reaching(curve.get(1..)?, threshold?);
    let reached: Vec<Option<f64>> = curves.iter().map(reach).collect();
    ResultRow {
        task: task.to_owned(),
        variant: variant.to_owned(),
        runs: curves.len(),
        env_steps: curves
            .iter()
            .filter_map(|curve| curve.last())
            .fold(0.0, |most, end| end.0.max(most)),
        final_return: mean(&finals, 0),
        area: mean(&areas, 1),
        steps_to_threshold: median_steps(&reached),
        runs_at_threshold: reached.iter().flatten().count(),
        improvement: baseline.map(|baseline| Improvement::of(&[(finals, baseline.to_vec())])),
    }
}

/// The return of untrained policies on a task: the interquartile mean of the first evaluations of its runs.
fn start<'a>(variants: impl Iterator<Item = &'a [&'a [(f64, f64)]]>) -> f64 {
    let firsts = variants.flatten().filter_map(|curve| Some(curve.first()?.1));
    interquartile_mean(&firsts.collect::<Vec<f64>>())
}

/// The final return of each run.
pub(super) fn finals(curves: &[&[(f64, f64)]]) -> Vec<f64> {
    curves.iter().map(|curve| final_return(curve)).collect()
}

/// The mean return over training of each run.
pub(super) fn areas(curves: &[&[(f64, f64)]]) -> Vec<f64> {
    curves.iter().map(|curve| area_under_curve(curve)).collect()
}

/// The mean of the evaluations after nine tenths of the run; the last one is always among them. NaN without any.
fn final_return(curve: &[(f64, f64)]) -> f64 {
    let last = curve.last().map_or(0.0, |point| point.0);
    let late = curve.iter().filter(|point| point.0 > 0.9 * last || point.0 == last);
    let returns: Vec<f64> = late.map(|point| point.1).collect();
    returns.iter().sum::<f64>() / returns.len() as f64
}

fn mean(values: &[f64], figure: u32) -> Estimate {
    let key = Draw::of(Purpose::Bootstrap).step(figure);
    Estimate {
        value: interquartile_mean(values),
        interval: interquartile_mean_interval(values, PRINTED_RESAMPLES, key),
    }
}

/// The median, in which a run that never reaches the threshold counts as infinity.
fn median_steps(reached: &[Option<f64>]) -> Option<f64> {
    let steps: Vec<f64> = reached.iter().map(|steps| steps.unwrap_or(f64::INFINITY)).collect();
    let median = quantile(&steps, 0.5);
    median.is_finite().then_some(median)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn curve(variant: &str, returns: [f64; 3]) -> Measured {
        let returns = [0.0, 100.0, 200.0].into_iter().zip(returns).collect();
        Measured { task: "ant-4x2".into(), variant: variant.into(), returns }
    }

    #[test]
    fn the_final_return_is_the_mean_over_the_last_tenth_of_the_run() {
        let curve = [(0.0, 1.0), (900.0, 2.0), (950.0, 3.0), (1000.0, 5.0)];
        assert_eq!(final_return(&curve), 4.0);
        assert_eq!(final_return(&curve[..1]), 1.0);
    }

    #[test]
    fn a_table_worked_by_hand_is_met() {
        let runs = [
            curve("happo", [0.0, 10.0, 40.0]),
            curve("new", [0.0, 90.0, 100.0]),
            curve("new", [0.0, 60.0, 100.0]),
            curve("new", [0.0, 30.0, 20.0]),
        ];
        let variants = ["new".to_owned(), "happo".to_owned(), "absent".to_owned()];
        let rows = rows(&runs, &variants, "happo", 0.5);
        let [new, happo] = rows.as_slice() else { panic!("{rows:?}") };
        // IQM of 20, 100, 100: 20 / 6 + 100 * 2 / 3 + 100 / 6 = 86.67; half of it is learnt.
        assert!((new.final_return.value - 260.0 / 3.0).abs() < 1e-9, "{new:?}");
        assert_eq!((new.runs, new.runs_at_threshold, new.steps_to_threshold), (3, 2, Some(100.0)));
        // Areas 70, 55 and 20: (20 + 70) / 6 + 55 * 2 / 3.
        assert!((new.area.value - (15.0 + 110.0 / 3.0)).abs() < 1e-9, "{new:?}");
        // Two of three end above 40.
        let Improvement { probability, p_value } = new.improvement.unwrap();
        assert!((probability.value - 2.0 / 3.0).abs() < 1e-9, "{new:?}");
        assert_eq!(probability.interval, Interval { low: 0.0, high: 1.0 });
        // Whichever of the four runs is the baseline's, P is at least 1/6 from 1/2.
        assert_eq!(p_value, 1.0);
        assert_eq!((happo.runs_at_threshold, happo.steps_to_threshold), (0, None));
        assert_eq!(
            (happo.final_return.value, happo.area.value, happo.improvement),
            (40.0, 15.0, None)
        );
    }

    #[test]
    fn a_threshold_is_measured_from_the_return_at_the_start() {
        let runs = [curve("happo", [-100.0, -60.0, -10.0]), curve("new", [-100.0, -20.0, 0.0])];
        let variants = ["new".to_owned(), "happo".to_owned()];
        let rows = rows(&runs, &variants, "happo", 0.8);
        // -20, four fifths of the way from -100 to 0.
        let steps: Vec<_> = rows.iter().map(|row| row.steps_to_threshold).collect();
        assert_eq!(steps, [Some(100.0), Some(200.0)]);
    }

    #[test]
    fn where_nothing_improves_nothing_is_learnt() {
        for returns in [[-1.0, -1.0, -1.0], [5.0, 9.0, 4.0]] {
            let runs = [curve("happo", returns)];
            let rows = rows(&runs, &["happo".to_owned()], "happo", 0.8);
            let [happo] = rows.as_slice() else { panic!("{rows:?}") };
            let learnt = (happo.runs_at_threshold, happo.steps_to_threshold);
            assert_eq!(learnt, (0, None), "{returns:?}");
        }
    }

    #[test]
    fn a_run_that_begins_above_the_threshold_has_not_learnt_before_its_training() {
        let happo = || curve("happo", [0.0, 0.0, 100.0]);
        let runs = [happo(), happo(), happo(), curve("lucky", [90.0, 0.0, 10.0])];
        let rows = rows(&runs, &["happo".to_owned(), "lucky".to_owned()], "happo", 0.8);
        assert_eq!((rows[1].runs_at_threshold, rows[1].steps_to_threshold), (0, None));
    }
}
