//! The program as its users meet it: commands, runs and their files, with real processes.
#![expect(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

mod certificates;
mod cli;
mod control;
mod cue_service;
mod damage;
mod environment;
mod exactness;
mod experiment;
mod faults;
mod film;
mod folders;
mod hostile_peers;
mod logs;
mod output;
mod own_task;
mod pack;
mod page;
#[path = "../../proto/tests/wire/peer.rs"]
mod peer;
mod processes;
mod roles;
mod runs;
mod serve;
mod shutdown;
mod start;
mod teams;
mod train;
mod verify;
