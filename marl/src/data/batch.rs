//! The experience `D_k` of one iteration, and the shapes it must have.

use policy::Head;

use crate::error::MarlError;

/// What the algorithm is told about a task: sizes and ranges only, no names.
#[derive(Clone, Debug, PartialEq)]
pub struct Problem {
    /// One shape per agent, in the task's agent order.
    pub agents: Vec<AgentShape>,
    /// Features of the global state, which only critics see.
    pub state: usize,
}

/// One agent's sizes.
#[derive(Clone, Debug, PartialEq)]
pub struct AgentShape {
    /// Features of the agent's observation.
    pub observation: usize,
    /// Numbers in the agent's action.
    pub action: usize,
    /// Lowest and highest number of an action, for policies that keep to a range.
    pub action_range: (f32, f32),
    /// What these numbers are.
    pub kind: ActionKind,
    /// Indices of the observation features that carry a signal; surprise looks at no others
    /// (one-hot ids, duplicates and constants are left out).
    pub surprise_features: Vec<usize>,
    /// Places in the global state of the signals that it observes; empty if they are not there.
    pub seen: Vec<usize>,
    /// Places in the global state of the signals near it; likewise.
    pub near: Vec<usize>,
}

/// What an agent's action is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ActionKind {
    /// Real numbers.
    Continuous,
    /// One number, the index of a choice.
    Discrete {
        /// `K`, number of choices.
        choices: usize,
    },
}

impl ActionKind {
    /// The head of a policy that draws such actions.
    #[must_use]
    pub fn head(self) -> Head {
        match self {
            Self::Continuous => Head::Gaussian,
            Self::Discrete { choices } => Head::Categorical { choices },
        }
    }

    /// Numbers as which others see an action of `action` numbers: a choice is seen one-hot.
    #[must_use]
    pub fn seen_size(self, action: usize) -> usize {
        match self {
            Self::Continuous => action,
            Self::Discrete { choices } => choices,
        }
    }

    /// Adds an action `[act]` to `to` as others see it.
    pub fn see(self, action: &[f32], to: &mut Vec<f32>) {
        match self {
            Self::Continuous => to.extend_from_slice(action),
            Self::Discrete { choices } => {
                let chosen = action[0] as usize;
                to.extend((0..choices).map(|k| if k == chosen { 1.0 } else { 0.0 }));
            }
        }
    }

    /// Refuses actions that are no choices.
    fn check(self, field: &str, actions: &[f32]) -> Result<(), MarlError> {
        let Self::Discrete { choices } = self else { return Ok(()) };
        let is_choice = |a: &f32| *a >= 0.0 && *a < choices as f32 && a.fract() == 0.0;
        actions.iter().position(|a| !is_choice(a)).map_or(Ok(()), |at| {
            let found = actions[at];
            Err(MarlError::Batch(format!("{field}[{at}] is {found}, no choice among {choices}")))
        })
    }
}

/// Rewards of every agent, `[N][T * B]`, row `t * B + b`.
pub type Rewards = Vec<Vec<f32>>;

/// The experience of one iteration, time-major: row `t * B + b`, environments ordered by slot, then
/// by place in the slot.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Batch {
    /// `T`, environment steps.
    pub steps: usize,
    /// `B`, environments.
    pub environments: usize,
    /// What each agent saw and did, in agent order.
    pub agents: Vec<AgentBatch>,
    /// Global state before the step, `[T, B, S]`.
    pub state: Vec<f32>,
    /// Team reward of the step, `[T, B]`.
    pub reward: Vec<f32>,
    /// The step ended the episode for good, `[T, B]`: nothing comes after it.
    pub terminated: Vec<bool>,
    /// The step ended the episode by a limit, `[T, B]`: its value goes on.
    pub truncated: Vec<bool>,
    /// What was true after every done step and after the last step of every environment, sorted by
    /// `(step, environment)`.
    pub finals: Vec<Final>,
}

/// What one agent saw and did.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct AgentBatch {
    /// Observation before the step, `[T, B, obs]`.
    pub observation: Vec<f32>,
    /// Action taken, not clamped, `[T, B, act]`.
    pub action: Vec<f32>,
    /// Log-density of the action under the behaviour weights as the actor computed it, `[T, B]`, nats.
    pub log_prob: Vec<f32>,
    /// Recurrent state before each chunk's first step, after any reset, `[T / chunk, B, H]`.
    pub hidden: Vec<f32>,
}

/// The true next state and observations, where the next row does not show them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Final {
    /// The step after which this holds.
    pub step: usize,
    /// The environment.
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

    /// Whether row `t * B + b` ended an episode, for good or by a limit.
    #[must_use]
    pub fn done(&self, row: usize) -> bool {
        self.terminated[row] || self.truncated[row]
    }

    /// Refuses a batch that does not fit `problem` and chunks of `chunk_steps` steps, whose hidden
    /// states have `hidden[agent]` numbers, whose finals are not exactly where they must be, or
    /// which holds a number that is not finite.
    ///
    /// # Errors
    /// Names the first array that is wrong.
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
                "finals must stand exactly at the done steps and at each environment's last step, \
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

/// Refuses rewards that are not one finite number per agent and row.
///
/// # Errors
/// Names the agent whose rewards are wrong.
pub fn check_rewards(rewards: &Rewards, agents: usize, rows: usize) -> Result<(), MarlError> {
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
