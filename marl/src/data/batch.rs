//! The rollout data `D_k` of one iteration, and its shapes.

use policy::Head;

use crate::error::MarlError;

/// Sizes and ranges of a task's observations, actions and state.
#[derive(Clone, Debug, PartialEq)]
pub struct Problem {
    /// One shape per agent, in the task's agent order.
    pub agents: Vec<AgentShape>,
    /// Features of the global state, which only critics see.
    pub state: usize,
}

/// Sizes of one agent's observations and actions.
#[derive(Clone, Debug, PartialEq)]
pub struct AgentShape {
    /// Features of the agent's observation.
    pub observation: usize,
    /// Numbers in the agent's action.
    pub action: usize,
    /// Lowest and highest value of an action, for policies with bounded actions.
    pub action_range: (f32, f32),
    /// Kind of action.
    pub kind: ActionKind,
    /// Indices of the observation features that surprise scores. One-hot ids, duplicates and constants are left out.
    pub surprise_features: Vec<usize>,
}

/// Kind of action.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ActionKind {
    /// A vector of real numbers.
    Continuous,
    /// The index of a choice.
    Discrete {
        /// `K`, the number of choices.
        choices: usize,
    },
}

impl ActionKind {
    /// Head of a policy with such actions.
    #[must_use]
    pub fn head(self) -> Head {
        match self {
            Self::Continuous => Head::Gaussian,
            Self::Discrete { choices } => Head::Categorical { choices },
        }
    }

    /// Size of an action's encoding for other agents: `action` numbers, or a one-hot vector of choices.
    pub(crate) fn encoded_size(self, action: usize) -> usize {
        match self {
            Self::Continuous => action,
            Self::Discrete { choices } => choices,
        }
    }

    /// Appends the encoding of `action` `[act]` for other agents to `to`.
    pub fn encode(self, action: &[f32], to: &mut Vec<f32>) {
        match self {
            Self::Continuous => to.extend_from_slice(action),
            Self::Discrete { choices } => {
                let chosen = action[0] as usize;
                to.extend((0..choices).map(|k| if k == chosen { 1.0 } else { 0.0 }));
            }
        }
    }

    /// Rejects invalid choices.
    fn check(self, field: &str, actions: &[f32]) -> Result<(), MarlError> {
        let Self::Discrete { choices } = self else { return Ok(()) };
        let is_choice = |a: &f32| *a >= 0.0 && *a < choices as f32 && a.fract() == 0.0;
        actions.iter().position(|a| !is_choice(a)).map_or(Ok(()), |at| {
            let found = actions[at];
            Err(MarlError::Batch(format!(
                "{field}[{at}] is {found}, expected a choice below {choices}"
            )))
        })
    }
}

/// Rewards of every agent, `[N][T * B]`, row `t * B + b`.
pub type Rewards = Vec<Vec<f32>>;

/// The rollout data of one iteration, time-major: row `t * B + b`. Environments are ordered by slot, then by index in
/// the slot.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Batch {
    /// `T`, environment steps per environment.
    pub steps: usize,
    /// `B`, number of environments.
    pub environments: usize,
    /// Observations and actions of each agent, in agent order.
    pub agents: Vec<AgentBatch>,
    /// Global state before the step, `[T, B, S]`.
    pub state: Vec<f32>,
    /// Team reward of the step, `[T, B]`.
    pub reward: Vec<f32>,
    /// The step ended the episode by termination, `[T, B]`.
    pub terminated: Vec<bool>,
    /// The step ended the episode by truncation, `[T, B]`.
    pub truncated: Vec<bool>,
    /// State and observations after every done step and after the last step of every environment, sorted by
    /// `(step, environment)`.
    pub finals: Vec<Final>,
}

/// Observations and actions of one agent.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct AgentBatch {
    /// Observation before the step, `[T, B, obs]`.
    pub observation: Vec<f32>,
    /// Action taken, not clamped, `[T, B, act]`.
    pub action: Vec<f32>,
    /// Log-probability of the action under the behaviour weights, computed by the actor, `[T, B]`, nats.
    pub log_prob: Vec<f32>,
    /// Recurrent state before each chunk's first step, after any reset, `[T / chunk, B, H]`.
    pub hidden: Vec<f32>,
}

/// The true next state and observations of a row whose next row does not contain them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Final {
    /// Step before this state.
    pub step: usize,
    /// Index of the environment.
    pub environment: usize,
    /// Global state after the step, `[S]`.
    pub state: Vec<f32>,
    /// Every agent's observation after the step, `[N][obs]`.
    pub observation: Vec<Vec<f32>>,
}

impl Batch {
    /// Rows of the batch, `T * B`.
    #[must_use]
    pub fn rows(&self) -> usize {
        self.steps * self.environments
    }

    /// Whether row `t * B + b` ended an episode, by termination or truncation.
    #[must_use]
    pub fn done(&self, row: usize) -> bool {
        self.terminated[row] || self.truncated[row]
    }

    /// Rejects a batch with a wrong shape, misplaced finals or a number that is not finite. Chunks have `chunk_steps`
    /// steps; `hidden[agent]` is the size of an agent's recurrent state.
    ///
    /// # Errors
    /// Names the first invalid array.
    pub fn check(
        &self,
        problem: &Problem,
        chunk_steps: usize,
        hidden: &[usize],
    ) -> Result<(), MarlError> {
        if self.rows() == 0 || !self.steps.is_multiple_of(chunk_steps) {
            return Err(MarlError::Batch(format!(
                "{} steps x {} environments; steps must be a positive multiple of chunk_steps = {chunk_steps}",
                self.steps, self.environments
            )));
        }
        let rows = self.rows();
        floats("state", "[T, B, S]", &self.state, rows * problem.state)?;
        floats("reward", "[T, B]", &self.reward, rows)?;
        length("terminated", "[T, B]", self.terminated.len(), rows)?;
        length("truncated", "[T, B]", self.truncated.len(), rows)?;
        length("agents", "[N]", self.agents.len(), problem.agents.len())?;
        let chunks = self.steps / chunk_steps * self.environments;
        for (index, (agent, shape)) in self.agents.iter().zip(&problem.agents).enumerate() {
            agent.check(index, shape, rows, chunks * hidden[index])?;
        }
        self.check_finals(problem)
    }

    fn check_finals(&self, problem: &Problem) -> Result<(), MarlError> {
        let expected = (0..self.rows())
            .filter(|&row| self.done(row) || row / self.environments + 1 == self.steps);
        let found = self.finals.iter().map(|f| f.step * self.environments + f.environment);
        if !expected.eq(found) || self.finals.iter().any(|f| f.environment >= self.environments) {
            return Err(MarlError::Batch(
                "finals must be exactly those of the done steps and of each environment's last step, \
                 sorted by step and environment"
                    .to_owned(),
            ));
        }
        for last in &self.finals {
            floats("finals.state", "[S]", &last.state, problem.state)?;
            length("finals.observation", "[N]", last.observation.len(), problem.agents.len())?;
            for (observation, shape) in last.observation.iter().zip(&problem.agents) {
                floats("finals.observation", "[obs]", observation, shape.observation)?;
            }
        }
        Ok(())
    }
}

impl AgentBatch {
    fn check(
        &self,
        index: usize,
        shape: &AgentShape,
        rows: usize,
        hidden: usize,
    ) -> Result<(), MarlError> {
        let at = |name: &str| format!("agents[{index}].{name}");
        let observation = rows * shape.observation;
        floats(&at("observation"), "[T, B, obs]", &self.observation, observation)?;
        floats(&at("action"), "[T, B, act]", &self.action, rows * shape.action)?;
        shape.kind.check(&at("action"), &self.action)?;
        floats(&at("log_prob"), "[T, B]", &self.log_prob, rows)?;
        floats(&at("hidden"), "[T / chunk, B, H]", &self.hidden, hidden)
    }
}

/// Rejects rewards that are not one finite number per agent and row.
///
/// # Errors
/// Names the agent with invalid rewards.
pub(crate) fn check_rewards(
    rewards: &Rewards,
    agents: usize,
    rows: usize,
) -> Result<(), MarlError> {
    length("rewards", "[N]", rewards.len(), agents)?;
    for (index, reward) in rewards.iter().enumerate() {
        floats(&format!("rewards[{index}]"), "[T, B]", reward, rows)?;
    }
    Ok(())
}

fn floats(
    field: &str,
    shape: &'static str,
    data: &[f32],
    expected: usize,
) -> Result<(), MarlError> {
    length(field, shape, data.len(), expected)?;
    match data.iter().position(|x| !x.is_finite()) {
        None => Ok(()),
        Some(index) => {
            Err(MarlError::NotFinite { field: field.to_owned(), index, found: data[index] })
        }
    }
}

fn length(
    field: &str,
    shape: &'static str,
    found: usize,
    expected: usize,
) -> Result<(), MarlError> {
    if found == expected {
        return Ok(());
    }
    Err(MarlError::Shape { field: field.to_owned(), shape, expected, found })
}
