//! Messages of the wire: arbitrary bytes as each kind of message, and chunks that were changed before or after their
//! digest was taken, so that what stands behind the digest is reached as well.
#![no_main]

#[path = "../../proto/tests/wire/sample.rs"]
mod sample;

use arbitrary::{Arbitrary, Unstructured};
use bytes::Bytes;
use libfuzzer_sys::fuzz_target;
use prost::Message;
use proto::wire::push_trajectory_request::Content;
use proto::{
    AgentChunk, Digest, EvaluationResult, LeaseAnswer, PushHeader, Registration, RunDescription,
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
        _ => {
            // Too few bytes for a whole list of changes are no case.
            let _judged = changed(&mut Unstructured::new(bytes), &run);
        }
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
    let _judged = read.check(&sample::run());
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

/// A change of the content before its digest is taken.
#[derive(Arbitrary, Debug)]
enum Change {
    Number { array: u8, at: u8, value: f32 },
    Terminated(u8),
    Truncated(u8),
    FinalKey { at: u8, step: u32, environment: u32 },
    FinalTwice(u8),
    FinalGone(u8),
    EndGone,
    EndState { environment: u8, bytes: Vec<u8> },
    Counters { sequence: u32, first_step: u32, steps: u32 },
}

/// A change of the message that its digest does not see, or that comes after it.
#[derive(Arbitrary, Debug)]
enum Forgery {
    Shape { tensor: u8, shape: Vec<u32> },
    Type { tensor: u8, data_type: i32 },
    Bytes { tensor: u8, bytes: Vec<u8> },
    Gone(u8),
    AgentGone,
    EndStateGone,
}

fn changed(unstructured: &mut Unstructured<'_>, run: &RunDescription) -> arbitrary::Result<()> {
    let mut chunk = sample::chunk(u32::from(bool::arbitrary(unstructured)?));
    for change in Vec::<Change>::arbitrary(unstructured)? {
        apply(&mut chunk, change);
    }
    let (mut message, digest) = chunk.to_wire(run, &sample::origin());
    for forgery in Vec::<Forgery>::arbitrary(unstructured)? {
        forge(&mut message, forgery);
    }
    taken_in(&message, run, digest);
    Ok(())
}

fn apply(chunk: &mut TrajectoryChunk, change: Change) {
    match change {
        Change::Number { array, at, value } => {
            let numbers = numbers(chunk, array);
            let at = usize::from(at).checked_rem(numbers.len());
            at.into_iter().for_each(|at| numbers[at] = value);
        }
        Change::Terminated(at) => chunk.terminated[usize::from(at) % 4] ^= true,
        Change::Truncated(at) => chunk.truncated[usize::from(at) % 4] ^= true,
        Change::FinalKey { at, step, environment } => {
            let count = chunk.finals.len().max(1);
            if let Some(last) = chunk.finals.get_mut(usize::from(at) % count) {
                (last.step, last.environment) = (step, environment);
            }
        }
        Change::FinalTwice(at) => {
            let again = chunk.finals.get(usize::from(at)).cloned();
            chunk.finals.extend(again);
        }
        Change::FinalGone(at) if usize::from(at) < chunk.finals.len() => {
            drop(chunk.finals.remove(at.into()));
        }
        Change::FinalGone(_) => {}
        Change::EndGone => chunk.end = None,
        Change::EndState { environment, bytes } => {
            let states = chunk.end.iter_mut().flat_map(|end| &mut end.environments);
            let state = states.skip(usize::from(environment)).take(1);
            state.for_each(|state| state.clone_from(&bytes));
        }
        Change::Counters { sequence, first_step, steps } => {
            (chunk.sequence, chunk.first_step, chunk.steps) = (sequence, first_step, steps);
        }
    }
}

fn numbers(chunk: &mut TrajectoryChunk, array: u8) -> &mut Vec<f32> {
    let (agent, array) = (usize::from(array / 8) % chunk.agents.len(), array % 8);
    let AgentChunk { observation, action, log_prob, hidden } = &mut chunk.agents[agent];
    match array {
        0 => observation,
        1 => action,
        2 => log_prob,
        3 => hidden,
        4 => &mut chunk.state,
        _ => &mut chunk.reward,
    }
}

fn forge(message: &mut wire::TrajectoryChunk, forgery: Forgery) {
    match forgery {
        Forgery::Shape { tensor, shape } => edit(message, tensor, |it| it.shape = shape),
        Forgery::Type { tensor, data_type } => {
            edit(message, tensor, |it| it.data_type = data_type);
        }
        Forgery::Bytes { tensor, bytes } => {
            edit(message, tensor, |it| it.data = Bytes::from(bytes));
        }
        Forgery::Gone(tensor) => *place(message, tensor) = None,
        Forgery::AgentGone => drop(message.agents.pop()),
        Forgery::EndStateGone => {
            message.end.iter_mut().for_each(|end| drop(end.environments.pop()));
        }
    }
}

fn edit(message: &mut wire::TrajectoryChunk, tensor: u8, change: impl FnOnce(&mut wire::Tensor)) {
    if let Some(it) = place(message, tensor) {
        change(it);
    }
}

fn place(message: &mut wire::TrajectoryChunk, tensor: u8) -> &mut Option<wire::Tensor> {
    if tensor >= 128 && !message.agents.is_empty() {
        let agent = usize::from(tensor) % message.agents.len();
        let agent = &mut message.agents[agent];
        return match tensor / 4 % 4 {
            0 => &mut agent.observation,
            1 => &mut agent.action,
            2 => &mut agent.log_prob,
            _ => &mut agent.hidden,
        };
    }
    match tensor % 5 {
        0 => &mut message.state,
        1 => &mut message.reward,
        2 => &mut message.terminated,
        3 => &mut message.truncated,
        _ => &mut message.finals.get_or_insert_default().state,
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
