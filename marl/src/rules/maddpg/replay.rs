//! Past transitions, each state held once: the next one is read from the row that follows, and only
//! where no row does (a truncation, the newest step) is the true final state kept beside.
//!
//! A transition of `S` state features, `O` observation features and `A` action dimensions of all agents
//! costs `4 (S + O + A + 1) + 1` bytes: 249 bytes on `halfcheetah-2x3`, 637 on `halfcheetah-6x1`, so
//! that a million of them take 0.25 and 0.64 GB, in memory and in every checkpoint.

use std::collections::BTreeMap;

use policy::arrays::{Array, NamedArrays};
use rand::RngCore;

use crate::data::batch::{Batch, Problem};
use crate::error::MarlError;
use crate::optimisation::minibatch::below;

/// Nothing ended with the step.
const GOES_ON: u8 = 0;
/// The step ended the episode for good.
const TERMINATED: u8 = 1;
/// The step ended the episode by a limit.
const TRUNCATED: u8 = 2;

/// Where a row's parts begin: state, every agent's observation, every agent's action, reward.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Columns {
    state: usize,
    observations: Vec<usize>,
    actions: Vec<usize>,
}

/// A ring of transitions, the oldest overwritten first. Rows are counted from the run's beginning:
/// row `t * B + b`.
pub(super) struct Replay {
    columns: Columns,
    capacity: usize,
    environments: usize,
    /// Steps of each environment that were ever remembered.
    steps: u64,
    rows: Vec<f32>,
    ends: Vec<u8>,
    /// State and observations after the rows where the next row does not show them.
    finals: BTreeMap<u64, Vec<f32>>,
}

/// Discount, and how many rewards stand before the bootstrap.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Horizon {
    pub(super) gamma: f64,
    pub(super) steps: usize,
}

/// What lies ahead of a row.
#[derive(Debug, PartialEq)]
struct Outlook<'a> {
    reward: f64,
    /// Of the bootstrapped value; 0 after a termination.
    discount: f64,
    /// State and observations to bootstrap from.
    next: &'a [f32],
}

/// What is seen at one moment of `R` transitions.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct View {
    /// `[R, S]`.
    pub(super) state: Vec<f32>,
    /// `[N][R, obs]`.
    pub(super) observation: Vec<Vec<f32>>,
}

/// `R` transitions to learn from.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Sample {
    pub(super) now: View,
    /// `[N][R, act]`.
    pub(super) action: Vec<Vec<f32>>,
    /// Discounted rewards before the bootstrap, `[R]`.
    pub(super) reward: Vec<f64>,
    /// Discount of the bootstrapped value, `[R]`; 0 after a termination.
    pub(super) discount: Vec<f64>,
    /// What the value is bootstrapped from.
    pub(super) next: View,
}

impl Columns {
    fn of(problem: &Problem) -> Self {
        Self {
            state: problem.state,
            observations: problem.agents.iter().map(|agent| agent.observation).collect(),
            actions: problem.agents.iter().map(|agent| agent.action).collect(),
        }
    }

    /// Numbers of state and observations.
    fn seen(&self) -> usize {
        self.state + self.observations.iter().sum::<usize>()
    }

    fn width(&self) -> usize {
        self.seen() + self.actions.iter().sum::<usize>() + 1
    }

    fn look(&self, seen: &[f32], view: &mut View) {
        view.state.extend_from_slice(&seen[..self.state]);
        spread(&seen[self.state..], &self.observations, &mut view.observation);
    }
}

/// Deals `row` out to the agents.
fn spread(row: &[f32], widths: &[usize], agents: &mut Vec<Vec<f32>>) {
    agents.resize(widths.len(), Vec::new());
    let mut from = 0;
    for (agent, &width) in agents.iter_mut().zip(widths) {
        agent.extend_from_slice(&row[from..from + width]);
        from += width;
    }
}

impl Replay {
    /// Remembers up to `capacity` transitions.
    pub(super) fn new(problem: &Problem, capacity: usize) -> Self {
        Self {
            columns: Columns::of(problem),
            capacity,
            environments: 0,
            steps: 0,
            rows: Vec::new(),
            ends: Vec::new(),
            finals: BTreeMap::new(),
        }
    }

    /// Transitions that were ever remembered.
    pub(super) fn taken_in(&self) -> u64 {
        self.steps * self.environments as u64
    }

    /// Transitions that are remembered.
    pub(super) fn len(&self) -> usize {
        self.ends.len()
    }

    /// Rows that fit: whole steps of all environments.
    fn places(&self) -> usize {
        self.capacity / self.environments * self.environments
    }

    fn place(&self, row: u64) -> usize {
        (row % self.places() as u64) as usize
    }

    fn oldest(&self) -> u64 {
        self.taken_in() - self.len() as u64
    }

    /// Remembers an iteration, which goes on where the last one ended.
    pub(super) fn remember(&mut self, batch: &Batch) -> Result<(), MarlError> {
        if self.capacity < batch.environments {
            let range = "at least one step of every environment";
            let (key, found) = ("maddpg.replay", self.capacity.to_string());
            return Err(MarlError::Config { key, found, range });
        }
        self.environments = batch.environments;
        let first = self.taken_in();
        // The newest step's next state is now shown by the row that follows, but for truncations.
        let newest = first.saturating_sub(batch.environments as u64)..first;
        for row in newest {
            if self.ends[self.place(row)] == GOES_ON {
                self.finals.remove(&row);
            }
        }
        for row in 0..batch.rows() {
            self.push(batch, row);
        }
        self.steps += batch.steps as u64;
        for last in &batch.finals {
            let row = last.step * batch.environments + last.environment;
            if !batch.terminated[row] {
                let seen = last.state.iter().chain(last.observation.iter().flatten()).copied();
                self.finals.insert(first + row as u64, seen.collect());
            }
        }
        self.finals = self.finals.split_off(&self.oldest());
        Ok(())
    }

    fn push(&mut self, batch: &Batch, row: usize) {
        let width = self.columns.width();
        let place = self.place(self.taken_in() + row as u64);
        if place == self.ends.len() {
            self.ends.push(GOES_ON);
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
        self.rows[place * width..(place + 1) * width].copy_from_slice(&numbers);
        self.ends[place] = match (batch.terminated[row], batch.truncated[row]) {
            (true, _) => TERMINATED,
            (false, true) => TRUNCATED,
            (false, false) => GOES_ON,
        };
    }

    fn row(&self, row: u64) -> &[f32] {
        let width = self.columns.width();
        &self.rows[self.place(row) * width..][..width]
    }

    /// The n-step target's parts: `sum_(k < m) gamma^k r_(t+k)`, `gamma^m`, and the state after step
    /// `t + m - 1`, where `m` is `horizon.steps` or what is left of the episode or of the replay.
    /// A truncation and the newest step bootstrap from the true final state; a termination from
    /// nothing.
    fn look_ahead(&self, row: u64, horizon: Horizon) -> Outlook<'_> {
        let (mut reward, mut discount, mut at) = (0.0, 1.0, row);
        for _ in 0..horizon.steps {
            let here = self.row(at);
            reward += discount * f64::from(here[here.len() - 1]);
            discount *= horizon.gamma;
            if self.ends[self.place(at)] == TERMINATED {
                return Outlook { reward, discount: 0.0, next: &here[..self.columns.seen()] };
            }
            if let Some(next) = self.finals.get(&at) {
                return Outlook { reward, discount, next };
            }
            at += self.environments as u64;
        }
        Outlook { reward, discount, next: &self.row(at)[..self.columns.seen()] }
    }

    /// `count` transitions, each as likely as any other, with replacement.
    pub(super) fn sample(&self, count: usize, horizon: Horizon, rng: &mut impl RngCore) -> Sample {
        let mut sample = Sample::default();
        for _ in 0..count {
            let row = self.oldest() + below(self.len(), rng) as u64;
            let (here, seen) = (self.row(row), self.columns.seen());
            let ahead = self.look_ahead(row, horizon);
            self.columns.look(here, &mut sample.now);
            spread(&here[seen..], &self.columns.actions, &mut sample.action);
            self.columns.look(ahead.next, &mut sample.next);
            sample.reward.push(ahead.reward);
            sample.discount.push(ahead.discount);
        }
        sample
    }

    /// `replay/*`: the ring as it lies, and the final states with their rows.
    pub(super) fn arrays(&self) -> NamedArrays {
        let (width, seen, finals) = (self.columns.width(), self.columns.seen(), &self.finals);
        let counts = vec![self.steps as i64, self.environments as i64];
        let after = finals.keys().map(|&row| row as i64).collect();
        let kept = finals.values().flatten().copied().collect();
        let arrays = [
            ("counts", Array::I64 { shape: vec![2], data: counts }),
            ("ends", Array::U8 { shape: vec![self.len()], data: self.ends.clone() }),
            ("final_rows", Array::I64 { shape: vec![finals.len()], data: after }),
            ("finals", Array::F32 { shape: vec![finals.len(), seen], data: kept }),
            ("rows", Array::F32 { shape: vec![self.len(), width], data: self.rows.clone() }),
        ];
        arrays.into_iter().map(|(name, array)| (format!("replay/{name}"), array)).collect()
    }

    /// Takes over what [`Replay::arrays`] gave.
    pub(super) fn restore(&mut self, arrays: &NamedArrays) -> Result<(), MarlError> {
        let (width, seen) = (self.columns.width(), self.columns.seen());
        let wrong =
            |name: &str| MarlError::Restore(format!("replay/{name} is missing or misshapen"));
        let get =
            |name: &'static str| arrays.get(&format!("replay/{name}")).ok_or_else(|| wrong(name));
        let (Array::I64 { data: counts, .. }, Array::U8 { data: ends, .. }) =
            (get("counts")?, get("ends")?)
        else {
            return Err(wrong("counts"));
        };
        let (Array::I64 { data: after, .. }, Array::F32 { data: finals, .. }) =
            (get("final_rows")?, get("finals")?)
        else {
            return Err(wrong("finals"));
        };
        let Array::F32 { data: rows, .. } = get("rows")? else { return Err(wrong("rows")) };
        let fits = rows.len() == ends.len() * width && finals.len() == after.len() * seen;
        if !fits || counts.len() != 2 || counts.iter().any(|&count| count < 0) {
            return Err(wrong("rows"));
        }
        (self.steps, self.environments) = (counts[0] as u64, counts[1] as usize);
        let kept = (self.taken_in() as usize).min(match self.environments {
            0 => 0,
            _ => self.places(),
        });
        if kept != ends.len() {
            return Err(wrong("ends"));
        }
        (self.rows, self.ends) = (rows.clone(), ends.clone());
        let pairs = after.iter().zip(finals.chunks_exact(seen));
        self.finals = pairs.map(|(&row, next)| (row as u64, next.to_vec())).collect();
        Ok(())
    }
}

#[cfg(test)]
mod tests;
