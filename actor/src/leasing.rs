//! One lease, from the stepping thread's results to their acknowledgements.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use policy::PolicySnapshot;
use proto::{Ack, Beat, Lease, Registered};
use tonic::{Code, Status};
use tracing::Instrument as _;

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

/// Where a lease stands.
#[derive(Default)]
struct Progress {
    /// Messages sent and not acknowledged.
    waiting: usize,
    /// The stepping thread has nothing more to say.
    produced_all: bool,
}

/// Has the stepping thread work off `lease`, streams what it produces and keeps the lease alive.
/// When it returns, the stepping thread is idle.
pub(crate) async fn work_off(
    client: &mut Client,
    own: &Registered,
    stepper: &mut Stepper,
    lease: Lease,
    policy: Arc<PolicySnapshot>,
    pace: Duration,
) -> Result<Ended, ActorError> {
    let watch = Arc::new(Watch::default());
    let beat =
        Beat { actor: own.actor, incarnation: own.incarnation, lease: lease.id, slot_step: 0 };
    let mut push = client.open_push().await?;
    let span = tracing::Span::current();
    let job = Job { lease, policy, watch: Arc::clone(&watch), span };
    stepper.jobs.send(job).await.map_err(|_| gone())?;
    let mut progress = Progress::default();
    let ended = stream(client, stepper, &mut push, beat, (&watch, pace), &mut progress)
        .instrument(tracing::trace_span!("push"))
        .await;
    watch.cancelled.store(true, Ordering::Relaxed);
    while !progress.produced_all {
        progress.produced_all = match stepper.produced.recv().await {
            Some(Produced::Message(_)) => false,
            Some(Produced::End | Produced::Failed(_)) => true,
            None => return Err(gone()),
        };
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
    stepper: &mut Stepper,
    push: &mut PushStream,
    mut beat: Beat,
    (watch, pace): (&Watch, Duration),
    progress: &mut Progress,
) -> Result<Ended, ActorError> {
    let mut pulse = tokio::time::interval(pace);
    pulse.tick().await;
    loop {
        let room = !progress.produced_all && progress.waiting < MAX_UNACKNOWLEDGED;
        tokio::select! {
            produced = stepper.produced.recv(), if room => {
                match produced.ok_or_else(gone)? {
                    Produced::Message(message) => {
                        progress.waiting += 1;
                        // If the stream is closed, its status says why.
                        let _ = push.results.send(*message).await;
                    }
                    Produced::End => progress.produced_all = true,
                    Produced::Failed(error) => {
                        progress.produced_all = true;
                        return Err(error.of_lease(beat.lease));
                    }
                }
            }
            ack = push.acknowledgements.message() => {
                let ack = ack?.ok_or_else(|| Status::unavailable("the learner closed the stream"))?;
                progress.waiting = progress.waiting.saturating_sub(1);
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

fn gone() -> ActorError {
    ActorError::Stepping("its channel is closed".to_owned())
}
