//! Every message survives the way to bytes and back.

use proto::wire::push_trajectory_request::Content;
use proto::{
    Ack, AckState, ActorId, Digest, EnvironmentStart, EvaluationResult, EvaluationWork, Heartbeat,
    HeartbeatAnswer, Incarnation, Lease, LeaseAnswer, LeaseId, PolicyVersion, PushHeader,
    Registered, RolloutWork, RunDescription, Start, WeightsName, Work,
};

use crate::{received, sample, sent};

fn weights() -> WeightsName {
    WeightsName { version: PolicyVersion(3), digest: Digest([9; 32]) }
}

fn lease(work: Work) -> Lease {
    Lease { id: LeaseId(4), incarnation: Incarnation(11), weights: weights(), attempt: 2, work }
}

fn rollout() -> Work {
    let fresh = Start::Fresh { episode: 2, limit: 500 };
    let continued =
        Start::Continue { state: vec![1, 2, 3], recurrent: vec![vec![0.5; 3], Vec::new()] };
    let start = |environment, start| EnvironmentStart { environment, start };
    let environments = vec![start(6, fresh), start(7, continued)];
    Work::Rollout(RolloutWork { iteration: 5, slot: 3, environments })
}

#[test]
fn a_run_survives_the_round_trip() {
    assert_eq!(RunDescription::from_wire(Some(sent(&sample::run().to_wire()))), Ok(sample::run()));
}

#[test]
fn every_answer_to_a_request_for_work_survives_the_round_trip() {
    let evaluation = Work::Evaluation(EvaluationWork { iteration: 5, episode: 9 });
    let answers = [
        LeaseAnswer::Lease(lease(rollout())),
        LeaseAnswer::Lease(lease(evaluation)),
        LeaseAnswer::Retry { wait_millis: 100 },
        LeaseAnswer::Done,
    ];
    for answer in answers {
        let found = LeaseAnswer::from_wire(sent(&answer.to_wire()), &sample::run());
        assert_eq!(found, Ok(answer));
    }
}

#[test]
fn a_chunk_survives_the_round_trip_and_keeps_its_digest() {
    let run = sample::run();
    for sequence in [0, 1] {
        let chunk = sample::chunk(sequence);
        let (message, digest) = chunk.to_wire(&run, &sample::origin());
        assert_eq!(chunk.digest(&sample::origin()), digest);
        assert_eq!(received(&message, &run, digest), Ok(chunk));
    }
}

#[test]
fn an_evaluation_survives_the_round_trip() {
    let (extrinsic_return, reward_terms) = (-17.25, vec![3.0, -20.25]);
    let result = EvaluationResult { episode: 2, extrinsic_return, steps: 1000, reward_terms };
    let message = sent(&result.to_wire());
    assert_eq!(
        EvaluationResult::from_wire(&message, &sample::run(), 7, result.digest(7)),
        Ok(result)
    );
}

#[test]
fn a_push_survives_the_round_trip() {
    let (message, digest) = sample::chunk(0).to_wire(&sample::run(), &sample::origin());
    let header = PushHeader::of(&lease(rollout()), digest);
    let found = PushHeader::from_wire(sent(&header.to_wire(Content::Chunk(message.clone()))));
    assert_eq!(found, Ok((header, Content::Chunk(message))));
}

#[test]
fn the_largest_message_has_a_sum_of_eight_bytes_for_each_reward_term_and_environment() {
    let (run, mut more) = (sample::run(), sample::run());
    more.environment.reward_terms.extend(["third", "fourth", "fifth"].map(str::to_owned));
    let sums = 2 * 3 * 8;
    assert_eq!(more.largest_message_bytes(), run.largest_message_bytes().map(|size| size + sums));
}

#[test]
fn acknowledgements_and_signs_of_life_survive_the_round_trip() {
    let registered = Registered { actor: ActorId(5), incarnation: Incarnation(11) };
    assert_eq!(Registered::from_wire(&sent(&registered.to_wire())), registered);
    for state in [AckState::Accepted, AckState::Repeated] {
        let ack = Ack { lease: LeaseId(4), sequence: 3, state, lease_finished: true };
        assert_eq!(Ack::from_wire(&sent(&ack.to_wire())), Ok(ack));
    }
    let beat = Heartbeat {
        actor: ActorId(1),
        incarnation: Incarnation(2),
        lease: LeaseId(3),
        slot_step: 4,
    };
    assert_eq!(Heartbeat::from_wire(&sent(&beat.to_wire())), beat);
    for is_over in [false, true] {
        let answer = HeartbeatAnswer { lease_valid: true, is_over };
        assert_eq!(HeartbeatAnswer::from_wire(&sent(&answer.to_wire())), Ok(answer));
    }
}
