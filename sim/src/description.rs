//! Description of a task: agents, features, limits. `rollout` converts it to the protocol's messages.

/// Description of a task.
#[derive(Clone, Debug, PartialEq)]
pub struct Description {
    /// Name of the task, such as `halfcheetah-2x3`.
    pub task: String,
    /// The agents, in the order of their actions.
    pub agents: Vec<AgentDescription>,
    /// Features of the global state, `[S]`.
    pub state: Vec<Feature>,
    /// Seconds that one environment step simulates.
    pub dt_secs: f64,
    /// Steps after which an episode is truncated.
    pub episode_steps: u32,
    /// Kind of an encoded state; names its robot.
    pub state_kind: String,
    /// Layout version of an encoded state.
    pub state_version: u32,
    /// Largest size of an encoded state, bytes.
    pub max_state_bytes: u32,
}

/// Description of an agent.
#[derive(Clone, Debug, PartialEq)]
pub struct AgentDescription {
    /// Name of the agent: `agent_0`, `agent_1`, ...
    pub name: String,
    /// Joints that the agent controls, in the order of its action.
    pub joints: Vec<String>,
    /// Features of the observation, `[obs]`.
    pub observation: Vec<Feature>,
    /// Indices in the global state of the observed features; empty if the state does not contain them.
    pub seen: Vec<usize>,
    /// Indices in the global state of the features that `k_nearest` would show; empty in the same case.
    pub near: Vec<usize>,
    /// Size and range of the action.
    pub action: ActionRange,
}

/// Size and range of an agent's action. If all motors of the agent have one control range, the range is that one and
/// actions are controls. Otherwise it is -1 to 1, mapped linearly to the control range of each motor. Controls are
/// clamped to their ranges; the reward's control cost uses the action before clamping.
#[derive(Clone, Debug, PartialEq)]
pub struct ActionRange {
    /// Number of components.
    pub size: usize,
    /// Lowest value; lower ones are clamped.
    pub low: f32,
    /// Highest value; higher ones are clamped.
    pub high: f32,
    /// Number of choices of a discrete action, which is one number: the index of a choice. `None` for a continuous
    /// action.
    pub choices: Option<u32>,
}

/// Feature of a state or an observation.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Feature {
    /// Name, such as `rootz.position`, `bthigh.velocity` or `id.0`.
    pub name: String,
    /// Kind of information.
    pub role: FeatureRole,
}

/// Kind of information in a feature. Densities use it to exclude features.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FeatureRole {
    /// Measurement of the environment.
    Signal,
    /// Component of the agent's one-hot index.
    Identity,
    /// Copy of an earlier feature.
    Duplicate,
    /// Constant value.
    Constant,
}
