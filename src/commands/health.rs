//! `s2mia health`: a health check of a learner, for example for a container engine.

use crate::cli::HealthArguments;
use crate::cli::{credentials, patience};
use crate::process::{output, runtime};

/// Ends with status 0 if the learner serves, else with a one-line reason.
pub(super) fn run(arguments: &HealthArguments) -> anyhow::Result<()> {
    let patience = patience(arguments.timeout_secs)?;
    let tls = credentials(&arguments.learner, &arguments.tls)?;
    let asked = learner::health::demand_serving(&arguments.learner, tls.as_ref(), patience);
    runtime()?.block_on(asked)?;
    output::line(format!("{} serves", arguments.learner));
    Ok(())
}
