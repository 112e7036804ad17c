//! The rows on which a density is fitted and which it scores.

use std::borrow::Cow;

use crate::config::{Scored, Space};
use crate::data::batch::{AgentShape, Batch, Final};

/// Indices of the scored features in the rows of [`rows`].
pub(super) fn features(shape: &AgentShape, space: Space) -> &[usize] {
    match space {
        Space::PolicyObs => &shape.surprise_features,
        Space::Raw => &shape.seen,
        Space::Local => &shape.near,
    }
}

/// The rows that contain agent `agent`'s scored features, `[T, B, width]`: its observation or the global state.
pub(super) fn rows(batch: &Batch, agent: usize, space: Space, obs: Scored) -> Cow<'_, [f32]> {
    let now = match space {
        Space::PolicyObs => &batch.agents[agent].observation,
        Space::Raw | Space::Local => &batch.state,
    };
    let after = |last: &Final| match space {
        Space::PolicyObs => last.observation[agent].clone(),
        Space::Raw | Space::Local => last.state.clone(),
    };
    match obs {
        Scored::Current => Cow::Borrowed(now),
        Scored::Next => Cow::Owned(next(batch, now, after)),
    }
}

/// `o_(t+1)` for every `o_t` in `now` `[T, B, width]`; where an episode or the batch ends, the true final one.
fn next(batch: &Batch, now: &[f32], after: impl Fn(&Final) -> Vec<f32>) -> Vec<f32> {
    let shift = now.len() / batch.steps;
    let mut next = [&now[shift..], &now[..shift]].concat();
    let width = shift / batch.environments;
    for last in &batch.finals {
        let row = last.step * batch.environments + last.environment;
        next[row * width..(row + 1) * width].copy_from_slice(&after(last));
    }
    next
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::batch::AgentBatch;

    /// Two environments, two steps. The episode of environment 0 ends with step 0.
    fn batch() -> Batch {
        let last = |step, environment, x: f32| Final {
            step,
            environment,
            state: vec![x, -x],
            observation: vec![vec![10.0 * x]],
        };
        Batch {
            steps: 2,
            environments: 2,
            agents: vec![AgentBatch {
                observation: vec![1.0, 2.0, 3.0, 4.0],
                ..AgentBatch::default()
            }],
            state: vec![1.0, -1.0, 2.0, -2.0, 3.0, -3.0, 4.0, -4.0],
            finals: vec![last(0, 0, 7.0), last(1, 0, 8.0), last(1, 1, 9.0)],
            ..Batch::default()
        }
    }

    #[test]
    fn the_next_row_is_the_following_one_or_at_an_end_the_final_one() {
        let seen = rows(&batch(), 0, Space::PolicyObs, Scored::Next).into_owned();
        assert_eq!(seen, [70.0, 4.0, 80.0, 90.0]);
        let state = rows(&batch(), 0, Space::Raw, Scored::Next).into_owned();
        assert_eq!(state, [7.0, -7.0, 4.0, -4.0, 8.0, -8.0, 9.0, -9.0]);
    }

    #[test]
    fn the_current_row_is_the_row_itself() {
        let batch = batch();
        assert_eq!(
            *rows(&batch, 0, Space::PolicyObs, Scored::Current),
            batch.agents[0].observation
        );
        assert_eq!(*rows(&batch, 0, Space::Local, Scored::Current), batch.state);
    }
}
