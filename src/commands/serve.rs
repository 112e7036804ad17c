//! `s2mia serve`: the policies of a run's newest checkpoint, for robots, evaluators and programs in any language.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use anyhow::Context as _;
use learner::checkpoint::Loaded;
use learner::published::Published;
use learner::service::{ServedPolicies, serve_policies};
use proto::{AgentSpec, EnvironmentSpec, PolicyVersion};
use tokio::sync::watch;

use crate::cli::ServeArguments;
use crate::commands::checkpointed;
use crate::listening::Listening;
use crate::offered::Stage;
use crate::run_config::RunConfig;
use crate::runtime::runtime;
use crate::{output, run_path, signals};

/// How often a run that is followed is looked at.
const LOOK_AGAIN: Duration = Duration::from_secs(1);

/// Serves until it is told to stop.
pub(super) fn run(arguments: &ServeArguments) -> anyhow::Result<()> {
    let listening = Listening::new(arguments.listen, &arguments.tls)?;
    let loaded = checkpointed::load(&arguments.run)?;
    let folder = Folder::open(&arguments.run)?;
    let (sender, newest) = watch::channel(Arc::new(folder.policies(loaded)?));
    let served = ServedPolicies {
        run_id: run_path::name(&folder.path),
        environment: folder.environment.clone(),
        newest,
    };
    if arguments.follow {
        let thread = std::thread::Builder::new().name("follow".to_owned());
        // It ends with the process; nobody waits for it.
        thread.spawn(move || follow(&folder, &sender)).context("cannot follow the run")?;
    }
    runtime()?.block_on(serve(&arguments.run, served, listening))
}

async fn serve(run: &Path, served: ServedPolicies, listening: Listening) -> anyhow::Result<()> {
    let (door, url) = listening.open().await?;
    let version = served.newest.borrow().name.version;
    output::line(format!(
        "{} acts by its policies after iteration {version} on {url}",
        run.display()
    ));
    let (stop_sender, stop) = watch::channel(false);
    signals::stop_on_signal(stop_sender, || output::line("stopping"))?;
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
        let config = RunConfig::of_run(run)?;
        let stage = Stage::of(&config)?;
        let environment = actor::environment_spec(stage.environment.description());
        let hidden = |_: &AgentSpec| config.policy.hidden_size() as u32;
        let hidden_sizes = environment.agents.iter().map(hidden).collect();
        Ok(Self { path: run.to_path_buf(), environment, hidden_sizes })
    }

    /// The policies in a checkpoint of the run.
    fn policies(&self, loaded: Loaded) -> anyhow::Result<Published> {
        let version = PolicyVersion(loaded.checkpoint.iteration);
        let bytes = loaded.checkpoint.policy.into();
        Published::parse(version, bytes, &self.environment.agents, &self.hidden_sizes).map_err(
            |why| anyhow::anyhow!("cannot serve the policy in {}: {why}", loaded.path.display()),
        )
    }
}

/// Takes up each new checkpoint as it is written; one that cannot be used is told of and passed over.
fn follow(folder: &Folder, newest: &watch::Sender<Arc<Published>>) {
    let mut seen = newest.borrow().name.version.0;
    while !newest.is_closed() {
        std::thread::sleep(LOOK_AGAIN);
        let found = learner::checkpoint::newest_iteration(&folder.path).ok().flatten();
        let Some(iteration) = found.filter(|iteration| *iteration > seen) else { continue };
        seen = iteration;
        match checkpointed::load(&folder.path).and_then(|loaded| folder.policies(loaded)) {
            Ok(policies) => {
                let version = policies.name.version;
                tracing::info!(
                    "episodes that begin now act by the policies after iteration {version}"
                );
                newest.send_replace(Arc::new(policies));
            }
            Err(error) => tracing::warn!("the policies before are kept: {error:#}"),
        }
    }
}
