//! Rollouts as pure functions: slots of training and episodes of evaluation, stepped with given weights.
//!
//! A lease defines the rollout of a slot, and the policy snapshot defines the actions; both in, chunks of trajectories
//! out ([`roll_out`]). The learning rule is unknown here. Environments are passed in behind [`sim::EnvironmentBatch`].
//! No file here uses sockets, threads, clocks or the disk.

mod acting;
mod chunk;
mod evaluation;
mod film;
mod fingerprint;
mod slot;
mod step_event;

pub use evaluation::{Episode, EvaluationEpisode, play_episode};
pub use film::{FILMED, FilmRecorder};
pub use fingerprint::rollout_fingerprint;
pub use slot::{roll_out, start_episode};
pub use step_event::{PlayedStep, StepEvent};
