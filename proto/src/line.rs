//! What is told of a run at the end of each iteration, to whoever watches it.

use crate::read::unknown;
use crate::{Refusal, wire};

/// The end of an iteration, or of a learner.
#[derive(Clone, Debug, PartialEq)]
pub struct RunLine {
    /// Names the run for people.
    pub run_id: String,
    /// Finished iterations.
    pub iteration: u64,
    /// Environment steps of all of them.
    pub env_steps: u64,
    /// Environment steps per second of this iteration, over the time since the end of the one before.
    pub env_steps_per_sec: f64,
    /// Mean extrinsic return of the last finished episodes; `None` before the first.
    pub episode_return: Option<f64>,
    /// The newest evaluation whose result is in.
    pub evaluation: Option<EvaluationSummary>,
    /// Why no more lines come; `None` while they do.
    pub end: Option<RunEnd>,
}

/// How evaluation episodes came out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EvaluationSummary {
    /// Iterations after which these were the policies.
    pub iteration: u64,
    /// Mean extrinsic return.
    pub mean: f64,
    /// Its standard deviation over the episodes.
    pub standard_deviation: f64,
    /// Episodes.
    pub episodes: u32,
}

/// How a learner ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RunEnd {
    /// The run has had its last iteration.
    Finished,
    /// Before that; another learner may go on with the run.
    Stopped,
}

impl RunLine {
    /// A run that stands after `iteration`, of which nothing else is known.
    #[must_use]
    pub fn without_figures(run_id: String, iteration: u64, env_steps: u64) -> Self {
        let (env_steps_per_sec, episode_return, evaluation, end) = (0.0, None, None, None);
        Self { run_id, iteration, env_steps, env_steps_per_sec, episode_return, evaluation, end }
    }

    /// The message for it.
    #[must_use]
    pub fn to_wire(&self) -> wire::WatchRunResponse {
        let end = match self.end {
            None => wire::RunEnd::Unspecified,
            Some(RunEnd::Finished) => wire::RunEnd::Finished,
            Some(RunEnd::Stopped) => wire::RunEnd::Stopped,
        };
        wire::WatchRunResponse {
            run_id: self.run_id.clone(),
            iteration: self.iteration,
            env_steps: self.env_steps,
            env_steps_per_sec: self.env_steps_per_sec,
            episode_return: self.episode_return,
            evaluation: self.evaluation.map(EvaluationSummary::to_wire),
            end: end.into(),
        }
    }

    /// Reads the message.
    ///
    /// # Errors
    /// Refuses an unknown end.
    pub fn from_wire(wire: wire::WatchRunResponse) -> Result<Self, Refusal> {
        let end = match wire::RunEnd::try_from(wire.end) {
            Ok(wire::RunEnd::Unspecified) => None,
            Ok(wire::RunEnd::Finished) => Some(RunEnd::Finished),
            Ok(wire::RunEnd::Stopped) => Some(RunEnd::Stopped),
            Err(_) => return Err(unknown("end", wire.end)),
        };
        Ok(Self {
            run_id: wire.run_id,
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
    fn a_line_survives_the_round_trip_with_and_without_what_it_may_lack() {
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
    }
}
