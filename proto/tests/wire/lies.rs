//! An invalid chunk is rejected with the right reason and field.

use bytes::Bytes;
use proto::Reason::{
    BadShape, BadType, BadValue, DigestMismatch, Inconsistent, MissingField, NotFinite,
};
use proto::{Digest, EvaluationResult, Reason, wire};

use crate::{assert_refused, honest_digest, received, sample};

/// The sequence number of a valid chunk, the reason and field of the refusal, and the change that causes it.
type Lie = (u32, Reason, &'static str, fn(&mut wire::TrajectoryChunk));

fn tensor(tensor: &mut Option<wire::Tensor>) -> &mut wire::Tensor {
    tensor.as_mut().unwrap()
}

/// Overwrites the bytes of a tensor from `at`.
fn put(part: &mut Option<wire::Tensor>, at: usize, bytes: &[u8]) {
    let mut data = tensor(part).data.to_vec();
    data[at..at + bytes.len()].copy_from_slice(bytes);
    tensor(part).data = data.into();
}

/// Overwrites the first element.
fn set(part: &mut Option<wire::Tensor>, value: f32) {
    put(part, 0, &value.to_le_bytes());
}

fn finals(chunk: &mut wire::TrajectoryChunk) -> &mut wire::FinalSteps {
    chunk.finals.as_mut().unwrap()
}

fn end(chunk: &mut wire::TrajectoryChunk) -> &mut wire::SlotEnd {
    chunk.end.as_mut().unwrap()
}

fn message(sequence: u32) -> (wire::TrajectoryChunk, Digest) {
    sample::chunk(sequence).to_wire(&sample::run(), &sample::origin())
}

/// The digests are valid: they are computed after the changes.
fn assert_all_refused(lies: &[Lie]) {
    for &(sequence, reason, field, change) in lies {
        let mut message = message(sequence).0;
        change(&mut message);
        let result = received(&message, &sample::run(), honest_digest(&message, &sample::run()));
        assert_refused(result, reason, &format!("chunk.{field}"));
    }
}

#[test]
fn lies_about_counters_are_refused_by_name() {
    assert_all_refused(&[
        (0, BadValue, "sequence", |c| c.sequence = 2),
        (0, BadValue, "sequence", |c| c.sequence = u32::MAX),
        (1, Inconsistent, "first_step", |c| c.first_step = 3),
        (0, BadValue, "steps", |c| c.steps = 1),
        (0, BadValue, "steps", |c| c.steps = u32::MAX),
    ]);
}

#[test]
fn lies_about_shapes_and_types_are_refused_by_name() {
    assert_all_refused(&[
        (0, BadShape, "agents", |c| c.agents.truncate(1)),
        (0, BadShape, "agents[0].observation", |c| c.agents.swap(0, 1)),
        (0, MissingField, "agents[1].action", |c| c.agents[1].action = None),
        (0, BadShape, "agents[0].hidden", |c| tensor(&mut c.agents[0].hidden).shape[0] = 2),
        (0, BadShape, "state", |c| tensor(&mut c.state).shape.swap(0, 2)),
        (0, BadShape, "state", |c| tensor(&mut c.state).shape.clear()),
        (0, BadShape, "reward", |c| tensor(&mut c.reward).data = Bytes::from_static(&[0; 12])),
        (0, BadType, "reward", |c| tensor(&mut c.reward).data_type = 2),
        (0, BadType, "reward", |c| tensor(&mut c.reward).data_type = 99),
        (0, BadType, "terminated", |c| c.terminated = c.reward.clone()),
        (0, BadShape, "finals.environments", |c| finals(c).environments.truncate(1)),
        (0, BadShape, "finals.observations", |c| finals(c).observations.truncate(1)),
        (0, BadValue, "finals.steps", |c| finals(c).steps = vec![0; 5]),
        (1, BadShape, "end.environments", |c| end(c).environments.truncate(1)),
        (1, BadShape, "end.recurrent", |c| end(c).recurrent.truncate(1)),
    ]);
}

#[test]
fn numbers_that_no_update_survives_are_refused_by_name() {
    assert_all_refused(&[
        (0, NotFinite, "agents[0].observation", |c| set(&mut c.agents[0].observation, f32::NAN)),
        (0, NotFinite, "agents[0].action", |c| set(&mut c.agents[0].action, f32::INFINITY)),
        (0, NotFinite, "agents[1].log_prob", |c| {
            set(&mut c.agents[1].log_prob, f32::NEG_INFINITY);
        }),
        (0, BadValue, "agents[0].hidden", |c| set(&mut c.agents[0].hidden, 1e38)),
        (0, NotFinite, "state", |c| set(&mut c.state, f32::INFINITY)),
        (0, BadValue, "reward", |c| set(&mut c.reward, -1e38)),
        (0, NotFinite, "finals.state", |c| set(&mut finals(c).state, f32::NAN)),
        (1, NotFinite, "end.recurrent[0]", |c| {
            end(c).recurrent[0].data = f32::NAN.to_le_bytes().repeat(6).into();
        }),
    ]);
}

#[test]
fn lies_about_the_ends_of_episodes_and_slots_are_refused_by_name() {
    assert_all_refused(&[
        (0, BadValue, "terminated", |c| put(&mut c.terminated, 0, &[2])),
        (0, Inconsistent, "truncated", |c| put(&mut c.truncated, 1, &[1])),
        (0, Inconsistent, "finals", |c| put(&mut c.truncated, 3, &[1])),
        (0, Inconsistent, "finals", |c| put(&mut c.terminated, 1, &[0])),
        (0, Inconsistent, "finals", |c| c.finals = None),
        (0, Inconsistent, "finals", |c| finals(c).steps.swap(0, 1)),
        (0, Inconsistent, "finals", |c| finals(c).environments[1] = u32::MAX),
        (0, Inconsistent, "end", |c| c.end = message(1).0.end),
        (1, MissingField, "end", |c| c.end = None),
        (1, BadValue, "end.environments[1]", |c| end(c).environments[1] = Bytes::new()),
        (1, BadValue, "end.environments[0]", |c| end(c).environments[0] = vec![0; 65].into()),
        (0, BadShape, "reward_terms", |c| c.reward_terms.push(0.0)),
        (0, NotFinite, "reward_terms", |c| c.reward_terms[1] = f64::NAN),
        (1, BadValue, "reward_terms", |c| c.reward_terms[3] = 4e9),
    ]);
}

#[test]
fn content_that_does_not_have_its_digest_is_refused_before_anybody_looks_at_its_values() {
    let (mut message, digest) = message(0);
    set(&mut message.reward, f32::NAN);
    assert_refused(received(&message, &sample::run(), digest), DigestMismatch, "digest");
}

#[test]
fn evaluations_that_no_episode_gives_are_refused_by_name() {
    let honest =
        EvaluationResult { extrinsic_return: 1.0, steps: 10, ..EvaluationResult::default() };
    let returned = |extrinsic_return| EvaluationResult { extrinsic_return, ..honest.clone() };
    let lasted = |steps| EvaluationResult { steps, ..honest.clone() };
    let summed = |reward_terms: &[f64]| EvaluationResult {
        reward_terms: reward_terms.to_vec(),
        ..honest.clone()
    };
    let own = |result: EvaluationResult| {
        let digest = result.digest(7);
        (result, digest)
    };
    for ((result, digest), reason, field) in [
        (own(returned(f64::NAN)), NotFinite, "evaluation.extrinsic_return"),
        (own(returned(4e12)), BadValue, "evaluation.extrinsic_return"),
        (own(lasted(0)), BadValue, "evaluation.steps"),
        (own(lasted(1001)), BadValue, "evaluation.steps"),
        (own(summed(&[1.0])), BadShape, "evaluation.reward_terms"),
        (own(summed(&[1.0, f64::INFINITY])), NotFinite, "evaluation.reward_terms"),
        (own(summed(&[-4e12, 1.0])), BadValue, "evaluation.reward_terms"),
        ((honest, Digest([0; 32])), DigestMismatch, "digest"),
    ] {
        let read = EvaluationResult::from_wire(&result.to_wire(), &sample::run(), 7, digest);
        assert_refused(read, reason, field);
    }
}
