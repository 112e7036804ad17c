//! `s2mia watch`: a line for each iteration as it is finished, from one learner of a run and the next.

use std::path::Path;
use std::time::{Duration, Instant};

use learner::health::HealthError;
use learner::service::WatchedLines;
use proto::{EvaluationSummary, RunEnd, RunLine};
use serde_json::{Value, json};

use crate::chart::thousands;
use crate::cli::WatchArguments;
use crate::commands::control::{operator, url};
use crate::commands::status::AtRest;
use crate::commands::{Usage, runtime};
use crate::output;

/// How long a learner may take to answer.
const ANSWER: Duration = Duration::from_secs(3);
/// Pause between two tries to reach it.
const PAUSE: Duration = Duration::from_millis(500);

/// Ends when the run has had its last iteration.
pub(super) fn run(arguments: &WatchArguments) -> anyhow::Result<()> {
    let outage = Duration::try_from_secs_f64(arguments.max_outage_secs).map_err(|_| {
        let given = arguments.max_outage_secs;
        Usage::new(format!("--max-outage-secs must be at least 0, is {given}"))
    })?;
    runtime()?.block_on(Watch::new(arguments).until_the_end(outage))
}

/// How far somebody has watched.
struct Watch<'a> {
    arguments: &'a WatchArguments,
    run_id: Option<String>,
    seen: u64,
    /// When a learner was last there.
    reached: Instant,
}

impl<'a> Watch<'a> {
    fn new(arguments: &'a WatchArguments) -> Self {
        Self { arguments, run_id: None, seen: arguments.after, reached: Instant::now() }
    }

    /// One learner after the other; gives up when none has been reached for as long as `outage`.
    async fn until_the_end(mut self, outage: Duration) -> anyhow::Result<()> {
        loop {
            let missing = match self.session().await {
                Ok(RunEnd::Finished) => return Ok(()),
                Ok(RunEnd::Stopped) => anyhow::anyhow!("the learner has ended"),
                Err(error) if is_final(&error) => return Err(error),
                Err(error) => error,
            };
            if self.reached.elapsed() >= outage {
                return Err(missing);
            }
            tracing::info!("{missing:#}; trying again");
            tokio::time::sleep(PAUSE).await;
        }
    }

    /// One learner, and how it ended; a run that is finished needs none.
    async fn session(&mut self) -> anyhow::Result<RunEnd> {
        let learner = &self.arguments.learner;
        let Some(url) = url(learner)? else {
            return match AtRest::of(Path::new(&learner.of))?.is_finished() {
                true => Ok(RunEnd::Finished),
                false => Err(anyhow::anyhow!("no learner works on {}", learner.of)),
            };
        };
        let mut operator = operator(&url, learner, ANSWER).await?;
        self.meet(operator.status().await?.run_id);
        let lines = operator.watch(self.seen).await?;
        let ended = self.follow(lines).await;
        self.reached = Instant::now();
        ended
    }

    /// The lines of one learner, to its last.
    async fn follow(&mut self, mut lines: WatchedLines) -> anyhow::Result<RunEnd> {
        while let Some(line) = lines.next().await? {
            self.show(&line);
            if let Some(end) = line.end {
                return Ok(end);
            }
        }
        Ok(RunEnd::Stopped)
    }

    /// Another run at the same address is watched from its beginning.
    fn meet(&mut self, run_id: String) {
        if self.run_id.as_ref().is_some_and(|known| *known != run_id) {
            self.seen = 0;
        }
        self.run_id = Some(run_id);
    }

    fn show(&mut self, line: &RunLine) {
        self.seen = self.seen.max(line.iteration);
        match self.arguments.json {
            true => output::line(to_json(line)),
            false => output::line(text(line)),
        }
    }
}

/// Whether another try would end in the same way.
fn is_final(error: &anyhow::Error) -> bool {
    let refused = |error: &HealthError| !matches!(error, HealthError::Silent { .. });
    error.is::<Usage>() || error.downcast_ref().is_some_and(refused)
}

fn text(line: &RunLine) -> String {
    let RunLine { iteration, episode_return, evaluation, end, .. } = line;
    let steps = thousands(line.env_steps);
    let evaluated = evaluation.map_or_else(String::new, |found| {
        let EvaluationSummary { iteration, mean, standard_deviation, .. } = found;
        format!("  evaluation after {iteration}: {mean:.1} ± {standard_deviation:.1}")
    });
    match end {
        Some(RunEnd::Finished) => {
            format!("finished after iteration {iteration}, {steps} env steps{evaluated}")
        }
        Some(RunEnd::Stopped) => {
            format!("stopped after iteration {iteration}, {steps} env steps{evaluated}")
        }
        None => {
            let pace = thousands(line.env_steps_per_sec.round() as u64);
            let reward =
                episode_return.map_or_else(|| "-".to_owned(), |found| format!("{found:.1}"));
            format!(
                "iteration {iteration}  {steps} env steps  {pace} steps/s  return {reward}{evaluated}"
            )
        }
    }
}

fn to_json(line: &RunLine) -> Value {
    let end = line.end.map(|end| match end {
        RunEnd::Finished => "finished",
        RunEnd::Stopped => "stopped",
    });
    let evaluation = line.evaluation.map(|found| {
        json!({
            "iteration": found.iteration,
            "mean": found.mean,
            "standard_deviation": found.standard_deviation,
            "episodes": found.episodes,
        })
    });
    json!({
        "run_id": line.run_id,
        "iteration": line.iteration,
        "env_steps": line.env_steps,
        "env_steps_per_sec": line.env_steps_per_sec,
        "episode_return": line.episode_return,
        "evaluation": evaluation,
        "end": end,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn line() -> RunLine {
        RunLine {
            run_id: "a run".to_owned(),
            iteration: 7,
            env_steps: 28_000,
            env_steps_per_sec: 2345.4,
            episode_return: Some(12.34),
            evaluation: None,
            end: None,
        }
    }

    #[test]
    fn a_line_tells_steps_pace_return_and_the_newest_evaluation() {
        assert_eq!(text(&line()), "iteration 7  28,000 env steps  2,345 steps/s  return 12.3");
        let found =
            EvaluationSummary { iteration: 5, mean: 45.0, standard_deviation: 1.25, episodes: 4 };
        let last = RunLine { evaluation: Some(found), end: Some(RunEnd::Finished), ..line() };
        let told = "finished after iteration 7, 28,000 env steps  evaluation after 5: 45.0 ± 1.2";
        assert_eq!(text(&last), told);
        let before = RunLine { episode_return: None, ..line() };
        assert!(text(&before).ends_with("return -"));
    }
}
