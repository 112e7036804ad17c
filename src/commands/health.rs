//! `s2mia health`: for whoever watches a learner from outside, such as a container engine.

use std::time::Duration;

use crate::cli::HealthArguments;
use crate::commands::{Usage, runtime};
use crate::output;

/// Ends with status 0 if the learner serves, else with one line that says why not.
pub(super) fn run(arguments: &HealthArguments) -> anyhow::Result<()> {
    let secs = arguments.timeout_secs;
    let patience = Duration::try_from_secs_f64(secs)
        .map_err(|_| Usage::new(format!("--timeout-secs must be at least 0, is {secs}")))?;
    runtime()?.block_on(learner::health::demand_serving(&arguments.learner, patience))?;
    output::line(format!("{} serves", arguments.learner));
    Ok(())
}
