//! An invalid chunk is rejected with the right reason and field.

use bytes::Bytes;
use proto::{Digest, EvaluationResult, Reason, Refusal, TrajectoryChunk, wire};

use crate::sample;

/// A change of a valid chunk 0 or 1, and the expected reason and field.
struct Lie {
    sequence: u32,
    tell: fn(&mut wire::TrajectoryChunk),
    reason: Reason,
    field: &'static str,
}

const fn lie(
    sequence: u32,
    tell: fn(&mut wire::TrajectoryChunk),
    reason: Reason,
    field: &'static str,
) -> Lie {
    Lie { sequence, tell, reason, field }
}

fn tensor(tensor: &mut Option<wire::Tensor>) -> &mut wire::Tensor {
    tensor.as_mut().unwrap()
}

/// Overwrites the first element.
fn set(tensor: &mut Option<wire::Tensor>, value: f32) {
    set_in(tensor.as_mut().unwrap(), value);
}

fn set_in(tensor: &mut wire::Tensor, value: f32) {
    let mut data = tensor.data.to_vec();
    data[..4].copy_from_slice(&value.to_le_bytes());
    tensor.data = Bytes::from(data);
}

fn flag(tensor: &mut Option<wire::Tensor>, row: usize, value: u8) {
    let tensor = tensor.as_mut().unwrap();
    let mut data = tensor.data.to_vec();
    data[row] = value;
    tensor.data = Bytes::from(data);
}

fn finals(chunk: &mut wire::TrajectoryChunk) -> &mut wire::FinalSteps {
    chunk.finals.as_mut().unwrap()
}

fn end(chunk: &mut wire::TrajectoryChunk) -> &mut wire::SlotEnd {
    chunk.end.as_mut().unwrap()
}

/// The digest is valid: it is computed after the change.
fn verdict(lie: &Lie) -> Refusal {
    let run = sample::run();
    let (mut message, _) = sample::chunk(lie.sequence).to_wire(&run, &sample::origin());
    (lie.tell)(&mut message);
    let digest = honest_digest(&message);
    TrajectoryChunk::from_wire(&message, &run, &sample::origin(), digest).unwrap_err()
}

/// The correct digest, from the refusal of a wrong one; any digest if an earlier check fails.
fn honest_digest(message: &wire::TrajectoryChunk) -> Digest {
    let wrong = Digest([0; 32]);
    match TrajectoryChunk::from_wire(message, &sample::run(), &sample::origin(), wrong) {
        Err(refusal) if refusal.reason == Reason::DigestMismatch => {
            let text = refusal.detail.strip_prefix("the content has ").unwrap();
            let byte = |i| u8::from_str_radix(&text[2 * i..2 * i + 2], 16).unwrap();
            Digest(std::array::from_fn(byte))
        }
        _ => wrong,
    }
}

fn assert_refused(lies: &[Lie]) {
    for (i, lie) in lies.iter().enumerate() {
        let refusal = verdict(lie);
        assert_eq!(
            (refusal.reason, refusal.field.as_str()),
            (lie.reason, lie.field),
            "lie {i}: {refusal}"
        );
    }
}

#[test]
fn lies_about_counters_are_refused_by_name() {
    assert_refused(&[
        lie(0, |c| c.sequence = 2, Reason::BadValue, "chunk.sequence"),
        lie(0, |c| c.sequence = u32::MAX, Reason::BadValue, "chunk.sequence"),
        lie(1, |c| c.first_step = 3, Reason::Inconsistent, "chunk.first_step"),
        lie(0, |c| c.steps = 1, Reason::BadValue, "chunk.steps"),
        lie(0, |c| c.steps = u32::MAX, Reason::BadValue, "chunk.steps"),
    ]);
}

#[test]
fn lies_about_shapes_and_types_are_refused_by_name() {
    assert_refused(&[
        lie(0, |c| c.agents.truncate(1), Reason::BadShape, "chunk.agents"),
        lie(0, |c| c.agents.swap(0, 1), Reason::BadShape, "chunk.agents[0].observation"),
        lie(0, |c| c.agents[1].action = None, Reason::MissingField, "chunk.agents[1].action"),
        lie(
            0,
            |c| tensor(&mut c.agents[0].hidden).shape[0] = 2,
            Reason::BadShape,
            "chunk.agents[0].hidden",
        ),
        lie(0, |c| tensor(&mut c.state).shape.swap(0, 2), Reason::BadShape, "chunk.state"),
        lie(0, |c| tensor(&mut c.state).shape.clear(), Reason::BadShape, "chunk.state"),
        lie(
            0,
            |c| tensor(&mut c.reward).data = Bytes::from_static(&[0; 12]),
            Reason::BadShape,
            "chunk.reward",
        ),
        lie(0, |c| tensor(&mut c.reward).data_type = 2, Reason::BadType, "chunk.reward"),
        lie(0, |c| tensor(&mut c.reward).data_type = 99, Reason::BadType, "chunk.reward"),
        lie(0, |c| c.terminated = c.reward.clone(), Reason::BadType, "chunk.terminated"),
        lie(
            0,
            |c| finals(c).environments.truncate(1),
            Reason::BadShape,
            "chunk.finals.environments",
        ),
        lie(
            0,
            |c| finals(c).observations.truncate(1),
            Reason::BadShape,
            "chunk.finals.observations",
        ),
        lie(0, |c| finals(c).steps = vec![0; 5], Reason::BadValue, "chunk.finals.steps"),
        lie(1, |c| end(c).environments.truncate(1), Reason::BadShape, "chunk.end.environments"),
        lie(1, |c| end(c).recurrent.truncate(1), Reason::BadShape, "chunk.end.recurrent"),
    ]);
}

#[test]
fn numbers_that_no_update_survives_are_refused_by_name() {
    assert_refused(&[
        lie(
            0,
            |c| set(&mut c.agents[0].observation, f32::NAN),
            Reason::NotFinite,
            "chunk.agents[0].observation",
        ),
        lie(
            0,
            |c| set(&mut c.agents[0].action, f32::INFINITY),
            Reason::NotFinite,
            "chunk.agents[0].action",
        ),
        lie(
            0,
            |c| set(&mut c.agents[1].log_prob, f32::NEG_INFINITY),
            Reason::NotFinite,
            "chunk.agents[1].log_prob",
        ),
        lie(0, |c| set(&mut c.agents[0].hidden, 1e38), Reason::BadValue, "chunk.agents[0].hidden"),
        lie(0, |c| set(&mut c.reward, -1e38), Reason::BadValue, "chunk.reward"),
        lie(0, |c| set(&mut finals(c).state, f32::NAN), Reason::NotFinite, "chunk.finals.state"),
        lie(
            1,
            |c| set_in(&mut end(c).recurrent[0], f32::NAN),
            Reason::NotFinite,
            "chunk.end.recurrent[0]",
        ),
    ]);
}

#[test]
fn lies_about_the_ends_of_episodes_and_slots_are_refused_by_name() {
    assert_refused(&[
        lie(0, |c| flag(&mut c.terminated, 0, 2), Reason::BadValue, "chunk.terminated"),
        lie(0, |c| flag(&mut c.truncated, 1, 1), Reason::Inconsistent, "chunk.truncated"),
        lie(0, |c| flag(&mut c.truncated, 3, 1), Reason::Inconsistent, "chunk.finals"),
        lie(0, |c| flag(&mut c.terminated, 1, 0), Reason::Inconsistent, "chunk.finals"),
        lie(0, |c| c.finals = None, Reason::Inconsistent, "chunk.finals"),
        lie(0, |c| finals(c).steps.swap(0, 1), Reason::Inconsistent, "chunk.finals"),
        lie(0, |c| finals(c).environments[1] = u32::MAX, Reason::Inconsistent, "chunk.finals"),
        lie(
            0,
            |c| c.end = sample::chunk(1).to_wire(&sample::run(), &sample::origin()).0.end,
            Reason::Inconsistent,
            "chunk.end",
        ),
        lie(1, |c| c.end = None, Reason::MissingField, "chunk.end"),
        lie(
            1,
            |c| end(c).environments[1] = Bytes::new(),
            Reason::BadValue,
            "chunk.end.environments[1]",
        ),
        lie(
            1,
            |c| end(c).environments[0] = Bytes::from(vec![0; 65]),
            Reason::BadValue,
            "chunk.end.environments[0]",
        ),
    ]);
}

#[test]
fn content_that_does_not_have_its_digest_is_refused_before_anybody_looks_at_its_values() {
    let run = sample::run();
    let (mut message, digest) = sample::chunk(0).to_wire(&run, &sample::origin());
    set(&mut message.reward, f32::NAN);
    let refusal =
        TrajectoryChunk::from_wire(&message, &run, &sample::origin(), digest).unwrap_err();
    assert_eq!((refusal.reason, refusal.field.as_str()), (Reason::DigestMismatch, "digest"));
}

#[test]
fn evaluations_that_no_episode_gives_are_refused_by_name() {
    let honest = EvaluationResult { episode: 0, extrinsic_return: 1.0, steps: 10 };
    let verdict = |result: EvaluationResult| {
        let refusal =
            EvaluationResult::from_wire(&result.to_wire(), &sample::run(), 7, result.digest(7))
                .unwrap_err();
        (refusal.reason, refusal.field)
    };
    let nan = EvaluationResult { extrinsic_return: f64::NAN, ..honest };
    assert_eq!(verdict(nan), (Reason::NotFinite, "evaluation.extrinsic_return".to_owned()));
    let forged = EvaluationResult { extrinsic_return: 4e12, ..honest };
    assert_eq!(verdict(forged), (Reason::BadValue, "evaluation.extrinsic_return".to_owned()));
    for steps in [0, 1001] {
        let odd = EvaluationResult { steps, ..honest };
        assert_eq!(verdict(odd), (Reason::BadValue, "evaluation.steps".to_owned()));
    }
    let wrong = EvaluationResult::from_wire(&honest.to_wire(), &sample::run(), 7, Digest([0; 32]));
    assert_eq!(wrong.unwrap_err().reason, Reason::DigestMismatch);
}
