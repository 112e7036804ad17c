//! One evaluation episode, step by step, with which another runtime can be compared.

use std::collections::BTreeMap;

use policy::arrays::{Array, ArrayError, NamedArrays, to_safetensors};
use policy::{Key, PolicySnapshot};
use proto::ActionChoice;
use rollout::StepEvent;
use sim::{EnvironmentBatch, SimError};

use crate::progress::WorkProgress;

/// Observations, hidden states and actions of every agent.
pub(super) struct Episode {
    pub(super) steps: usize,
    pub(super) extrinsic_return: f64,
    agents: Vec<Track>,
}

/// One agent's part; row `t` of each is step `t`.
#[derive(Default)]
struct Track {
    observation: Vec<f32>,
    /// Before the step.
    hidden: Vec<f32>,
    action: Vec<f32>,
}

/// Plays an episode with mean actions from the start that the key draws.
pub(super) fn play(
    world: &mut dyn EnvironmentBatch,
    policy: &PolicySnapshot,
    start: Key,
    progress: &mut WorkProgress,
) -> Result<Episode, SimError> {
    let most = u64::from(world.description().episode_steps);
    let mut agents: Vec<Track> = Vec::new();
    for agent in &policy.agents {
        agents.push(Track { hidden: vec![0.0; agent.hidden_size()], ..Track::default() });
    }
    let episode = rollout::play_episode(world, policy, (start, ActionChoice::Mean), |event| {
        let StepEvent::After(step) = event else { return };
        for (index, track) in agents.iter_mut().enumerate() {
            track.observation.extend(&step.observation[index]);
            track.hidden.extend(&step.hidden[index]);
            track.action.extend(&step.actions[index]);
        }
        let place = || format!("episode for comparison, step {}", step.step);
        progress.reach(step.step.into(), most, place);
    })?;
    // No step uses the hidden state after the last one.
    for (track, agent) in agents.iter_mut().zip(&policy.agents) {
        track.hidden.truncate(episode.steps as usize * agent.hidden_size());
    }
    let extrinsic_return = episode.extrinsic_return;
    Ok(Episode { steps: episode.steps as usize, extrinsic_return, agents })
}

impl Episode {
    /// A safetensors file: `agent_I.observation` `[T, obs]`, `agent_I.hidden` `[T, H]`, `agent_I.action` `[T, act]`.
    pub(super) fn to_bytes(&self) -> Result<Vec<u8>, ArrayError> {
        let mut arrays = NamedArrays::new();
        for (index, track) in self.agents.iter().enumerate() {
            let parts = [
                ("observation", &track.observation),
                ("hidden", &track.hidden),
                ("action", &track.action),
            ];
            for (name, data) in parts {
                let shape = vec![self.steps, data.len() / self.steps];
                let array = Array::F32 { shape, data: data.clone() };
                arrays.insert(format!("agent_{index}.{name}"), array);
            }
        }
        to_safetensors(&arrays, &BTreeMap::new())
    }
}
