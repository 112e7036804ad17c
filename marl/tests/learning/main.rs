//! Every algorithm, from its first draw to the solution: a game of choices with one best agreement, and
//! a point that two agents bring to its mark. Each takes about a second.
#![expect(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

#[path = "../fixture/settings.rs"]
mod fixture;
mod games;
mod harness;
mod reaching;
mod settings;
