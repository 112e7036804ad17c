//! The simulator: robots and tasks, stepped with rapier3d. It contains no learning.
//!
//! A robot is an MJCF file in `assets/` and a row in `robot.rs`. A task is a file in `task/` and a row in `task.rs`.
//! A game is a task without physics, in `game/`. Between two slot boundaries, the simulation depends only on the
//! encoded state and the actions: `reset` and `restore` both call the one function that rebuilds a world from bytes.

mod config;
mod description;
mod environment_batch;
mod environments;
mod error;
mod game;
mod noise;
mod observation;
mod partition;
mod probe;
mod robot;
mod scene;
mod simulation;
mod state;
mod task;
mod world;

pub use config::{
    ContactForces, ObservationConfig, ObservationMode, ObservationNorm, PartitionSemantics,
    RootView, TaskConfig,
};
pub use description::{ActionRange, AgentDescription, Description, Feature, FeatureRole};
pub use environment_batch::{EnvironmentBatch, Outcome};
pub use error::{ActionError, SimError, StateError};
pub use probe::probe;
pub use robot::Robot;
pub use scene::{JointPose, LinkPose, LinkShape, Pose, Shape, drivers, hinges, rotated, shapes};
pub use simulation::environments;
pub use state::{State, StateBounds};
pub use task::task_names;
pub use world::World;
