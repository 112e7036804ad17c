//! Past transitions. Each state is stored once: the next state of a row is in the following row. Only after a truncation,
//! the newest step and, if the rule reads it, a termination is the true final state stored separately. Rewards are stored
//! without surprise, which is that of the newest density when a transition is drawn.
//!
//! A transition of `S` state features, `O` observation features and `A` action dimensions of all agents takes
//! `4 (S + O + A + 1) + 1` bytes: 249 bytes on `halfcheetah-2x3`, 637 on `halfcheetah-6x1`. A million of them take 0.25
//! and 0.64 GB, in memory and in every checkpoint.

use std::collections::BTreeMap;

use rand::RngCore;

use crate::config::ReplaySettings;
use crate::data::batch::{Batch, Problem};
use crate::error::MarlError;
use crate::optimisation::minibatch::below;
use crate::state::{ArrayShape, Elements, Visitor};
use crate::surprise::Surprise;

/// The episode continues after the step.
const CONTINUES: u8 = 0;
/// The step ended the episode by termination.
const TERMINATED: u8 = 1;
/// The step ended the episode by truncation.
const TRUNCATED: u8 = 2;

/// Widths of a row's parts, in order: state, every agent's observation, every agent's action, reward.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Columns {
    state: usize,
    observations: Vec<usize>,
    actions: Vec<usize>,
}

/// A ring buffer of transitions; the oldest are overwritten first. Rows are counted from the start of the run: row
/// `t * B + b`.
pub(crate) struct Replay {
    columns: Columns,
    capacity: usize,
    terminal_states: bool,
    environments: usize,
    /// Steps of each environment stored so far, including overwritten ones.
    steps: u64,
    rows: Vec<f32>,
    ends: Vec<u8>,
    /// State and observations after the rows whose next row does not contain them.
    finals: BTreeMap<u64, Vec<f32>>,
}

/// Discount, and number of rewards before the bootstrap.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct NStepHorizon {
    pub(crate) gamma: f64,
    pub(crate) steps: usize,
}

/// The n-step target of a row.
#[derive(Debug, PartialEq)]
struct NStepTarget<'a> {
    /// The rows with the rewards before the bootstrap.
    rows: Vec<&'a [f32]>,
    /// Discount of the bootstrapped value; 0 after a termination.
    discount: f64,
    /// State and observations to bootstrap from.
    next: &'a [f32],
}

/// States and observations of `R` transitions.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct NetworkInputs {
    /// `[R, S]`.
    pub(crate) state: Vec<f32>,
    /// `[N][R, obs]`.
    pub(crate) observation: Vec<Vec<f32>>,
}

/// A batch of `R` transitions.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Sample {
    pub(crate) now: NetworkInputs,
    /// `[N][R, act]`.
    pub(crate) action: Vec<Vec<f32>>,
    /// Every agent's discounted rewards before the bootstrap, `[N][R]`.
    pub(crate) reward: Vec<Vec<f64>>,
    /// Discount of the bootstrapped value, `[R]`; 0 after a termination.
    pub(crate) discount: Vec<f64>,
    /// State and observations that the value is bootstrapped from.
    pub(crate) next: NetworkInputs,
    /// Mean surprise bonus in the rewards of all steps drawn, `[N]`; empty without surprise.
    pub(crate) bonus: Vec<f64>,
}

impl Columns {
    fn of(problem: &Problem) -> Self {
        Self {
            state: problem.state,
            observations: problem.agents.iter().map(|agent| agent.observation).collect(),
            actions: problem.agents.iter().map(|agent| agent.action).collect(),
        }
    }

    /// Width of state and observations.
    fn seen(&self) -> usize {
        self.state + self.observations.iter().sum::<usize>()
    }

    fn width(&self) -> usize {
        self.seen() + self.actions.iter().sum::<usize>() + 1
    }

    fn read(&self, seen: &[f32], view: &mut NetworkInputs) {
        view.state.extend_from_slice(&seen[..self.state]);
        split(&seen[self.state..], &self.observations, &mut view.observation);
    }
}

/// Splits `row` into the agents' parts.
fn split(row: &[f32], widths: &[usize], agents: &mut Vec<Vec<f32>>) {
    agents.resize(widths.len(), Vec::new());
    let mut from = 0;
    for (agent, &width) in agents.iter_mut().zip(widths) {
        agent.extend_from_slice(&row[from..from + width]);
        from += width;
    }
}

impl Replay {
    /// An empty replay.
    pub(crate) fn new(problem: &Problem, settings: ReplaySettings) -> Self {
        Self {
            columns: Columns::of(problem),
            capacity: settings.capacity,
            terminal_states: settings.terminal_states,
            environments: 0,
            steps: 0,
            rows: Vec::new(),
            ends: Vec::new(),
            finals: BTreeMap::new(),
        }
    }

    /// Number of transitions stored so far, including overwritten ones.
    pub(crate) fn rows_added(&self) -> u64 {
        self.steps * self.environments as u64
    }

    /// Number of transitions in the replay.
    pub(crate) fn len(&self) -> usize {
        self.ends.len()
    }

    /// Capacity in rows: whole steps of all environments.
    fn row_capacity(&self) -> usize {
        self.capacity / self.environments * self.environments
    }

    fn index(&self, row: u64) -> usize {
        (row % self.row_capacity() as u64) as usize
    }

    fn oldest(&self) -> u64 {
        self.rows_added() - self.len() as u64
    }

    /// Stores an iteration, the continuation of the previous one.
    pub(crate) fn add(&mut self, batch: &Batch) -> Result<(), MarlError> {
        assert!(
            self.capacity >= batch.environments,
            "a replay of {} transitions for {} environments",
            self.capacity,
            batch.environments
        );
        self.environments = batch.environments;
        let first = self.rows_added();
        // The following row now contains the newest step's next state, except after the end of an episode.
        let newest = first.saturating_sub(batch.environments as u64)..first;
        for row in newest {
            if self.ends[self.index(row)] == CONTINUES {
                self.finals.remove(&row);
            }
        }
        for row in 0..batch.rows() {
            self.push(batch, row);
        }
        self.steps += batch.steps as u64;
        for last in &batch.finals {
            let row = last.step * batch.environments + last.environment;
            if self.terminal_states || !batch.terminated[row] {
                let seen = last.state.iter().chain(last.observation.iter().flatten()).copied();
                self.finals.insert(first + row as u64, seen.collect());
            }
        }
        self.finals = self.finals.split_off(&self.oldest());
        Ok(())
    }

    /// Makes an environment's newest step a truncation, whose final state is stored already: the next one begins an episode.
    pub(crate) fn cut_off(&mut self, environment: usize) {
        if self.steps == 0 {
            return;
        }
        let index = self.index(self.rows_added() - self.environments as u64 + environment as u64);
        if self.ends[index] == CONTINUES {
            self.ends[index] = TRUNCATED;
        }
    }

    fn push(&mut self, batch: &Batch, row: usize) {
        let width = self.columns.width();
        let index = self.index(self.rows_added() + row as u64);
        if index == self.ends.len() {
            self.ends.push(CONTINUES);
            self.rows.resize(self.rows.len() + width, 0.0);
        }
        let part = |data: &[f32], width: usize| data[row * width..(row + 1) * width].to_vec();
        let mut numbers = part(&batch.state, self.columns.state);
        for (agent, &width) in batch.agents.iter().zip(&self.columns.observations) {
            numbers.extend(part(&agent.observation, width));
        }
        for (agent, &width) in batch.agents.iter().zip(&self.columns.actions) {
            numbers.extend(part(&agent.action, width));
        }
        numbers.push(batch.reward[row]);
        self.rows[index * width..(index + 1) * width].copy_from_slice(&numbers);
        self.ends[index] = match (batch.terminated[row], batch.truncated[row]) {
            (true, _) => TERMINATED,
            (false, true) => TRUNCATED,
            (false, false) => CONTINUES,
        };
    }

    fn row(&self, row: u64) -> &[f32] {
        let width = self.columns.width();
        &self.rows[self.index(row) * width..][..width]
    }

    /// The n-step target: the rows of the rewards `r_t` to `r_(t+m-1)`, `gamma^m`, and the state after step `t + m - 1`,
    /// where `m` is `horizon.steps`, or fewer at the end of the episode or of the replay. A truncation and the newest step
    /// have the true final state. A termination does not bootstrap, and has its own state if the final one is not stored.
    fn n_step_target(&self, row: u64, horizon: NStepHorizon) -> NStepTarget<'_> {
        let mut rows = Vec::new();
        let mut discount = 1.0;
        let mut at = row;
        for _ in 0..horizon.steps {
            let here = self.row(at);
            rows.push(here);
            discount *= horizon.gamma;
            let last = self.finals.get(&at).map(Vec::as_slice);
            if self.ends[self.index(at)] == TERMINATED {
                let next = last.unwrap_or(&here[..self.columns.seen()]);
                return NStepTarget { rows, discount: 0.0, next };
            }
            if let Some(next) = last {
                return NStepTarget { rows, discount, next };
            }
            at += self.environments as u64;
        }
        NStepTarget { rows, discount, next: &self.row(at)[..self.columns.seen()] }
    }

    /// `count` transitions, sampled uniformly with replacement. With surprise, every reward is relabelled (Eq. 9), with the
    /// draws of this optimiser step.
    ///
    /// # Errors
    /// If a tensor operation of a density fails.
    pub(crate) fn sample(
        &self,
        count: usize,
        horizon: NStepHorizon,
        surprise: Option<(&Surprise, u32)>,
        rng: &mut impl RngCore,
    ) -> Result<Sample, MarlError> {
        let mut sample = Sample::default();
        let mut targets = Vec::with_capacity(count);
        for _ in 0..count {
            let row = self.oldest() + below(self.len(), rng) as u64;
            let here = self.row(row);
            let target = self.n_step_target(row, horizon);
            self.columns.read(here, &mut sample.now);
            split(&here[self.columns.seen()..], &self.columns.actions, &mut sample.action);
            self.columns.read(target.next, &mut sample.next);
            sample.discount.push(target.discount);
            targets.push(target.rows);
        }
        (sample.reward, sample.bonus) = self.discounted(&targets, horizon.gamma, surprise)?;
        Ok(sample)
    }

    /// `sum_k gamma^k r_k` of the rows of each target, per agent `[N][R]`. With surprise, each reward is the agent's with
    /// the surprise of its own observation, otherwise the team's. Also [`Sample::bonus`].
    fn discounted(
        &self,
        targets: &[Vec<&[f32]>],
        gamma: f64,
        surprise: Option<(&Surprise, u32)>,
    ) -> Result<(Vec<Vec<f64>>, Vec<f64>), MarlError> {
        let mut seen = NetworkInputs::default();
        let mut team = Vec::new();
        for row in targets.iter().flatten() {
            team.push(row[row.len() - 1]);
            if surprise.is_some() {
                self.columns.read(row, &mut seen);
            }
        }
        let agents = match surprise {
            Some((surprise, step)) => surprise.rewards(&team, &seen.observation, step)?,
            None => vec![team.clone(); self.columns.observations.len()],
        };
        let bonus = |rewards: &Vec<f32>| {
            let pairs = rewards.iter().zip(&team);
            let sum: f64 = pairs.map(|(&own, &team)| f64::from(own) - f64::from(team)).sum();
            sum / team.len() as f64
        };
        let bonuses = surprise.map(|_| agents.iter().map(bonus).collect());
        let of_agent = |rewards: &Vec<f32>| {
            let mut rewards = rewards.iter();
            let target = |rows: &Vec<&[f32]>| {
                let (mut sum, mut discount) = (0.0, 1.0);
                for &reward in rewards.by_ref().take(rows.len()) {
                    sum += discount * f64::from(reward);
                    discount *= gamma;
                }
                sum
            };
            targets.iter().map(target).collect()
        };
        Ok((agents.iter().map(of_agent).collect(), bonuses.unwrap_or_default()))
    }

    /// Visits `replay/*`: the ring buffer as stored, and the final states with their rows.
    pub(crate) fn visit(&mut self, visitor: &mut dyn Visitor) -> Result<(), MarlError> {
        let (width, seen) = (self.columns.width(), self.columns.seen());
        let mut counts = vec![self.steps as i64, self.environments as i64];
        let mut after: Vec<i64> = self.finals.keys().map(|&row| row as i64).collect();
        let mut finals: Vec<f32> = self.finals.values().flatten().copied().collect();
        visitor.array("replay/counts", ArrayShape::Fixed(&[2]), Elements::I64(&mut counts))?;
        visitor.array("replay/ends", ArrayShape::Rows(&[]), Elements::U8(&mut self.ends))?;
        visitor.array("replay/final_rows", ArrayShape::Rows(&[]), Elements::I64(&mut after))?;
        visitor.array("replay/finals", ArrayShape::Rows(&[seen]), Elements::F32(&mut finals))?;
        visitor.array("replay/rows", ArrayShape::Rows(&[width]), Elements::F32(&mut self.rows))?;
        (self.steps, self.environments) = (counts[0] as u64, counts[1] as usize);
        let pairs = after.iter().zip(finals.chunks_exact(seen));
        self.finals = pairs.map(|(&row, next)| (row as u64, next.to_vec())).collect();
        let kept = match counts[..] {
            [steps, environments] if steps < 0 || environments < 0 => None,
            [_, 0] => Some(0),
            _ => Some((self.rows_added() as usize).min(self.row_capacity())),
        };
        let lengths = [self.rows.len() / width, self.ends.len()].map(Some);
        if lengths == [kept; 2] && after.len() == finals.len() / seen {
            return self.check_terminal_states();
        }
        let rows = self.rows.len() / width;
        let ends = self.ends.len();
        let finals = finals.len() / seen;
        Err(MarlError::Restore(format!(
            "replay/counts is {counts:?}, with {rows} replay/rows, {ends} replay/ends, {} replay/final_rows, {finals} \
             replay/finals",
            after.len()
        )))
    }

    /// Refuses a termination without its final state if the rule reads it.
    fn check_terminal_states(&self) -> Result<(), MarlError> {
        let lacks =
            |row: &u64| self.ends[self.index(*row)] == TERMINATED && !self.finals.contains_key(row);
        let mut rows = self.oldest()..self.rows_added();
        match self.terminal_states.then(|| rows.find(lacks)).flatten() {
            None => Ok(()),
            Some(row) => Err(MarlError::Restore(format!(
                "replay/final_rows lacks {row}, a termination: an earlier version stored this replay; finish the run with \
                 that version, or start it again"
            ))),
        }
    }
}

#[cfg(test)]
mod tests;
