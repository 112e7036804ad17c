//! Sizes that overflow, messages of the maximum size, and noise never cause a panic.

use bytes::Bytes;
use prost::Message;
use proto::{
    Digest, LeaseAnswer, MAX_MESSAGE_BYTES, Reason, Refusal, RunDescription, TrajectoryChunk, wire,
};

use crate::sample;

fn with_state(tensor: wire::Tensor) -> Refusal {
    let (mut message, digest) = sample::chunk(0).to_wire(&sample::run(), &sample::origin());
    message.state = Some(tensor);
    TrajectoryChunk::from_wire(&message, &sample::run(), &sample::origin(), digest).unwrap_err()
}

fn floats(shape: &[u32], data: Bytes) -> wire::Tensor {
    wire::Tensor { data_type: wire::DataType::F32.into(), shape: shape.to_vec(), data }
}

#[test]
fn shapes_whose_product_overflows_are_refused_without_an_allocation() {
    for shape in [&[u32::MAX; 2][..], &[u32::MAX; 3], &[u32::MAX; 1000], &[1 << 31, 1 << 31, 0]] {
        let refusal = with_state(floats(shape, Bytes::new()));
        assert_eq!((refusal.reason, refusal.field.as_str()), (Reason::BadShape, "chunk.state"));
    }
}

#[test]
fn four_mebibytes_in_one_tensor_are_refused_by_their_shape() {
    let data = Bytes::from(vec![0; MAX_MESSAGE_BYTES]);
    let refusal = with_state(floats(&[1 << 20], data));
    assert_eq!((refusal.reason, refusal.field.as_str()), (Reason::BadShape, "chunk.state"));
    assert!(refusal.detail.contains("[1048576], expected [2, 2, 4]"), "{refusal}");
}

#[test]
fn an_empty_message_is_refused_by_its_first_missing_part() {
    let (run, digest) = (sample::run(), Digest([0; 32]));
    let refusal = TrajectoryChunk::from_wire(
        &wire::TrajectoryChunk::default(),
        &run,
        &sample::origin(),
        digest,
    );
    assert_eq!(refusal.unwrap_err().field, "chunk.steps");
    let lease = LeaseAnswer::from_wire(wire::LeaseSlotsResponse::default(), &run);
    assert_eq!(lease.unwrap_err().field, "answer");
    assert_eq!(RunDescription::from_wire(None).unwrap_err().field, "run");
}

#[test]
fn a_run_whose_messages_could_not_be_sent_is_refused_by_name() {
    let refused = |change: fn(&mut RunDescription)| {
        let mut run = sample::run();
        change(&mut run);
        run.validate().unwrap_err().field
    };
    assert_eq!(refused(|run| run.chunk_steps = 0), "run.chunk_steps");
    assert_eq!(refused(|run| run.slot_steps = 5), "run.chunk_steps");
    assert_eq!(refused(|run| run.hidden_every = 3), "run.hidden_every");
    assert_eq!(refused(|run| run.environments_per_slot = 0), "run.environments_per_slot");
    assert_eq!(refused(|run| run.environments_per_slot = u32::MAX), "run.chunk_steps");
    assert_eq!(
        refused(|run| run.environment.agents[0].action.size = u32::MAX as usize),
        "run.chunk_steps"
    );
    assert_eq!(refused(|run| run.hidden_sizes.clear()), "run.hidden_sizes");
    assert_eq!(refused(|run| run.heartbeat_secs = f64::NAN), "run.heartbeat_secs");
    assert_eq!(refused(|run| run.heartbeat_secs = 1e300), "run.heartbeat_secs");
    assert_eq!(refused(|run| run.heartbeat_secs = 1e-300), "run.heartbeat_secs");
    assert_eq!(refused(|run| run.environment.dt_secs = 0.0), "run.environment.dt_secs");
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
        if let Ok(chunk) = TrajectoryChunk::from_wire(&message, &run, &sample::origin(), digest) {
            assert_eq!(chunk, sample::chunk(1), "bit {bit}");
        }
    }
}
