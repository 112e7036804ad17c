//! Sizes that overflow, messages of the maximum size, and noise never cause a panic.

use bytes::Bytes;
use prost::Message;
use proto::Reason::{BadShape, BadValue, MissingField};
use proto::{
    Digest, LeaseAnswer, MAX_MESSAGE_BYTES, Refusal, RunDescription, TrajectoryChunk, wire,
};

use crate::{assert_refused, honest_digest, received, sample};

fn with_state(shape: &[u32], data: Bytes) -> Result<TrajectoryChunk, Refusal> {
    let (mut message, _) = sample::chunk(0).to_wire(&sample::run(), &sample::origin());
    let data_type = wire::DataType::F32.into();
    message.state = Some(wire::Tensor { data_type, shape: shape.to_vec(), data });
    received(&message, &sample::run(), honest_digest(&message, &sample::run()))
}

#[test]
fn a_shape_that_overflows_or_has_four_mebibytes_is_refused_without_an_allocation() {
    for shape in [&[u32::MAX; 2][..], &[u32::MAX; 3], &[u32::MAX; 1000], &[1 << 31, 1 << 31, 0]] {
        assert_refused(with_state(shape, Bytes::new()), BadShape, "chunk.state");
    }
    let large = with_state(&[1 << 20], vec![0; MAX_MESSAGE_BYTES].into());
    let refusal = large.unwrap_err();
    assert!(refusal.detail.contains("[1048576], expected [2, 2, 4]"), "{refusal}");
    assert_refused(Err::<(), _>(refusal), BadShape, "chunk.state");
}

#[test]
fn an_empty_message_is_refused_by_its_first_missing_part() {
    let run = sample::run();
    let nothing = wire::TrajectoryChunk::default();
    assert_refused(received(&nothing, &run, Digest([0; 32])), BadValue, "chunk.steps");
    let lease = LeaseAnswer::from_wire(wire::LeaseSlotsResponse::default(), &run);
    assert_refused(lease, MissingField, "answer");
    assert_refused(RunDescription::from_wire(None), MissingField, "run");
}

#[test]
fn a_run_whose_messages_could_not_be_sent_is_refused_by_name() {
    type Change = fn(&mut RunDescription);
    let changes: [(&str, Change); 11] = [
        ("chunk_steps", |run| run.chunk_steps = 0),
        ("chunk_steps", |run| run.slot_steps = 5),
        ("hidden_every", |run| run.hidden_every = 3),
        ("environments_per_slot", |run| run.environments_per_slot = 0),
        ("chunk_steps", |run| run.environments_per_slot = u32::MAX),
        ("chunk_steps", |run| run.environment.agents[0].action.size = u32::MAX as usize),
        ("hidden_sizes", |run| run.hidden_sizes.clear()),
        ("heartbeat_secs", |run| run.heartbeat_secs = f64::NAN),
        ("heartbeat_secs", |run| run.heartbeat_secs = 1e300),
        ("heartbeat_secs", |run| run.heartbeat_secs = 1e-300),
        ("environment.dt_secs", |run| run.environment.dt_secs = 0.0),
    ];
    for (field, change) in changes {
        let mut run = sample::run();
        change(&mut run);
        assert_eq!(run.validate().unwrap_err().field, format!("run.{field}"));
    }
}

#[test]
fn a_flipped_bit_is_refused_or_changes_no_value() {
    let run = sample::run();
    let (message, digest) = sample::chunk(1).to_wire(&run, &sample::origin());
    let honest = message.encode_to_vec();
    for bit in 0..8 * honest.len() {
        let mut bytes = honest.clone();
        bytes[bit / 8] ^= 1 << (bit % 8);
        let Ok(message) = wire::TrajectoryChunk::decode(bytes.as_slice()) else {
            continue;
        };
        if let Ok(chunk) = received(&message, &run, digest) {
            assert_eq!(chunk, sample::chunk(1), "bit {bit}");
        }
    }
}
