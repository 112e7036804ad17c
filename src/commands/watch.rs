//! `s2mia watch`: one line for each iteration as it is finished, from one learner of a run and the next.

use std::path::Path;
use std::time::{Duration, Instant};

use clap::Args;
use learner::serve::client::CallError;
use learner::serve::service::WatchedLines;
use proto::{EvaluationSummary, RunEnd, RunLine};
use serde_json::json;

use crate::commands::control::{
    AtRest, LearnerArgument, explained, operator, seconds, unsaved, url,
};
use crate::errors::Usage;
use crate::figures::chart::thousands;
use crate::process::{output, runtime, shell};

/// `s2mia watch`
#[derive(Args, Debug)]
pub(crate) struct WatchArguments {
    /// Run folder or learner.
    #[command(flatten)]
    pub(crate) learner: LearnerArgument,
    /// Print one JSON object per line.
    #[arg(long)]
    pub(crate) json: bool,
    /// Exit if the learner cannot be reached for this long.
    #[arg(long, value_name = "SECONDS", default_value = "300", value_parser = seconds)]
    pub(crate) max_outage_secs: Duration,
}

/// Pause between two tries to reach it.
const PAUSE: Duration = Duration::from_millis(500);

/// Prints one line per finished iteration until the run has had its last one.
pub(super) fn run(arguments: &WatchArguments) -> anyhow::Result<()> {
    runtime()?.block_on(Watch::new(arguments).until_the_end())
}

/// A watcher and the last iteration that it has shown.
struct Watch<'a> {
    arguments: &'a WatchArguments,
    run_id: Option<String>,
    seen: u64,
    /// When a learner was last there.
    reached: Instant,
}

impl<'a> Watch<'a> {
    fn new(arguments: &'a WatchArguments) -> Self {
        Self { arguments, run_id: None, seen: 0, reached: Instant::now() }
    }

    /// Watches the learners of the run one after the other. Fails if none could be reached for `--max-outage-secs`.
    async fn until_the_end(mut self) -> anyhow::Result<()> {
        let outage = self.arguments.max_outage_secs;
        let LearnerArgument { tls, timeout_secs, .. } = &self.arguments.learner;
        // One warning for each learner that ended.
        let mut reported = None;
        loop {
            let missing = match self.session().await {
                Ok(RunEnd::Finished | RunEnd::StoppedByClient) => return Ok(()),
                Ok(RunEnd::Stopped) => anyhow::anyhow!("the learner has ended"),
                Err(error) => explained(error, tls, *timeout_secs).await,
            };
            if is_final(&missing) || self.reached.elapsed() >= outage {
                return Err(missing);
            }
            if reported.replace(self.reached) != Some(self.reached) {
                let secs = outage.as_secs_f64();
                tracing::warn!("{missing:#}; waiting up to {secs} s (--max-outage-secs)");
            }
            tokio::time::sleep(PAUSE).await;
        }
    }

    /// One learner, and how it ended. A run without a learner from the start shows how far it came.
    async fn session(&mut self) -> anyhow::Result<RunEnd> {
        let learner = &self.arguments.learner;
        let Some(url) = url(learner)? else {
            let rest = AtRest::of(Path::new(&learner.of))?;
            let of = &learner.of;
            if self.run_id.is_some() && !rest.is_finished() {
                let run = shell::path(Path::new(of));
                let next = format!("`s2mia train --resume {run}` starts one");
                return Err(anyhow::anyhow!("the learner of {of} has ended; {next}"));
            }
            if !rest.has_checkpoint {
                return Err(Usage::new(unsaved(Path::new(of))).into());
            }
            self.show(&rest.last_line);
            return Ok(RunEnd::Finished);
        };
        let mut operator = operator(&url, learner).await?;
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
        if self.arguments.json {
            output::line(json!(line));
        } else {
            output::line(text(line));
        }
    }
}

/// Whether another try would end in the same way.
fn is_final(error: &anyhow::Error) -> bool {
    let refused =
        |error: &CallError| matches!(error, CallError::Final(_) | CallError::InvalidUrl { .. });
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
        Some(RunEnd::Stopped | RunEnd::StoppedByClient) => {
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
        let expected =
            "finished after iteration 7, 28,000 env steps  evaluation after 5: 45.0 ± 1.2";
        assert_eq!(text(&last), expected);
        let before = RunLine { episode_return: None, ..line() };
        assert!(text(&before).ends_with("return -"));
    }
}
