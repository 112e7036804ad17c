//! Tests of rollouts: slots, episodes of evaluation and films.
#![expect(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

mod film;
mod fixture;
mod left_out;
mod slot;
mod work;

use sim::{ObservationConfig, ObservationNorm, TaskConfig};

/// A game with discrete actions.
fn cue() -> TaskConfig {
    let task = fixture::task();
    let observation = ObservationConfig { norm: ObservationNorm::None, ..task.observation };
    TaskConfig { task: "cue-2x1".to_owned(), observation, ..task }
}
