//! Curves of all figures of `metrics.jsonl`, thinned out so that memory is bounded for long runs.

use std::collections::BTreeMap;

use serde_json::Value;

/// Fewest points of a long curve; at twice as many, every second point is dropped.
const FEWEST_KEPT: usize = 128;

/// Fields of a line that are no measurements.
const POSITIONS: [&str; 3] = ["kind", "iteration", "env_steps"];

/// All curves by name: figures of iterations as in `metrics.jsonl`, figures of evaluations under `evaluation/`.
#[derive(Clone, Debug, Default)]
pub struct Curves {
    curves: BTreeMap<String, MetricCurve>,
    lines: u64,
}

/// One figure as a function of environment steps.
#[derive(Clone, Debug, PartialEq)]
pub struct MetricCurve {
    /// Environment steps and figure, evenly spaced.
    points: Vec<(u64, f64)>,
    newest: (u64, f64),
    /// Lines from one point to the next.
    stride: u64,
    lines: u64,
}

impl Curves {
    /// Adds a line of `metrics.jsonl`. Non-finite figures are left out.
    pub fn add(&mut self, line: &Value) {
        let (Some(figures), Some(env_steps)) = (line.as_object(), line["env_steps"].as_u64())
        else {
            return;
        };
        let evaluation = line["kind"] == "evaluation";
        self.lines += 1;
        for (name, value) in figures.iter().filter(|(name, _)| !POSITIONS.contains(&name.as_str()))
        {
            let name = if evaluation { format!("evaluation/{name}") } else { name.clone() };
            if let Some(value) = value.as_f64() {
                let point = (env_steps, value);
                self.curves.entry(name).or_insert_with(|| MetricCurve::new(point)).add(point);
            }
        }
    }

    /// Number of lines so far; with equal numbers, the curves are equal.
    #[must_use]
    pub fn lines(&self) -> u64 {
        self.lines
    }

    /// The newest value of a figure.
    #[must_use]
    pub fn newest(&self, name: &str) -> Option<f64> {
        self.curves.get(name).map(|curve| curve.newest.1)
    }

    /// All curves, in alphabetical order of their names.
    pub fn iter(&self) -> impl Iterator<Item = (&str, &MetricCurve)> {
        self.curves.iter().map(|(name, curve)| (name.as_str(), curve))
    }
}

impl MetricCurve {
    fn new(point: (u64, f64)) -> Self {
        Self { points: Vec::new(), newest: point, stride: 1, lines: 0 }
    }

    fn add(&mut self, point: (u64, f64)) {
        self.newest = point;
        if self.lines.is_multiple_of(self.stride) {
            self.points.push(point);
        }
        self.lines += 1;
        if self.points.len() == 2 * FEWEST_KEPT {
            let mut index = 0;
            self.points.retain(|_| {
                index += 1;
                index % 2 == 1
            });
            self.stride *= 2;
        }
    }

    /// Environment steps and figures in the order of the run, always including the newest point.
    pub fn points(&self) -> impl Iterator<Item = (u64, f64)> {
        let shown = self.points.last() == Some(&self.newest);
        self.points.iter().copied().chain((!shown).then_some(self.newest))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn curves_have_the_names_of_figures_and_evaluations_a_prefix() {
        let mut curves = Curves::default();
        let line =
            json!({"kind": "iteration", "iteration": 1, "env_steps": 40, "a": 0.5, "b": null});
        curves.add(&line);
        let line = json!({"kind": "evaluation", "iteration": 1, "env_steps": 40, "mean": -2.0});
        curves.add(&line);
        let found: Vec<_> = curves.iter().map(|(name, curve)| (name, curve.newest)).collect();
        assert_eq!(found, [("a", (40, 0.5)), ("evaluation/mean", (40, -2.0))]);
        assert_eq!((curves.lines(), curves.newest("a"), curves.newest("b")), (2, Some(0.5), None));
    }

    #[test]
    fn a_long_curve_keeps_its_ends_and_evenly_spaced_points_between_them() {
        let mut curves = Curves::default();
        for k in 0..100_000_u64 {
            curves.add(&json!({"kind": "iteration", "env_steps": k, "a": k}));
        }
        let points: Vec<_> = curves.curves["a"].points().map(|(steps, _)| steps).collect();
        assert!((FEWEST_KEPT..=2 * FEWEST_KEPT).contains(&points.len()), "{}", points.len());
        assert_eq!((points[0], points[points.len() - 1]), (0, 99_999));
        let gaps: Vec<_> = points[..points.len() - 1].windows(2).map(|w| w[1] - w[0]).collect();
        assert!(gaps.iter().all(|gap| *gap == gaps[0]), "{gaps:?}");
    }
}
