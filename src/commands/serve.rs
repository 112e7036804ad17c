//! `s2mia serve`: the policies of a run's newest checkpoint, for robots, evaluators and programs in any language.

use std::path::Path;

use anyhow::Context as _;
use learner::service::{ServedPolicies, serve_policies};
use tokio::sync::watch;

use crate::cli::ServeArguments;
use crate::listening::Listening;
use crate::process::{output, runtime, signals};
use crate::run::served_run::ServedRun;

/// Serves until a signal stops it.
pub(super) fn run(arguments: &ServeArguments) -> anyhow::Result<()> {
    let listening = Listening::new(arguments.listen, &arguments.tls)?;
    let run = ServedRun::open(&arguments.run)?;
    let served = run.policies();
    if arguments.follow {
        run.follow()?;
    }
    runtime()?.block_on(serve(&arguments.run, served, listening))
}

async fn serve(run: &Path, served: ServedPolicies, listening: Listening) -> anyhow::Result<()> {
    let (listener, url) = listening.open().await?;
    let version = served.newest.borrow().name.version;
    output::line(format!("{} serves its policies of iteration {version} on {url}", run.display()));
    let (stop_sender, stop) = watch::channel(false);
    signals::stop_on_signal(stop_sender, || output::line("stopping"))?;
    serve_policies(served, listener, stop).await.context("the service ended")
}
