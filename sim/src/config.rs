//! Settings of a task. There are no defaults here; they are in the run's base configuration.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

/// A task and its observations.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TaskConfig {
    /// Name of the task: one of [`crate::task_names`], or of `definition`.
    pub task: String,
    /// The task's own file; `None` for a task of the program.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub definition: Option<TaskDefinition>,
    /// Weights of reward terms in place of those in the task's file, by the term's name; `None` if all stay.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub weights: Option<BTreeMap<String, f32>>,
    /// Observations of the agents.
    pub observation: ObservationConfig,
}

/// Text of a task file and of the model that it names.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TaskDefinition {
    /// The task file, TOML.
    pub file: String,
    /// The model, MJCF.
    pub model: String,
}

/// Observations of the agents.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ObservationConfig {
    /// Observed features.
    pub mode: ObservationMode,
    /// Scaling of the features.
    pub norm: ObservationNorm,
    /// Observed distance in `k_nearest`: 0 for the agent's own joints, 1 also for their neighbours' angles, and so on.
    pub nearest: usize,
    /// Whether an agent in `k_nearest` also observes the pose and velocity of the root.
    pub globals: RootView,
    /// Whether contact forces are observed, if the task supports them.
    pub contact_forces: ContactForces,
}

/// Features that an agent observes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ObservationMode {
    /// The global state and the agent's one-hot index, as in the published results.
    FullId,
    /// The agent's own joints, contacts on them, and nearby joints. All agents' observations have the same length.
    KNearest,
}

/// Whether an agent with a local observation also observes the root.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RootView {
    /// Height, orientation and velocities of the root, as in Gymnasium-Robotics.
    Shown,
    /// Joints only, as in Multi-Agent MuJoCo.
    Hidden,
}

/// Whether contact forces are observed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ContactForces {
    /// No contact features.
    Absent,
    /// The features exist and are always zero, as in the published runs.
    Zeros,
}

/// Scaling of an observation's features.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ObservationNorm {
    /// Each vector is standardised by the mean and standard deviation over its own features, including the one-hot
    /// index. `observation.rs` describes the consequences.
    FeatureZ,
    /// Running mean and standard deviation of each feature, which the learner updates and policies contain. The
    /// simulator's output is the same as with [`ObservationNorm::None`].
    Running,
    /// Unscaled, in metres, radians and seconds.
    None,
}
