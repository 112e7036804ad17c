//! A client that sends invalid messages to a running learner: each is rejected with a status that names
//! the field, all are counted and logged, and the run ends with the weights of an undisturbed run.

use std::io::Write as _;

use proto::wire::push_trajectory_request::Content;
use proto::{Digest, Reason, Refusal, Registration, Work, wire};
use tonic::Status;

use super::attackers::{Attacker, arbitrary_chunk, message, registration};
use super::{UNDISTURBED, finished, learner};
use crate::processes::{Learner, eventually};
use crate::runs::{Runs, inspect, metrics};

/// A change to the message, and the expected reason and field. The tests of `proto` have one for each field.
type Attack = (fn(&mut wire::PushTrajectoryRequest), Reason, &'static str);

const ATTACKS: &[Attack] = &[
    (
        |m| {
            if let Some(Content::Chunk(chunk)) = &mut m.content {
                chunk.reward.as_mut().unwrap().shape = vec![u32::MAX, u32::MAX];
            }
        },
        Reason::BadShape,
        "chunk.reward",
    ),
    (|_| {}, Reason::CanaryMismatch, "chunk.agents[0].log_prob"),
    (|m| m.lease_id = 999_999, Reason::UnknownLease, "lease_id"),
    (|m| m.incarnation += 1, Reason::OtherIncarnation, "incarnation"),
    (|m| m.weights.as_mut().unwrap().version = 7, Reason::StaleWeights, "weights.version"),
    (|m| m.digest = vec![1; 32].into(), Reason::DigestMismatch, "digest"),
    (|m| m.content = None, Reason::MissingField, "content"),
];

async fn attack(url: &str, (change, reason, field): &Attack) {
    let mut attacker = Attacker::connect(url).await;
    let lease = attacker.lease().await;
    assert!(matches!(lease.work, Work::Rollout(_)));
    let mut message = message(&lease, &arbitrary_chunk(&attacker.run), &attacker.run);
    change(&mut message);
    let status = attacker.push(message).await;
    let refusal = Refusal::from_status(&status).unwrap_or_else(|| panic!("{field}: {status:?}"));
    assert_eq!((refusal.reason, refusal.field.as_str()), (*reason, *field), "{refusal}");
    assert_eq!(status.code(), reason.code());
}

/// Registrations, leases and snapshots that no valid actor requests. Returns their number.
async fn send_invalid_requests(url: &str) -> usize {
    let mut attacker = Attacker::connect(url).await;
    let run = attacker.run.clone();
    let mut other_robot = registration(&run);
    other_robot.environment.state.pop();
    let other_program =
        Registration { rollout_fingerprint: Some(Digest([1; 32])), ..registration(&run) };
    let other_build = Registration { build: "0.0.1+other".to_owned(), ..registration(&run) };
    let refused = |status: Status| Refusal::from_status(&status).unwrap().reason;
    for (registration, reason) in [
        (other_program, Reason::OtherFingerprint),
        (other_build, Reason::OtherBuild),
        (other_robot, Reason::OtherEnvironment),
    ] {
        let status = attacker.service.register(registration.to_wire()).await;
        assert_eq!(refused(status.unwrap_err()), reason);
    }
    let incarnation = attacker.own.incarnation.0;
    let unregistered =
        wire::LeaseSlotsRequest { actor_id: 77_777, incarnation, ..Default::default() };
    let status = attacker.service.lease_slots(unregistered).await;
    assert_eq!(refused(status.unwrap_err()), Reason::UnknownActor);
    let unknown = wire::WeightsName { version: 99, digest: vec![3; 32].into() };
    let request = wire::GetWeightsRequest { weights: Some(unknown), repeats: false };
    let status = attacker.service.get_weights(request).await;
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

/// Waits for the only log line that contains all these words.
fn logged(learner: &Learner, all: &[&str]) {
    eventually(|| {
        let log = learner.process.log();
        let found = log.lines().filter(|line| all.iter().all(|words| line.contains(words)));
        match found.count() {
            0 => Err(format!("no line with {all:?} in:\n{log}")),
            1 => Ok(()),
            _ => panic!("logged twice: {all:?} in:\n{log}"),
        }
    });
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn refused_messages_are_logged_and_their_actor_is_quarantined() {
    let runs = Runs::new();
    let learner = learner(&runs.folder("run"), &[]);
    let mut attacker = Attacker::connect(&learner.url).await;
    let who = format!("actor {} (attacker)", attacker.own.actor);
    for _ in 0..3 {
        let lease = attacker.lease().await;
        let pushed = message(&lease, &arbitrary_chunk(&attacker.run), &attacker.run);
        attacker.push(pushed).await;
        let what = format!("{who} was at slot 0 (lease {}) after 0 chunks", lease.id);
        let refused = ["push_trajectory from 127.0.0.1:", "is refused", &what, "the lease ends"];
        logged(
            &learner,
            &[&refused[..], &["CANARY_MISMATCH", "chunk.agents[0].log_prob"]].concat(),
        );
    }
    logged(&learner, &["WARN", &who, "is in quarantine", "it gets no work for 20.0 s"]);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_expired_lease_is_logged() {
    let runs = Runs::new();
    let learner = learner(&runs.folder("run"), &["lease.ttl_secs=0.4"]);
    let mut attacker = Attacker::connect(&learner.url).await;
    let (actor, lease) = (attacker.own.actor, attacker.lease().await.id);
    let _other_slot = attacker.lease().await;
    // No slot is free until the first lease has expired.
    let again = attacker.lease().await;
    assert_ne!(again.id, lease);
    let who = format!("actor {actor} (attacker) got nothing done for ");
    let what = format!("at slot 0 (lease {lease}) after 0 chunks; the lease ends");
    logged(&learner, &["WARN", &who, &what, "its work is free again"]);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_actor_lost_during_a_slot_is_logged_with_the_slot() {
    let runs = Runs::new();
    let learner = learner(&runs.folder("run"), &[]);
    let mut attacker = Attacker::connect(&learner.url).await;
    let (actor, lease) = (attacker.own.actor, attacker.lease().await.id);
    drop(attacker);
    let who = format!("actor {actor} (attacker) is gone");
    let what = format!("at slot 0 (lease {lease}) after 0 chunks");
    logged(&learner, &["WARN", &who, &what, "its work is free again"]);
}
