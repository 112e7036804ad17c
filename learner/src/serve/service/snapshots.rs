//! A policy snapshot as a stream: one header, then pieces that are slices of the one copy in memory.

use std::time::Duration;

use bytes::Bytes;
use proto::wire::get_weights_response::Part;
use proto::{WeightsName, wire};
use tokio::sync::mpsc;
use tokio::sync::mpsc::error::SendTimeoutError;
use tokio_stream::wrappers::ReceiverStream;
use tonic::Status;

use crate::exchange::Caller;

/// A piece that is not taken away for this long ends the stream.
const PIECE_DEADLINE: Duration = Duration::from_secs(30);
/// Bytes of a piece, fewer than a message may hold. Each is encoded into a buffer of its own, and small buffers are used again where large ones go back
/// to the system, which clears their pages anew.
const PIECE_BYTES: usize = 64 << 10;
/// Pieces that wait to be taken away.
const PIECES_AHEAD: usize = 2;

/// The snapshot `bytes` called `name`.
pub(super) fn stream(
    name: WeightsName,
    bytes: Bytes,
    caller: Caller,
) -> ReceiverStream<Result<wire::GetWeightsResponse, Status>> {
    // Full when the actor reads slowly; the task below then waits, holding no copy.
    let (sender, stream) = mpsc::channel(PIECES_AHEAD);
    tokio::spawn(async move {
        for part in parts(name, &bytes) {
            let response = wire::GetWeightsResponse { part: Some(part) };
            if let Err(error) = sender.send_timeout(Ok(response), PIECE_DEADLINE).await {
                let version = name.version;
                let why = broken_off(&error);
                tracing::warn!(%version, "{caller} breaks off: {why}; it may ask for them again");
                return;
            }
        }
    });
    ReceiverStream::new(stream)
}

fn broken_off<T>(error: &SendTimeoutError<T>) -> String {
    match error {
        SendTimeoutError::Timeout(_) => {
            format!("the weights are not taken away for {} s", PIECE_DEADLINE.as_secs())
        }
        SendTimeoutError::Closed(_) => "whoever asked for the weights is gone".to_owned(),
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
    fn a_snapshot_comes_in_equal_pieces_and_a_rest() {
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
