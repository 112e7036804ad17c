//! Main loop of an actor: describe, register, then process leases until the run is done.

use std::hash::{BuildHasher, Hasher, RandomState};
use std::sync::Arc;
use std::time::{Duration, Instant};

use proto::{Lease, LeaseAnswer, Registered, Registration, RunDescription};
use tokio::sync::{Mutex, MutexGuard, watch};

use crate::client::{Client, WeightsCache, explained, is_transient};
use crate::config::Config;
use crate::error::{ActorError, describe};
use crate::identity::rollout_fingerprint;
use crate::leasing::{Ended, process_lease};
use crate::source::Source;
use crate::stepping::Stepper;
use crate::trajectory_log::Log;

/// First and longest bound of the delay between two connection attempts.
const RETRY_DELAY: (Duration, Duration) = (Duration::from_millis(100), Duration::from_secs(10));

/// End of a session with the learner.
enum Session {
    /// The run is done.
    Done,
    /// This actor was stopped.
    Stopped,
}

/// Processes leases of the learner at `config.learner` until its run is done or `stop` becomes true. Reconnects after
/// transient failures.
///
/// # Errors
/// If the learner rejects this actor permanently or is unreachable for too long, or the log cannot be started.
pub async fn run(config: Config, stop: watch::Receiver<bool>) -> Result<(), ActorError> {
    let log = config.log.as_ref().map(|log| Log::start(log, &config.name)).transpose()?;
    let ended = sessions(&config, log.as_ref(), stop).await;
    if let Some(log) = log {
        tokio::task::spawn_blocking(move || log.close())
            .await
            .map_err(|_| ActorError::Log("the last file of the log was not closed".to_owned()))?;
    }
    ended
}

/// Runs sessions until the run is done, with a delay after each failure.
async fn sessions(
    config: &Config,
    log: Option<&Log>,
    mut stop: watch::Receiver<bool>,
) -> Result<(), ActorError> {
    let mut outage = Outage::begin();
    loop {
        let session = tokio::select! {
            session = explained_session(config, log, &mut outage) => session,
            () = stopped(&mut stop) => Ok(Session::Stopped),
        };
        let error = match session {
            Ok(Session::Done | Session::Stopped) => return Ok(()),
            Err(error) => error,
        };
        if !is_transient(&error) {
            return Err(error);
        }
        let pause = outage.next_pause(config, &error)?;
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

/// Runs a session. An error of the TLS handshake is replaced by its reason.
async fn explained_session(
    config: &Config,
    log: Option<&Log>,
    outage: &mut Outage,
) -> Result<Session, ActorError> {
    match run_session(config, log, outage).await {
        Err(error) => Err(explained(error, config).await),
        done => done,
    }
}

/// Runs a session, from a new connection to the end of the run. Two leases overlap: the next lease is stepped while the
/// last messages of the previous one are sent and acknowledged.
async fn run_session(
    config: &Config,
    log: Option<&Log>,
    outage: &mut Outage,
) -> Result<Session, ActorError> {
    let mut client = Client::connect(config).await?;
    let run = Arc::new(client.describe_run().await?);
    let source = Source::of(config, &run).await?;
    let own = client.register(&registration(config, &source)?).await?;
    tracing::info!(actor = own.actor.0, run = run.run_id, "registered with {}", config.learner);
    let handle = log.and_then(|log| Some(log.handle(&run, source.task()?)));
    let stepper = Stepper::start(Arc::clone(&run), &source, handle)?;
    let shared = Mutex::new(SharedState { stepper, weights: WeightsCache::default(), outage });
    let worker = || LeaseWorker { client: client.clone(), own, run: &run, log, shared: &shared };
    let (mut first, mut second) = (worker(), worker());
    tokio::select! {
        ended = first.work_until_done() => ended,
        ended = second.work_until_done() => ended,
    }
}

/// State that the two workers of a session use alternately.
struct SharedState<'a> {
    stepper: Stepper,
    weights: WeightsCache,
    outage: &'a mut Outage,
}

/// Processes leases. Holds the shared state from the request of a lease until its last step, and releases it to the
/// other worker while its last messages are acknowledged.
struct LeaseWorker<'a, 'o> {
    client: Client,
    own: Registered,
    run: &'a RunDescription,
    log: Option<&'a Log>,
    shared: &'a Mutex<SharedState<'o>>,
}

impl LeaseWorker<'_, '_> {
    /// Processes leases until the run is done.
    async fn work_until_done(&mut self) -> Result<Session, ActorError> {
        let mut worked = false;
        loop {
            let mut shared = self.shared.lock().await;
            if std::mem::take(&mut worked) {
                shared.outage.end();
            }
            let lost = self.log.map_or(0, Log::unreported);
            let answer = self.client.lease(&self.own, self.run, lost).await?;
            if let Some(log) = self.log {
                log.mark_reported(lost);
            }
            match answer {
                LeaseAnswer::Done => return Ok(Session::Done),
                LeaseAnswer::Retry { wait_millis } => {
                    shared.outage.end();
                    tokio::time::sleep(Duration::from_millis(wait_millis.into())).await;
                }
                LeaseAnswer::Lease(lease) => {
                    self.work(lease, shared).await?;
                    worked = true;
                }
            }
        }
    }

    /// Processes a lease.
    async fn work(
        &mut self,
        lease: Lease,
        mut shared: MutexGuard<'_, SharedState<'_>>,
    ) -> Result<(), ActorError> {
        let (id, client) = (lease.id, &mut self.client);
        let pace = Duration::from_secs_f64(self.run.heartbeat_secs);
        let policy = client.weights(&mut shared.weights, lease.weights).await?;
        let stepper = MutexGuard::map(shared, |shared| &mut shared.stepper);
        match process_lease(client, &self.own, stepper, lease, policy, pace).await? {
            Ended::Finished => {}
            Ended::Dropped(why) => tracing::warn!("lease {id} dropped: {why}; requesting another"),
        }
        Ok(())
    }
}

/// Registration of this actor for the run.
fn registration(config: &Config, source: &Source) -> Result<Registration, ActorError> {
    Ok(Registration {
        client: config.name.clone(),
        build: config.build.clone(),
        protocol_version: proto::PROTOCOL_VERSION,
        environment: source.spec()?,
        rollout_fingerprint: Some(rollout_fingerprint()),
    })
}

/// Duration of an outage of the learner and number of connection attempts.
struct Outage {
    since: Instant,
    tries: u32,
}

impl Outage {
    fn begin() -> Self {
        Self { since: Instant::now(), tries: 0 }
    }

    fn end(&mut self) {
        *self = Self::begin();
    }

    /// Delay before the next attempt: exponential backoff with full jitter.
    fn next_pause(&mut self, config: &Config, error: &ActorError) -> Result<Duration, ActorError> {
        let secs = self.since.elapsed().as_secs_f64();
        if secs > config.max_outage_secs {
            let (url, last) = (config.learner.clone(), line(error));
            return Err(ActorError::Outage { url, secs, last });
        }
        let bound = RETRY_DELAY.0.saturating_mul(1 << self.tries.min(10)).min(RETRY_DELAY.1);
        self.tries += 1;
        // Any random source is allowed, because delays do not affect results.
        let share = RandomState::new().build_hasher().finish() as f64 / u64::MAX as f64;
        Ok(bound.mul_f64(share))
    }
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
