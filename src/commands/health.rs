//! `s2mia health`: for whoever watches a learner from outside, such as a container engine.

use crate::cli::HealthArguments;
use crate::commands::{patience, runtime};
use crate::output;

/// Ends with status 0 if the learner serves, else with one line that says why not.
pub(super) fn run(arguments: &HealthArguments) -> anyhow::Result<()> {
    let patience = patience(arguments.timeout_secs)?;
    runtime()?.block_on(learner::health::demand_serving(&arguments.learner, patience))?;
    output::line(format!("{} serves", arguments.learner));
    Ok(())
}
