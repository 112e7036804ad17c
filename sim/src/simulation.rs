//! A slot's environments, whatever is simulated in them: robots in worlds, or games.

use rand::RngCore;

use crate::config::TaskConfig;
use crate::description::Description;
use crate::environments::{Outcome, RobotEnvironments};
use crate::error::{ActionError, SimError};
use crate::game::cue::{self, CueEnvironments};
use crate::scene::Pose;
use crate::state::StateBounds;
use crate::world::World;

/// A slot's vectorised environments.
pub struct Environments(Simulation);

enum Simulation {
    Robots(RobotEnvironments),
    Cue(CueEnvironments),
}

/// The same call, whichever simulation it is.
macro_rules! either {
    ($environments:expr, $inner:ident => $call:expr) => {
        match $environments {
            Simulation::Robots($inner) => $call,
            Simulation::Cue($inner) => $call,
        }
    };
}

impl Environments {
    /// `count` environments of a task at rest, episode 0.
    pub fn new(config: &TaskConfig, count: usize) -> Result<Self, SimError> {
        Ok(Self(match config.task.as_str() {
            cue::NAME => Simulation::Cue(CueEnvironments::new(config, count)?),
            _ => Simulation::Robots(RobotEnvironments::new(config, count)?),
        }))
    }

    /// The task as seen from outside.
    pub fn description(&self) -> &Description {
        either!(&self.0, inner => inner.description())
    }

    /// Number of environments `E`.
    pub fn count(&self) -> usize {
        either!(&self.0, inner => inner.count())
    }

    /// What an encoded state may hold.
    pub fn state_bounds(&self) -> &StateBounds {
        either!(&self.0, inner => inner.state_bounds())
    }

    /// A new episode with a drawn start. `limit` is the number of steps until truncation, brought into
    /// `1..=episode_steps`.
    pub fn reset(&mut self, environment: usize, episode: u64, limit: u32, rng: &mut impl RngCore) {
        either!(&mut self.0, inner => inner.reset(environment, episode, limit, rng));
    }

    /// Goes on from an encoded state; refused bytes change nothing.
    pub fn restore(&mut self, environment: usize, state: &[u8]) -> Result<(), SimError> {
        either!(&mut self.0, inner => inner.restore(environment, state))
    }

    /// The environment's state. Taken before a reset that is due, it is refused by [`Self::restore`]: that episode
    /// is over.
    pub fn encode(&self, environment: usize) -> Vec<u8> {
        either!(&self.0, inner => inner.encode(environment))
    }

    /// The index of the environment's episode.
    pub fn episode(&self, environment: usize) -> u64 {
        either!(&self.0, inner => inner.episode(environment))
    }

    /// Steps taken in the environment's episode.
    pub fn episode_step(&self, environment: usize) -> u32 {
        either!(&self.0, inner => inner.episode_step(environment))
    }

    /// One step of every environment. `actions` is `[E, A]`, each row all agents' actions in agent order;
    /// `outcome` is `[E]`. A finished episode is not reset: the caller reads its last observation and state first.
    ///
    /// # Errors
    /// Refuses actions of another length and numbers that are no actions, before anything moves.
    ///
    /// # Panics
    /// If `outcome` has another length.
    pub fn step(&mut self, actions: &[f32], outcome: &mut [Outcome]) -> Result<(), ActionError> {
        either!(&mut self.0, inner => inner.step(actions, outcome))
    }

    /// What an agent sees, `[obs]`.
    ///
    /// # Panics
    /// If `out` has another length.
    pub fn observation(&self, environment: usize, agent: usize, out: &mut [f32]) {
        either!(&self.0, inner => inner.observation(environment, agent, out));
    }

    /// The global state, `[S]`.
    ///
    /// # Panics
    /// If `out` has another length.
    pub fn state(&self, environment: usize, out: &mut [f32]) {
        either!(&self.0, inner => inner.state(environment, out));
    }

    /// Where the robot's links and joints are, for a recording; a game has none.
    pub fn pose(&self, environment: usize) -> Pose {
        match &self.0 {
            Simulation::Robots(robots) => robots.pose(environment),
            Simulation::Cue(_) => Pose { links: Vec::new(), joints: Vec::new() },
        }
    }

    /// The environment's world, for measurements.
    ///
    /// # Panics
    /// If the task is a game: it has no world.
    pub fn world(&self, environment: usize) -> &World {
        match &self.0 {
            Simulation::Robots(robots) => robots.world(environment),
            Simulation::Cue(_) => panic!("{} is a game and has no world", cue::NAME),
        }
    }
}
