//! `s2mia inspect`: contents of the newest valid checkpoint of a run.

use serde_json::json;

use crate::cli::InspectArguments;
use crate::process::output;
use crate::run::checkpointed;

/// Iteration, env steps and both hashes.
pub(super) fn run(arguments: &InspectArguments) -> anyhow::Result<()> {
    let loaded = checkpointed::load(&arguments.run)?;
    let checkpoint = &loaded.checkpoint;
    let (weights, state) = (checkpoint.weights_sha256(), checkpoint.state_sha256());
    if arguments.json {
        let told = json!({
            "iteration": checkpoint.iteration,
            "env_steps": checkpoint.env_steps,
            "weights_sha256": weights,
            "state_sha256": state,
        });
        output::line(told);
        return Ok(());
    }
    output::line(format!("checkpoint     {}", loaded.path.display()));
    output::line(format!("iteration      {}", checkpoint.iteration));
    output::line(format!("env steps      {}", checkpoint.env_steps));
    output::line(format!("weights_sha256 {weights}"));
    output::line(format!("state_sha256   {state}"));
    Ok(())
}
