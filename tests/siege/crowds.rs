//! Two hundred peers at once.

use proto::wire::learner_service_client::LearnerServiceClient;
use proto::{RunDescription, WeightsName, wire};
use tonic::transport::Endpoint;

use crate::attackers::{Attacker, registration};
use crate::learners::{Learner, inspect};
use crate::usage::Usage;

const PEERS: usize = 200;
/// What a peer that reads nothing may cost the learner: most of it is what waits to be sent.
const MOST_MIB_EACH: u64 = 1;

/// Weights of some hundred kilobytes: more than the peers take in without reading. Leases of peers end soon.
const SETTINGS: [&str; 3] = ["policy.hidden=128", "lease.ttl_secs=2", "lease.heartbeat_secs=0.5"];
/// The least that HTTP/2 starts with, bytes.
const WINDOW: u32 = 65_535;

/// Connects, registers, asks for weights of which it reads nothing, and keeps still.
async fn peer(url: String, run: RunDescription, weights: WeightsName) -> impl Sized {
    let endpoint = Endpoint::from_shared(url).unwrap();
    let endpoint =
        endpoint.initial_stream_window_size(WINDOW).initial_connection_window_size(WINDOW);
    let mut service = LearnerServiceClient::new(endpoint.connect().await.unwrap());
    service.register(registration(&run).to_wire()).await.unwrap();
    let request = wire::GetWeightsRequest { weights: Some(weights.to_wire()) };
    let unread = service.get_weights(request).await.unwrap();
    (service, unread)
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn two_hundred_peers_that_register_idle_and_vanish_cost_little_and_change_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let (besieged, in_peace) = (folder.path().join("besieged"), folder.path().join("in-peace"));
    let settings = SETTINGS.map(str::to_owned);
    let mut learner = Learner::start(&besieged, &settings);
    let before = Usage::of(learner.process.id());
    let mut first = Attacker::connect(&learner.url).await;
    let (run, weights) = (first.run.clone(), first.lease().await.weights);
    let peer = |_| tokio::spawn(peer(learner.url.clone(), run.clone(), weights));
    let peers = (0..PEERS).map(peer).collect::<Vec<_>>();
    let mut held = Vec::new();
    for each in peers {
        held.push(each.await.unwrap());
    }
    let during = Usage::of(learner.process.id());
    assert!(during.descriptors <= before.descriptors + PEERS + 16, "{before:?}, {during:?}");
    assert!(
        during.resident_mib <= before.resident_mib + MOST_MIB_EACH * PEERS as u64,
        "{before:?}, {during:?}"
    );
    // Half of them vanish, the other half look on while an honest actor does the work.
    held.truncate(PEERS / 2);
    while Usage::of(learner.process.id()).descriptors > before.descriptors + PEERS / 2 + 16 {
        tokio::task::yield_now().await;
    }
    tokio::task::spawn_blocking(move || learner.finish(&[])).await.unwrap();
    drop(held);
    let mut quiet = Learner::start(&in_peace, &settings);
    tokio::task::spawn_blocking(move || quiet.finish(&[])).await.unwrap();
    assert_eq!(inspect(&besieged), inspect(&in_peace));
}
