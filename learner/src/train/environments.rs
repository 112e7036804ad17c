//! State of all environments between two iterations: where each continues, the return and length of its current
//! episode, and the returns of the last finished episodes.

use std::collections::VecDeque;

use marl::Batch;
use policy::arrays::{Array, NamedArrays};
use proto::{EnvironmentStart, EpisodePosition, RolloutWork, RunDescription, Start};

use crate::config::Phase;
use crate::lease::end_states::StateReader;
use crate::lease::slots::SlotRollout;
use crate::store::checkpoint::{CheckpointError, fields};

/// Finished episodes in the reported mean return.
const RECENT: usize = 20;

/// Array of the environments that begin a new episode in place of one that could not be continued.
const BEGUN_AGAIN: &str = "environments/begun_again";

/// State of all environments, in the order of their global index.
#[derive(Clone, Debug, PartialEq)]
pub struct Environments {
    /// `H` of each agent, 0 without a recurrent state.
    hidden_sizes: Vec<usize>,
    /// Step limit of each environment's first episode.
    limits: Vec<u32>,
    starts: Vec<Start>,
    episode_return: Vec<f64>,
    episode_length: Vec<u64>,
    finished: Vec<u64>,
    recent: VecDeque<f64>,
    episode_steps: u32,
    /// Environments that began a new episode before the last iteration because theirs could not be continued.
    pub(crate) begun_again: Vec<u32>,
    /// Episodes of the last iteration that were truncated before their limit by a fault of their environment.
    pub(crate) faults: u64,
}

impl Environments {
    /// The state of `count` environments of `run` before the first iteration. With `Phase::Staggered`, the first episode of environment `e` of `E` is
    /// truncated after `episode_steps * (e + 1) / E` steps, at least one.
    #[must_use]
    pub fn fresh(run: &RunDescription, count: usize, phase: Phase) -> Self {
        let episode_steps = run.environment.episode_steps;
        let limits: Vec<u32> = (0..count).map(|e| limit(e, count, episode_steps, phase)).collect();
        let start = |limit: &u32| Start::Fresh { episode: 0, limit: *limit };
        Self {
            starts: limits.iter().map(start).collect(),
            hidden_sizes: run.hidden_sizes.iter().map(|size| *size as usize).collect(),
            limits,
            episode_return: vec![0.0; count],
            episode_length: vec![0; count],
            finished: vec![0; count],
            recent: VecDeque::new(),
            episode_steps,
            begun_again: Vec::new(),
            faults: 0,
        }
    }

    /// The slots of an iteration, each with the start states of `per_slot` environments; the last slot has the rest.
    #[must_use]
    pub fn work(&self, iteration: u64, per_slot: usize) -> Vec<RolloutWork> {
        let all = (0..self.starts.len() as u32).collect::<Vec<_>>();
        let environments = all.chunks(per_slot).map(|slot| self.starts_of(slot));
        let slot = |(slot, environments)| RolloutWork { iteration, slot, environments };
        (0..).zip(environments).map(slot).collect()
    }

    /// The start states of these environments.
    pub(crate) fn starts_of(&self, environments: &[u32]) -> Vec<EnvironmentStart> {
        let start = |environment: &u32| {
            let start = self.starts[*environment as usize].clone();
            EnvironmentStart { environment: *environment, start }
        };
        environments.iter().map(start).collect()
    }

    /// Begins a new episode in an environment that continues one. The steps of the old one so far stay in the results, but
    /// its return is not reported. Returns whether there is an old one.
    pub fn begin_again(&mut self, environment: u32) -> bool {
        let environment = environment as usize;
        if !matches!(self.starts[environment], Start::Continue { .. }) {
            return false;
        }
        self.begin_episode(environment);
        let episode = self.finished[environment];
        let limit = self.episode_steps;
        self.starts[environment] = Start::Fresh { episode, limit };
        true
    }

    /// The environments whose start state cannot be decoded or is at another position than the environment, and why.
    #[must_use]
    pub fn invalid(&self, states: &StateReader) -> Vec<(u32, String)> {
        let check = |(environment, start): (usize, &Start)| {
            let Start::Continue { state, .. } = start else { return None };
            let position = EpisodePosition {
                episode: self.finished[environment],
                step: u32::try_from(self.episode_length[environment]).unwrap_or(u32::MAX),
                limit: self.limit(environment),
            };
            let why = states.check(state, position).err()?;
            Some((environment as u32, why))
        };
        self.starts.iter().enumerate().filter_map(check).collect()
    }

    /// Advances to the end of an iteration with its rewards and the end states of its slots. `batch` is assembled from
    /// `rollouts`.
    pub fn advance(&mut self, batch: &Batch, rollouts: &[SlotRollout]) {
        assert_eq!(batch.environments, self.starts.len(), "environments of all slots");
        self.begun_again = self.replaced();
        self.faults = 0;
        for row in 0..batch.rows() {
            let environment = row % batch.environments;
            self.episode_return[environment] += f64::from(batch.reward[row]);
            self.episode_length[environment] += 1;
            let limit = u64::from(self.limit(environment));
            if batch.truncated[row] && self.episode_length[environment] < limit {
                self.faults += 1;
            }
            if batch.done(row) {
                self.finish_episode(environment);
            }
        }
        self.starts = rollouts.iter().flat_map(|rollout| self.continuations(rollout)).collect();
    }

    /// Step limit of the environment's current episode.
    fn limit(&self, environment: usize) -> u32 {
        match self.finished[environment] {
            0 => self.limits[environment],
            _ => self.episode_steps,
        }
    }

    fn finish_episode(&mut self, environment: usize) {
        // The return of a first episode that is shorter than usual is not comparable.
        if self.limit(environment) == self.episode_steps {
            self.recent.push_back(self.episode_return[environment]);
        }
        while self.recent.len() > RECENT {
            self.recent.pop_front();
        }
        self.begin_episode(environment);
    }

    /// Counts the environment's current episode as finished and resets the figures for the next one.
    fn begin_episode(&mut self, environment: usize) {
        self.episode_return[environment] = 0.0;
        self.episode_length[environment] = 0;
        self.finished[environment] += 1;
    }

    fn continuations(&self, rollout: &SlotRollout) -> Vec<Start> {
        let end = rollout.chunks.last().and_then(|chunk| chunk.end.as_ref());
        let end = end.expect("an assembled rollout has end states");
        let states = end.environments.iter().enumerate();
        states
            .map(|(p, state)| Start::Continue {
                state: state.clone(),
                recurrent: self.recurrent_of(p, end.recurrent.iter().map(Vec::as_slice)),
            })
            .collect()
    }

    /// Recurrent states of environment `e`, `[H]` for each agent; `all` is `[E, H]` for each agent.
    fn recurrent_of<'a>(&self, e: usize, all: impl Iterator<Item = &'a [f32]>) -> Vec<Vec<f32>> {
        all.zip(&self.hidden_sizes).map(|(all, size)| all[e * size..][..*size].to_vec()).collect()
    }

    /// Mean extrinsic return of the last 20 finished episodes that were not shortened; `None` before the first.
    #[must_use]
    pub fn mean_return(&self) -> Option<f64> {
        let count = self.recent.len();
        (count > 0).then(|| self.recent.iter().sum::<f64>() / count as f64)
    }

    /// The state as arrays under `environments/`, and recent returns under `counters/`.
    #[must_use]
    pub fn arrays(&self) -> NamedArrays {
        let mut arrays = NamedArrays::new();
        for (e, start) in self.starts.iter().enumerate() {
            if let Start::Continue { state, .. } = start {
                let array = Array::U8 { shape: vec![state.len()], data: state.clone() };
                arrays.insert(state_name(e), array);
            }
        }
        self.add_recurrent(&mut arrays);
        self.add_begun_again(&mut arrays);
        let count = self.starts.len();
        let f64s = |data: Vec<f64>| Array::F64 { shape: vec![data.len()], data };
        let i64s = |data: &[u64]| Array::I64 {
            shape: vec![count],
            data: data.iter().map(|value| *value as i64).collect(),
        };
        arrays.insert("environments/episode_return".into(), f64s(self.episode_return.clone()));
        arrays.insert("environments/episode_length".into(), i64s(&self.episode_length));
        arrays.insert("environments/finished_episodes".into(), i64s(&self.finished));
        if !self.recent.is_empty() {
            let recent = self.recent.iter().copied().collect();
            arrays.insert("counters/recent_returns".into(), f64s(recent));
        }
        arrays
    }

    /// Adds `environments/recurrent_I`, `[B, H]`, of every agent `I` with a recurrent state. Before the first iteration
    /// there are none.
    fn add_recurrent(&self, arrays: &mut NamedArrays) {
        for (index, size) in self.hidden_sizes.iter().enumerate() {
            let mut data = Vec::new();
            for start in &self.starts {
                match start {
                    Start::Continue { recurrent, .. } => data.extend_from_slice(&recurrent[index]),
                    Start::Fresh { .. } => data.resize(data.len() + size, 0.0),
                }
            }
            if !data.is_empty() && !self.is_new() {
                let shape = vec![self.starts.len(), *size];
                arrays.insert(recurrent_name(index), Array::F32 { shape, data });
            }
        }
    }

    /// Adds `environments/begun_again`, `[B]`, with 1 for each environment that has no state because it begins a new episode.
    /// Without such an environment, and before the first iteration, there is none.
    fn add_begun_again(&self, arrays: &mut NamedArrays) {
        let mut data = vec![0; self.starts.len()];
        self.replaced().iter().for_each(|environment| data[*environment as usize] = 1);
        if data.contains(&1) {
            let array = Array::I64 { shape: vec![data.len()], data };
            arrays.insert(BEGUN_AGAIN.to_owned(), array);
        }
    }

    /// Environments that begin a new episode in place of one that could not be continued.
    fn replaced(&self) -> Vec<u32> {
        if self.is_new() {
            return Vec::new();
        }
        let fresh =
            (0..).zip(&self.starts).filter(|(_, start)| matches!(start, Start::Fresh { .. }));
        fresh.map(|(environment, _)| environment).collect()
    }

    /// Whether no environment has taken a step. Only first episodes have the index 0.
    fn is_new(&self) -> bool {
        let is_first = |start: &Start| matches!(start, Start::Fresh { episode: 0, .. });
        self.starts.iter().all(is_first)
    }

    /// Restores the state that [`Self::arrays`] returned after `iteration` iterations.
    ///
    /// # Errors
    /// An array is missing or has the wrong type or length.
    pub fn restore(&mut self, arrays: &NamedArrays, iteration: u64) -> Result<(), CheckpointError> {
        let count = self.starts.len();
        self.episode_return = fields::f64s(arrays, "environments/episode_return", count)?.to_vec();
        self.episode_length = fields::counts(arrays, "environments/episode_length", count)?;
        self.finished = fields::counts(arrays, "environments/finished_episodes", count)?;
        self.recent = match arrays.get("counters/recent_returns") {
            None => VecDeque::new(),
            Some(_) => {
                fields::all_f64s(arrays, "counters/recent_returns")?.iter().copied().collect()
            }
        };
        if iteration > 0 {
            self.starts = self.read_starts(arrays)?;
        }
        Ok(())
    }

    fn read_starts(&self, arrays: &NamedArrays) -> Result<Vec<Start>, CheckpointError> {
        let count = self.starts.len();
        let mut recurrent = Vec::new();
        for (index, size) in self.hidden_sizes.iter().enumerate() {
            recurrent.push(match size {
                0 => &[][..],
                size => fields::f32s(arrays, &recurrent_name(index), count * size)?,
            });
        }
        let begun_again = if arrays.contains_key(BEGUN_AGAIN) {
            fields::counts(arrays, BEGUN_AGAIN, count)?
        } else {
            vec![0; count]
        };
        let read = |e: usize| {
            if begun_again[e] == 1 {
                return Ok(Start::Fresh { episode: self.finished[e], limit: self.episode_steps });
            }
            let state = fields::bytes(arrays, &state_name(e))?.to_vec();
            Ok(Start::Continue {
                state,
                recurrent: self.recurrent_of(e, recurrent.iter().copied()),
            })
        };
        (0..count).map(read).collect()
    }
}

fn limit(environment: usize, count: usize, episode_steps: u32, phase: Phase) -> u32 {
    match phase {
        Phase::Lockstep => episode_steps,
        Phase::Staggered => {
            let share = u64::from(episode_steps) * (environment as u64 + 1) / count as u64;
            u32::try_from(share).map_or(episode_steps, |share| share.max(1))
        }
    }
}

fn state_name(environment: usize) -> String {
    format!("environments/{environment:04}/state")
}

fn recurrent_name(agent: usize) -> String {
    format!("environments/recurrent_{agent}")
}

#[cfg(test)]
mod tests;
