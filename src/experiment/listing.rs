//! The runs of an experiment as lines: index, name, length and progress.

use super::plan::PlannedRun;
use super::record::Record;
use super::run_state::{RunState, mismatch, run_state};
use crate::figures::chart;

/// One line per run, and one for all.
pub(crate) fn listing(runs: &[PlannedRun], record: &Record, at_once: usize) -> String {
    let width = runs.iter().map(|run| run.name().len()).max().unwrap_or(0);
    let digits = runs.iter().map(|run| run.index.to_string().len()).max().unwrap_or(0);
    let line = |run: &PlannedRun| {
        let steps = chart::thousands(run.config.env_steps());
        let state = state(run, record);
        format!("{:digits$}  {:width$}  {steps:>10} steps  {state}\n", run.index, run.name())
    };
    let total = runs.iter().map(|run| run.config.env_steps()).sum();
    let lines: String = runs.iter().map(line).collect();
    format!("{lines}{} runs, {} steps, {at_once} at once", runs.len(), chart::thousands(total))
}

fn state(run: &PlannedRun, record: &Record) -> String {
    if record.holds(run) {
        return "recorded".to_owned();
    }
    match (mismatch(run), run_state(run)) {
        (Some(why), _) => why,
        (None, RunState::New) => "new".to_owned(),
        (None, RunState::Begun { env_steps }) => format!("at {}", chart::thousands(env_steps)),
        (None, RunState::Finished) => "finished".to_owned(),
    }
}
