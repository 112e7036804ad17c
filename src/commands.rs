//! Selects and runs a command; each has its own file.

mod actor;
mod certs;
mod config;
mod control;
mod eval;
mod experiment;
mod export;
mod film;
mod health;
mod inspect;
mod learner;
mod log;
mod page;
mod plot;
mod record;
mod serve;
mod status;
mod task;
mod tasks;
mod train;
mod watch;

use crate::cli::Command;

/// Runs one command to its end.
pub(crate) fn run(command: Command) -> anyhow::Result<()> {
    match command {
        Command::Train(arguments) => train::run(&arguments),
        Command::Learner(arguments) => learner::run(&arguments),
        Command::Actor(arguments) => actor::run(arguments),
        Command::Serve(arguments) => serve::run(&arguments),
        Command::Eval(arguments) => eval::run(&arguments),
        Command::Record(arguments) => record::run(&arguments),
        Command::Log(command) => log::run(&command),
        Command::Film(arguments) => film::run(&arguments),
        Command::Plot(arguments) => plot::run(&arguments),
        Command::Page(arguments) => page::run(arguments),
        Command::Experiment(arguments) => experiment::run(&arguments),
        Command::Export(arguments) => export::run(&arguments),
        Command::Health(arguments) => health::run(&arguments),
        Command::Status(arguments) => status::run(&arguments),
        Command::Watch(arguments) => watch::run(&arguments),
        Command::Stop(arguments) => control::stop(&arguments),
        Command::Inspect(arguments) => inspect::run(&arguments),
        Command::Tasks(arguments) => tasks::run(&arguments),
        Command::Task(command) => task::run(&command),
        Command::Config(arguments) => config::run(&arguments),
        Command::Certs(arguments) => certs::run(&arguments),
    }
}
