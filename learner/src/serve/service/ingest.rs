//! Receives the results of one stream: reads, checks, accepts and acknowledges one message after another.

use std::sync::Arc;
use std::time::Duration;

use proto::wire::push_trajectory_request::Content;
use proto::{Ack, Film, LeaseId, PushHeader, Reason, Refusal, wire};
use tokio::sync::mpsc::error::SendTimeoutError;
use tokio::sync::{Semaphore, mpsc};
use tonic::{Status, Streaming};

use crate::lease::exchange::{Caller, Exchange};
use crate::lease::slots::{ConnectionId, Preview, ResultPart};
use crate::serve::service::bodies::Share;

/// Longest time without a complete message before the stream is closed.
const MESSAGE_TIMEOUT: Duration = Duration::from_secs(300);
/// Longest time for the actor to receive an acknowledgement before the stream is closed.
const ACK_TIMEOUT: Duration = Duration::from_secs(10);

/// Acknowledgements of one stream.
type Acks = mpsc::Sender<Result<wire::PushTrajectoryResponse, Status>>;

/// A stream of results.
pub(super) struct Results {
    pub(super) messages: Streaming<wire::PushTrajectoryRequest>,
    /// Permits of the connection; further streams wait.
    pub(super) pushes: Arc<Semaphore>,
    /// The stream's share of the byte budget.
    pub(super) share: Option<Arc<Share>>,
    /// Permits of concurrent checks, over all streams.
    pub(super) checks: Arc<Semaphore>,
}

/// Accepts the messages of a stream until it ends or one is rejected.
pub(super) async fn pump(exchange: Arc<Exchange>, caller: Caller, results: Results, acks: Acks) {
    let Results { mut messages, pushes, share, checks } = results;
    let _permit = tokio::select! {
        () = acks.closed() => return,
        permit = pushes.acquire_owned() => permit,
    };
    let mut lease = None;
    loop {
        let next = tokio::select! {
            () = acks.closed() => return,
            next = tokio::time::timeout(MESSAGE_TIMEOUT, messages.message()) => next,
        };
        let result = match next {
            Ok(Ok(None)) => return,
            Ok(Ok(Some(request))) => {
                lease = Some(LeaseId(request.lease_id));
                exchange.count_bytes(proto::wire_bytes(&request));
                let accepted = accept(&exchange, caller, request, &checks).await;
                share.iter().for_each(|share| share.processed());
                accepted
            }
            Ok(Err(status)) => match super::unreadable(&status) {
                None => return,
                Some(refusal) => Err(super::refused(&exchange, &caller, lease, refusal)),
            },
            // An episode is one message, however slow; its lease expires if the actor is silent.
            Err(_) if exchange.holds_lease(caller.connection) => continue,
            Err(_) => {
                let detail = format!("no message for {} s", MESSAGE_TIMEOUT.as_secs());
                let refusal = Refusal::new(Reason::TooSlow, "stream", detail);
                Err(super::refused(&exchange, &caller, lease, refusal))
            }
        };
        let last = result.is_err();
        if let Err(SendTimeoutError::Timeout(_)) = acks.send_timeout(result, ACK_TIMEOUT).await {
            let secs = ACK_TIMEOUT.as_secs();
            tracing::warn!(
                "{caller}: stream closed, an acknowledgement was not received within {secs} s; the lease expires \
                 unless the actor reconnects"
            );
            return;
        }
        if last {
            return;
        }
    }
}

/// Checks and accepts one message on a blocking thread, because the checks compute.
async fn accept(
    exchange: &Arc<Exchange>,
    caller: Caller,
    request: wire::PushTrajectoryRequest,
    checks: &Semaphore,
) -> Result<wire::PushTrajectoryResponse, Status> {
    // The semaphore is never closed.
    let _permit = checks.acquire().await;
    let shared = Arc::clone(exchange);
    let lease = LeaseId(request.lease_id);
    let result =
        tokio::task::spawn_blocking(move || read(&shared, caller.connection, request)).await;
    match result {
        Ok(Ok(ack)) => Ok(ack.to_wire()),
        Ok(Err(refusal)) => Err(super::refused(exchange, &caller, Some(lease), refusal)),
        Err(panic) => {
            tracing::error!(%lease, "{caller}: the check of a message failed: {panic}; the stream is closed");
            Err(Status::internal("the check of this message failed"))
        }
    }
}

/// Checks the header, the lease and the order, the content, and the canary, in this order, and takes the result in.
fn read(
    exchange: &Exchange,
    sender: ConnectionId,
    mut request: wire::PushTrajectoryRequest,
) -> Result<Ack, Refusal> {
    let film = request.film.take();
    let (header, content) = PushHeader::from_wire(request)?;
    let sequence = match &content {
        Content::Chunk(chunk) => Some(chunk.sequence),
        Content::Evaluation(_) => None,
    };
    let check = match exchange.expected(sender, &header, sequence)? {
        Preview::Repeated(ack) => return Ok(ack),
        Preview::Next(check) => check,
    };
    // Not under the exchange's lock: this takes milliseconds.
    let part = check.read(&content, header.digest, &exchange.run, &exchange.states)?;
    let filmed = match (&part, film) {
        (ResultPart::Episode(result), Some(film)) => Some((result.clone(), film)),
        _ => None,
    };
    let ack = exchange.take(sender, &header, &check, part)?;
    if let Some((result, film)) = filmed {
        // No result depends on a film, so an invalid film does not end the lease.
        match Film::from_wire(&film, &exchange.run) {
            Ok(film) => exchange.keep_film(&header, result, film),
            Err(why) => tracing::warn!(lease = %header.lease, "film ignored: {why}"),
        }
    }
    Ok(ack)
}
