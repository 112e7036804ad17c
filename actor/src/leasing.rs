//! Processing of a lease, from the stepping thread's results to their acknowledgements.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use policy::PolicySnapshot;
use proto::{Ack, Heartbeat, Lease, Registered};
use tokio::sync::MutexGuard;
use tonic::{Code, Status};

use crate::client::{Client, MAX_UNACKNOWLEDGED};
use crate::error::{ActorError, describe};
use crate::stepping::{Job, JobOutput, JobProgress, Stepper};

/// End of a lease for this actor.
pub(crate) enum Ended {
    /// All messages are acknowledged.
    Finished,
    /// The learner revoked the lease or rejected its data.
    Dropped(String),
}

/// The stepping thread, until its last output for the lease.
type HeldStepper<'a> = Option<MutexGuard<'a, Stepper>>;

/// Processes `lease` with the stepping thread, streams its results and sends heartbeats until all messages are
/// acknowledged. Steps begin before the stream to the learner is open. The stepping thread is released as soon as it has
/// produced all results.
pub(crate) async fn process_lease(
    client: &mut Client,
    own: &Registered,
    stepper: MutexGuard<'_, Stepper>,
    lease: Lease,
    policy: Arc<PolicySnapshot>,
    pace: Duration,
) -> Result<Ended, ActorError> {
    let progress = Arc::new(JobProgress::default());
    let beat =
        Heartbeat { actor: own.actor, incarnation: own.incarnation, lease: lease.id, slot_step: 0 };
    let job = Job { lease, policy, progress: Arc::clone(&progress) };
    stepper.jobs.send(job).await.map_err(|_| gone())?;
    let mut stepper = Some(stepper);
    let ended = stream(client, &mut stepper, beat, (&progress, pace)).await;
    // Also if no stream could be opened: the next lease must not get this one's results.
    progress.cancelled.store(true, Ordering::Relaxed);
    while stepper.is_some() {
        if let JobOutput::End | JobOutput::Failed(_) = next(&mut stepper).await? {
            stepper = None;
        }
    }
    match ended {
        Err(ActorError::Refused(status)) if is_over(&status) => {
            Ok(Ended::Dropped(describe(&status)))
        }
        other => other,
    }
}

/// Whether the lease was revoked or its data corrupted in transit; the actor continues with a new lease.
fn is_over(status: &Status) -> bool {
    matches!(status.code(), Code::Aborted | Code::DataLoss)
}

async fn stream(
    client: &mut Client,
    stepper: &mut HeldStepper<'_>,
    mut beat: Heartbeat,
    (progress, pace): (&JobProgress, Duration),
) -> Result<Ended, ActorError> {
    let mut push = client.open_push().await?;
    let mut pulse = tokio::time::interval(pace);
    pulse.tick().await;
    let mut unacknowledged = 0_usize;
    loop {
        let room = stepper.is_some() && unacknowledged < MAX_UNACKNOWLEDGED;
        tokio::select! {
            produced = next(stepper), if room => {
                match produced? {
                    JobOutput::Message(message) => {
                        unacknowledged += 1;
                        // If the stream is closed, its status has the reason.
                        let _ = push.results.send(*message).await;
                    }
                    JobOutput::End => *stepper = None,
                    JobOutput::Failed(error) => {
                        *stepper = None;
                        return Err(ActorError::of_lease(error, beat.lease));
                    }
                }
            }
            ack = push.acknowledgements.message() => {
                let ack = ack?.ok_or_else(|| Status::unavailable("the learner closed the stream"))?;
                unacknowledged = unacknowledged.saturating_sub(1);
                if Ack::from_wire(&ack)?.lease_finished {
                    return Ok(Ended::Finished);
                }
            }
            _ = pulse.tick() => {
                beat.slot_step = progress.step.load(Ordering::Relaxed);
                if !client.heartbeat(&beat).await?.lease_valid {
                    return Ok(Ended::Dropped("the learner has revoked it".to_owned()));
                }
            }
        }
    }
}

/// Next output of the stepping thread; never completes once the thread is released.
async fn next(stepper: &mut HeldStepper<'_>) -> Result<JobOutput, ActorError> {
    match stepper {
        Some(stepper) => stepper.outputs.recv().await.ok_or_else(gone),
        None => std::future::pending().await,
    }
}

fn gone() -> ActorError {
    ActorError::Stepping("its channel is closed".to_owned())
}
