//! A whole run: the folder, the service on its socket, the trainer on its thread, and their end.

use std::any::Any;
use std::fmt::Display;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use tokio::sync::{oneshot, watch};
use tokio::task::{JoinHandle, JoinSet};

use crate::error::LearnerError;
use crate::launch::Launch;
use crate::lease::exchange::Exchange;
use crate::observe::event::Summary;
use crate::serve::listener::Listener;
use crate::serve::page::{self, Facts, Page, RunView};
use crate::serve::service;
use crate::train::prepare::prepare;
use crate::train::trainer::{Observer, Outside, RunningTrainer, Trainer};

/// How long the learner waits for actors to disconnect after the run.
const NOTIFYING: Duration = Duration::from_secs(2);

/// How long open connections have to end after that.
const CLOSING: Duration = Duration::from_secs(1);

/// Runs from the start, or from the newest good checkpoint, to the last iteration and its evaluation,
/// or until `stop` is true. Both ends leave a checkpoint and return within seconds. Actors end with a
/// run that is complete or that a client stopped; after `stop` they wait for the next learner. A `page` shows the run meanwhile.
///
/// # Errors
/// Says what could not start or broke; a resume continues from the last checkpoint.
pub async fn run(
    launch: Launch,
    listener: Listener,
    page: Option<Page>,
    observer: Observer,
    stop: watch::Receiver<bool>,
) -> Result<Summary, LearnerError> {
    let prepared = tokio::task::spawn_blocking(move || prepare(launch)).await;
    let (trainer, description) = prepared
        .map_err(|error| LearnerError::Other(format!("the trainer panicked: {error}")))??;
    let address = listener.listener.local_addr();
    let address = address.map_err(service_ended)?;
    let token = listener.token.as_ref().map(|required| &required.token);
    trainer.folder.note_token(token)?;
    trainer.folder.note_address(address)?;
    let config = &trainer.launch.config;
    let connections = config.learner.connections;
    let states = trainer.launch.states.clone();
    let exchange = Exchange::new(description, config.lease, config.audit, states);
    let _shown = page.map(|page| show(page, &trainer, &exchange));
    let asked = Arc::clone(&exchange);
    let broken = Arc::new(AtomicBool::new(false));
    let service_ended = Arc::clone(&broken);
    let stop = move || {
        *stop.borrow() || asked.is_stop_requested() || service_ended.load(Ordering::Relaxed)
    };
    let outside = Outside { exchange: Arc::clone(&exchange), observer, stop: Box::new(stop) };
    // The first answer to a client already has the figures of the run.
    let running = trainer.begin(outside)?;
    let server = Server::start(listener, connections, &exchange, broken);
    let result = on_own_thread(running).await;
    let complete = result.as_ref().is_ok_and(|summary| !summary.stopped_early);
    // After a signal actors wait for the next learner: it may be a restart.
    let actors_end = complete || exchange.is_stop_requested();
    exchange.show_end(result.as_ref().ok());
    if actors_end {
        notify_actors(&exchange).await;
    }
    let served = server.close().await;
    result.and_then(|summary| served.map(|()| summary))
}

/// Serves the run's page until the returned task set is dropped.
fn show(page: Page, trainer: &Trainer, exchange: &Arc<Exchange>) -> JoinSet<()> {
    let facts = Facts::of(&trainer.launch, trainer.iteration);
    let exchange = Arc::clone(exchange);
    let view = RunView { facts, exchange, curves: trainer.metrics.curves() };
    let mut serving = JoinSet::new();
    serving.spawn(page::serve_live(page, Arc::new(view)));
    serving
}

/// The service while the trainer works.
struct Server {
    task: JoinHandle<Result<(), tonic::transport::Error>>,
    close: oneshot::Sender<()>,
}

impl Server {
    /// `broken` becomes true when the service ends, also on its own.
    fn start(
        listener: Listener,
        connections: usize,
        exchange: &Arc<Exchange>,
        broken: Arc<AtomicBool>,
    ) -> Self {
        let (close, closed) = oneshot::channel::<()>();
        let serving = service::serve(Arc::clone(exchange), listener, connections, async move {
            // An error means that the sender is gone, which ends the service as well.
            let _closed = closed.await;
        });
        let task = tokio::spawn(async move {
            let result = serving.await;
            broken.store(true, Ordering::Relaxed);
            result
        });
        Self { task, close }
    }

    async fn close(mut self) -> Result<(), LearnerError> {
        let _sent = self.close.send(());
        match tokio::time::timeout(CLOSING, &mut self.task).await {
            Ok(Ok(Ok(()))) => Ok(()),
            Ok(Ok(Err(error))) => Err(service_ended(error)),
            Ok(Err(error)) => Err(service_ended(error)),
            Err(_) => {
                self.task.abort();
                Ok(())
            }
        }
    }
}

/// Answers requests for work that the run is done, until all actors have disconnected.
async fn notify_actors(exchange: &Exchange) {
    exchange.finish();
    let disconnected = async {
        while exchange.run_snapshot().status.actors > 0 {
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    };
    // Others find a closed connection, and end with status 1 when their outage has lasted too long.
    let _timeout = tokio::time::timeout(NOTIFYING, disconnected).await;
}

async fn on_own_thread(trainer: RunningTrainer) -> Result<Summary, LearnerError> {
    let (sender, ended) = oneshot::channel();
    let thread = std::thread::Builder::new().name("trainer".to_owned()).spawn(move || {
        // Sending fails only if the whole run has been dropped.
        let _sent = sender.send(trainer.train());
    });
    let thread = thread
        .map_err(|error| LearnerError::Other(format!("cannot start the trainer: {error}")))?;
    ended.await.unwrap_or_else(|_| {
        let why = thread.join().map_or_else(panic_message, |()| "no result".to_owned());
        Err(LearnerError::Other(format!("the trainer panicked: {why}")))
    })
}

fn service_ended(error: impl Display) -> LearnerError {
    LearnerError::Other(format!("the service ended: {error}"))
}

fn panic_message(panic: Box<dyn Any + Send>) -> String {
    let text = panic.downcast_ref::<&str>().map(|text| (*text).to_owned());
    text.or_else(|| panic.downcast_ref::<String>().cloned())
        .unwrap_or_else(|| "no message".to_owned())
}
