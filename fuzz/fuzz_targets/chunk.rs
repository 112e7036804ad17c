//! Messages of the wire: arbitrary bytes as each kind of message, and as chunks with the right digest, so that the checks
//! after that of the digest are reached as well.
#![no_main]
#![expect(dead_code, reason = "only the seeds take chunks of the sample")]

#[path = "../../proto/tests/wire/sample.rs"]
mod sample;

use libfuzzer_sys::fuzz_target;
use prost::Message;
use proto::wire::push_trajectory_request::Content;
use proto::{
    Digest, EvaluationResult, LeaseAnswer, PushHeader, Registration, RunDescription,
    TrajectoryChunk, wire,
};

fuzz_target!(|data: &[u8]| {
    let Some((kind, bytes)) = data.split_first() else { return };
    let run = sample::run();
    match kind % 5 {
        0 => push(bytes, &run),
        1 => registration(bytes),
        2 => lease_answer(bytes, &run),
        3 => description(bytes),
        _ => with_its_digest(bytes, &run),
    }
});

fn push(bytes: &[u8], run: &RunDescription) {
    let Ok(message) = wire::PushTrajectoryRequest::decode(bytes) else { return };
    match PushHeader::from_wire(message) {
        Ok((header, Content::Chunk(chunk))) => taken_in(&chunk, run, header.digest),
        Ok((header, Content::Evaluation(result))) => {
            let read = EvaluationResult::from_wire(&result, run, 3, header.digest);
            read.into_iter().for_each(|read| assert_eq!(read.digest(3), header.digest));
        }
        Err(_) => {}
    }
}

fn registration(bytes: &[u8]) {
    let Ok(message) = wire::RegisterRequest::decode(bytes) else { return };
    let Ok(read) = Registration::from_wire(message) else { return };
    let _checked = read.check(&sample::run());
}

fn lease_answer(bytes: &[u8], run: &RunDescription) {
    let Ok(message) = wire::LeaseSlotsResponse::decode(bytes) else { return };
    let Ok(read) = LeaseAnswer::from_wire(message, run) else { return };
    assert_eq!(LeaseAnswer::from_wire(read.to_wire(), run), Ok(read));
}

fn description(bytes: &[u8]) {
    let Ok(message) = wire::RunDescription::decode(bytes) else { return };
    let Ok(read) = RunDescription::from_wire(Some(message)) else { return };
    if read.validate().is_ok() {
        assert!(read.chunks_per_slot() > 0);
    }
}

/// A chunk with the digest of its content, which the refusal of a wrong one names.
fn with_its_digest(bytes: &[u8], run: &RunDescription) {
    let Ok(message) = wire::TrajectoryChunk::decode(bytes) else { return };
    let wrong = Digest([0; 32]);
    let refused = TrajectoryChunk::from_wire(&message, run, &sample::origin(), wrong).err();
    let digits = refused.as_ref().and_then(|it| it.detail.strip_prefix("the content has "));
    if let Some(digits) = digits {
        let byte = |i: usize| u8::from_str_radix(&digits[2 * i..][..2], 16).expect("hexadecimal");
        taken_in(&message, run, Digest(std::array::from_fn(byte)));
    }
}

/// What is taken in is what was sent: every number finite, no flag twice, and the digest that was claimed.
fn taken_in(message: &wire::TrajectoryChunk, run: &RunDescription, claimed: Digest) {
    let origin = sample::origin();
    let Ok(chunk) = TrajectoryChunk::from_wire(message, run, &origin, claimed) else { return };
    let (again, digest) = chunk.to_wire(run, &origin);
    assert_eq!(digest, claimed);
    assert_eq!(TrajectoryChunk::from_wire(&again, run, &origin, digest).as_ref(), Ok(&chunk));
    let both = chunk.terminated.iter().zip(&chunk.truncated).any(|(one, other)| *one && *other);
    assert!(!both && chunk.state.iter().chain(&chunk.reward).all(|number| number.is_finite()));
}
