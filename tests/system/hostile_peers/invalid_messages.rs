//! A client that sends invalid messages to a running learner: each is rejected with a status that names
//! the field, all are counted, and the run ends with the weights of an undisturbed run.

use std::io::Write as _;

use proto::{Digest, Reason, Refusal, Registration, TrajectoryChunk, Work, wire};
use tonic::Status;

use super::attackers::{Attacker, arbitrary_chunk, message, registration};
use super::{UNDISTURBED, finished, learner};
use crate::runs::{Runs, inspect, metrics};

/// Changes to the chunk and to the message, and the expected reason and field.
type Attack =
    (fn(&mut TrajectoryChunk), fn(&mut wire::PushTrajectoryRequest), Reason, &'static str);

fn reward(message: &mut wire::PushTrajectoryRequest) -> &mut wire::Tensor {
    match message.content.as_mut().unwrap() {
        wire::push_trajectory_request::Content::Chunk(chunk) => chunk.reward.as_mut().unwrap(),
        other => panic!("expected a chunk, got {other:?}"),
    }
}

fn unchanged<T>(_: &mut T) {}

const ATTACKS: &[Attack] = &[
    (unchanged, |m| reward(m).shape = vec![9, 2], Reason::BadShape, "chunk.reward"),
    (unchanged, |m| reward(m).shape = vec![u32::MAX, u32::MAX], Reason::BadShape, "chunk.reward"),
    (|c| c.agents[1].action[4] = f32::NAN, unchanged, Reason::NotFinite, "chunk.agents[1].action"),
    (|c| c.state[0] = f32::INFINITY, unchanged, Reason::NotFinite, "chunk.state"),
    (|c| c.truncated[3] = true, unchanged, Reason::Inconsistent, "chunk.finals"),
    (|c| c.sequence = 1, unchanged, Reason::OutOfOrder, "chunk.sequence"),
    (unchanged, unchanged, Reason::CanaryMismatch, "chunk.agents[0].log_prob"),
    (unchanged, |m| m.lease_id = 999_999, Reason::UnknownLease, "lease_id"),
    (unchanged, |m| m.incarnation += 1, Reason::OtherIncarnation, "incarnation"),
    (
        unchanged,
        |m| m.weights.as_mut().unwrap().version = 7,
        Reason::StaleWeights,
        "weights.version",
    ),
    (unchanged, |m| m.digest = vec![1; 32].into(), Reason::DigestMismatch, "digest"),
    (unchanged, |m| m.content = None, Reason::MissingField, "content"),
];

async fn attack(url: &str, (change_chunk, change_message, reason, field): &Attack) {
    let mut attacker = Attacker::connect(url).await;
    let lease = attacker.lease().await;
    assert!(matches!(lease.work, Work::Rollout(_)));
    let mut chunk = arbitrary_chunk(&attacker.run);
    change_chunk(&mut chunk);
    let mut message = message(&lease, &chunk, &attacker.run);
    change_message(&mut message);
    let status = attacker.push(message).await;
    let refusal = Refusal::from_status(&status).unwrap_or_else(|| panic!("{field}: {status:?}"));
    assert_eq!((refusal.reason, refusal.field.as_str()), (*reason, *field), "{refusal}");
    assert_eq!(status.code(), reason.code());
}

/// Registrations, leases and snapshots that no valid actor requests. Returns their number.
async fn send_invalid_requests(url: &str) -> usize {
    let mut attacker = Attacker::connect(url).await;
    let run = attacker.run.clone();
    let other_program =
        Registration { rollout_fingerprint: Some(Digest([1; 32])), ..registration(&run) };
    let mut other_robot = registration(&run);
    other_robot.environment.state.pop();
    let service = &mut attacker.service;
    let refused = |status: Status| Refusal::from_status(&status).unwrap().reason;
    let status = service.register(other_program.to_wire()).await.unwrap_err();
    assert_eq!(refused(status), Reason::OtherFingerprint);
    let other_build = Registration { build: "0.0.1+other".to_owned(), ..registration(&run) };
    let status = service.register(other_build.to_wire()).await.unwrap_err();
    assert_eq!(refused(status), Reason::OtherBuild);
    let status = service.register(other_robot.to_wire()).await.unwrap_err();
    assert_eq!(refused(status), Reason::OtherEnvironment);
    let unregistered = wire::LeaseSlotsRequest {
        actor_id: 77_777,
        incarnation: attacker.own.incarnation.0,
        wait_millis: 0,
        log_steps_lost: 0,
    };
    let status = service.lease_slots(unregistered).await.unwrap_err();
    assert_eq!(refused(status), Reason::UnknownActor);
    let unknown = wire::WeightsName { version: 99, digest: vec![3; 32].into() };
    let request = wire::GetWeightsRequest { weights: Some(unknown), repeats: false };
    let status = service.get_weights(request).await;
    assert_eq!(refused(status.unwrap_err()), Reason::UnknownWeights);
    5
}

fn send_random_bytes(url: &str) {
    let address = url.strip_prefix("http://").unwrap();
    let mut socket = std::net::TcpStream::connect(address).unwrap();
    socket.write_all(&[0x5a; 4096]).unwrap();
}

#[tokio::test]
async fn invalid_messages_are_refused_by_field_and_counted_and_do_not_affect_the_run() {
    let runs = Runs::new();
    let attacked = runs.folder("attacked");
    let learner = learner(&attacked, &[]);
    send_random_bytes(&learner.url);
    for each in ATTACKS {
        attack(&learner.url, each).await;
    }
    let more = send_invalid_requests(&learner.url).await;
    finished(learner).await;
    let last = metrics(&attacked, "iteration").pop().unwrap();
    assert_eq!(last["messages_refused"], ATTACKS.len() + more);
    assert_eq!(inspect(&attacked), *UNDISTURBED);
}
