//! Progress of a run, sent to watchers at the end of each iteration.

use serde::Serialize;

use crate::name::printable;
use crate::read::unknown;
use crate::{Refusal, wire};

/// Progress at the end of an iteration, or of the learner. Serialized, it is a line of `s2mia watch --json`.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct RunLine {
    /// Human-readable name of the run.
    pub run_id: String,
    /// Finished iterations.
    pub iteration: u64,
    /// Environment steps of all finished iterations.
    pub env_steps: u64,
    /// Environment steps of this iteration per second since the end of the previous one.
    pub env_steps_per_sec: f64,
    /// Mean extrinsic return of the last finished episodes; `None` before the first.
    pub episode_return: Option<f64>,
    /// The newest complete evaluation.
    pub evaluation: Option<EvaluationSummary>,
    /// Why the learner ended; set only in the last message.
    pub end: Option<RunEnd>,
}

/// Results of evaluation episodes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct EvaluationSummary {
    /// Number of iterations that trained the policies.
    pub iteration: u64,
    /// Mean extrinsic return.
    pub mean: f64,
    /// Standard deviation of the return over the episodes.
    pub standard_deviation: f64,
    /// Number of episodes.
    pub episodes: u32,
}

/// How a learner ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum RunEnd {
    /// The last iteration is complete.
    Finished,
    /// Stopped earlier, by a signal or a failure; can be resumed, and the next learner may follow soon.
    Stopped,
    /// Stopped earlier by a client; can be resumed.
    #[serde(rename = "stopped")]
    StoppedByClient,
}

impl RunLine {
    /// Converts to the message.
    #[must_use]
    pub fn to_wire(&self) -> wire::WatchRunResponse {
        let end = match self.end {
            None => wire::RunEnd::Unspecified,
            Some(RunEnd::Finished) => wire::RunEnd::Finished,
            Some(RunEnd::Stopped | RunEnd::StoppedByClient) => wire::RunEnd::Stopped,
        };
        wire::WatchRunResponse {
            run_id: self.run_id.clone(),
            iteration: self.iteration,
            env_steps: self.env_steps,
            env_steps_per_sec: self.env_steps_per_sec,
            episode_return: self.episode_return,
            evaluation: self.evaluation.map(EvaluationSummary::to_wire),
            end: end.into(),
            stopped_by_client: self.end == Some(RunEnd::StoppedByClient),
        }
    }

    /// Reads the message.
    ///
    /// # Errors
    /// If the end is unknown.
    pub fn from_wire(wire: wire::WatchRunResponse) -> Result<Self, Refusal> {
        let end = match wire::RunEnd::try_from(wire.end) {
            Ok(wire::RunEnd::Unspecified) => None,
            Ok(wire::RunEnd::Finished) => Some(RunEnd::Finished),
            Ok(wire::RunEnd::Stopped) if wire.stopped_by_client => Some(RunEnd::StoppedByClient),
            Ok(wire::RunEnd::Stopped) => Some(RunEnd::Stopped),
            Err(_) => return Err(unknown("end", wire.end)),
        };
        Ok(Self {
            run_id: printable(&wire.run_id),
            iteration: wire.iteration,
            env_steps: wire.env_steps,
            env_steps_per_sec: wire.env_steps_per_sec,
            episode_return: wire.episode_return,
            evaluation: wire.evaluation.map(EvaluationSummary::from_wire),
            end,
        })
    }
}

impl EvaluationSummary {
    fn to_wire(self) -> wire::EvaluationSummary {
        let Self { iteration, mean, standard_deviation, episodes } = self;
        wire::EvaluationSummary { iteration, mean, standard_deviation, episodes }
    }

    fn from_wire(wire: wire::EvaluationSummary) -> Self {
        let wire::EvaluationSummary { iteration, mean, standard_deviation, episodes } = wire;
        Self { iteration, mean, standard_deviation, episodes }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_survives_the_round_trip_with_and_without_optional_fields() {
        let evaluation =
            EvaluationSummary { iteration: 5, mean: 1.5, standard_deviation: 0.25, episodes: 10 };
        let bare = RunLine {
            run_id: "a run".to_owned(),
            iteration: 7,
            env_steps: 28_000,
            env_steps_per_sec: 1234.5,
            episode_return: None,
            evaluation: None,
            end: None,
        };
        let full = |end| RunLine {
            episode_return: Some(-2.5),
            evaluation: Some(evaluation),
            end: Some(end),
            ..bare.clone()
        };
        for line in [bare.clone(), full(RunEnd::Finished), full(RunEnd::Stopped)] {
            assert_eq!(RunLine::from_wire(line.to_wire()), Ok(line));
        }
        let hostile = RunLine { run_id: "a\u{1b}[2J\u{202e}\nb".to_owned(), ..bare };
        let read = RunLine::from_wire(hostile.to_wire()).unwrap();
        assert_eq!(read.run_id, "a<U+001B>[2J<U+202E> b");
    }
}
