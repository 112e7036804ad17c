//! `s2mia learner`: one run, served to actors that come from anywhere.

use anyhow::Context as _;
use tokio::sync::watch;

use crate::cli::LearnerArguments;
use crate::commands::entrance::{Entrance, demand_loopback};
use crate::commands::runtime;
use crate::launch::{self, Prepared};
use crate::progress::Progress;
use crate::{output, signals};

/// Serves until the run is done, or it is told to stop; then the newest state is in a checkpoint.
pub(super) fn run(arguments: &LearnerArguments) -> anyhow::Result<()> {
    if !arguments.insecure_allow_remote {
        demand_loopback(arguments.listen, &arguments.tls)?;
    }
    let entrance = Entrance::new(arguments.listen, &arguments.tls)?;
    let prepared = launch::prepare_or_resume(&arguments.settings, &arguments.resume)?;
    runtime()?.block_on(serve(prepared, entrance))
}

async fn serve(prepared: Prepared, entrance: Entrance) -> anyhow::Result<()> {
    let Prepared { config, folder, launch } = prepared;
    let (door, url) = entrance.open().await?;
    output::line(format!("{} waits for actors on {url}", folder.display()));
    let (stop_sender, stop) = watch::channel(false);
    signals::stop_on_signal(stop_sender, || output::line("stopping after a checkpoint"))?;
    let mut progress = Progress::new(config.env_steps());
    let observer = Box::new(move |event: &learner::Event| progress.observe(event));
    let summary = learner::run(launch, door, observer, stop).await.context("the learner failed")?;
    let done = if summary.stopped_early { "stopped" } else { "finished" };
    output::line(format!(
        "{done} after iteration {}: {}",
        summary.iteration,
        summary.checkpoint.display()
    ));
    Ok(())
}
