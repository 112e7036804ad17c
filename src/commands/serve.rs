//! `s2mia serve`: the policies of a run's newest checkpoint, for robots, evaluators and programs in any language.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use anyhow::Context as _;
use clap::Args;
use learner::lease::published::Published;
use learner::serve::service::{ServedPolicies, serve_policies};
use learner::store::run_folder::RunFolder;
use policy::RunSeed;
use proto::{ActuatorSpec, EnvironmentSpec};
use tokio::sync::watch;

use crate::endpoints::{Listening, ServerTlsArguments};
use crate::errors::Usage;
use crate::process::{self, output, runtime};
use crate::run::chosen::ChosenArguments;
use crate::run::stored::Trained;
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
    /// Load newer checkpoints of the run as they are written. An episode keeps the checkpoint that it started with.
    #[arg(long, conflicts_with = "checkpoint")]
    pub(crate) follow: bool,
    /// TLS.
    #[command(flatten)]
    pub(crate) tls: ServerTlsArguments,
}

/// Serves until a signal stops it.
pub(super) fn run(arguments: &ServeArguments) -> anyhow::Result<()> {
    let listening = Listening::new(arguments.listen, &arguments.tls)?;
    let of = arguments.of.path()?;
    let run = ServedRun::open(&of)?;
    let served = run.policies();
    if arguments.follow {
        run.follow()?;
    }
    runtime()?.block_on(serve(&of, served, listening))
}

async fn serve(run: &Path, served: ServedPolicies, listening: Listening) -> anyhow::Result<()> {
    let (listener, url) = listening.open().await?;
    let (stop_sender, stop) = watch::channel(false);
    process::stop_on_signal(stop_sender, || output::line("stopping"))?;
    let version = served.newest.borrow().name.version;
    output::line(format!("{} serves its policies of iteration {version} on {url}", run.display()));
    serve_policies(served, listener, stop).await.context("the service ended")
}

/// Interval between checks for a new checkpoint.
const POLL_INTERVAL: Duration = Duration::from_secs(1);

/// A run whose policies are served.
struct ServedRun {
    path: PathBuf,
    algorithm: String,
    seed: RunSeed,
    environment: EnvironmentSpec,
    /// Of each agent.
    control_ranges: Vec<Vec<[f32; 2]>>,
    /// Of each agent.
    actuators: Vec<Vec<ActuatorSpec>>,
    /// Of each agent.
    hidden_sizes: Vec<u32>,
    newest: watch::Sender<Arc<Published>>,
}

impl ServedRun {
    /// Loads the newest checkpoint of the run in `folder`.
    ///
    /// # Errors
    /// The run has no valid checkpoint, or its environment cannot be reached.
    fn open(folder: &Path) -> anyhow::Result<Self> {
        let trained = stored::trained(folder)?;
        let hosted = trained.environment()?;
        let environment = hosted.environment.description().clone();
        let hidden_sizes = trained.hidden_sizes(&environment.agents);
        let newest = Arc::new(policies(folder, &trained, &environment, &hidden_sizes)?);
        let newest = watch::Sender::new(newest);
        let (agents, world) = (0..environment.agents.len(), &hosted.environment);
        let control_ranges = agents.clone().map(|agent| world.control_ranges(agent)).collect();
        let actuators = agents.map(|agent| world.actuators(agent)).collect();
        let algorithm = trained.config.resolved.text("algorithm").to_owned();
        let (path, seed) = (folder.to_path_buf(), RunSeed(trained.config.run.seed));
        Ok(Self {
            path,
            algorithm,
            seed,
            environment,
            control_ranges,
            actuators,
            hidden_sizes,
            newest,
        })
    }

    /// The policies that the service hands out, always the newest loaded ones.
    fn policies(&self) -> ServedPolicies {
        ServedPolicies {
            run_id: run_path::name(&RunFolder::of(&self.path)),
            algorithm: self.algorithm.clone(),
            seed: self.seed,
            environment: self.environment.clone(),
            control_ranges: self.control_ranges.clone(),
            actuators: self.actuators.clone(),
            newest: self.newest.subscribe(),
        }
    }

    /// Loads each new checkpoint on a separate thread until the process ends.
    fn follow(self) -> anyhow::Result<()> {
        if learner::store::checkpoint::is_checkpoint(&self.path) || !self.path.exists() {
            let shown = self.path.display();
            let why = format!("{shown} is no run, and never changes; leave out --follow");
            return Err(Usage::new(why).into());
        }
        let thread = std::thread::Builder::new().name("follow".to_owned());
        thread.spawn(move || self.load_newer()).map(drop).context("cannot follow the run")
    }

    /// Loads each new checkpoint; logs one that is invalid and keeps the policies before it.
    fn load_newer(&self) {
        let mut seen = self.newest.borrow().name.version.0;
        while !self.newest.is_closed() {
            std::thread::sleep(POLL_INTERVAL);
            let found = learner::store::checkpoint::newest_iteration(&self.path).ok().flatten();
            let Some(iteration) = found.filter(|iteration| *iteration > seen) else { continue };
            seen = iteration;
            let trained = stored::trained(&self.path);
            match trained
                .and_then(|of| policies(&self.path, &of, &self.environment, &self.hidden_sizes))
            {
                Ok(policies) => {
                    let version = policies.name.version;
                    tracing::info!("new episodes use the policies of iteration {version}");
                    self.newest.send_replace(Arc::new(policies));
                }
                Err(error) => tracing::warn!("the previous policies stay in use: {error:#}"),
            }
        }
    }
}

/// The policies as clients get them.
fn policies(
    run: &Path,
    trained: &Trained,
    environment: &EnvironmentSpec,
    hidden_sizes: &[u32],
) -> anyhow::Result<Published> {
    let (version, bytes) = (trained.weights.version, trained.policy.to_bytes()?);
    let parsed = Published::parse(version, bytes.into(), &environment.agents, hidden_sizes);
    parsed.map_err(|why| anyhow::anyhow!("cannot serve the policies of {}: {why}", run.display()))
}
