//! What the Python module uses of this program: environments by the names and settings that commands take.

use anyhow::Context as _;
use sim::EnvironmentBatch;

use crate::config::Request;
use crate::config::run_config::RunConfig;

/// `count` environments of the simulator for `settings`, which are a task and pairs `key=value` as commands take them.
///
/// # Errors
/// If a setting or the task is invalid.
pub fn environments(
    settings: Vec<String>,
    count: usize,
) -> anyhow::Result<Box<dyn EnvironmentBatch>> {
    let config = RunConfig::of(&Request { settings, ..Request::default() })?;
    sim::environments(&config.task, count).context("cannot build the task")
}
