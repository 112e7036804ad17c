//! Tests of rollouts: slots, episodes of evaluation and films.
#![expect(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

mod choices;
mod film;
mod fixture;
mod left_out;
mod slot;
mod work;
