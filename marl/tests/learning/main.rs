//! Every algorithm from initial weights to the solution of a matrix game and of a reaching task with two agents. Each
//! takes about a second.
#![expect(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

#[path = "../fixture/settings.rs"]
mod fixture;
mod games;
mod harness;
mod reaching;
mod settings;
