//! Decodes environment states of a task without restoring them in a world.

use crate::config::TaskConfig;
use crate::error::{SimError, StateError};
use crate::game::Game;
use crate::game::cue::Cue;
use crate::game::signal::Signal;
use crate::simulation::environments;
use crate::state::{State, StateBounds};

/// Decodes the states of one task.
#[derive(Clone, Debug)]
pub struct StateDecoder {
    bounds: StateBounds,
    /// Checks the coordinates of a game.
    check: fn(&[f32]) -> Result<(), StateError>,
}

impl StateDecoder {
    /// The decoder for the states of a task.
    ///
    /// # Errors
    /// If the task is unknown or does not allow these settings.
    pub fn new(config: &TaskConfig) -> Result<Self, SimError> {
        let built = environments(config, 1)?;
        let bounds = built.state_bounds().cloned();
        Ok(Self {
            bounds: bounds.expect("robots and games have bounds of their states"),
            check: match config.task.as_str() {
                Cue::NAME => check::<Cue>,
                Signal::NAME => check::<Signal>,
                _ => |_| Ok(()),
            },
        })
    }

    /// Decodes a state.
    ///
    /// # Errors
    /// Exactly if [`crate::EnvironmentBatch::restore`] rejects the state.
    pub fn decode(&self, state: &[u8]) -> Result<State, StateError> {
        let state = State::from_bytes(state, &self.bounds)?;
        (self.check)(&state.coordinates)?;
        Ok(state)
    }
}

fn check<G: Game>(numbers: &[f32]) -> Result<(), StateError> {
    G::from_numbers(numbers).map(drop)
}
