//! Results coming in over one stream: read, checked, taken in and acknowledged one after another.

use std::sync::Arc;
use std::time::Duration;

use proto::wire::push_trajectory_request::Content;
use proto::{
    Ack, AckState, EvaluationResult, Film, LeaseId, PushHeader, Reason, Refusal, TrajectoryChunk,
    wire,
};
use tokio::sync::mpsc;
use tokio::sync::mpsc::error::SendTimeoutError;
use tonic::{Code, Status, Streaming};

use crate::exchange::{Caller, Exchange};

/// A stream on which no whole message came for this long is closed.
const SILENCE: Duration = Duration::from_secs(300);
/// An acknowledgement that is not taken away for this long ends the stream.
const ACK_DEADLINE: Duration = Duration::from_secs(10);

/// Acknowledgements of one stream.
type Acks = mpsc::Sender<Result<wire::PushTrajectoryResponse, Status>>;

/// Takes in everything that comes over `inbound`, until it ends or something is refused.
pub(super) async fn pump(
    exchange: Arc<Exchange>,
    caller: Caller,
    mut inbound: Streaming<wire::PushTrajectoryRequest>,
    acks: Acks,
) {
    let mut lease = None;
    loop {
        let next = tokio::select! {
            () = acks.closed() => return,
            next = tokio::time::timeout(SILENCE, inbound.message()) => next,
        };
        let result = match next {
            Ok(Ok(None)) => return,
            Ok(Ok(Some(request))) => {
                lease = Some(LeaseId(request.lease_id));
                exchange.count_bytes(proto::wire_bytes(&request));
                take_in(&exchange, caller, request).await
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
    let result = tokio::task::spawn_blocking(move || read(&shared, request)).await;
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
fn read(exchange: &Exchange, mut request: wire::PushTrajectoryRequest) -> Result<Ack, Refusal> {
    let film = request.film.take();
    let (header, content) = PushHeader::from_wire(request)?;
    match content {
        Content::Chunk(chunk) => {
            let state = exchange.preview_chunk(&header, chunk.sequence)?;
            let chunk = TrajectoryChunk::from_wire(&chunk, exchange.run(), header.digest)?;
            log(&header, chunk.sequence, state);
            exchange.accept_chunk(&header, chunk)
        }
        Content::Evaluation(result) => {
            let result = EvaluationResult::from_wire(&result, exchange.run(), header.digest)?;
            let ack = exchange.accept_evaluation(&header, result)?;
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

fn log(header: &PushHeader, sequence: u32, state: AckState) {
    tracing::trace!(lease = %header.lease, sequence, ?state, "chunk");
}
