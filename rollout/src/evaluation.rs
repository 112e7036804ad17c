//! Plays whole episodes with mean actions, most likely choices or sampled actions, for evaluation, `eval` and
//! recordings.

use std::fmt;

use policy::{DrawKey, PolicySnapshot, RunSeed};
use proto::ActionChoice;
use sim::{EnvironmentBatch, Outcome, SimError};

use crate::acting::Agents;
use crate::chunk;
use crate::step_event::StepEvent;

/// One episode of the evaluation of a run's weights. Training, `eval`, `record`, `film`, `export` and the page start
/// an episode of the same index in the same state.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EvaluationEpisode {
    /// Seed of the run.
    pub seed: RunSeed,
    /// Iteration of the weights.
    pub iteration: u64,
    /// Index of the episode in the evaluation.
    pub index: u32,
}

impl EvaluationEpisode {
    /// The key that draws the start state.
    #[must_use]
    pub fn key(self) -> DrawKey {
        DrawKey::of_evaluation(self.seed, self.iteration, self.index)
    }

    /// The id in logs: `evaluation-ITERATION-INDEX`.
    #[must_use]
    pub fn id(self) -> String {
        format!("evaluation-{}-{}", self.iteration, self.index)
    }
}

/// `episode 0 (evaluation-4-0, seed 7)`
impl fmt::Display for EvaluationEpisode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "episode {} ({}, seed {})", self.index, self.id(), self.seed.0)
    }
}

/// Result of an episode.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Episode {
    /// Sum of extrinsic rewards.
    pub extrinsic_return: f64,
    /// Number of steps.
    pub steps: u32,
    /// Sum of each term of the reward, `[K]` in the order of [`proto::EnvironmentSpec::reward_terms`].
    pub reward_terms: Vec<f64>,
}

/// Plays an episode in environment 0 from a start drawn with `key`, with actions selected by `choice`, and calls
/// `on_event` before and after each step. `world` must have one environment.
///
/// # Errors
/// If an action is not finite, or an external environment fails.
pub fn play_episode(
    world: &mut dyn EnvironmentBatch,
    policy: &PolicySnapshot,
    (key, choice): (DrawKey, ActionChoice),
    mut on_event: impl FnMut(StepEvent<'_>),
) -> Result<Episode, SimError> {
    world.reset(0, 0, world.description().episode_steps, key.0)?;
    let mut agents = Agents::new(world, policy);
    let mut outcomes = vec![Outcome::default(); world.count()];
    let reward_terms = vec![0.0; world.description().reward_terms.len()];
    let mut episode = Episode { reward_terms, ..Episode::default() };
    loop {
        on_event(StepEvent::Before(episode.steps, world));
        agents.observe(world);
        agents.forward(policy);
        agents.choose(policy, choice, episode.steps);
        world.step(agents.join(), &mut outcomes)?;
        episode.extrinsic_return += f64::from(outcomes[0].reward);
        chunk::add(&mut episode.reward_terms, world.reward_terms(0));
        episode.steps += 1;
        on_event(StepEvent::After(agents.played(world, &outcomes, episode.steps)));
        if outcomes[0].is_end() {
            return Ok(episode);
        }
    }
}
