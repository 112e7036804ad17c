//! Splits the chunks of a finished slot into the shares of its episodes.

use proto::trajectory_log::{AgentStep, FinalObservation, ShareEnd, Step};
use proto::{FinalStep, TrajectoryChunk};

use super::collector::{PartialShare, Rollout};
use crate::share::{LoggedShare, LoggedStep};

/// All shares of a slot, in the order of their starts.
pub(super) fn shares(rollout: Rollout) -> Vec<LoggedShare> {
    let Rollout { begun, chunks } = rollout;
    begun.into_iter().map(|begun| share(begun, &chunks)).collect()
}

fn share(begun: PartialShare, chunks: &[TrajectoryChunk]) -> LoggedShare {
    let PartialShare { head, position, slot_step, poses } = begun;
    let first = head.first_step;
    let steps: Vec<LoggedStep> = poses
        .into_iter()
        .enumerate()
        .map(|(index, pose)| {
            let index = index as u32;
            let (chunk, row) = place(chunks, slot_step + index, position);
            let step = step(chunk, row, first + index);
            LoggedStep { pose, agents: agents(chunk, row), step }
        })
        .collect();
    let last = slot_step + steps.len() as u32 - 1;
    LoggedShare { end: end(chunks, position, last, steps.len()), steps, head }
}

/// Chunk with step `step` of the slot, and the row of `position` in it.
fn place(chunks: &[TrajectoryChunk], step: u32, position: usize) -> (&TrajectoryChunk, usize) {
    let holds = |chunk: &&TrajectoryChunk| {
        (chunk.first_step..chunk.first_step + chunk.steps).contains(&step)
    };
    let chunk = chunks.iter().find(holds).expect("a finished slot has all its steps");
    let environments = chunk.reward.len() / chunk.steps as usize;
    (chunk, (step - chunk.first_step) as usize * environments + position)
}

fn agents(chunk: &TrajectoryChunk, row: usize) -> Vec<AgentStep> {
    let rows = chunk.reward.len();
    let of_row = |values: &[f32]| {
        let width = values.len() / rows;
        values[row * width..(row + 1) * width].to_vec()
    };
    let agent = |agent: &proto::AgentChunk| AgentStep {
        observation: of_row(&agent.observation),
        action: of_row(&agent.action),
        log_prob: Some(agent.log_prob[row]),
    };
    chunk.agents.iter().map(agent).collect()
}

fn step(chunk: &TrajectoryChunk, row: usize, step: u32) -> Step {
    let width = chunk.state.len() / chunk.reward.len();
    Step {
        step,
        reward: chunk.reward[row],
        terminated: chunk.terminated[row],
        truncated: chunk.truncated[row],
        state: chunk.state[row * width..(row + 1) * width].to_vec(),
    }
}

/// End of a share whose last step is step `last` of the slot.
fn end(chunks: &[TrajectoryChunk], position: usize, last: u32, steps: usize) -> ShareEnd {
    let (chunk, row) = place(chunks, last, position);
    let is_last = |end: &&FinalStep| end.step == last && end.environment as usize == position;
    let FinalStep { state, observation: rows, .. } =
        chunk.finals.iter().find(is_last).expect("chunks contain the final state of each share");
    let over = chunk.terminated[row] || chunk.truncated[row];
    let environment_state = match &chunk.end {
        Some(end) if !over => end.environments[position].clone(),
        _ => Vec::new(),
    };
    let observation = |row: &Vec<f32>| FinalObservation { observation: row.clone() };
    let observations = rows.iter().map(observation).collect();
    ShareEnd { steps: steps as u32, environment_state, state: state.clone(), observations }
}
