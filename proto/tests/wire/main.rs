//! Every message survives the round trip, and an invalid one is rejected with the name of the field.
#![expect(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

mod acting;
mod choices;
mod film;
mod hostile;
mod left_out;
mod lies;
mod peer;
mod play;
mod registration;
mod round_trips;
mod sample;

use std::fmt::Debug;

use prost::Message;
use proto::{Digest, Reason, Refusal, RunDescription, TrajectoryChunk, wire};

/// A message after the way to bytes and back.
fn sent<M: Message + Default>(message: &M) -> M {
    M::decode(message.encode_to_vec().as_slice()).unwrap()
}

/// What the learner reads from the message of a chunk.
fn received(
    message: &wire::TrajectoryChunk,
    run: &RunDescription,
    digest: Digest,
) -> Result<TrajectoryChunk, Refusal> {
    TrajectoryChunk::from_wire(&sent(message), run, &sample::origin(), digest)
}

/// The correct digest, from the refusal of a wrong one; any digest if an earlier check fails.
fn honest_digest(message: &wire::TrajectoryChunk, run: &RunDescription) -> Digest {
    let wrong = Digest([0; 32]);
    match received(message, run, wrong) {
        Err(refusal) if refusal.reason == Reason::DigestMismatch => {
            let text = refusal.detail.strip_prefix("the content has ").unwrap();
            let byte = |i| u8::from_str_radix(&text[2 * i..2 * i + 2], 16).unwrap();
            Digest(std::array::from_fn(byte))
        }
        _ => wrong,
    }
}

#[track_caller]
fn assert_refused<T: Debug>(result: Result<T, Refusal>, reason: Reason, field: &str) {
    let refusal = result.expect_err(field);
    assert_eq!((refusal.reason, refusal.field.as_str()), (reason, field), "{refusal}");
}
