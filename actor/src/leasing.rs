//! One lease, from the stepping thread's results to their acknowledgements.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use policy::PolicySnapshot;
use proto::{Ack, Heartbeat, Lease, Registered};
use tokio::sync::MappedMutexGuard;
use tonic::{Code, Status};

use crate::client::{Client, MAX_UNACKNOWLEDGED, PushStream};
use crate::error::{ActorError, describe};
use crate::stepping::{Job, Produced, Stepper, Watch};

/// How a lease ended for this actor.
pub(crate) enum Ended {
    /// Every message is acknowledged.
    Finished,
    /// The learner wants nothing more of it.
    Dropped(String),
}

/// The stepping thread, until it has nothing more to say about the lease.
type Held<'a> = Option<MappedMutexGuard<'a, Stepper>>;

/// Has the stepping thread work off `lease`, streams what it produces and keeps the lease alive until
/// every message is acknowledged. The stepping thread is given back, idle, before that: as soon as it has produced all.
pub(crate) async fn work_off(
    client: &mut Client,
    own: &Registered,
    stepper: MappedMutexGuard<'_, Stepper>,
    lease: Lease,
    policy: Arc<PolicySnapshot>,
    pace: Duration,
) -> Result<Ended, ActorError> {
    let watch = Arc::new(Watch::default());
    let beat =
        Heartbeat { actor: own.actor, incarnation: own.incarnation, lease: lease.id, slot_step: 0 };
    let mut push = client.open_push().await?;
    let job = Job { lease, policy, watch: Arc::clone(&watch) };
    stepper.jobs.send(job).await.map_err(|_| gone())?;
    let mut stepper = Some(stepper);
    let ended = stream(client, &mut stepper, &mut push, beat, (&watch, pace)).await;
    watch.cancelled.store(true, Ordering::Relaxed);
    while stepper.is_some() {
        if let Produced::End | Produced::Failed(_) = next(&mut stepper).await? {
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

/// The lease is void, or its bytes were damaged on the way: another lease mends both.
fn is_over(status: &Status) -> bool {
    matches!(status.code(), Code::Aborted | Code::DataLoss)
}

async fn stream(
    client: &mut Client,
    stepper: &mut Held<'_>,
    push: &mut PushStream,
    mut beat: Heartbeat,
    (watch, pace): (&Watch, Duration),
) -> Result<Ended, ActorError> {
    let mut pulse = tokio::time::interval(pace);
    pulse.tick().await;
    let mut unacknowledged = 0_usize;
    loop {
        let room = stepper.is_some() && unacknowledged < MAX_UNACKNOWLEDGED;
        tokio::select! {
            produced = next(stepper), if room => {
                match produced? {
                    Produced::Message(message) => {
                        unacknowledged += 1;
                        // If the stream is closed, its status says why.
                        let _ = push.results.send(*message).await;
                    }
                    Produced::End => *stepper = None,
                    Produced::Failed(error) => {
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
                beat.slot_step = watch.step.load(Ordering::Relaxed);
                if !client.heartbeat(&beat).await?.lease_valid {
                    return Ok(Ended::Dropped("the learner has ended it".to_owned()));
                }
            }
        }
    }
}

/// What the stepping thread produces next. Waits for ever once it is given back.
async fn next(stepper: &mut Held<'_>) -> Result<Produced, ActorError> {
    match stepper {
        Some(stepper) => stepper.produced.recv().await.ok_or_else(gone),
        None => std::future::pending().await,
    }
}

fn gone() -> ActorError {
    ActorError::Stepping("its channel is closed".to_owned())
}
