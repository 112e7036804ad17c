//! Where a chunk's recurrent state comes from: the rollout, today's weights, or a run-up with today's weights.
//!
//! States that are computed again are constants in single precision, as the stored ones are.

use candle_core::DType;
use policy::network::SequenceInput;
use policy::{PolicyConfig, RefreshHidden};

use super::agent::Agent;
use crate::data::sequence::Sequences;
use crate::error::MarlError;

/// How an agent's recurrent states are computed again.
#[derive(Clone, Debug)]
pub(super) struct Memory {
    /// Chunks that are run through before a chunk.
    burn_in: usize,
    refresh: RefreshHidden,
    /// States at each chunk's start `[C, H]` in place of the stored ones; never kept from one `D_k` to the next.
    refreshed: Option<Vec<f32>>,
}

impl Memory {
    pub(super) fn new(policy: &PolicyConfig) -> Self {
        let (burn_in, refresh) =
            (policy.burn_in / policy.backpropagation_steps, policy.refresh_hidden);
        Self { burn_in, refresh, refreshed: None }
    }
}

impl Agent {
    /// The network's input for some chunks; every log-density of an update is asked for with it.
    pub(super) fn input(
        &self,
        sequences: &Sequences,
        columns: &[usize],
    ) -> Result<SequenceInput, MarlError> {
        let start = self.run_up(sequences, columns, self.memory.burn_in)?;
        sequences.input_from(columns, start, self.precision.dtype())
    }

    /// Takes up what is stored with a new `D_k`.
    pub(super) fn forget_states(&mut self) {
        self.memory.refreshed = None;
    }

    /// To be called before every epoch: computes the states at all chunks' starts again where that is wanted.
    pub(super) fn refresh_states(
        &mut self,
        sequences: &Sequences,
        epoch: usize,
    ) -> Result<(), MarlError> {
        if self.memory.refresh == RefreshHidden::EveryEpoch && epoch > 0 {
            self.memory.refreshed = Some(self.unrolled_states(sequences)?);
        }
        Ok(())
    }

    /// States at the start of some chunks `[columns, H]` after a run-up over the `burn_in` chunks before each. It is
    /// shorter where `D_k` begins within it.
    fn run_up(
        &self,
        sequences: &Sequences,
        columns: &[usize],
        burn_in: usize,
    ) -> Result<Vec<f32>, MarlError> {
        let all = self.memory.refreshed.as_ref().unwrap_or(&sequences.hidden);
        let mut states = sequences.states(all, columns);
        let before = |&column: &usize| sequences.layout.before(column);
        let earlier: Vec<usize> = columns.iter().filter_map(before).collect();
        if burn_in == 0 || earlier.is_empty() {
            return Ok(states);
        }
        let start = self.run_up(sequences, &earlier, burn_in - 1)?;
        let found = self.states_after(sequences, &earlier, start)?;
        let width = self.hidden_size();
        let later = states.chunks_exact_mut(width).zip(columns);
        let later = later.filter(|(_, column)| before(column).is_some());
        for ((state, _), found) in later.zip(found.chunks_exact(width)) {
            state.copy_from_slice(found);
        }
        Ok(states)
    }

    /// States at all chunks' starts `[C, H]`, from the first stored ones through all of `D_k`.
    fn unrolled_states(&self, sequences: &Sequences) -> Result<Vec<f32>, MarlError> {
        let layout = sequences.layout;
        let first: Vec<usize> = (0..layout.environments).collect();
        let mut states = sequences.states(&sequences.hidden, &first);
        let mut all = states.clone();
        for chunk in (layout.environments..layout.chunks).step_by(layout.environments) {
            let before: Vec<usize> = (chunk - layout.environments..chunk).collect();
            states = self.states_after(sequences, &before, states)?;
            all.extend(&states);
        }
        Ok(all)
    }

    /// The states that some chunks which begin in `start` leave to the next, `[columns, H]`: zeros where an episode
    /// ends with the chunk.
    fn states_after(
        &self,
        sequences: &Sequences,
        columns: &[usize],
        start: Vec<f32>,
    ) -> Result<Vec<f32>, MarlError> {
        let input = sequences.input_from(columns, start, self.precision.dtype())?;
        let last =
            self.network.last_state(&self.network.weights()?, &input)?.to_dtype(DType::F32)?;
        let mut states = last.flatten_all()?.to_vec1::<f32>()?;
        for (state, &column) in states.chunks_exact_mut(self.hidden_size()).zip(columns) {
            if sequences.ends[column] {
                state.fill(0.0);
            }
        }
        Ok(states)
    }
}
