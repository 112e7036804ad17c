//! The learning curves of a run on the topic `/curves`: all of them in each message, so that one message is enough.

use std::path::Path;
use std::time::{Duration, Instant};

use anyhow::Context as _;
use recording::{LiveServer, LiveTopic};
use serde_json::{Value, json};

use crate::run::growing::Growing;
use crate::run::run_path;

/// How often the metrics are looked at.
const LOOK_AGAIN: Duration = Duration::from_secs(1);

/// The curves of a run, as far as they have been read.
pub(super) struct Curves {
    topic: LiveTopic,
    curves: Growing,
    looked: Option<Instant>,
}

impl Curves {
    /// Of the run in `folder`.
    pub(super) fn of(folder: &Path, server: &LiveServer) -> anyhow::Result<Self> {
        let topic = server.topic("/curves", &schema()).context("cannot show the curves")?;
        let curves = Growing::of(run_path::metrics_file(folder));
        Ok(Self { topic, curves, looked: None })
    }

    /// Shows what is new, once a second at most, and only if anybody looks.
    pub(super) fn follow(&mut self) {
        let recent = self.looked.is_some_and(|looked| looked.elapsed() < LOOK_AGAIN);
        if recent || !self.topic.is_watched() {
            return;
        }
        self.looked = Some(Instant::now());
        if self.curves.follow() {
            self.topic.show(&message(self.curves.get()));
        }
    }
}

/// Every curve as `{"env_steps": [...], "value": [...]}`. A name with a slash is a path: `evaluation/mean` stands under
/// `mean` in `evaluation`.
fn message(curves: &learner::metrics::Curves) -> Value {
    let mut message = json!({});
    for (name, curve) in curves.iter() {
        let (env_steps, value): (Vec<u64>, Vec<f64>) = curve.points().unzip();
        let place = name.split('/').fold(&mut message, |outer, part| &mut outer[part]);
        *place = json!({ "env_steps": env_steps, "value": value });
    }
    message
}

/// Two of the curves; the others depend on the algorithm.
fn schema() -> Value {
    let numbers = |about: &str| json!({ "type": "array", "items": { "type": "number" }, "description": about });
    let curve = |about: &str| {
        let (env_steps, value) = (numbers("environment steps"), numbers(about));
        json!({ "type": "object", "properties": { "env_steps": env_steps, "value": value } })
    };
    let mean = curve("mean extrinsic return of an evaluation");
    json!({
        "title": "s2mia.Curves",
        "type": "object",
        "properties": {
            "episode_return": curve("mean extrinsic return of training episodes that ended"),
            "evaluation": { "type": "object", "properties": { "mean": mean } },
        },
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_curve_stands_where_the_slashes_of_its_name_lead() {
        let mut curves = learner::metrics::Curves::default();
        let lines = [
            json!({"kind": "iteration", "env_steps": 40, "episode_return": 1.5, "losses/value": 2}),
            json!({"kind": "evaluation", "env_steps": 40, "mean": -1.0}),
            json!({"kind": "evaluation", "env_steps": 80, "mean": 3.0}),
        ];
        lines.iter().for_each(|line| curves.add(line.as_object().unwrap()));
        let expected = json!({
            "episode_return": {"env_steps": [40], "value": [1.5]},
            "losses": {"value": {"env_steps": [40], "value": [2.0]}},
            "evaluation": {"mean": {"env_steps": [40, 80], "value": [-1.0, 3.0]}},
        });
        assert_eq!(message(&curves), expected);
    }
}
