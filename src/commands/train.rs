//! `s2mia train`: a learner in this process and actors in their own, on this machine.

mod closing;

use std::path::Path;
use std::time::Instant;

use actor::Transport;
use anyhow::Context as _;
use learner::{LearnerError, Listener, Summary};
use proto::Episodes;
use security::Token;
use tokio::net::TcpListener;
use tokio::sync::watch;

use crate::cli::{PageArguments, TrainArguments};
use crate::commands::train::closing::{Closing, Length};
use crate::config::run_config::RunConfig;
use crate::figures::{chart, learning_curve};
use crate::page;
use crate::process::{output, runtime, signals};
use crate::progress::Progress;
use crate::run::launch::{self, Prepared};
use crate::run::supervisor::{self, ActorProcesses};
use crate::run::{determinism, run_path};

/// Trains to the end of the run or until a stop signal; both leave a checkpoint and end with status 0.
pub(super) fn run(arguments: &TrainArguments) -> anyhow::Result<()> {
    page::check(&arguments.page, None)?;
    let mut prepared =
        launch::prepare(&arguments.settings, &arguments.resume, &Transport::PlainTextOnLoopback)?;
    let audit = &mut prepared.launch.config.audit;
    *audit = audit.with_own_actors();
    if let Some(iterations) = arguments.verify_determinism {
        return determinism::verify(&arguments.settings, &prepared.config.environment, iterations);
    }
    let Prepared { config, folder, launch, .. } = &prepared;
    output::line(opening(config, &launch.environment.task, folder));
    let (stop_sender, stop) = watch::channel(false);
    if arguments.stop_with_stdin {
        signals::stop_with_stdin(stop_sender.clone())?;
    }
    runtime()?.block_on(train(prepared, &arguments.page, stop_sender, stop))
}

async fn train(
    prepared: Prepared,
    page: &PageArguments,
    stop_sender: watch::Sender<bool>,
    stop: watch::Receiver<bool>,
) -> anyhow::Result<()> {
    let Prepared { config, folder, launch, new: _new } = prepared;
    let page = page::open(page, None).await?;
    let begin = Instant::now();
    let listener = TcpListener::bind("127.0.0.1:0").await.context("cannot listen on loopback")?;
    let token = Token::random()?;
    let processes = processes(&config, &folder, &listener, token.clone())?;
    let listener = Listener::from(listener).with_token(token, &folder);
    let (end, ended) = watch::channel(false);
    signals::stop_on_signal(stop_sender.clone(), || {
        output::line("stopping after a checkpoint; Ctrl-C again ends at once without one");
    })?;
    let actors = tokio::spawn(supervisor::supervise(processes, ended, stop_sender));
    let mut progress = Progress::new(config.env_steps());
    let observer = Box::new(move |event: &learner::Event| progress.observe(event));
    let summary = learner::run(launch, listener, page, observer, stop).await;
    end.send_replace(true);
    let failure = actors.await.context("the supervisor of the actors failed")?;
    if config.log.episodes != Episodes::None {
        output::line(closing::logged(&run_path::logs(&folder)));
    }
    let summary = ended_well(summary, failure)?;
    let length = match config.resolved.depends_on_length() {
        true => Length::Fixed,
        false => Length::MayRise,
    };
    let points = learning_curve::evaluations(&run_path::metrics_file(&folder))?;
    let closing = Closing { folder: &folder, summary: &summary, length, elapsed: begin.elapsed() };
    output::line(closing.text(&points));
    Ok(())
}

/// The first line: the folder and the settings of the run.
fn opening(config: &RunConfig, task: &str, folder: &Path) -> String {
    format!(
        "{}: task {task}, algorithm {}, seed {}, {} actors, {} env steps",
        folder.display(),
        config.resolved.text("algorithm"),
        config.run.seed,
        config.actors(),
        chart::thousands(config.env_steps()),
    )
}

fn processes(
    config: &RunConfig,
    folder: &Path,
    listener: &TcpListener,
    token: Token,
) -> anyhow::Result<ActorProcesses> {
    let logs = run_path::logs(folder);
    learner::durable::make_folder(&logs)?;
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
