//! The interface of vectorised environments, whoever steps them: `sim` or another program.

use crate::description::Description;
use crate::error::SimError;
use crate::scene::Pose;
use crate::state::StateBounds;
use crate::world::World;

/// The environments of a slot. What they show after a reset, a restored state and a step is a function of the key, the
/// state and the actions. Environments outside this process fail with [`SimError::External`].
pub trait EnvironmentBatch: Send {
    /// The task as seen from outside.
    fn description(&self) -> &Description;

    /// Number of environments `E`.
    fn count(&self) -> usize;

    /// A new episode. `key` is the ChaCha8 key with which its start is drawn. `limit` is the number of steps until
    /// truncation, clamped to `1..=episode_steps`.
    ///
    /// # Errors
    /// If an external environment fails.
    fn reset(
        &mut self,
        environment: usize,
        episode: u64,
        limit: u32,
        key: [u8; 32],
    ) -> Result<(), SimError>;

    /// Continues from an encoded state. Invalid bytes change nothing.
    ///
    /// # Errors
    /// If the bytes are not a state of this task, or an external environment fails.
    fn restore(&mut self, environment: usize, state: &[u8]) -> Result<(), SimError>;

    /// The encoded state of an environment. [`Self::restore`] refuses it if its episode is over: encode after the reset.
    ///
    /// # Errors
    /// If an external environment fails.
    fn encode(&self, environment: usize) -> Result<Vec<u8>, SimError>;

    /// Index of the environment's episode.
    fn episode(&self, environment: usize) -> u64;

    /// Steps taken in the environment's episode.
    fn episode_step(&self, environment: usize) -> u32;

    /// One step of every environment. `actions` is `[E, A]`, each row all agents' actions in agent order;
    /// `outcome` is `[E]`. A finished episode is not reset: the caller reads its last observation and state first.
    ///
    /// # Errors
    /// If `actions` has another length or contains an invalid action, before any environment moves; if an external
    /// environment fails.
    ///
    /// # Panics
    /// If `outcome` has another length.
    fn step(&mut self, actions: &[f32], outcome: &mut [Outcome]) -> Result<(), SimError>;

    /// What an agent observes, `[obs]`.
    ///
    /// # Panics
    /// If `out` has another length.
    fn observation(&self, environment: usize, agent: usize, out: &mut [f32]);

    /// The global state, `[S]`.
    ///
    /// # Panics
    /// If `out` has another length.
    fn state(&self, environment: usize, out: &mut [f32]);

    /// Where a simulated robot's links and joints are; empty for games and external environments.
    fn pose(&self, _environment: usize) -> Pose {
        Pose::default()
    }

    /// The physics world of a simulated robot, for measurements; `None` for games and external environments.
    fn world(&self, _environment: usize) -> Option<&World> {
        None
    }

    /// Bounds of an encoded state; `None` for external environments.
    fn state_bounds(&self) -> Option<&StateBounds> {
        None
    }
}

/// Result of a step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Outcome {
    /// The task's reward; 0 on a fault.
    pub reward: f32,
    /// The task's rules ended the episode.
    pub terminated: bool,
    /// The step limit, or a fault, ended the episode; never together with `terminated`.
    pub truncated: bool,
    /// The world was no longer finite or left the bounds of a state. The state is the one before the
    /// step.
    pub fault: bool,
}
