//! Main loop of an actor process: its connections to the learner, the registration of its threads, and their leases
//! until the run is done.

use std::hash::{BuildHasher, Hasher, RandomState};
use std::ops::Range;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, PoisonError};
use std::task::Poll;
use std::time::{Duration, Instant};

use proto::{Lease, LeaseAnswer, ProcessId, Registered, Registration, RunDescription};
use recording::trajectory_log::{Log, LogHandle};
use rollout::rollout_fingerprint;
use tokio::sync::{Mutex, MutexGuard, watch};
use tokio::task::JoinSet;

use crate::client::{Client, WeightsCache, explained, is_transient};
use crate::config::ActorConfig;
use crate::error::{ActorError, describe};
use crate::leasing::{Ended, LeaseSteps, process_lease};
use crate::source::EnvironmentSource;
use crate::stepping::Stepper;

/// Threads that share a connection. Each has two leases with a call and a heartbeat at a time, so that they need no
/// more than the 16 concurrent calls that the learner allows.
const THREADS_PER_CONNECTION: usize = 4;
/// First and longest bound of the delay between two connection attempts.
const RETRY_DELAY: (Duration, Duration) = (Duration::from_millis(100), Duration::from_secs(10));

/// Processes leases of the learner at `config.learner` until its run is done or `stop` becomes true. Reconnects after
/// transient failures.
///
/// # Errors
/// If the learner rejects this actor permanently or is unreachable for too long, or the log cannot be started.
pub async fn run(config: ActorConfig, stop: watch::Receiver<bool>) -> Result<(), ActorError> {
    let log = config.log.as_ref().map(|log| Log::start(log, &config.name, config.threads));
    let log = log.transpose().map_err(|error| ActorError::Other(error.to_string()))?;
    let answered = std::sync::Mutex::new(Instant::now());
    let all = config.threads;
    let weights = WeightsCache::default();
    let process = Arc::new(Process { id: random_id(), config, log, weights, answered });
    let mut connections = JoinSet::new();
    for first in (0..all).step_by(THREADS_PER_CONNECTION) {
        let threads = first..all.min(first + THREADS_PER_CONNECTION);
        let connection =
            Connection { process: Arc::clone(&process), threads, tries: AtomicU32::new(0) };
        connections.spawn(connection.sessions(stop.clone()));
    }
    // What ends one connection ends all: the run is done, or this actor was stopped or rejected.
    let ended = connections.join_next().await.unwrap_or(Ok(Ok(())));
    connections.shutdown().await;
    if let Some(log) = Arc::into_inner(process).and_then(|process| process.log) {
        tokio::task::spawn_blocking(move || log.close())
            .await
            .map_err(|_| ActorError::Other("the last file of the log was not closed".to_owned()))?;
    }
    ended.unwrap_or_else(|panic| {
        Err(ActorError::Other(format!("the stepping thread ended: {panic}")))
    })
}

/// State that all connections of an actor process share.
struct Process {
    /// Id by which the learner recognises the connections of this process.
    id: ProcessId,
    config: ActorConfig,
    log: Option<Log>,
    weights: WeightsCache,
    /// When the learner last answered a request for work.
    answered: std::sync::Mutex<Instant>,
}

/// A connection to the learner, which is replaced when it fails, and the threads that use it.
struct Connection {
    process: Arc<Process>,
    /// Indices of the threads in the process.
    threads: Range<usize>,
    /// Attempts to connect since the learner last answered a request for work over this connection.
    tries: AtomicU32,
}

impl Connection {
    /// Runs sessions until the run is done or `stop` becomes true, with a delay after each failure.
    async fn sessions(self, mut stop: watch::Receiver<bool>) -> Result<(), ActorError> {
        let config = &self.process.config;
        loop {
            let session = async {
                match self.session().await {
                    // An error of the TLS handshake is replaced by its reason.
                    Err(error) => Err(explained(error, config).await),
                    done => done,
                }
            };
            let session = tokio::select! {
                session = session => session,
                () = stopped(&mut stop) => return Ok(()),
            };
            let Err(error) = session else { return Ok(()) };
            if !is_transient(&error) {
                return Err(error);
            }
            let pause = self.next_pause(&error)?;
            tracing::warn!(
                learner = config.learner,
                "session ended: {}; connecting again in {:.1} s",
                line(&error),
                pause.as_secs_f64()
            );
            tokio::select! {
                () = tokio::time::sleep(pause) => {}
                () = stopped(&mut stop) => return Ok(()),
            }
        }
    }

    /// Runs a session, from a new connection to the end of the run.
    async fn session(&self) -> Result<(), ActorError> {
        let config = &self.process.config;
        let mut client = Client::connect(config).await?;
        let run = Arc::new(client.describe_run().await?);
        let source = EnvironmentSource::of(config, &run).await?;
        let log = self.process.log.as_ref();
        let handle = log.and_then(|log| Some(log.handle(&run, source.task()?)));
        let mut threads = Vec::new();
        for index in self.threads.clone() {
            let own = client.register(&registration(&self.process, &source, index)?).await?;
            tracing::info!(
                actor = own.actor.0,
                run = run.run_id,
                "registered with {}",
                config.learner
            );
            threads.push(Thread::start(index, own, (&run, &source, handle.clone()))?);
        }
        let worker =
            |thread| LeaseWorker { connection: self, client: client.clone(), run: &run, thread };
        // Two leases of a thread overlap: the next one is requested before the last steps of the previous one, and stepped while
        // its last messages are sent and acknowledged.
        let workers = threads.iter().flat_map(|thread| [worker(thread), worker(thread)]);
        first(workers.map(LeaseWorker::work_until_done)).await
    }

    /// The learner answered a request for work.
    fn answered(&self) {
        self.tries.store(0, Ordering::Relaxed);
        *self.process.answered.lock().unwrap_or_else(PoisonError::into_inner) = Instant::now();
    }

    /// Delay before the next attempt to connect: exponential backoff with full jitter.
    fn next_pause(&self, error: &ActorError) -> Result<Duration, ActorError> {
        let Process { config, answered, .. } = &*self.process;
        let answered = *answered.lock().unwrap_or_else(PoisonError::into_inner);
        let secs = answered.elapsed().as_secs_f64();
        if secs >= config.max_outage_secs {
            let url = &config.learner;
            let last = line(error);
            return Err(match error {
                ActorError::Environment(_) => ActorError::EnvironmentOutage { secs, last },
                _ => ActorError::Other(format!(
                    "no session with {url} for {secs:.0} s; last error: {last}"
                )),
            });
        }
        let tries = self.tries.fetch_add(1, Ordering::Relaxed);
        let bound = RETRY_DELAY.0.saturating_mul(1 << tries.min(10)).min(RETRY_DELAY.1);
        // Any random source is allowed, because delays do not affect results.
        let share = RandomState::new().build_hasher().finish() as f64 / u64::MAX as f64;
        let left =
            Duration::try_from_secs_f64(config.max_outage_secs - secs).unwrap_or(Duration::MAX);
        Ok(bound.mul_f64(share).min(left))
    }
}

/// A registered thread of the process and its environments.
struct Thread {
    index: usize,
    own: Registered,
    /// Held by the worker that requests a lease, until most of its steps are done.
    turn: Mutex<()>,
    stepper: Mutex<Stepper>,
}

impl Thread {
    fn start(
        index: usize,
        own: Registered,
        (run, source, log): (&Arc<RunDescription>, &EnvironmentSource, Option<LogHandle>),
    ) -> Result<Self, ActorError> {
        let stepper = Mutex::new(Stepper::start(Arc::clone(run), source, log)?);
        Ok(Self { index, own, turn: Mutex::new(()), stepper })
    }
}

/// Processes leases, in turns with the other worker of its thread.
struct LeaseWorker<'a> {
    connection: &'a Connection,
    client: Client,
    run: &'a RunDescription,
    thread: &'a Thread,
}

impl LeaseWorker<'_> {
    /// Processes leases until the run is done.
    async fn work_until_done(mut self) -> Result<(), ActorError> {
        let mut worked = false;
        loop {
            let turn = self.thread.turn.lock().await;
            if std::mem::take(&mut worked) {
                self.connection.answered();
            }
            match self.lease().await? {
                LeaseAnswer::Done => return Ok(()),
                LeaseAnswer::Retry { wait_millis } => {
                    self.connection.answered();
                    tokio::time::sleep(Duration::from_millis(wait_millis.into())).await;
                }
                LeaseAnswer::Lease(lease) => {
                    self.work(lease, turn).await?;
                    worked = true;
                }
            }
        }
    }

    /// Requests a lease. The first thread also reports the steps that the log of the process lost.
    async fn lease(&mut self) -> Result<LeaseAnswer, ActorError> {
        let log = self.connection.process.log.as_ref().filter(|_| self.thread.index == 0);
        let lost = log.map_or(0, Log::unreported);
        let answer = self.client.lease(&self.thread.own, self.run, lost).await?;
        if let Some(log) = log {
            log.mark_reported(lost);
        }
        Ok(answer)
    }

    /// Processes a lease.
    async fn work(&mut self, lease: Lease, turn: MutexGuard<'_, ()>) -> Result<(), ActorError> {
        let id = lease.id;
        let client = &mut self.client;
        let own = &self.thread.own;
        let heartbeat_interval = Duration::from_secs_f64(self.run.heartbeat_secs);
        let policy = client.weights(&self.connection.process.weights, lease.weights).await?;
        let steps = LeaseSteps::new(&self.thread.stepper, turn, lease, policy);
        match process_lease(client, own, steps, id, heartbeat_interval).await? {
            Ended::Finished => {}
            Ended::Dropped(why) => tracing::warn!("lease {id} dropped: {why}; requesting another"),
        }
        Ok(())
    }
}

/// Registration of the thread with this index for the run.
fn registration(
    process: &Process,
    source: &EnvironmentSource,
    thread: usize,
) -> Result<Registration, ActorError> {
    let config = &process.config;
    Ok(Registration {
        client: match config.threads {
            1 => config.name.clone(),
            _ => format!("{}/{thread}", config.name),
        },
        build: config.build.clone(),
        protocol_version: proto::PROTOCOL_VERSION,
        environment: source.open(1).map_err(ActorError::of_task)?.description().clone(),
        rollout_fingerprint: Some(rollout_fingerprint()),
        process: Some(process.id),
    })
}

/// Any random source is allowed, because no result depends on the id.
fn random_id() -> ProcessId {
    let number = || RandomState::new().build_hasher().finish();
    ProcessId((u128::from(number()) << 64 | u128::from(number())).to_le_bytes())
}

/// Polls all futures and returns the output of the first that completes.
async fn first<F: Future>(futures: impl Iterator<Item = F>) -> F::Output {
    let mut futures = futures.map(Box::pin).collect::<Vec<_>>();
    std::future::poll_fn(|context| {
        let mut polled = futures.iter_mut().map(|future| future.as_mut().poll(context));
        polled.find(Poll::is_ready).unwrap_or(Poll::Pending)
    })
    .await
}

fn line(error: &ActorError) -> String {
    match error {
        ActorError::Refused(status) => describe(status),
        other => other.to_string(),
    }
}

async fn stopped(stop: &mut watch::Receiver<bool>) {
    if stop.wait_for(|&stop| stop).await.is_err() {
        // The sender is gone, so no stop signal can arrive.
        std::future::pending::<()>().await;
    }
}
