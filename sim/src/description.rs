//! What a task looks like from outside: agents, features, limits. The binary turns this into the wire's form.

/// One task, as [`crate::Environments`] run it.
#[derive(Clone, Debug, PartialEq)]
pub struct Description {
    /// The task's name, `halfcheetah-2x3`.
    pub task: String,
    /// The agents, in the order of their actions.
    pub agents: Vec<AgentDescription>,
    /// The global state's features, `[S]`.
    pub state: Vec<Feature>,
    /// Seconds that one environment step simulates.
    pub dt_secs: f64,
    /// Steps after which an episode is truncated.
    pub episode_steps: u32,
    /// Names the robot that an encoded state belongs to.
    pub state_kind: String,
    /// Version of the encoded state's layout.
    pub state_version: u32,
    /// Bytes of an encoded state.
    pub max_state_bytes: u32,
}

/// One agent.
#[derive(Clone, Debug, PartialEq)]
pub struct AgentDescription {
    /// `agent_0`, `agent_1`, ...
    pub name: String,
    /// The joints the agent drives, in the order of its action.
    pub joints: Vec<String>,
    /// The observation's features, `[obs]`.
    pub observation: Vec<Feature>,
    /// Places in the global state of what the observation shows, unscaled; empty if the state does not hold it.
    pub seen: Vec<usize>,
    /// Places in the global state of what is near the agent, as `k_nearest` would show it; likewise.
    pub near: Vec<usize>,
    /// The action's size and range.
    pub action: ActionRange,
}

/// Size and range of an agent's action. Values outside the range are clamped before they become torques, and cost
/// what they were.
#[derive(Clone, Debug, PartialEq)]
pub struct ActionRange {
    /// Numbers in the action.
    pub size: usize,
    /// Lowest value that still changes the torque.
    pub low: f32,
    /// Highest value that still changes the torque.
    pub high: f32,
    /// Of a discrete action the number of choices: the action is one number, the index of a choice. `None`:
    /// continuous.
    pub choices: Option<u32>,
}

/// One feature of a state or an observation.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Feature {
    /// `rootz.position`, `bthigh.velocity`, `id.0`.
    pub name: String,
    /// What the feature carries.
    pub role: FeatureRole,
}

/// What a feature carries, so that a density knows what to leave out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FeatureRole {
    /// A measurement of the world.
    Signal,
    /// A part of the agent's one-hot number.
    Identity,
    /// The same number as an earlier feature.
    Duplicate,
    /// Always the same number.
    Constant,
}
