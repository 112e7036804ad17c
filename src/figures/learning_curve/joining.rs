//! The mean curve of the runs of a group: their values at common environment steps, and intervals over the runs.

use policy::{Draw, Purpose};

use super::{Curve, Point, Quantity};
use crate::figures::statistics::{
    interquartile_mean, interquartile_mean_interval, interquartile_range,
};

/// The points of a group at the environment steps of any of its runs, from their latest start to their earliest end; between its
/// own points, a run has the value of a straight line.
pub(super) fn joined(group: &[&Curve], quantity: Quantity) -> Vec<Point> {
    let runs: Vec<&[(f64, f64)]> = group.iter().map(|curve| curve.of(quantity)).collect();
    let ends = |run: &&[(f64, f64)]| Some((run.first()?.0, run.last()?.0));
    let Some(ends) = runs.iter().map(ends).collect::<Option<Vec<_>>>() else { return Vec::new() };
    let start = ends.iter().fold(f64::NEG_INFINITY, |start, end| start.max(end.0));
    let end = ends.iter().fold(f64::INFINITY, |end, other| end.min(other.1));
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
        confidence: interquartile_mean_interval(values, key),
        quartiles: interquartile_range(values),
    }
}
