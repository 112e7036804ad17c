//! The quantities that can be drawn over environment steps, read from the lines of `metrics.jsonl`.

use kuva::render::layout::TickFormat;
use serde_json::Value;

/// Largest number of points of a curve; neighbouring iterations are averaged above it.
const MOST_POINTS: usize = 100;

/// A quantity that changes during training.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Quantity {
    /// Mean extrinsic return of an evaluation.
    Return,
    /// Bound of the entropy of observations (Eq. 2), mean over agents, nats.
    Surprise,
    /// Estimate of the information between an agent's action and the others' (Eq. 6 to 8), mean over agents, nats.
    Information,
}

impl Quantity {
    /// All quantities, in the order of their rows in a picture.
    pub(crate) const ALL: [Self; 3] = [Self::Return, Self::Surprise, Self::Information];

    /// Label of the y-axis.
    pub(crate) fn label(self) -> &'static str {
        match self {
            Self::Return => "evaluation return",
            Self::Surprise => "surprise, nats",
            Self::Information => "information, nats",
        }
    }

    /// Numbers on the y-axis. Information is small; with exponents the axis would have no room for them.
    pub(crate) fn tick_format(self) -> TickFormat {
        match self {
            Self::Return | Self::Surprise => TickFormat::Auto,
            Self::Information => TickFormat::Fixed(4),
        }
    }

    /// Env steps and value of every line that has one, in order of env steps.
    pub(crate) fn points(self, lines: &[Value]) -> Vec<(f64, f64)> {
        let value = |line: &Value| match self {
            Self::Return => (line["kind"] == "evaluation").then(|| line["mean"].as_f64())?,
            Self::Surprise => mean_over_agents(line, "surprise_entropy_bound"),
            Self::Information => mean_over_agents(line, "mi_estimate"),
        };
        let point = |line: &Value| Some((line["env_steps"].as_f64()?, value(line)?));
        let mut points: Vec<(f64, f64)> = lines.iter().filter_map(point).collect();
        points.sort_by(|left, right| left.0.total_cmp(&right.0));
        match self {
            Self::Return => points,
            Self::Surprise | Self::Information => thinned(&points),
        }
    }
}

/// Mean of `agent0/NAME`, `agent1/NAME` and so on; `None` if no agent has it.
fn mean_over_agents(line: &Value, name: &str) -> Option<f64> {
    let of = |agent: usize| line.get(format!("agent{agent}/{name}"))?.as_f64();
    let values: Vec<f64> = (0..).map_while(of).collect();
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

/// Means of equally many neighbours, so that at most `MOST_POINTS` remain.
fn thinned(points: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let together = points.len().div_ceil(MOST_POINTS).max(1);
    let mean = |part: &[(f64, f64)], of: fn(&(f64, f64)) -> f64| {
        part.iter().map(of).sum::<f64>() / part.len() as f64
    };
    points.chunks(together).map(|part| (mean(part, |p| p.0), mean(part, |p| p.1))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn each_quantity_is_taken_from_the_lines_that_hold_it() {
        let lines = [
            json!({"kind": "iteration", "env_steps": 40, "mean": 9.0,
                   "agent0/mi_estimate": 1.0, "agent1/mi_estimate": 2.0}),
            json!({"kind": "iteration", "env_steps": 80, "agent0/surprise_entropy_bound": 3.0}),
            json!({"kind": "evaluation", "env_steps": 80, "mean": 5.0}),
            json!({"kind": "evaluation", "env_steps": 0, "mean": -1.0}),
        ];
        assert_eq!(Quantity::Return.points(&lines), [(0.0, -1.0), (80.0, 5.0)]);
        assert_eq!(Quantity::Surprise.points(&lines), [(80.0, 3.0)]);
        assert_eq!(Quantity::Information.points(&lines), [(40.0, 1.5)]);
    }

    #[test]
    fn many_points_become_means_of_neighbours() {
        let points: Vec<(f64, f64)> = (0..200).map(|i| (f64::from(i), f64::from(2 * i))).collect();
        let thinned = thinned(&points);
        assert_eq!((thinned.len(), thinned[0], thinned[99]), (100, (0.5, 1.0), (198.5, 397.0)));
    }
}
