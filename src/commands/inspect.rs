//! `s2mia config` and `s2mia inspect`: the settings that a run would have, and the contents of its newest valid
//! checkpoint.

use std::path::PathBuf;

use clap::Args;
use serde_json::json;

use crate::config::effect;
use crate::config::run_config::RunConfig;
use crate::process::output;
use crate::run::{SettingsArguments, stored};

/// Prints TOML that `--config` can read again.
pub(super) fn config(arguments: &SettingsArguments) -> anyhow::Result<()> {
    let config = RunConfig::of(&arguments.request())?;
    output::line(config.resolved.to_toml_with_origins(effect::remarks(&config)));
    output::line(format!("# config_sha256 = {}", policy::arrays::hex(&config.resolved.sha256())));
    Ok(())
}

/// `s2mia inspect`
#[derive(Args, Debug)]
pub(crate) struct InspectArguments {
    /// Run folder, or one of its checkpoints.
    pub(crate) run: PathBuf,
    /// Print one JSON object.
    #[arg(long)]
    pub(crate) json: bool,
}

/// Iteration, env steps and both hashes.
pub(super) fn inspect(arguments: &InspectArguments) -> anyhow::Result<()> {
    let loaded = stored::load(&arguments.run)?;
    let checkpoint = &loaded.checkpoint;
    let (weights, state) = (checkpoint.weights_sha256(), checkpoint.state_sha256());
    if arguments.json {
        let object = json!({
            "iteration": checkpoint.iteration,
            "env_steps": checkpoint.env_steps,
            "weights_sha256": weights,
            "state_sha256": state,
        });
        output::line(object);
        return Ok(());
    }
    output::line(format!("checkpoint     {}", loaded.path.display()));
    output::line(format!("iteration      {}", checkpoint.iteration));
    output::line(format!("env steps      {}", checkpoint.env_steps));
    output::line(format!("weights_sha256 {weights}"));
    output::line(format!("state_sha256   {state}"));
    Ok(())
}
