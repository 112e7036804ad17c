//! Recurrent states at the start of a chunk: stored, recomputed with the current weights, or after a burn-in with them.
//!
//! Recomputed states are constants, like stored ones.

use policy::network::SequenceInput;
use policy::{ActorNetwork, PolicyConfig, RefreshHidden};

use crate::data::sequence::Sequences;
use crate::error::MarlError;

/// How an agent recomputes recurrent states.
#[derive(Clone, Debug)]
pub(super) struct Memory {
    /// Number of chunks processed before a chunk.
    burn_in: usize,
    refresh: RefreshHidden,
    /// States at each chunk's start `[C, H]` that replace the stored ones, for the current `D_k` only.
    refreshed: Option<Vec<f32>>,
}

impl Memory {
    pub(super) fn new(policy: &PolicyConfig) -> Self {
        let (burn_in, refresh) =
            (policy.burn_in / policy.backpropagation_steps, policy.refresh_hidden);
        Self { burn_in, refresh, refreshed: None }
    }

    /// Input of `network` for some chunks. All log-probabilities of an update use it.
    pub(super) fn input(
        &self,
        network: &ActorNetwork,
        sequences: &Sequences,
        columns: &[usize],
    ) -> Result<SequenceInput, MarlError> {
        let start = self.burned_in_states(network, sequences, columns, self.burn_in)?;
        sequences.input_from(columns, start)
    }

    /// Returns to the stored states, for a new `D_k`.
    pub(super) fn use_stored_states(&mut self) {
        self.refreshed = None;
    }

    /// Recomputes the states at all chunks' starts if configured; to be called before every epoch.
    pub(super) fn refresh_states(
        &mut self,
        network: &ActorNetwork,
        sequences: &Sequences,
        epoch: usize,
    ) -> Result<(), MarlError> {
        if self.refresh == RefreshHidden::EveryEpoch && epoch > 0 {
            self.refreshed = Some(self.unrolled_states(network, sequences)?);
        }
        Ok(())
    }

    /// States at the start of some chunks `[columns, H]` after a burn-in over the `burn_in` chunks before each, or as
    /// many as `D_k` contains.
    fn burned_in_states(
        &self,
        network: &ActorNetwork,
        sequences: &Sequences,
        columns: &[usize],
        burn_in: usize,
    ) -> Result<Vec<f32>, MarlError> {
        let all = self.refreshed.as_ref().unwrap_or(&sequences.hidden);
        let mut states = sequences.states(all, columns);
        let before = |&column: &usize| sequences.layout.before(column);
        let earlier: Vec<usize> = columns.iter().filter_map(before).collect();
        if burn_in == 0 || earlier.is_empty() {
            return Ok(states);
        }
        let start = self.burned_in_states(network, sequences, &earlier, burn_in - 1)?;
        let found = self.states_after(network, sequences, &earlier, start)?;
        let width = network.hidden_size();
        let later = states.chunks_exact_mut(width).zip(columns);
        let later = later.filter(|(_, column)| before(column).is_some());
        for ((state, _), found) in later.zip(found.chunks_exact(width)) {
            state.copy_from_slice(found);
        }
        Ok(states)
    }

    /// States at all chunks' starts `[C, H]`, from the first stored ones through all of `D_k`.
    fn unrolled_states(
        &self,
        network: &ActorNetwork,
        sequences: &Sequences,
    ) -> Result<Vec<f32>, MarlError> {
        let layout = sequences.layout;
        let first: Vec<usize> = (0..layout.environments).collect();
        let mut states = sequences.states(&sequences.hidden, &first);
        let mut all = states.clone();
        for chunk in (layout.environments..layout.chunks).step_by(layout.environments) {
            let before: Vec<usize> = (chunk - layout.environments..chunk).collect();
            states = self.states_after(network, sequences, &before, states)?;
            all.extend(&states);
        }
        Ok(all)
    }

    /// States after some chunks that start in `start`, `[columns, H]`: zeros where an episode ends with the chunk.
    fn states_after(
        &self,
        network: &ActorNetwork,
        sequences: &Sequences,
        columns: &[usize],
        start: Vec<f32>,
    ) -> Result<Vec<f32>, MarlError> {
        let input = sequences.input_from(columns, start)?;
        let last = network.last_state(&network.weights()?, &input)?;
        let mut states = last.flatten_all()?.to_vec1::<f32>()?;
        for (state, &column) in states.chunks_exact_mut(network.hidden_size()).zip(columns) {
            if sequences.ends[column] {
                state.fill(0.0);
            }
        }
        Ok(states)
    }
}
