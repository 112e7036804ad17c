//! Streams a policy snapshot: one header, then pieces that are slices of one copy in memory.

use std::time::Duration;

use bytes::Bytes;
use proto::wire::get_weights_response::Part;
use proto::{WeightsName, wire};
use tokio::sync::mpsc;
use tokio::sync::mpsc::error::SendTimeoutError;
use tokio_stream::wrappers::ReceiverStream;
use tonic::Status;

use crate::exchange::Caller;

/// Longest time for the actor to receive a piece before the stream is closed.
const PIECE_TIMEOUT: Duration = Duration::from_secs(30);
/// Size of a piece, bytes; smaller than the limit of a message. The allocator reuses small message buffers, while large
/// ones are returned to the system, which then clears their pages again.
const PIECE_BYTES: usize = 64 << 10;
/// Pieces buffered per stream.
const PIECES_AHEAD: usize = 2;

/// Streams the snapshot `bytes` with the name `name`.
pub(super) fn stream(
    name: WeightsName,
    bytes: Bytes,
    caller: Caller,
) -> ReceiverStream<Result<wire::GetWeightsResponse, Status>> {
    // A full channel means a slow actor; the task below then waits without copying.
    let (sender, stream) = mpsc::channel(PIECES_AHEAD);
    tokio::spawn(async move {
        for part in parts(name, &bytes) {
            let response = wire::GetWeightsResponse { part: Some(part) };
            if let Err(error) = sender.send_timeout(Ok(response), PIECE_TIMEOUT).await {
                let version = name.version;
                let why = reason(&error);
                tracing::warn!(%version, "{caller}: stream closed, {why}; the actor may request them again");
                return;
            }
        }
    });
    ReceiverStream::new(stream)
}

fn reason<T>(error: &SendTimeoutError<T>) -> String {
    match error {
        SendTimeoutError::Timeout(_) => {
            format!("a piece of the weights was not received within {} s", PIECE_TIMEOUT.as_secs())
        }
        SendTimeoutError::Closed(_) => {
            "the actor disconnected before it had received the weights".to_owned()
        }
    }
}

fn parts(name: WeightsName, bytes: &Bytes) -> impl Iterator<Item = Part> {
    let header =
        wire::WeightsHeader { weights: Some(name.to_wire()), total_bytes: bytes.len() as u64 };
    let starts = (0..bytes.len()).step_by(PIECE_BYTES);
    let pieces = starts.map(|start| {
        let end = bytes.len().min(start + PIECE_BYTES);
        Part::Data(bytes.slice(start..end))
    });
    std::iter::once(Part::Header(header)).chain(pieces)
}

#[cfg(test)]
mod tests {
    use proto::{Digest, MAX_WEIGHTS_PIECE_BYTES, PolicyVersion};

    use super::*;

    #[test]
    fn a_snapshot_is_split_into_equal_pieces_and_a_remainder() {
        let bytes = Bytes::from(vec![7; 2 * PIECE_BYTES + 5]);
        const { assert!(PIECE_BYTES <= MAX_WEIGHTS_PIECE_BYTES) };
        let name = WeightsName { version: PolicyVersion(3), digest: Digest::of(&bytes) };
        let parts = parts(name, &bytes).collect::<Vec<_>>();
        let sizes = parts.iter().map(|part| match part {
            Part::Header(header) => header.total_bytes as usize,
            Part::Data(data) => data.len(),
        });
        assert_eq!(sizes.collect::<Vec<_>>(), [bytes.len(), PIECE_BYTES, PIECE_BYTES, 5]);
    }
}
