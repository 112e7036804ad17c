//! Processing of a lease, from the stepping thread's results to their acknowledgements.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use policy::PolicySnapshot;
use proto::{
    Ack, Heartbeat, Lease, LeaseFailure, LeaseId, MAX_UNACKNOWLEDGED, Registered, ReturnedLease,
};
use tokio::sync::{Mutex, MutexGuard};
use tonic::{Code, Status};

use crate::client::Client;
use crate::error::{ActorError, describe};
use crate::stepping::{Job, JobOutput, JobProgress, Stepper};

/// End of a lease for this actor.
pub(crate) enum Ended {
    /// All messages are acknowledged.
    Finished,
    /// The learner revoked the lease or rejected its data.
    Dropped(String),
}

/// The steps of a lease: before, during and after its time on the stepping thread.
pub(crate) struct LeaseSteps<'a> {
    stepper: &'a Mutex<Stepper>,
    /// Until the stepping thread has it.
    job: Option<Job>,
    /// The stepping thread, until its last output for the lease.
    held: Option<MutexGuard<'a, Stepper>>,
    /// The turn of the worker, until most steps are done.
    turn: Option<MutexGuard<'a, ()>>,
    progress: Arc<JobProgress>,
}

impl<'a> LeaseSteps<'a> {
    /// Steps of `lease`, which `stepper` does after those of the previous lease.
    pub(crate) fn new(
        stepper: &'a Mutex<Stepper>,
        turn: MutexGuard<'a, ()>,
        lease: Lease,
        policy: Arc<PolicySnapshot>,
    ) -> Self {
        let progress = Arc::new(JobProgress::default());
        let job = Job { lease, policy, progress: Arc::clone(&progress) };
        Self { stepper, job: Some(job), held: None, turn: Some(turn), progress }
    }

    /// Starts on the stepping thread now if it is free, otherwise [`LeaseSteps::next`] does.
    fn start_if_free(&mut self) -> Result<(), ActorError> {
        self.stepper.try_lock().map_or(Ok(()), |held| self.start(held))
    }

    fn start(&mut self, held: MutexGuard<'a, Stepper>) -> Result<(), ActorError> {
        if let Some(job) = self.job.take() {
            held.jobs.try_send(job).map_err(|_| gone())?;
        }
        self.held = Some(held);
        Ok(())
    }

    /// Next output of the stepping thread; never completes after the last one. Nothing is lost if this is cancelled.
    async fn next(&mut self) -> Result<JobOutput, ActorError> {
        if self.job.is_some() {
            let held = self.stepper.lock().await;
            self.start(held)?;
        }
        let Some(held) = &mut self.held else { return std::future::pending().await };
        let output = held.outputs.recv().await.ok_or_else(gone)?;
        if let JobOutput::End | JobOutput::Failed(_) = output {
            (self.held, self.turn) = (None, None);
        }
        Ok(output)
    }
}

/// Processes a lease: streams the results of its steps and sends heartbeats until all messages are acknowledged.
pub(crate) async fn process_lease(
    client: &mut Client,
    own: &Registered,
    mut steps: LeaseSteps<'_>,
    lease: LeaseId,
    heartbeat_interval: Duration,
) -> Result<Ended, ActorError> {
    let beat = Heartbeat { actor: own.actor, incarnation: own.incarnation, lease, slot_step: 0 };
    let ended = stream(client, &mut steps, beat, heartbeat_interval).await;
    // Also if no stream could be opened: the next lease must not get this one's results.
    steps.progress.cancelled.store(true, Ordering::Relaxed);
    while steps.held.is_some() {
        steps.next().await?;
    }
    match ended {
        Err(ActorError::Refused(status)) if is_over(&status) => {
            Ok(Ended::Dropped(describe(&status)))
        }
        Err(error) => give_back(client, &beat, error).await,
        Ok(ended) => Ok(ended),
    }
}

/// Returns a lease that `error` ended, if its work is the cause.
async fn give_back(
    client: &mut Client,
    beat: &Heartbeat,
    error: ActorError,
) -> Result<Ended, ActorError> {
    let failure = match &error {
        ActorError::StartState(_) => LeaseFailure::StartState,
        ActorError::Environment(_) | ActorError::Task(_) => LeaseFailure::Environment,
        _ => return Err(error),
    };
    let Heartbeat { actor, incarnation, lease, .. } = *beat;
    let detail = error.to_string();
    let returned =
        client.return_lease(&ReturnedLease { actor, incarnation, lease, failure, detail }).await;
    match (failure, returned) {
        // Another lease may have other start states.
        (LeaseFailure::StartState, returned) => {
            returned.map(|()| Ended::Dropped(error.to_string()))
        }
        (LeaseFailure::Environment, Ok(())) => Err(error),
        (LeaseFailure::Environment, Err(error_of_return)) => {
            tracing::warn!("lease {lease} could not be returned: {error_of_return}");
            Err(error)
        }
    }
}

/// Whether the lease was revoked or its data corrupted in transit; the actor continues with a new lease.
fn is_over(status: &Status) -> bool {
    matches!(status.code(), Code::Aborted | Code::DataLoss)
}

async fn stream(
    client: &mut Client,
    steps: &mut LeaseSteps<'_>,
    mut beat: Heartbeat,
    heartbeat_interval: Duration,
) -> Result<Ended, ActorError> {
    let progress = Arc::clone(&steps.progress);
    // Before the round trip that opens the stream.
    steps.start_if_free()?;
    let mut push = client.open_push().await?;
    let mut heartbeats = tokio::time::interval(heartbeat_interval);
    heartbeats.tick().await;
    let mut unacknowledged = 0_usize;
    loop {
        tokio::select! {
            produced = steps.next(), if unacknowledged < MAX_UNACKNOWLEDGED => {
                match produced? {
                    JobOutput::Message(message) => {
                        unacknowledged += 1;
                        // If the stream is closed, its status has the reason.
                        let _ = push.results.send(*message).await;
                    }
                    JobOutput::End => {}
                    JobOutput::Failed(error) => return Err(ActorError::of_lease(error, beat.lease)),
                }
            }
            () = progress.nearly_done.notified() => steps.turn = None,
            ack = push.acknowledgements.message() => {
                let ack = ack?.ok_or_else(|| Status::unavailable("the learner closed the stream"))?;
                unacknowledged = unacknowledged.saturating_sub(1);
                if Ack::from_wire(&ack)?.lease_finished {
                    return Ok(Ended::Finished);
                }
            }
            _ = heartbeats.tick() => {
                beat.slot_step = progress.step.load(Ordering::Relaxed);
                if !client.heartbeat(&beat).await?.lease_valid {
                    return Ok(Ended::Dropped("the learner has revoked it".to_owned()));
                }
            }
        }
    }
}

fn gone() -> ActorError {
    ActorError::Other("the stepping thread ended: its channel is closed".to_owned())
}
