//! `s2mia health`: for whoever watches a learner from outside, such as a container engine.

use crate::cli::HealthArguments;
use crate::cli::{credentials, patience};
use crate::output;
use crate::runtime::runtime;

/// Ends with status 0 if the learner serves, else with one line that says why not.
pub(super) fn run(arguments: &HealthArguments) -> anyhow::Result<()> {
    let patience = patience(arguments.timeout_secs)?;
    let tls = credentials(&arguments.learner, &arguments.tls)?;
    let asked = learner::health::demand_serving(&arguments.learner, tls.as_ref(), patience);
    runtime()?.block_on(asked)?;
    output::line(format!("{} serves", arguments.learner));
    Ok(())
}
