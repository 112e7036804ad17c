//! Peers that send in another actor's name, and peers that use many resources. Neither ends an actor's lease, exhausts
//! memory or blocks health probes.

use proto::wire::learner_service_client::LearnerServiceClient;
use proto::{Heartbeat, LeaseAnswer, Reason, Refusal, wire};
use tonic::transport::{Channel, Endpoint};

use super::attackers::{Attacker, arbitrary_chunk, message, registration};
use super::{ProcessUsage, UNDISTURBED, finished, learner};
use crate::runs::{Runs, inspect, s2mia};

/// Maximum growth of the learner's memory during a flood: 1,024 requests of 256 KiB, and overhead of the allocator.
const MOST_MIB: u64 = 500;

async fn is_valid(attacker: &mut Attacker, lease: proto::LeaseId) -> bool {
    let (actor, incarnation) = (attacker.own.actor, attacker.own.incarnation);
    let beat = Heartbeat { actor, incarnation, lease, slot_step: 0 };
    attacker.service.heartbeat(beat.to_wire()).await.unwrap().into_inner().lease_valid
}

#[tokio::test]
async fn pushes_over_another_connection_do_not_end_a_lease_and_quarantine_their_sender() {
    let runs = Runs::new();
    let attacked = runs.folder("attacked");
    let learner = learner(&attacked, &[]);
    let mut honest = Attacker::connect(&learner.url).await;
    let lease = honest.lease().await;
    let forged = message(&lease, &arbitrary_chunk(&honest.run), &honest.run);
    let mut unregistered = LearnerServiceClient::connect(learner.url.clone()).await.unwrap();
    let mut registered = Attacker::connect(&learner.url).await;
    for _ in 0..3 {
        let pushed = unregistered.push_trajectory(tokio_stream::iter([forged.clone()])).await;
        let refusal = Refusal::from_status(&pushed.unwrap_err()).unwrap();
        assert_eq!(refusal.reason, Reason::UnknownActor);
        let refusal = Refusal::from_status(&registered.push(forged.clone()).await).unwrap();
        assert_eq!(refusal.reason, Reason::OtherConnection, "{refusal}");
        assert!(is_valid(&mut honest, lease.id).await);
    }
    let answer = registered.asks_for_work(0).await;
    assert!(matches!(answer, LeaseAnswer::Retry { .. }), "not in quarantine: {answer:?}");
    drop((honest, registered, unregistered));
    finished(learner).await;
    assert_eq!(inspect(&attacked), *UNDISTURBED);
}

fn is_healthy(url: &str) -> bool {
    s2mia(&["health", "--learner", url]).status.success()
}

/// Sixteen concurrent calls over one connection: large registrations, and streams with a large message.
async fn flood(url: String) -> Channel {
    let channel = Endpoint::from_shared(url).unwrap().connect().await.unwrap();
    let large = "x".repeat(4_000_000);
    let calls = (0..16).map(|call| {
        let mut service = LearnerServiceClient::new(channel.clone());
        let large = large.clone();
        tokio::spawn(async move {
            let content = wire::EvaluationResult::default();
            let content = wire::push_trajectory_request::Content::Evaluation(content);
            let push = wire::PushTrajectoryRequest {
                digest: large.clone().into_bytes().into(),
                content: Some(content),
                ..Default::default()
            };
            let registration = wire::RegisterRequest { client: large, ..Default::default() };
            match call % 2 {
                0 => service.register(registration).await.map(drop).unwrap_err(),
                _ => {
                    service.push_trajectory(tokio_stream::iter([push])).await.map(drop).unwrap_err()
                }
            }
        })
    });
    for call in calls.collect::<Vec<_>>() {
        call.await.unwrap();
    }
    channel
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_flood_of_large_requests_uses_bounded_memory() {
    let runs = Runs::new();
    let learner = learner(&runs.folder("run"), &[]);
    let before = ProcessUsage::of(&learner);
    let floods = (0..64).map(|_| tokio::spawn(flood(learner.url.clone()))).collect::<Vec<_>>();
    let mut most = before.resident_mib;
    let mut channels = Vec::new();
    for flood in floods {
        channels.push(flood.await.unwrap());
        most = most.max(ProcessUsage::of(&learner).resident_mib);
    }
    assert!(most <= before.resident_mib + MOST_MIB, "{most} MiB, {before:?}");
    assert!(is_healthy(&learner.url));
    finished(learner).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_learner_at_its_connection_limits_answers_probes_and_refuses_actors() {
    let runs = Runs::new();
    let learner = learner(&runs.folder("run"), &["learner.connections=3"]);
    let mut actors = Vec::new();
    for _ in 0..3 {
        actors.push(Attacker::connect(&learner.url).await);
    }
    let mut idle = Vec::new();
    for _ in 0..300 {
        idle.push(Endpoint::from_shared(learner.url.clone()).unwrap().connect().await.unwrap());
    }
    let mut late = LearnerServiceClient::connect(learner.url.clone()).await.unwrap();
    let refused = late.register(registration(&actors[0].run).to_wire()).await.unwrap_err();
    let refusal = Refusal::from_status(&refused).unwrap();
    assert_eq!((refusal.reason, refusal.field.as_str()), (Reason::Busy, "connection"));
    assert!(is_healthy(&learner.url));
    assert!(learner.process.log().contains("too many connections without an actor"));
    let lease = actors[0].lease().await.id;
    assert!(is_valid(&mut actors[0], lease).await);
    drop((actors, idle, late));
    finished(learner).await;
}
