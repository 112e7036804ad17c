//! What a caller chooses about a task. There are no defaults here: they stand in the run's base configuration.

use serde::{Deserialize, Serialize};

/// One task and how its agents see and share the robot.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TaskConfig {
    /// One of [`crate::task_names`].
    pub task: String,
    /// What the agents observe.
    pub observation: ObservationConfig,
    /// Which agent drives which joint.
    pub partition: PartitionSemantics,
}

/// What the agents observe.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ObservationConfig {
    /// Which features an agent sees.
    pub mode: ObservationMode,
    /// How the features are scaled.
    pub norm: ObservationNorm,
    /// How far an agent sees in `k_nearest`: 0 its own joints, 1 their neighbours' angles too, and so on.
    pub nearest: usize,
    /// Whether an agent in `k_nearest` also sees how the root stands and moves.
    pub globals: RootView,
    /// Whether contact forces are observed, where the task knows them.
    pub contact_forces: ContactForces,
}

/// Which features an agent sees.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ObservationMode {
    /// The global state and the agent's one-hot number, as the published results had it.
    FullId,
    /// The agent's own joints, what touches them, and joints near them: local views, all of one length.
    KNearest,
}

/// Whether an agent that sees only its own surroundings also sees the root.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RootView {
    /// Height, orientation and velocities of the root, as in Gymnasium-Robotics.
    Shown,
    /// Joints alone, as in Multi-Agent MuJoCo.
    Hidden,
}

/// Whether contact forces are observed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ContactForces {
    /// No such features.
    Absent,
    /// The features are there and always zero, as in the published runs.
    Zeros,
    /// From the contacts' impulses in the last physics step; they then cost reward, too.
    Real,
}

/// How an observation's features are scaled.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ObservationNorm {
    /// The vector is standardised by the mean and deviation over its own features, the one-hot number included.
    /// See `observation.rs` for what that does.
    FeatureZ,
    /// By the run's own mean and deviation of each feature, which the learner keeps and policies carry; what leaves
    /// the simulation is as with [`ObservationNorm::None`].
    Running,
    /// Raw metres, radians and seconds.
    None,
}

/// Which agent drives which joint.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PartitionSemantics {
    /// Contiguous slices in the order of the robot's actuators: what the published numbers used.
    ActuatorSlices,
    /// The joints that the task's published labels name.
    Labels,
}
