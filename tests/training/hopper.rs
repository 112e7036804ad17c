//! The rollouts of a hopper whose hip and knee are two agents, with episodes of ten steps.

use std::ops::ControlFlow;

use learner::lease::end_states::StateReader;
use policy::{DrawKey, PolicySnapshot, RunSeed};
use proto::{
    ActionChoice, EnvironmentSpec, EvaluationResult, EvaluationWork, RolloutWork, RunDescription,
    TrajectoryChunk,
};
use rollout::Episode;
use sim::{
    EnvironmentBatch, ObservationConfig, ObservationNorm, State, TaskConfig, TaskDefinition,
};

use crate::fixture;

fn world(environments: usize) -> Box<dyn EnvironmentBatch> {
    let usual = fixture::task();
    let mut definition = TaskDefinition::example();
    definition.file = definition.file.replace("episode_steps = 1000", "episode_steps = 10");
    let task = TaskConfig {
        task: "hopper-2x1".to_owned(),
        definition: Some(definition),
        weights: None,
        observation: ObservationConfig { norm: ObservationNorm::None, ..usual.observation },
    };
    sim::environments(&task, environments).unwrap()
}

pub(crate) fn environment() -> EnvironmentSpec {
    world(1).description().clone()
}

/// Decodes the environment's states.
pub(crate) fn states() -> StateReader {
    let bounds = world(1).state_bounds().unwrap().clone();
    StateReader::new(move |state| match State::from_bytes(state, &bounds) {
        Ok(state) => Ok(state.position),
        Err(error) => Err(error.to_string()),
    })
}

/// All chunks of a slot.
pub(crate) fn roll_out(
    run: &RunDescription,
    policy: &PolicySnapshot,
    work: &RolloutWork,
) -> Vec<TrajectoryChunk> {
    let mut world = world(work.environments.len());
    let mut chunks = Vec::new();
    let keep = |chunk| {
        chunks.push(chunk);
        ControlFlow::Continue(())
    };
    rollout::roll_out(run, work, policy, &mut *world, |_| {}, keep).unwrap();
    chunks
}

/// Plays one evaluation episode with mean actions.
pub(crate) fn evaluate(
    run: &RunDescription,
    policy: &PolicySnapshot,
    work: &EvaluationWork,
) -> EvaluationResult {
    let key = DrawKey::of_evaluation(RunSeed(run.seed), work.iteration, work.episode);
    let start = (key, ActionChoice::Mean);
    let played = rollout::play_episode(&mut *world(1), policy, start, |_| {}).unwrap();
    let Episode { extrinsic_return, steps, reward_terms } = played;
    EvaluationResult { episode: work.episode, extrinsic_return, steps, reward_terms }
}
