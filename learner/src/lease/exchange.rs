//! Where the service's many tasks and the trainer's one thread meet: published weights, the slot table
//! under one lock, and the queue of what the trainer waits for.

use std::collections::{BTreeMap, VecDeque};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use bytes::Bytes;
use proto::{
    ActorId, Heartbeat, HeartbeatAnswer, Incarnation, LeaseAnswer, PolicyVersion, Refusal,
    Registered, Registration, RolloutWork, RunDescription, WeightsName,
};
use tokio::sync::{Notify, watch};

use crate::config::{AuditConfig, LeaseConfig};
use crate::lease::canary;
use crate::lease::end_states::StateReader;
use crate::lease::published::{Published, PublishedVersions};
use crate::lease::sample::SecretSample;
use crate::lease::slots::{ConnectionId, Effect, Offer, SlotRules, SlotTable, Trust};
use crate::observe::snapshot::RunSnapshot;

mod incidents;
mod reporting;
mod results;
mod wake;

pub use incidents::Caller;
use incidents::{ActorNames, Notice};
use reporting::Pace;
pub use reporting::{Storage, status_json};
pub use wake::{ExchangeError, Wake};

/// How long an actor that gets no work waits before it asks again.
const RETRY: Duration = Duration::from_millis(100);

/// Connects the service to the trainer.
#[derive(Debug)]
pub struct Exchange {
    /// Description of the run for actors.
    pub run: RunDescription,
    begun: Instant,
    /// A blocking lock: calls from tokio tasks and from the trainer's thread hold it for microseconds and never
    /// across an await. Where the snapshot is written under it, this lock is taken first.
    shared: Mutex<Shared>,
    /// Wakes the trainer: `Shared::wakes` is no longer empty.
    trainer: Condvar,
    /// Wakes tasks that wait for a lease.
    work: Notify,
    storage: watch::Sender<Storage>,
    /// Whether a client asked the run to end, as a signal does.
    stop_requested: AtomicBool,
    /// Decodes the states of the run's environments.
    pub states: StateReader,
    /// Chunks that are checked whole although no check has failed, by lease and sequence.
    checked: SecretSample,
    /// Shared with readers, who then hold no lock; it is copied if a reader still has it when it changes.
    snapshot: watch::Sender<Arc<RunSnapshot>>,
}

/// What must change together: a lease names weights that are held, and a complete iteration wakes the trainer.
#[derive(Debug)]
struct Shared {
    table: SlotTable,
    weights: PublishedVersions,
    /// Bounded by what is open: one iteration, a few evaluations, one failure.
    wakes: VecDeque<Wake>,
    refusals: BTreeMap<String, u64>,
    chunks_accepted: u64,
    names: ActorNames,
    /// Lines of the log that are written once the lock is free.
    notices: Vec<Notice>,
    pace: Pace,
}

impl Exchange {
    /// An exchange without work. The settings have been validated.
    #[must_use]
    pub fn new(
        run: RunDescription,
        lease: LeaseConfig,
        audit: AuditConfig,
        states: StateReader,
    ) -> Arc<Self> {
        let table = SlotTable::new(SlotRules {
            incarnation: run.incarnation,
            ttl: Duration::from_secs_f64(lease.ttl_secs),
            chunks_per_slot: run.chunks_per_slot(),
            steps_per_slot: run.slot_steps,
            episode_steps: run.environment.episode_steps,
            audit: SecretSample::new(audit.share),
            requires_fingerprint: audit.requires_fingerprint(),
        });
        let shared = Shared {
            table,
            weights: PublishedVersions::default(),
            wakes: VecDeque::new(),
            refusals: BTreeMap::new(),
            chunks_accepted: 0,
            names: ActorNames::default(),
            notices: Vec::new(),
            pace: Pace::default(),
        };
        let snapshot = RunSnapshot::new(run.run_id.clone(), run.incarnation);
        Arc::new(Self {
            snapshot: watch::Sender::new(Arc::new(snapshot)),
            stop_requested: AtomicBool::new(false),
            states,
            checked: SecretSample::new(canary::SHARE),
            run,
            begun: Instant::now(),
            shared: Mutex::new(shared),
            trainer: Condvar::new(),
            work: Notify::new(),
            storage: watch::Sender::new(Storage::Sound),
        })
    }

    /// Ends the run as a signal does. The trainer reads the request several times a second.
    pub(crate) fn request_stop(&self) {
        self.stop_requested.store(true, Ordering::Relaxed);
    }

    /// Whether a client asked the run to end.
    pub(crate) fn is_stop_requested(&self) -> bool {
        self.stop_requested.load(Ordering::Relaxed)
    }

    // What the trainer does.

    /// Makes weights available. Versions that no open work names are dropped, except the latest two
    /// published.
    ///
    /// # Errors
    /// Refuses bytes that are no policy for this run.
    pub fn publish(
        &self,
        version: PolicyVersion,
        snapshot: Bytes,
    ) -> Result<WeightsName, ExchangeError> {
        let agents = &self.run.environment.agents;
        let hidden = &self.run.hidden_sizes;
        let published = Published::parse(version, snapshot, agents, hidden)
            .map_err(|why| ExchangeError(format!("cannot publish weights {version}: {why}")))?;
        let name = published.name;
        self.change(|shared| {
            shared.weights.insert(published);
            shared.weights.prune(shared.table.weights_in_use());
        });
        Ok(name)
    }

    /// Opens an iteration to be rolled out with published weights, whose name is returned. What was open before is
    /// dropped.
    ///
    /// # Panics
    /// If the weights were not published.
    pub fn open_iteration(
        &self,
        iteration: u64,
        weights: PolicyVersion,
        slots: Vec<RolloutWork>,
    ) -> WeightsName {
        self.change(|shared| {
            let name = shared.weights.expect(weights);
            shared.pace.open(iteration, self.begun.elapsed());
            shared.table.open_iteration(name, slots);
            name
        })
    }

    /// Opens an evaluation of published weights, leased when no slot is free.
    ///
    /// # Panics
    /// If the weights were not published.
    pub fn open_evaluation(&self, iteration: u64, weights: PolicyVersion, episodes: u32) {
        self.change(|shared| {
            let name = shared.weights.expect(weights);
            shared.table.open_evaluation(iteration, name, episodes);
        });
    }

    /// Replaces the start states of a slot of the open iteration.
    pub fn replace(&self, work: RolloutWork) {
        self.change(|shared| shared.table.replace(work));
    }

    /// Blocks until something is complete or fails, at most for `timeout`.
    pub fn wait(&self, timeout: Duration) -> Wake {
        let shared = self.lock();
        let idle = |shared: &mut Shared| shared.wakes.is_empty();
        let waited = self.trainer.wait_timeout_while(shared, timeout, idle);
        let (mut shared, _) = waited.unwrap_or_else(PoisonError::into_inner);
        shared.wakes.pop_front().unwrap_or(Wake::Timeout)
    }

    /// A failure since the last wait: an audit may end after the last iteration.
    pub fn failure(&self) -> Option<ExchangeError> {
        let mut shared = self.lock();
        let at = shared.wakes.iter().position(|wake| matches!(wake, Wake::Failed(_)))?;
        match shared.wakes.remove(at) {
            Some(Wake::Failed(error)) => Some(error),
            _ => None,
        }
    }

    /// Actor threads that are connected.
    #[must_use]
    pub fn threads(&self) -> usize {
        self.lock().table.actors()
    }

    /// The run is over: every later request for a lease is answered so.
    pub fn finish(&self) {
        self.change(|shared| shared.table.finish());
    }

    // What the service does for actors.

    /// Admits an actor.
    ///
    /// # Errors
    /// Refuses another protocol version, another environment, or another fingerprint.
    pub fn register(
        &self,
        connection: ConnectionId,
        registration: &Registration,
    ) -> Result<Registered, Refusal> {
        registration.check(&self.run)?;
        let trust = match registration.rollout_fingerprint {
            Some(_) => Trust::Exact,
            None => Trust::Foreign,
        };
        let actor = self.change(|shared| {
            let actor = shared.table.register(connection, trust, registration.process);
            shared.names.insert(actor, registration.client.clone());
            actor
        });
        tracing::info!(%actor, client = %registration.client, ?trust, "actor registered");
        Ok(Registered { actor, incarnation: self.run.incarnation })
    }

    /// The connection closed: its actors are gone, their leases end.
    pub fn disconnect(&self, connection: ConnectionId) {
        self.change(|shared| shared.table.disconnect(connection));
    }

    /// Waits for work, at most for `timeout`.
    ///
    /// # Errors
    /// Refuses unknown actors, other incarnations, and too many leases.
    pub async fn lease(
        &self,
        sender: ConnectionId,
        actor: ActorId,
        incarnation: Incarnation,
        timeout: Duration,
    ) -> Result<LeaseAnswer, Refusal> {
        let end = self.begun.elapsed() + timeout;
        let mut has_waited = false;
        loop {
            // Registered before the table is asked, so that no wake is missed in between.
            let mut freed = std::pin::pin!(self.work.notified());
            freed.as_mut().enable();
            // The deadline is read under the same lock: time may pass it in between, and no wake follows.
            let (offer, deadline) = self.change(|shared| {
                let offer = shared.table.lease(sender, actor, incarnation);
                let idle = matches!(offer, Ok(Offer::Nothing));
                (offer, idle.then(|| shared.table.next_deadline()).flatten())
            });
            let left = end.saturating_sub(self.begun.elapsed());
            let offer = match offer {
                // The connection closed meanwhile: no actor reads the answer.
                Err(_) if has_waited => return Ok(retry(RETRY)),
                offer => offer?,
            };
            let pause = match offer {
                Offer::Lease(lease) => return Ok(LeaseAnswer::Lease(lease)),
                Offer::Done => return Ok(LeaseAnswer::Done),
                _ if left.is_zero() => return Ok(retry(RETRY)),
                Offer::Quarantined(wait) if wait > left => return Ok(retry(wait)),
                Offer::Quarantined(wait) => wait,
                Offer::Nothing => deadline.map_or(left, |at| left.min(self.until(at))),
            };
            // Either way the table is asked again: woken, or an open lease may have ended.
            let _ = tokio::time::timeout(pause, freed).await;
            has_waited = true;
        }
    }

    /// Takes in a heartbeat.
    ///
    /// # Errors
    /// Refuses unknown actors and other incarnations.
    pub fn heartbeat(
        &self,
        sender: ConnectionId,
        beat: &Heartbeat,
    ) -> Result<HeartbeatAnswer, Refusal> {
        let (lease_valid, is_over) =
            self.change(|shared| (shared.table.heartbeat(sender, beat), shared.table.is_over()));
        Ok(HeartbeatAnswer { lease_valid: lease_valid?, is_over })
    }

    /// The weights with this name.
    ///
    /// # Errors
    /// Refuses names of weights that are not held.
    pub fn weights(&self, name: WeightsName) -> Result<Arc<Published>, Refusal> {
        self.lock().weights.find(name)
    }

    fn until(&self, deadline: Duration) -> Duration {
        // A millisecond more, so that the deadline has passed when the table is asked again.
        deadline.saturating_sub(self.begun.elapsed()) + Duration::from_millis(1)
    }

    /// Sets the table's time, makes a change, then carries out the table's effects. Every change uses this function.
    fn change<T>(&self, act: impl FnOnce(&mut Shared) -> T) -> T {
        let mut shared = self.lock();
        shared.table.tick(self.begun.elapsed());
        let result = act(&mut shared);
        for effect in shared.table.effects() {
            match effect {
                Effect::WorkFreed => self.work.notify_waiters(),
                Effect::Iteration(rollouts) => {
                    let secs = shared.pace.secs_open(self.begun.elapsed());
                    shared.wakes.push_back(Wake::Iteration { rollouts, secs });
                }
                Effect::Evaluation(outcome) => shared.wakes.push_back(Wake::Evaluation(outcome)),
                Effect::Failed(disagreement) => {
                    let error = ExchangeError(disagreement.to_string());
                    shared.wakes.push_back(Wake::Failed(error));
                }
                Effect::BeginAgain(slot) => shared.wakes.push_back(Wake::BeginAgain(slot)),
                Effect::GivenUp { actor, work, times, detail } => {
                    let work = incidents::work(work);
                    let actor = shared.names.name_of(actor);
                    let error = ExchangeError(format!(
                        "{work} failed {times} times and no actor could finish it, the last was {actor}: {detail}; \
                         remove the cause, then resume the run"
                    ));
                    shared.wakes.push_back(Wake::Failed(error));
                }
            }
        }
        if !shared.wakes.is_empty() {
            self.trainer.notify_all();
        }
        let Shared { table, names, notices, .. } = &mut *shared;
        notices.extend(table.incidents().iter().map(|incident| names.describe(incident)));
        let notices = std::mem::take(notices);
        // The log may be slow, and no other task waits for that.
        drop(shared);
        let has_ended = self.snapshot.borrow().has_ended();
        if has_ended {
            // Connections close under actors that still work, and nothing is lost.
            notices.iter().for_each(|notice| tracing::debug!("{notice:?}"));
        } else {
            notices.iter().for_each(Notice::log);
        }
        result
    }

    fn lock(&self) -> MutexGuard<'_, Shared> {
        // Nothing panics while it holds the lock half-changed: the table's methods check first.
        self.shared.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn retry(wait: Duration) -> LeaseAnswer {
    LeaseAnswer::Retry { wait_millis: u32::try_from(wait.as_millis()).unwrap_or(u32::MAX) }
}
