//! One file per command; here only the choice between them.

mod actor;
mod certs;
mod checkpointed;
mod config;
mod control;
mod entrance;
mod eval;
mod experiment;
mod export;
mod film;
mod health;
mod inspect;
mod learner;
mod live;
mod log;
mod plot;
mod record;
mod serve;
mod status;
mod tasks;
mod train;
mod watch;

use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::Context as _;
use tokio::runtime::Runtime;

use security::ClientFiles;

use crate::cli::{ClientTlsArguments, Command};
pub(crate) use crate::commands::log::Incomplete;
use crate::run_path;

/// Arguments that cannot be followed; the program ends with status 2.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub(crate) struct Usage(String);

impl Usage {
    /// One line that says what is wrong and what to do.
    pub(crate) fn new(message: impl Into<String>) -> Self {
        Self(message.into())
    }
}

/// The settings of the run in `folder`; refuses a folder that holds none.
pub(crate) fn config_file_of_run(folder: &Path) -> Result<PathBuf, Usage> {
    let file = run_path::config_file(folder);
    let lacking = || format!("{} is no run folder: it has no config.toml", folder.display());
    if file.is_file() { Ok(file) } else { Err(Usage::new(lacking())) }
}

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
        Command::Experiment(arguments) => experiment::run(&arguments),
        Command::Export(arguments) => export::run(&arguments),
        Command::Health(arguments) => health::run(&arguments),
        Command::Status(arguments) => status::run(&arguments),
        Command::Watch(arguments) => watch::run(&arguments),
        Command::Pause(arguments) => control::pause(&arguments),
        Command::Resume(arguments) => control::resume(&arguments),
        Command::Checkpoint(arguments) => control::checkpoint(&arguments),
        Command::Stop(arguments) => control::stop(&arguments),
        Command::Inspect(arguments) => inspect::run(&arguments),
        Command::Tasks(arguments) => tasks::run(&arguments),
        Command::Config(arguments) => config::run(&arguments),
        Command::Certs(arguments) => certs::run(&arguments),
    }
}

/// How long an argument says to wait.
fn patience(timeout_secs: f64) -> Result<Duration, Usage> {
    Duration::try_from_secs_f64(timeout_secs)
        .map_err(|_| Usage::new(format!("--timeout-secs must be at least 0, is {timeout_secs}")))
}

/// The files for a question to the learner at `url`, which is asked in plain text without any.
fn credentials(url: &str, tls: &ClientTlsArguments) -> Result<Option<ClientFiles>, Usage> {
    let files = tls.files();
    match (&files, url.starts_with("https://")) {
        (None, true) => Err(Usage::new(format!(
            "{url}: https:// needs --tls-ca, --tls-certificate and --tls-key"
        ))),
        (Some(_), false) => {
            Err(Usage::new(format!("{url}: with --tls-ca it begins with https://")))
        }
        (Some(own), true) => match own.read() {
            Ok(_) => Ok(files),
            Err(why) => Err(Usage::new(why.to_string())),
        },
        (None, false) => Ok(None),
    }
}

/// Threads for sockets, signals and child processes; stepping and training have their own.
pub(crate) fn runtime() -> anyhow::Result<Runtime> {
    tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .thread_name("network")
        .enable_all()
        .build()
        .context("cannot start the network threads")
}
