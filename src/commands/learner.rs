//! `s2mia learner`: the learner of one run, for actors on any machine.

use std::sync::Arc;

use actor::Transport;
use anyhow::Context as _;
use security::ServerTls;
use tokio::sync::watch;

use crate::cli::LearnerArguments;
use crate::listening::{Listening, token};
use crate::page;
use crate::process::{output, runtime, signals};
use crate::progress::Progress;
use crate::run::launch::{self, Prepared};

/// Serves until the run is done or a stop signal; the newest state is then in a checkpoint.
pub(super) fn run(arguments: &LearnerArguments) -> anyhow::Result<()> {
    let listening = Listening::new(arguments.listen, &arguments.tls)?;
    let page_tls = arguments.page_tls.then(|| listening.tls()).flatten();
    page::check(&arguments.page, page_tls.as_ref())?;
    let (runtime, (stop_sender, stop)) = (runtime()?, watch::channel(false));
    // Before the launch, which takes a moment, so that a stop is never lost.
    runtime.block_on(async {
        signals::stop_on_signal(stop_sender, || output::line("stopping after a checkpoint"))
    })?;
    let prepared =
        launch::prepare_or_resume(&arguments.settings, &arguments.resume, &plain_text(arguments))?;
    runtime.block_on(serve(prepared, listening, page_tls, arguments, stop))
}

/// The machines on which an external environment may run.
fn plain_text(arguments: &LearnerArguments) -> Transport {
    match arguments.tls.insecure_allow_remote {
        true => Transport::PlainText,
        false => Transport::PlainTextOnLoopback,
    }
}

async fn serve(
    prepared: Prepared,
    listening: Listening,
    page_tls: Option<Arc<ServerTls>>,
    arguments: &LearnerArguments,
    stop: watch::Receiver<bool>,
) -> anyhow::Result<()> {
    let Prepared { config, folder, launch, new: _new } = prepared;
    let token = token::of_environment()?;
    let (mut listener, url) = listening.open().await?;
    if let Some(token) = token {
        listener = listener.with_token(token, &folder);
    }
    output::line(format!("{} waits for actors on {url}", folder.display()));
    let page = page::open(&arguments.page, page_tls).await?;
    let mut progress = Progress::new(config.env_steps());
    let observer = Box::new(move |event: &learner::Event| progress.observe(event));
    let summary =
        learner::run(launch, listener, page, observer, stop).await.context("the learner failed")?;
    let done = if summary.stopped_early { "stopped" } else { "finished" };
    output::line(format!(
        "{done} after iteration {}: {}",
        summary.iteration,
        summary.checkpoint.display()
    ));
    Ok(())
}
