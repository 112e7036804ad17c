//! Results coming in over one stream: read, checked, taken in and acknowledged one after another.

use std::sync::Arc;
use std::time::Duration;

use proto::wire::push_trajectory_request::Content;
use proto::{
    Ack, EvaluationResult, Film, LeaseId, PushHeader, Reason, Refusal, RolloutOrigin,
    TrajectoryChunk, wire,
};
use tokio::sync::mpsc::error::SendTimeoutError;
use tokio::sync::{Semaphore, mpsc};
use tonic::{Code, Status, Streaming};

use crate::exchange::{Caller, Exchange};
use crate::service::bodies::Share;
use crate::slots::ConnectionId;

/// A stream on which no whole message came for this long is closed.
const SILENCE: Duration = Duration::from_secs(300);
/// An acknowledgement that is not taken away for this long ends the stream.
const ACK_DEADLINE: Duration = Duration::from_secs(10);

/// Acknowledgements of one stream.
type Acks = mpsc::Sender<Result<wire::PushTrajectoryResponse, Status>>;

/// A stream of results.
pub(super) struct Results {
    pub(super) messages: Streaming<wire::PushTrajectoryRequest>,
    /// Permits of the connection; more streams than these wait.
    pub(super) pushes: Arc<Semaphore>,
    /// What the stream holds of the budget of bytes.
    pub(super) share: Option<Arc<Share>>,
}

/// Takes in all messages of a stream, until it ends or one is refused.
pub(super) async fn pump(exchange: Arc<Exchange>, caller: Caller, results: Results, acks: Acks) {
    let Results { mut messages, pushes, share } = results;
    let _permit = tokio::select! {
        () = acks.closed() => return,
        permit = pushes.acquire_owned() => permit,
    };
    let mut lease = None;
    loop {
        let next = tokio::select! {
            () = acks.closed() => return,
            next = tokio::time::timeout(SILENCE, messages.message()) => next,
        };
        let result = match next {
            Ok(Ok(None)) => return,
            Ok(Ok(Some(request))) => {
                lease = Some(LeaseId(request.lease_id));
                exchange.count_bytes(proto::wire_bytes(&request));
                let taken = take_in(&exchange, caller, request).await;
                share.iter().for_each(|share| share.processed());
                taken
            }
            Ok(Err(status)) => match unreadable(&status) {
                None => return,
                Some(refusal) => Err(super::refused(&exchange, &caller, lease, refusal)),
            },
            Err(_) => {
                let detail = format!("no message for {} s", SILENCE.as_secs());
                let refusal = Refusal::new(Reason::TooSlow, "stream", detail);
                Err(super::refused(&exchange, &caller, lease, refusal))
            }
        };
        let last = result.is_err();
        if let Err(SendTimeoutError::Timeout(_)) = acks.send_timeout(result, ACK_DEADLINE).await {
            let secs = ACK_DEADLINE.as_secs();
            tracing::warn!(
                "{caller} breaks off: acknowledgements are not taken away for {secs} s; its lease ends \
                 unless it comes back"
            );
            return;
        }
        if last {
            return;
        }
    }
}

/// What a broken stream says about the message that broke it; `None` if the peer just went away.
fn unreadable(status: &Status) -> Option<Refusal> {
    let reason = match status.code() {
        // tonic's answer to a message over the limit.
        Code::OutOfRange | Code::ResourceExhausted => Reason::TooLarge,
        Code::Internal => Reason::Undecodable,
        _ => return None,
    };
    Some(Refusal::new(reason, "message", status.message()))
}

/// Checks and takes in one message on a thread that may compute.
async fn take_in(
    exchange: &Arc<Exchange>,
    caller: Caller,
    request: wire::PushTrajectoryRequest,
) -> Result<wire::PushTrajectoryResponse, Status> {
    let shared = Arc::clone(exchange);
    let lease = LeaseId(request.lease_id);
    let result =
        tokio::task::spawn_blocking(move || read(&shared, caller.connection, request)).await;
    match result {
        Ok(Ok(ack)) => Ok(ack.to_wire()),
        Ok(Err(refusal)) => Err(super::refused(exchange, &caller, Some(lease), refusal)),
        Err(panic) => {
            tracing::error!(%lease, "{caller}: the check of a message broke down: {panic}; its stream ends");
            Err(Status::internal("the check of this message broke down"))
        }
    }
}

/// Header, then lease and order, then the content, then the canary.
fn read(
    exchange: &Exchange,
    sender: ConnectionId,
    mut request: wire::PushTrajectoryRequest,
) -> Result<Ack, Refusal> {
    let film = request.film.take();
    let (header, content) = PushHeader::from_wire(request)?;
    match content {
        Content::Chunk(chunk) => {
            let decode = |origin: &RolloutOrigin| {
                TrajectoryChunk::from_wire(&chunk, exchange.run(), origin, header.digest)
            };
            exchange.accept_chunk(sender, &header, chunk.sequence, decode)
        }
        Content::Evaluation(result) => {
            let mut checked = None;
            let ack = exchange.accept_evaluation(sender, &header, |iteration| {
                let run = exchange.run();
                let result = EvaluationResult::from_wire(&result, run, iteration, header.digest)?;
                checked = Some(result);
                Ok(result)
            })?;
            let Some(result) = checked else { return Ok(ack) };
            // No result depends on a film, so one that does not fit costs nobody a lease.
            match film.map(|film| Film::from_wire(&film, exchange.run())).transpose() {
                Ok(film) => {
                    film.into_iter().for_each(|film| exchange.keep_film(&header, result, film))
                }
                Err(why) => tracing::warn!(lease = %header.lease, "a film is passed over: {why}"),
            }
            Ok(ack)
        }
    }
}
