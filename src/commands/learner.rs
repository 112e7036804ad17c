//! `s2mia learner`: the learner of one run, for actors on any machine.

use std::net::SocketAddr;

use actor::Transport;
use anyhow::Context as _;
use clap::Args;
use security::{ServerTls, Token};
use tokio::sync::watch;

use crate::config::run_config::RunConfig;
use crate::endpoints::{self, Listening, PageArguments, ServerTlsArguments};
use crate::process::{self, output, runtime};
use crate::progress::Progress;
use crate::run::{self, PreparedRun, ResumeArguments, SettingsArguments, warm_up};

/// Settings of `s2mia train` alone, and what actors take in their place.
const FOR_TRAIN: [(&str, &str); 2] = [
    ("run.actors", "start as many `s2mia actor` processes"),
    ("log.episodes", "give each `s2mia actor` --log-dir and --log-episodes"),
];

/// `s2mia learner`
#[derive(Args, Debug)]
pub(crate) struct LearnerArguments {
    /// Settings.
    #[command(flatten)]
    pub(crate) settings: SettingsArguments,
    /// Resume.
    #[command(flatten)]
    pub(crate) resume: ResumeArguments,
    /// Address on which the learner listens for actors.
    #[arg(
        long,
        value_name = "ADDRESS",
        default_value = "127.0.0.1:50051",
        value_parser = crate::endpoints::address
    )]
    pub(crate) listen: SocketAddr,
    /// TLS.
    #[command(flatten)]
    pub(crate) tls: ServerTlsArguments,
    /// Web page.
    #[command(flatten)]
    pub(crate) page: PageArguments,
    /// Serve the page and /metrics over TLS with the files of --tls-certificate, to certificates with the role
    /// operator.
    #[arg(long, requires = "tls_certificate", conflicts_with = "insecure_allow_remote_page")]
    pub(crate) page_tls: bool,
}

/// Serves until the run is done or a stop signal; the newest state is then in a checkpoint.
pub(super) fn run(arguments: &LearnerArguments) -> anyhow::Result<()> {
    let listening = Listening::new(arguments.listen, &arguments.tls)?;
    let page_tls = listening.tls.as_ref().filter(|_| arguments.page_tls).map(ServerTls::for_page);
    arguments.page.check(page_tls.as_ref())?;
    let token = endpoints::token_of_environment()?;
    let (runtime, (stop_sender, stop)) = (runtime()?, watch::channel(false));
    // Before the launch, which takes a moment, so that a stop is never lost.
    runtime.block_on(async {
        process::stop_on_signal(stop_sender, || output::line("stopping after a checkpoint"))
    })?;
    let prepared =
        run::prepare_or_resume(&arguments.settings, &arguments.resume, &plain_text(arguments))?;
    runtime.block_on(serve(prepared, (listening, token), page_tls, arguments, stop))
}

/// Lines for given settings that only `s2mia train` follows, which starts actors.
fn ignored(config: &RunConfig) -> impl Iterator<Item = String> {
    let given = FOR_TRAIN.iter().filter(|(key, _)| config.resolved.is_given(key));
    given.map(|(key, instead)| {
        let origin = config.resolved.origin(key);
        format!("note: `{key}` ({origin}) has no effect here; {instead}")
    })
}

/// The machines on which an external environment may run.
fn plain_text(arguments: &LearnerArguments) -> Transport {
    if arguments.tls.insecure_allow_remote {
        Transport::PlainText
    } else {
        Transport::PlainTextOnLoopback
    }
}

async fn serve(
    prepared: PreparedRun,
    (listening, token): (Listening, Option<Token>),
    page_tls: Option<ServerTls>,
    arguments: &LearnerArguments,
    stop: watch::Receiver<bool>,
) -> anyhow::Result<()> {
    let PreparedRun { config, folder, launch, new: _new } = prepared;
    let (mut listener, url) = listening.open().await?;
    if let Some(token) = token {
        listener = listener.with_token(token, &folder);
    }
    output::line(format!("{} waits for actors on {url}", folder.display()));
    warm_up::remark(&config).iter().for_each(output::line);
    ignored(&config).for_each(output::line);
    let page = arguments.page.open(page_tls).await?;
    let mut progress = Progress::new(config.env_steps());
    let observer = Box::new(move |event: &learner::observe::event::Event| progress.observe(event));
    let summary = learner::run::run(launch, listener, page, observer, stop)
        .await
        .context("the learner failed")?;
    let done = if summary.stopped_early { "stopped" } else { "finished" };
    output::line(format!(
        "{done} after iteration {}: {}",
        summary.iteration,
        summary.checkpoint.display()
    ));
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn given_settings_of_actors_are_named_with_what_actors_take_instead() {
        let of = |settings: &[&str]| {
            let own = [&["cue-2x1"], settings].concat();
            ignored(&RunConfig::with(&own).unwrap()).collect::<Vec<_>>()
        };
        let lines = of(&["log.episodes=all", "run.actors=7"]);
        let [actors, logs] = lines.as_slice() else { panic!("{lines:?}") };
        assert!(actors.contains("`run.actors` (command line) has no effect here"), "{actors}");
        assert!(logs.ends_with("give each `s2mia actor` --log-dir and --log-episodes"), "{logs}");
        assert!(of(&["run.seed=3"]).is_empty());
    }
}
