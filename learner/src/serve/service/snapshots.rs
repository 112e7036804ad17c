//! Streams a policy snapshot: one header, then pieces that are slices of one copy in memory, and repeats of earlier bytes.

use std::ops::Range;
use std::time::Duration;

use bytes::Bytes;
use policy::snapshot::Repeat;
use proto::wire::get_weights_response::Part;
use proto::{WeightsName, wire};
use tokio::sync::mpsc;
use tokio::sync::mpsc::error::SendTimeoutError;
use tokio_stream::wrappers::ReceiverStream;
use tonic::Status;

use crate::lease::exchange::Caller;

/// Longest time for the actor to receive a piece before the stream is closed.
const PIECE_TIMEOUT: Duration = Duration::from_secs(30);
/// Size of a piece, bytes; smaller than the limit of a message. The allocator reuses small message buffers, while large
/// ones are returned to the system, which then clears their pages again.
const PIECE_BYTES: usize = 64 << 10;
/// Pieces buffered per stream.
const PIECES_AHEAD: usize = 2;

/// Streams the snapshot `bytes` with the name `name`, and names its `repeats` instead of sending them.
pub(super) fn stream(
    name: WeightsName,
    bytes: Bytes,
    repeats: Vec<Repeat>,
    caller: Caller,
) -> ReceiverStream<Result<wire::GetWeightsResponse, Status>> {
    // A full channel means a slow actor; the task below then waits without copying.
    let (sender, stream) = mpsc::channel(PIECES_AHEAD);
    tokio::spawn(async move {
        for part in parts(name, &bytes, &repeats) {
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

fn parts(name: WeightsName, bytes: &Bytes, repeats: &[Repeat]) -> Vec<Part> {
    let header =
        wire::WeightsHeader { weights: Some(name.to_wire()), total_bytes: bytes.len() as u64 };
    let mut parts = vec![Part::Header(header)];
    let mut sent = 0;
    for Repeat { at, of, length } in repeats {
        parts.extend(pieces(bytes, sent..*at));
        let (offset, length) = (*of as u64, *length as u64);
        parts.push(Part::Repeat(wire::WeightsRepeat { offset, length }));
        sent = at + length as usize;
    }
    parts.extend(pieces(bytes, sent..bytes.len()));
    parts
}

fn pieces(bytes: &Bytes, range: Range<usize>) -> impl Iterator<Item = Part> {
    let starts = range.clone().step_by(PIECE_BYTES);
    starts.map(move |start| Part::Data(bytes.slice(start..range.end.min(start + PIECE_BYTES))))
}

#[cfg(test)]
mod tests {
    use proto::{Digest, PolicyVersion};

    use super::*;

    #[test]
    fn a_snapshot_is_split_into_equal_pieces_and_a_remainder_around_its_repeats() {
        let bytes = Bytes::from(vec![7; 2 * PIECE_BYTES + 5]);
        const { assert!(PIECE_BYTES <= 1 << 20, "the protocol's limit of a piece") };
        let name = WeightsName { version: PolicyVersion(3), digest: Digest::of(&bytes) };
        let sizes = |repeats: &[Repeat]| {
            let size = |part: &Part| match part {
                Part::Header(header) => header.total_bytes as usize,
                Part::Data(data) => data.len(),
                Part::Repeat(repeat) => (repeat.offset + 1000 * repeat.length) as usize,
            };
            parts(name, &bytes, repeats).iter().map(size).collect::<Vec<_>>()
        };
        assert_eq!(sizes(&[]), [bytes.len(), PIECE_BYTES, PIECE_BYTES, 5]);
        let repeats = [
            Repeat { at: 20, of: 3, length: 4 },
            Repeat { at: 24, of: 0, length: 2 * PIECE_BYTES - 24 },
        ];
        let last = 1000 * (2 * PIECE_BYTES - 24);
        assert_eq!(sizes(&repeats), [bytes.len(), 20, 4003, last, 5]);
    }
}
