//! Every figure of `metrics.jsonl` over the run, thinned out so that a long run takes no more memory than a short one.

use std::collections::BTreeMap;

use serde_json::{Map, Value};

/// Points of one curve; at twice as many every second one is dropped.
const FEWEST_KEPT: usize = 128;

/// Figures that say where a line stands, not what was measured.
const PLACES: [&str; 3] = ["kind", "iteration", "env_steps"];

/// All curves by their names: an iteration's figures as in `metrics.jsonl`, an evaluation's under `evaluation/`.
#[derive(Clone, Debug, Default)]
pub struct Curves {
    curves: BTreeMap<String, Curve>,
    lines: u64,
}

/// One figure over environment steps.
#[derive(Clone, Debug, PartialEq)]
pub struct Curve {
    /// Environment steps and the figure there, in the order of the run: evenly spread, and the newest.
    points: Vec<(u64, f64)>,
    newest: (u64, f64),
    /// Lines from one point to the next.
    stride: u64,
    lines: u64,
}

impl Curves {
    /// Takes in a line of `metrics.jsonl`. What is no finite number is left out.
    pub fn add(&mut self, line: &Map<String, Value>) {
        let Some(env_steps) = line.get("env_steps").and_then(Value::as_u64) else { return };
        let evaluation = line.get("kind").is_some_and(|kind| kind == "evaluation");
        self.lines += 1;
        for (name, value) in line.iter().filter(|(name, _)| !PLACES.contains(&name.as_str())) {
            let name = if evaluation { format!("evaluation/{name}") } else { name.clone() };
            if let Some(value) = value.as_f64() {
                let point = (env_steps, value);
                self.curves.entry(name).or_insert_with(|| Curve::new(point)).add(point);
            }
        }
    }

    /// Lines so far: equal numbers mean equal curves.
    #[must_use]
    pub fn lines(&self) -> u64 {
        self.lines
    }

    /// The newest value of a figure.
    #[must_use]
    pub fn newest(&self, name: &str) -> Option<f64> {
        self.curves.get(name).map(|curve| curve.newest.1)
    }

    /// Every curve with its name, in alphabetical order.
    pub fn iter(&self) -> impl Iterator<Item = (&str, &Curve)> {
        self.curves.iter().map(|(name, curve)| (name.as_str(), curve))
    }
}

impl Curve {
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

    /// Environment steps and figures, in the order of the run; the newest is always there.
    pub fn points(&self) -> impl Iterator<Item = (u64, f64)> {
        let shown = self.points.last() == Some(&self.newest);
        self.points.iter().copied().chain((!shown).then_some(self.newest))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn add(curves: &mut Curves, line: &Value) {
        curves.add(line.as_object().unwrap());
    }

    #[test]
    fn figures_stand_under_their_names_and_evaluations_apart() {
        let mut curves = Curves::default();
        let line =
            json!({"kind": "iteration", "iteration": 1, "env_steps": 40, "a": 0.5, "b": null});
        add(&mut curves, &line);
        let line = json!({"kind": "evaluation", "iteration": 1, "env_steps": 40, "mean": -2.0});
        add(&mut curves, &line);
        let found: Vec<_> = curves.iter().map(|(name, curve)| (name, curve.newest)).collect();
        assert_eq!(found, [("a", (40, 0.5)), ("evaluation/mean", (40, -2.0))]);
        assert_eq!((curves.lines(), curves.newest("a"), curves.newest("b")), (2, Some(0.5), None));
    }

    #[test]
    fn a_long_curve_keeps_its_ends_and_evenly_spread_points_between_them() {
        let mut curves = Curves::default();
        for k in 0..100_000_u64 {
            add(&mut curves, &json!({"kind": "iteration", "env_steps": k, "a": k}));
        }
        let points: Vec<_> = curves.curves["a"].points().map(|(steps, _)| steps).collect();
        assert!((FEWEST_KEPT..=2 * FEWEST_KEPT).contains(&points.len()), "{}", points.len());
        assert_eq!((points[0], points[points.len() - 1]), (0, 99_999));
        let gaps: Vec<_> = points[..points.len() - 1].windows(2).map(|w| w[1] - w[0]).collect();
        assert!(gaps.iter().all(|gap| *gap == gaps[0]), "{gaps:?}");
    }
}
