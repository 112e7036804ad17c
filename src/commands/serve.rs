//! `s2mia serve`: the policies of a run's newest checkpoint, for robots, evaluators and programs in any language.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use anyhow::Context as _;
use learner::published::Published;
use learner::service::{ServedPolicies, serve_policies};
use proto::{AgentSpec, EnvironmentSpec, PolicyVersion};
use tokio::sync::watch;

use crate::cli::ServeArguments;
use crate::commands::entrance::{Entrance, demand_loopback};
use crate::commands::{checkpointed, runtime};
use crate::run_config::RunConfig;
use crate::{output, run_path, signals};

/// How often a run that is followed is looked at.
const LOOK_AGAIN: Duration = Duration::from_secs(1);

/// Serves until it is told to stop.
pub(super) fn run(arguments: &ServeArguments) -> anyhow::Result<()> {
    if !arguments.insecure_allow_remote {
        demand_loopback(arguments.listen, &arguments.tls)?;
    }
    let entrance = Entrance::new(arguments.listen, &arguments.tls)?;
    let folder = Arc::new(Folder::open(&arguments.run)?);
    runtime()?.block_on(serve(folder, entrance, arguments))
}

async fn serve(
    folder: Arc<Folder>,
    entrance: Entrance,
    arguments: &ServeArguments,
) -> anyhow::Result<()> {
    let first = folder.newest()?;
    let (door, url) = entrance.open().await?;
    let (run, version) = (folder.path.display(), first.name.version);
    output::line(format!("{run} acts by its policies after iteration {version} on {url}"));
    let (sender, newest) = watch::channel(Arc::new(first));
    let served = ServedPolicies {
        run_id: run_path::name(&folder.path),
        environment: folder.environment.clone(),
        newest,
    };
    let (stop_sender, stop) = watch::channel(false);
    signals::stop_on_signal(stop_sender, || output::line("stopping"))?;
    if arguments.follow {
        tokio::spawn(follow(Arc::clone(&folder), sender));
    }
    serve_policies(served, door, stop).await.context("the service ended")
}

/// A run whose policies are served.
struct Folder {
    path: PathBuf,
    environment: EnvironmentSpec,
    /// Of each agent.
    hidden_sizes: Vec<u32>,
}

impl Folder {
    fn open(run: &Path) -> anyhow::Result<Self> {
        // Says what is wrong with the folder, if anything, before its settings are missed.
        checkpointed::load(run)?;
        let config = RunConfig::of_run(run)?;
        let world = sim::Environments::new(&config.task, 1).context("cannot build the task")?;
        let environment = actor::environment_spec(world.description());
        let hidden = |_: &AgentSpec| config.policy.hidden_size() as u32;
        let hidden_sizes = environment.agents.iter().map(hidden).collect();
        Ok(Self { path: run.to_path_buf(), environment, hidden_sizes })
    }

    /// The policies of the newest good checkpoint.
    fn newest(&self) -> anyhow::Result<Published> {
        let loaded = checkpointed::load(&self.path)?;
        let version = PolicyVersion(loaded.checkpoint.iteration);
        let agents = &self.environment.agents;
        Published::parse(version, loaded.checkpoint.policy.into(), agents, &self.hidden_sizes)
            .map_err(|why| {
                anyhow::anyhow!("cannot serve the policy in {}: {why}", loaded.path.display())
            })
    }
}

/// Takes up each new checkpoint once; one that cannot be used is told of and passed over.
async fn follow(folder: Arc<Folder>, sender: watch::Sender<Arc<Published>>) {
    let mut seen = sender.borrow().name.version.0;
    while !sender.is_closed() {
        tokio::time::sleep(LOOK_AGAIN).await;
        let looked = Arc::clone(&folder);
        let found = tokio::task::spawn_blocking(move || newer(&looked, seen)).await;
        match found {
            Ok(Ok(None)) => {}
            Ok(Ok(Some((iteration, policies)))) => {
                seen = iteration;
                tracing::info!(
                    "episodes that begin now act by the policies after iteration {}",
                    policies.name.version
                );
                sender.send_replace(Arc::new(policies));
            }
            Ok(Err(error)) => tracing::warn!("the policies before are kept: {error:#}"),
            Err(panic) => tracing::error!("looking for new policies broke down: {panic}"),
        }
    }
}

/// The policies of a checkpoint after that of iteration `seen`, and which iteration was looked at.
fn newer(folder: &Folder, seen: u64) -> anyhow::Result<Option<(u64, Published)>> {
    match learner::checkpoint::newest_iteration(&folder.path)? {
        Some(iteration) if iteration > seen => Ok(Some((iteration, folder.newest()?))),
        _ => Ok(None),
    }
}
