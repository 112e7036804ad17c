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

/// Size and range of an agent's action. A continuous action is in units of half a range: -1 and 1 are the limits of
/// each number's own range, and 0 is its middle. [`ActionScale`] maps it to the own unit, such as that of a motor's control.
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

impl ActionRange {
    /// The range of a continuous action with `size` numbers.
    pub const fn continuous(size: usize) -> Self {
        Self { size, low: -1.0, high: 1.0, choices: None }
    }

    /// The unit of the action's numbers, as files state it.
    pub fn unit(&self) -> &'static str {
        match self.choices {
            None => "half_range",
            Some(_) => "choice",
        }
    }
}

/// Linear map of one number of an action from units of half a range to its own unit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ActionScale {
    middle: f32,
    half: f32,
}

impl ActionScale {
    /// The map to the range from `low` to `high`.
    pub fn to([low, high]: [f32; 2]) -> Self {
        Self { middle: low / 2.0 + high / 2.0, half: high / 2.0 - low / 2.0 }
    }

    /// `middle + half width x action`, in the own unit; not clamped. For the range -1 to 1 this is exactly the action.
    pub fn apply(self, action: f32) -> f32 {
        self.middle + self.half * action
    }
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
