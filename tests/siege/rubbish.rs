//! A client that sends invalid messages to a running learner: each is rejected with a status that names
//! the field, all are counted, and the run ends with the weights of an undisturbed run.

use std::io::Write as _;

use proto::{Digest, Reason, Refusal, Registration, TrajectoryChunk, Work, wire};
use tonic::Status;

use crate::attackers::{Attacker, invented, message, registration};
use crate::learners::{Learner, inspect};

/// What is spoilt, the reason given, and the field named.
type Attack =
    (fn(&mut TrajectoryChunk), fn(&mut wire::PushTrajectoryRequest), Reason, &'static str);

fn reward(message: &mut wire::PushTrajectoryRequest) -> &mut wire::Tensor {
    match message.content.as_mut().unwrap() {
        wire::push_trajectory_request::Content::Chunk(chunk) => chunk.reward.as_mut().unwrap(),
        other => panic!("expected a chunk, got {other:?}"),
    }
}

fn leave<T>(_: &mut T) {}

const ATTACKS: &[Attack] = &[
    (leave, |m| reward(m).shape = vec![9, 2], Reason::BadShape, "chunk.reward"),
    (leave, |m| reward(m).shape = vec![u32::MAX, u32::MAX], Reason::BadShape, "chunk.reward"),
    (|c| c.agents[1].action[4] = f32::NAN, leave, Reason::NotFinite, "chunk.agents[1].action"),
    (|c| c.state[0] = f32::INFINITY, leave, Reason::NotFinite, "chunk.state"),
    (|c| c.truncated[3] = true, leave, Reason::Inconsistent, "chunk.finals"),
    (|c| c.sequence = 1, leave, Reason::OutOfOrder, "chunk.sequence"),
    (leave, leave, Reason::CanaryMismatch, "chunk.agents[0].log_prob"),
    (leave, |m| m.lease_id = 999_999, Reason::UnknownLease, "lease_id"),
    (leave, |m| m.incarnation += 1, Reason::OtherIncarnation, "incarnation"),
    (leave, |m| m.weights.as_mut().unwrap().version = 7, Reason::StaleWeights, "weights.version"),
    (leave, |m| m.digest = vec![1; 32].into(), Reason::DigestMismatch, "digest"),
    (leave, |m| m.content = None, Reason::MissingField, "content"),
];

async fn attack(url: &str, (spoil_chunk, spoil_message, reason, field): &Attack) {
    let mut attacker = Attacker::connect(url).await;
    let lease = attacker.lease().await;
    assert!(matches!(lease.work, Work::Rollout(_)));
    let mut chunk = invented(&attacker.run);
    spoil_chunk(&mut chunk);
    let mut message = message(&lease, &chunk, &attacker.run);
    spoil_message(&mut message);
    let status = attacker.push(message).await;
    let refusal = Refusal::from_status(&status).unwrap_or_else(|| panic!("{field}: {status:?}"));
    assert_eq!((refusal.reason, refusal.field.as_str()), (*reason, *field), "{refusal}");
    assert_eq!(status.code(), reason.code());
}

/// Registrations, leases and snapshots that no honest actor asks for.
async fn ask_for_the_impossible(url: &str) -> usize {
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
    let status = service.register(other_robot.to_wire()).await.unwrap_err();
    assert_eq!(refused(status), Reason::OtherEnvironment);
    let stranger = wire::LeaseSlotsRequest {
        actor_id: 77_777,
        incarnation: attacker.own.incarnation.0,
        wait_millis: 0,
        log_steps_lost: 0,
    };
    let status = service.lease_slots(stranger).await.unwrap_err();
    assert_eq!(refused(status), Reason::UnknownActor);
    let ghost = wire::WeightsName { version: 99, digest: vec![3; 32].into() };
    let status = service.get_weights(wire::GetWeightsRequest { weights: Some(ghost) }).await;
    assert_eq!(refused(status.unwrap_err()), Reason::UnknownWeights);
    4
}

fn no_protocol_at_all(url: &str) {
    let address = url.strip_prefix("http://").unwrap();
    let mut socket = std::net::TcpStream::connect(address).unwrap();
    socket.write_all(&[0x5a; 4096]).unwrap();
}

#[tokio::test]
async fn rubbish_is_refused_by_name_and_counted_and_the_run_goes_on_as_if_nothing_had_been() {
    let folder = tempfile::tempdir().unwrap();
    let (attacked, in_peace) = (folder.path().join("attacked"), folder.path().join("in-peace"));
    let mut learner = Learner::start(&attacked, &[]);
    no_protocol_at_all(&learner.url);
    for each in ATTACKS {
        attack(&learner.url, each).await;
    }
    let more = ask_for_the_impossible(&learner.url).await;
    tokio::task::spawn_blocking(move || learner.finish(&[])).await.unwrap();
    let metrics = std::fs::read_to_string(attacked.join("metrics.jsonl")).unwrap();
    let last: serde_json::Value = serde_json::from_str(metrics.lines().last().unwrap()).unwrap();
    assert_eq!(last["messages_refused"], ATTACKS.len() + more);

    let mut quiet = Learner::start(&in_peace, &[]);
    tokio::task::spawn_blocking(move || quiet.finish(&[])).await.unwrap();
    assert_eq!(inspect(&attacked), inspect(&in_peace));
}
