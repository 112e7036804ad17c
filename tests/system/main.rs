//! The program as its users meet it: commands, runs and their files, with real processes.
#![expect(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

mod certificates;
mod cli;
mod commands;
mod configs;
mod control;
mod cue_service;
mod damage;
mod environment;
mod faults;
mod folders;
mod learners;
mod logs;
mod output;
mod own_task;
mod page;
mod processes;
mod roles;
mod runs;
mod serve;
mod shutdown;
mod train;
mod waiting;
