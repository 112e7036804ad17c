//! The simulator: robots and tasks, stepped with rapier3d. It contains no learning.
//!
//! A task is data: a TOML file with a robot's agents, rewards and rules, and an MJCF file with its model. Those of the
//! program are in `assets/`. A game is a task without physics, in `game/`. Between two slot boundaries, the simulation
//! depends only on the
//! encoded state and the actions: `reset` and `restore` both call the one function that rebuilds a world from bytes.

mod arrays;
mod config;
mod environment_batch;
mod environments;
mod error;
mod game;
mod noise;
mod observation;
mod probe;
mod robot;
mod scene;
pub mod spelling;
mod state;
mod task;
mod world;

pub use config::{
    ContactForces, ObservationConfig, ObservationMode, ObservationNorm, RootView, TaskConfig,
    TaskDefinition,
};
pub use environment_batch::{
    Disturbances, EnvironmentBatch, Outcome, check_actions, environments, in_range,
};
pub use error::{SimError, StateError};
pub use observation::standardise;
pub use probe::probe;
pub use robot::{Actuator, Robot, Torque, one_document};
pub use scene::{
    Capsule, Hull, JointPose, LinkPose, LinkShape, OKABE_ITO, Pose, Shape, WORLD, drivers,
    link_colour, rotated,
};
pub use state::{EpisodeDraws, State, StateBounds};
pub use task::task_names;
pub use world::World;
