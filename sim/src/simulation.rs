//! Builds the environments of a task from its name: simulated robots or games.

use crate::config::TaskConfig;
use crate::environment_batch::EnvironmentBatch;
use crate::environments::RobotEnvironments;
use crate::error::SimError;
use crate::game::cue::Cue;
use crate::game::signal::Signal;
use crate::game::{Game, GameEnvironments};

/// Returns `count` environments of a task in their rest state, in episode 0.
///
/// # Errors
/// If the task is unknown or does not allow these settings, or `count` is 0.
pub fn environments(
    config: &TaskConfig,
    count: usize,
) -> Result<Box<dyn EnvironmentBatch>, SimError> {
    Ok(match config.task.as_str() {
        Cue::NAME => Box::new(GameEnvironments::<Cue>::new(config, count)?),
        Signal::NAME => Box::new(GameEnvironments::<Signal>::new(config, count)?),
        _ => Box::new(RobotEnvironments::new(config, count)?),
    })
}
