//! `s2mia config`: the settings a run would have, each with its origin.

use crate::cli::SettingsArguments;
use crate::config::run_config::RunConfig;
use crate::config::{Request, effect, layers};
use crate::process::output;

/// Prints TOML that `--config` can read again.
pub(super) fn run(arguments: &SettingsArguments) -> anyhow::Result<()> {
    let request = Request::from_process(arguments.files.clone(), arguments.written());
    let config = RunConfig::build(layers::resolve(&request)?)?;
    output::line(config.resolved.to_toml_with_origins(effect::remarks(&config)));
    output::line(format!("# config_sha256 = {}", policy::arrays::hex(&config.resolved.sha256())));
    Ok(())
}
