//! Integration tests of the actor: rollouts, recordings, sessions with a learner.
#![expect(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

mod choices;
mod fixture;
mod left_out;
mod overlap;
mod recording;
mod rollout;
