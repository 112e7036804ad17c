//! `s2mia actor`: rolls out for a learner until its run is done.

use std::path::PathBuf;
use std::time::Duration;

use actor::Transport;
use anyhow::Context as _;
use clap::Args;
use proto::name;
use recording::trajectory_log::{FILE_BYTES, LogConfig};
use tokio::sync::watch;

use crate::commands::control::seconds;
use crate::config::ConfigError;
use crate::config::run_config::RunConfig;
use crate::endpoints::{self, ClientTlsArguments};
use crate::errors::Usage;
use crate::process::{self, runtime};
use crate::run::BUILD;

/// `s2mia actor`
#[derive(Args, Debug)]
pub(crate) struct ActorArguments {
    /// URL of the learner.
    #[arg(long, value_name = "URL", default_value = "http://127.0.0.1:50051")]
    pub(crate) learner: String,
    /// Use the environment that an external program offers at this URL, instead of the run's own.
    #[arg(long, value_name = "URL", conflicts_with = "log_dir")]
    pub(crate) environment: Option<String>,
    /// Name in the learner's log [default: host name and process id].
    #[arg(long)]
    pub(crate) name: Option<String>,
    /// Number of threads; each steps its own slots, as a separate actor would, but they share connections and weights.
    #[arg(
        long,
        value_name = "N",
        default_value_t = 1,
        value_parser = clap::value_parser!(u16).range(1..=1024)
    )]
    pub(crate) threads: u16,
    /// Exit when the learner cannot be reached for this long.
    #[arg(long, value_name = "SECONDS", default_value = "300", value_parser = seconds)]
    pub(crate) max_outage_secs: Duration,
    /// Exit when standard input closes, so that the actor does not outlive its parent process.
    #[arg(long)]
    pub(crate) exit_with_stdin: bool,
    /// Allow a learner on another machine without encryption and authentication.
    #[arg(long, conflicts_with = "tls_ca")]
    pub(crate) insecure_allow_remote: bool,
    /// Log.
    #[command(flatten)]
    pub(crate) log: ActorLogArguments,
    /// TLS.
    #[command(flatten)]
    pub(crate) tls: ClientTlsArguments,
}

/// Trajectory logging of an actor.
#[derive(Args, Clone, Debug, Default)]
pub(crate) struct ActorLogArguments {
    /// Folder for trajectory logs (MCAP).
    #[arg(long, value_name = "DIR", requires = "log_episodes")]
    pub(crate) log_dir: Option<PathBuf>,
    /// Episodes to log, as in log.episodes: evaluation, all, or a number N for one episode in N.
    #[arg(long, value_name = "WHICH", requires = "log_dir")]
    pub(crate) log_episodes: Option<String>,
}

/// Ends with status 0 when the learner reports that the run is done, or after a stop signal.
pub(super) fn run(arguments: ActorArguments) -> anyhow::Result<()> {
    let with_stdin = arguments.exit_with_stdin;
    let config = configure(arguments)?;
    let (stop_sender, stop) = watch::channel(false);
    if with_stdin {
        process::stop_with_stdin(stop_sender.clone())?;
    }
    runtime()?.block_on(async {
        process::stop_on_signal(stop_sender, || tracing::info!("stopping"))?;
        actor::run(config, stop).await.context("the actor failed")
    })
}

/// The actor's settings, checked; the program ends with status 2 if they are wrong.
fn configure(arguments: ActorArguments) -> anyhow::Result<actor::ActorConfig> {
    let transport = match (arguments.tls.read()?, arguments.insecure_allow_remote) {
        (Some(tls), _) => Transport::Tls(tls),
        (None, true) => Transport::PlainText,
        (None, false) => Transport::PlainTextOnLoopback,
    };
    if let Some(url) = &arguments.environment {
        let allowed = actor::config::check_environment(url, &transport);
        allowed.map_err(|error| Usage::new(format!("--environment: {error}")))?;
    }
    let name = arguments.name.unwrap_or_else(default_name);
    name::check(&name, name::LONGEST)
        .map_err(|error| Usage::new(format!("--name: {name:?} {error}")))?;
    let config = actor::ActorConfig {
        learner: arguments.learner,
        transport,
        token: endpoints::token_of_environment()?,
        environment: arguments.environment,
        max_outage_secs: arguments.max_outage_secs.as_secs_f64(),
        name,
        threads: arguments.threads.into(),
        build: BUILD.to_owned(),
        log: log(arguments.log)?,
    };
    config.validate().map_err(|error| Usage::new(format!("--learner: {error}")))?;
    Ok(config)
}

/// Trajectory logging, if enabled.
fn log(arguments: ActorLogArguments) -> Result<Option<LogConfig>, ConfigError> {
    let (Some(folder), Some(episodes)) = (arguments.log_dir, arguments.log_episodes) else {
        return Ok(None);
    };
    let episodes = RunConfig::with(&[&format!("log.episodes={episodes}")])?.log.episodes;
    Ok(Some(LogConfig { folder, episodes, file_bytes: FILE_BYTES }))
}

fn default_name() -> String {
    let host = std::fs::read_to_string("/etc/hostname").unwrap_or_default();
    let host = if host.trim().is_empty() { "actor" } else { host.trim() };
    format!("{host}-{}", std::process::id())
}
