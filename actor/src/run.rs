//! An actor's life: describe, register, then lease after lease until the run is done.

use std::hash::{BuildHasher, Hasher, RandomState};
use std::sync::Arc;
use std::time::{Duration, Instant};

use proto::{Lease, LeaseAnswer, Registered, Registration, RunDescription};
use tokio::sync::{Mutex, MutexGuard, watch};

use crate::client::{Client, WeightsCache, explained, may_pass};
use crate::config::Config;
use crate::error::{ActorError, describe};
use crate::identity::rollout_fingerprint;
use crate::leasing::{Ended, work_off};
use crate::source::Source;
use crate::stepping::Stepper;
use crate::trajectory_log::Log;

/// First and longest pause between two tries to reach the learner.
const PAUSE: (Duration, Duration) = (Duration::from_millis(100), Duration::from_secs(10));

/// How a session with the learner ended.
enum Session {
    /// The run is over.
    Done,
    /// This actor was told to stop.
    Stopped,
}

/// Rolls out for the learner at `config.learner` until its run is done or `stop` turns true. Comes
/// back by itself after every failure that may pass.
///
/// # Errors
/// If the learner refuses this actor for good, or stays away for longer than allowed; if its log cannot begin.
pub async fn run(config: Config, stop: watch::Receiver<bool>) -> Result<(), ActorError> {
    let log = config.log.as_ref().map(|log| Log::start(log, &config.name)).transpose()?;
    let ended = sessions(&config, log.as_ref(), stop).await;
    if let Some(log) = log {
        tokio::task::spawn_blocking(move || log.close())
            .await
            .map_err(|_| ActorError::Log("the log's last file was not closed".to_owned()))?;
    }
    ended
}

/// One session after the other.
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
        if !may_pass(&error) {
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

/// One session, and if it failed, what was behind that.
async fn explained_session(
    config: &Config,
    log: Option<&Log>,
    outage: &mut Outage,
) -> Result<Session, ActorError> {
    match attend(config, log, outage).await {
        Err(error) => Err(explained(error, config).await),
        done => done,
    }
}

/// One session: from a new connection to the run's end. Two leases overlap: while the last messages of one are
/// on their way and acknowledged, the next is taken and stepped.
async fn attend(
    config: &Config,
    log: Option<&Log>,
    outage: &mut Outage,
) -> Result<Session, ActorError> {
    let mut client = Client::connect(config).await?;
    let run = Arc::new(client.describe_run().await?);
    let source = Source::of(config, &run).await?;
    let own = client.register(&registration(config, &source)?).await?;
    tracing::info!(actor = own.actor.0, run = run.run_id, "registered with {}", config.learner);
    let desk = log.and_then(|log| Some(log.desk(&run, source.task()?)));
    let stepper = Stepper::start(Arc::clone(&run), &source, desk)?;
    let tools = Mutex::new(Tools { stepper, weights: WeightsCache::default(), outage });
    let lane = || Lane { client: client.clone(), own, run: &run, log, tools: &tools };
    let (mut first, mut second) = (lane(), lane());
    tokio::select! {
        ended = first.attend() => ended,
        ended = second.attend() => ended,
    }
}

/// What the lanes of a session use in turns.
struct Tools<'a> {
    stepper: Stepper,
    weights: WeightsCache,
    outage: &'a mut Outage,
}

/// Works off lease after lease. Holds the tools from asking for a lease until its last step, and
/// leaves them to the other lane while its last messages are acknowledged.
struct Lane<'a, 'o> {
    client: Client,
    own: Registered,
    run: &'a RunDescription,
    log: Option<&'a Log>,
    tools: &'a Mutex<Tools<'o>>,
}

impl Lane<'_, '_> {
    /// Until the run is over.
    async fn attend(&mut self) -> Result<Session, ActorError> {
        let mut worked = false;
        loop {
            let mut tools = self.tools.lock().await;
            if std::mem::take(&mut worked) {
                tools.outage.over();
            }
            let lost = self.log.map_or(0, Log::untold);
            let answer = self.client.lease(&self.own, self.run, lost).await?;
            if let Some(log) = self.log {
                log.tell(lost);
            }
            match answer {
                LeaseAnswer::Done => return Ok(Session::Done),
                LeaseAnswer::Retry { wait_millis } => {
                    tools.outage.over();
                    tokio::time::sleep(Duration::from_millis(wait_millis.into())).await;
                }
                LeaseAnswer::Lease(lease) => {
                    self.work(lease, tools).await?;
                    worked = true;
                }
            }
        }
    }

    /// One lease.
    async fn work(
        &mut self,
        lease: Lease,
        mut tools: MutexGuard<'_, Tools<'_>>,
    ) -> Result<(), ActorError> {
        let (id, client) = (lease.id, &mut self.client);
        let pace = Duration::from_secs_f64(self.run.heartbeat_secs);
        let policy = client.weights(&mut tools.weights, lease.weights).await?;
        let stepper = MutexGuard::map(tools, |tools| &mut tools.stepper);
        match work_off(client, &self.own, stepper, lease, policy, pace).await? {
            Ended::Finished => {}
            Ended::Dropped(why) => tracing::warn!("lease {id} dropped: {why}; asking for another"),
        }
        Ok(())
    }
}

/// What this actor offers for the run.
fn registration(config: &Config, source: &Source) -> Result<Registration, ActorError> {
    Ok(Registration {
        client: config.name.clone(),
        protocol_version: proto::PROTOCOL_VERSION,
        environment: source.spec()?,
        rollout_fingerprint: Some(rollout_fingerprint()),
    })
}

/// How long the learner has been away, and how patiently it was tried.
struct Outage {
    since: Instant,
    tries: u32,
}

impl Outage {
    fn begin() -> Self {
        Self { since: Instant::now(), tries: 0 }
    }

    fn over(&mut self) {
        *self = Self::begin();
    }

    /// Full jitter: anything up to a bound that doubles with every try.
    fn next_pause(&mut self, config: &Config, error: &ActorError) -> Result<Duration, ActorError> {
        let secs = self.since.elapsed().as_secs_f64();
        if secs > config.max_outage_secs {
            let (url, last) = (config.learner.clone(), line(error));
            return Err(ActorError::Outage { url, secs, last });
        }
        let bound = PAUSE.0.saturating_mul(1 << self.tries.min(10)).min(PAUSE.1);
        self.tries += 1;
        // Any source of chance will do: pauses reach no result.
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
        // Whoever could have said stop is gone without saying it.
        std::future::pending::<()>().await;
    }
}
