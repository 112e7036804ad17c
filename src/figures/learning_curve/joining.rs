//! The mean curve of the runs of a group: their values at common environment steps, intervals over the runs, and what it leaves out.

use policy::{Draw, Purpose};

use super::{Curve, Point, Quantity, grouped};
use crate::figures::chart;
use crate::figures::statistics::{
    DRAWN_RESAMPLES, interquartile_mean, interquartile_mean_interval, interquartile_range,
};

/// The points of a group at the environment steps of any of its runs, from their latest start to their earliest end; between its
/// own points, a run has the value of a straight line. Runs without the quantity are left out.
pub(super) fn joined(group: &[&Curve], quantity: Quantity) -> Vec<Point> {
    let runs = group.iter().map(|curve| curve.of(quantity));
    let runs: Vec<&[(f64, f64)]> = runs.filter(|run| !run.is_empty()).collect();
    let start = runs.iter().fold(f64::NEG_INFINITY, |start, run| start.max(run[0].0));
    let end = runs.iter().fold(f64::INFINITY, |end, run| end.min(run[run.len() - 1].0));
    let all = runs.iter().flat_map(|run| run.iter().map(|point| point.0));
    let mut steps: Vec<f64> = all.filter(|steps| (start..=end).contains(steps)).collect();
    steps.sort_by(f64::total_cmp);
    steps.dedup();
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    let point = |part: &[f64]| {
        let of = |run: &&[(f64, f64)]| {
            mean(&part.iter().map(|steps| interpolated(run, *steps)).collect::<Vec<_>>())
        };
        point(mean(part), &runs.iter().map(of).collect::<Vec<_>>())
    };
    steps.chunks(quantity.averaged(steps.len())).map(point).collect()
}

/// The value of a curve between its first and last point.
fn interpolated(curve: &[(f64, f64)], env_steps: f64) -> f64 {
    let after = curve.partition_point(|point| point.0 < env_steps);
    let (next, previous) = (curve[after], curve[after.saturating_sub(1)]);
    if next.0 == env_steps {
        return next.1;
    }
    previous.1 + (next.1 - previous.1) * (env_steps - previous.0) / (next.0 - previous.0)
}

fn point(env_steps: f64, values: &[f64]) -> Point {
    let key = Draw::of(Purpose::Bootstrap).iteration(env_steps as u64);
    Point {
        env_steps,
        centre: interquartile_mean(values),
        confidence: interquartile_mean_interval(values, DRAWN_RESAMPLES, key),
        quartiles: interquartile_range(values),
    }
}

/// A line for each variant of a task whose runs end at different steps, as its curve has no more steps than the shortest, and one
/// for each of its curves that has fewer runs than that of its returns.
pub(crate) fn shortened(curves: &[Curve]) -> Vec<String> {
    let mut lines = Vec::new();
    for ((task, name), group) in grouped(curves) {
        let ends = group.iter().filter_map(|curve| Some(curve.of(Quantity::Return).last()?.0));
        let (first, last) = ends
            .fold((f64::INFINITY, 0.0_f64), |(first, last), end| (first.min(end), last.max(end)));
        let runs = group.len();
        if first < last {
            let [shown, most] = [first, last].map(|end| chart::thousands(end as u64));
            lines.push(format!(
                "{task}: the curve of {name} ends at {shown} env steps with the shortest of its {runs} runs; the longest has {most}"
            ));
        }
        for quantity in [Quantity::Surprise, Quantity::Information] {
            let measured = group.iter().filter(|curve| !curve.of(quantity).is_empty()).count();
            if 0 < measured && measured < runs {
                let of = quantity.label();
                lines.push(format!(
                    "{task}: the curve of {name} is of {measured} of its {runs} runs for {of}"
                ));
            }
        }
    }
    lines
}
