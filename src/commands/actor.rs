//! `s2mia actor`: rolls out for a learner until its run is done.

use actor::Transport;
use anyhow::Context as _;
use proto::name;
use recording::trajectory_log::LogConfig;
use tokio::sync::watch;

use crate::cli::{ActorArguments, ActorLogArguments, seconds};
use crate::config::run_config::RunConfig;
use crate::config::{ConfigError, Request, layers};
use crate::errors::Usage;
use crate::listening::token;
use crate::process::runtime;
use crate::process::signals;
use crate::run::fingerprints::BUILD;

/// Ends with status 0 when the learner reports that the run is done, or after a stop signal.
pub(super) fn run(arguments: ActorArguments) -> anyhow::Result<()> {
    let with_stdin = arguments.exit_with_stdin;
    let config = configure(arguments)?;
    let (stop_sender, stop) = watch::channel(false);
    if with_stdin {
        signals::stop_with_stdin(stop_sender.clone())?;
    }
    runtime()?.block_on(async {
        signals::stop_on_signal(stop_sender, || tracing::info!("stopping"))?;
        actor::run(config, stop).await.context("the actor failed")
    })
}

/// The actor's settings, checked; the program ends with status 2 if they are wrong.
fn configure(arguments: ActorArguments) -> anyhow::Result<actor::Config> {
    let patience = seconds("--max-outage-secs", arguments.max_outage_secs)?;
    let transport = match (arguments.tls.files(), arguments.insecure_allow_remote) {
        (Some(files), _) => Transport::Tls(files),
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
    let config = actor::Config {
        learner: arguments.learner,
        transport,
        token: token::of_environment()?,
        environment: arguments.environment,
        max_outage_secs: patience.as_secs_f64(),
        name,
        threads: arguments.threads.into(),
        build: BUILD.to_owned(),
        log: log(arguments.log)?,
    };
    config.validate().map_err(|error| {
        use actor::ActorError::{PlainText, Url};
        let of_url = matches!(error, Url { .. } | PlainText { .. });
        Usage::new(if of_url { format!("--learner: {error}") } else { error.to_string() })
    })?;
    Ok(config)
}

/// Trajectory logging, if enabled: the arguments override the defaults of the settings.
fn log(arguments: ActorLogArguments) -> Result<Option<LogConfig>, ConfigError> {
    let (Some(folder), Some(episodes)) = (arguments.log_dir, arguments.log_episodes) else {
        return Ok(None);
    };
    let size = arguments.log_max_file_mib.map(|size| format!("log.max_file_mib={size}"));
    let settings = [format!("log.episodes={episodes}")].into_iter().chain(size).collect();
    let resolved = layers::resolve(&Request { settings, ..Request::default() })?;
    let settings = RunConfig::build(resolved)?.log;
    Ok(Some(LogConfig { folder, settings }))
}

fn default_name() -> String {
    let host = std::fs::read_to_string("/etc/hostname").unwrap_or_default();
    let host = if host.trim().is_empty() { "actor" } else { host.trim() };
    format!("{host}-{}", std::process::id())
}
