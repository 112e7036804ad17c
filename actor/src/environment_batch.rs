//! The door behind which a slot's environments are stepped: in this process by the simulator, or by a program that
//! offers them.

use policy::Key;
use sim::{Description, Environments, Outcome, Pose};

use crate::error::EnvironmentError;

/// A slot's environments. What they show after a reset, a restored state and a step is a function of the key, the
/// state and the actions.
pub trait EnvironmentBatch {
    /// The task as seen from outside.
    fn description(&self) -> &Description;

    /// Number of environments `E`.
    fn count(&self) -> usize;

    /// A new episode whose start is drawn with `key`. `limit` is the number of steps until truncation, brought into
    /// `1..=episode_steps`.
    ///
    /// # Errors
    /// If whoever steps them does not answer, or wrongly.
    fn reset(
        &mut self,
        environment: usize,
        episode: u64,
        limit: u32,
        key: Key,
    ) -> Result<(), EnvironmentError>;

    /// Goes on from an encoded state.
    ///
    /// # Errors
    /// If the bytes are none of this task's, and as [`Self::reset`].
    fn restore(&mut self, environment: usize, state: &[u8]) -> Result<(), EnvironmentError>;

    /// The environment's state, from which [`Self::restore`] goes on.
    ///
    /// # Errors
    /// As [`Self::reset`].
    fn encode(&self, environment: usize) -> Result<Vec<u8>, EnvironmentError>;

    /// The index of the environment's episode.
    fn episode(&self, environment: usize) -> u64;

    /// Steps taken in the environment's episode.
    fn episode_step(&self, environment: usize) -> u32;

    /// One step of every environment. `actions` is `[E, A]`, each row all agents' actions in agent order;
    /// `outcome` is `[E]`. A finished episode is not reset.
    ///
    /// # Errors
    /// If an action is none, and as [`Self::reset`].
    fn step(&mut self, actions: &[f32], outcome: &mut [Outcome]) -> Result<(), EnvironmentError>;

    /// What an agent sees, `[obs]`.
    fn observation(&self, environment: usize, agent: usize, out: &mut [f32]);

    /// The global state, `[S]`.
    fn state(&self, environment: usize, out: &mut [f32]);

    /// The simulator's own environments, which can be measured and drawn; `None` if they are stepped elsewhere.
    fn simulated(&self) -> Option<&Environments>;

    /// Where a simulated robot's links and joints are; none of anything else.
    fn pose(&self, environment: usize) -> Pose {
        let nothing = || Pose { links: Vec::new(), joints: Vec::new() };
        self.simulated().map_or_else(nothing, |own| own.pose(environment))
    }
}

impl EnvironmentBatch for Environments {
    fn description(&self) -> &Description {
        self.description()
    }

    fn count(&self) -> usize {
        self.count()
    }

    fn reset(
        &mut self,
        environment: usize,
        episode: u64,
        limit: u32,
        key: Key,
    ) -> Result<(), EnvironmentError> {
        self.reset(environment, episode, limit, &mut key.generator());
        Ok(())
    }

    fn restore(&mut self, environment: usize, state: &[u8]) -> Result<(), EnvironmentError> {
        Ok(self.restore(environment, state)?)
    }

    fn encode(&self, environment: usize) -> Result<Vec<u8>, EnvironmentError> {
        Ok(self.encode(environment))
    }

    fn episode(&self, environment: usize) -> u64 {
        self.episode(environment)
    }

    fn episode_step(&self, environment: usize) -> u32 {
        self.episode_step(environment)
    }

    fn step(&mut self, actions: &[f32], outcome: &mut [Outcome]) -> Result<(), EnvironmentError> {
        Ok(self.step(actions, outcome).map_err(sim::SimError::from)?)
    }

    fn observation(&self, environment: usize, agent: usize, out: &mut [f32]) {
        self.observation(environment, agent, out);
    }

    fn state(&self, environment: usize, out: &mut [f32]) {
        self.state(environment, out);
    }

    fn simulated(&self) -> Option<&Environments> {
        Some(self)
    }
}
