//! `s2mia serve`: the policies of a run's newest checkpoint, for robots, evaluators and programs in any language.

use std::net::SocketAddr;
use std::path::Path;
use std::sync::Arc;

use anyhow::{Context as _, anyhow};
use clap::Args;
use learner::lease::published::Published;
use learner::serve::service::{ServedPolicies, serve_policies};
use learner::store::run_folder::RunFolder;
use policy::RunSeed;
use tokio::sync::watch;

use crate::endpoints::{Listening, ServerTlsArguments};
use crate::process::{self, output, runtime};
use crate::run::chosen::ChosenArguments;
use crate::run::{run_path, stored};

/// `s2mia serve`
#[derive(Args, Debug)]
pub(crate) struct ServeArguments {
    /// Policies.
    #[command(flatten)]
    pub(crate) of: ChosenArguments,
    /// Address on which the server listens for clients of the policies.
    #[arg(
        long,
        value_name = "ADDRESS",
        default_value = "127.0.0.1:50052",
        value_parser = crate::endpoints::address
    )]
    pub(crate) listen: SocketAddr,
    /// TLS.
    #[command(flatten)]
    pub(crate) tls: ServerTlsArguments,
}

/// Serves until a signal stops it.
pub(super) fn run(arguments: &ServeArguments) -> anyhow::Result<()> {
    let listening = Listening::new(arguments.listen, &arguments.tls)?;
    let of = arguments.of.path()?;
    let served = served(&of)?;
    runtime()?.block_on(serve(&of, served, listening))
}

async fn serve(run: &Path, served: ServedPolicies, listening: Listening) -> anyhow::Result<()> {
    let (listener, url) = listening.open().await?;
    let (stop_sender, stop) = watch::channel(false);
    process::stop_on_signal(stop_sender, || output::line("stopping"))?;
    let version = served.published.name.version;
    output::line(format!("{} serves its policies of iteration {version} on {url}", run.display()));
    serve_policies(served, listener, stop).await.context("the service ended")
}

/// The policies of the newest checkpoint of `run`, or of the checkpoint or team that it names.
///
/// # Errors
/// The run has no valid checkpoint, or its environment cannot be reached.
fn served(run: &Path) -> anyhow::Result<ServedPolicies> {
    let trained = stored::trained(run)?;
    let hosted = trained.environment()?;
    let world = &hosted.environment;
    let environment = world.description().clone();
    let (version, bytes) = (trained.weights.version, trained.policy.to_bytes()?);
    let hidden_sizes = trained.hidden_sizes(&environment.agents);
    let published = Published::parse(version, bytes.into(), &environment.agents, &hidden_sizes);
    let published = published
        .map_err(|why| anyhow!("cannot serve the policies of {}: {why}", run.display()))?;
    let agents = 0..environment.agents.len();
    Ok(ServedPolicies {
        run_id: run_path::name(&RunFolder::of(run)),
        algorithm: trained.config.resolved.text("algorithm").to_owned(),
        seed: RunSeed(trained.config.run.seed),
        control_ranges: agents.clone().map(|agent| world.control_ranges(agent)).collect(),
        actuators: agents.map(|agent| world.actuators(agent)).collect(),
        environment,
        published: Arc::new(published),
    })
}
