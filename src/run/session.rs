//! One start of a run on this machine: the learner in this process, and actors in their own.

use std::path::Path;

use anyhow::Context as _;
use learner::error::LearnerError;
use learner::launch::Launch;
use learner::observe::event::Summary;
use learner::serve::listener::Listener;
use learner::serve::page::Page;
use learner::store::run_folder::LOGS;
use learner::train::trainer::Observer;
use security::Token;
use tokio::net::TcpListener;
use tokio::sync::watch;

use crate::config::run_config::RunConfig;
use crate::run::supervisor::{self, ActorProcesses};

/// Trains to the end of the launch or until a stop, which this function also requests if the actors keep failing.
///
/// # Errors
/// The learner failed, or the supervisor gave up on the actors.
pub(crate) async fn train(
    config: &RunConfig,
    mut launch: Launch,
    page: Option<Page>,
    observer: Observer,
    (stop_sender, stop): (watch::Sender<bool>, watch::Receiver<bool>),
) -> anyhow::Result<Summary> {
    let audit = &mut launch.config.audit;
    *audit = audit.with_own_actors();
    let listener = TcpListener::bind("127.0.0.1:0").await.context("cannot listen on loopback")?;
    let token = Token::random()?;
    let processes = processes(config, &launch.folder, &listener, token.clone())?;
    let listener = Listener::from(listener).with_token(token, &launch.folder);
    let (end, ended) = watch::channel(false);
    let actors = tokio::spawn(supervisor::supervise(processes, ended, stop_sender));
    let summary = learner::run::run(launch, listener, page, observer, stop).await;
    end.send_replace(true);
    let failure = actors.await.context("the supervisor of the actors failed")?;
    ended_well(summary, failure)
}

fn processes(
    config: &RunConfig,
    folder: &Path,
    listener: &TcpListener,
    token: Token,
) -> anyhow::Result<ActorProcesses> {
    let logs = folder.join(LOGS);
    learner::store::durable::make_folder(&logs)?;
    Ok(ActorProcesses {
        program: std::env::current_exe().context("cannot find this program")?,
        learner: format!("http://{}", listener.local_addr()?),
        token,
        environment: config.environment.arguments(),
        logs,
        log: config.log,
        actors: config.actors(),
    })
}

/// The summary; an error if the learner failed or the supervisor gave up on the actors.
fn ended_well(
    summary: Result<Summary, LearnerError>,
    failure: Option<String>,
) -> anyhow::Result<Summary> {
    match (summary.context("the learner failed"), failure) {
        (Ok(summary), None) => Ok(summary),
        (Ok(summary), Some(reason)) => {
            anyhow::bail!("{reason}; the run is kept in {}", summary.checkpoint.display());
        }
        (Err(error), None) => Err(error),
        (Err(error), Some(reason)) => Err(error.context(reason)),
    }
}
