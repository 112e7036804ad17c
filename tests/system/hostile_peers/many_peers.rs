//! Two hundred concurrent peers.

use proto::wire::learner_service_client::LearnerServiceClient;
use proto::{RunDescription, WeightsName, wire};
use tonic::transport::Endpoint;

use super::attackers::{Attacker, registration};
use super::{ProcessUsage, finished, learner};
use crate::runs::{Runs, inspect};

const PEERS: usize = 200;
/// Maximum memory of the learner per peer that reads nothing, mostly unsent data.
const MOST_MIB_EACH: u64 = 1;

/// Weights of a few hundred kilobytes, more than a peer's flow-control window, and short leases.
const SETTINGS: [&str; 2] = ["policy.hidden=128", "lease.ttl_secs=2"];
/// Initial window size of HTTP/2, bytes.
const WINDOW: u32 = 65_535;

/// Connects, registers, and requests weights without reading them.
async fn peer(url: String, run: RunDescription, weights: WeightsName) -> impl Sized {
    let endpoint = Endpoint::from_shared(url).unwrap();
    let endpoint =
        endpoint.initial_stream_window_size(WINDOW).initial_connection_window_size(WINDOW);
    let mut service = LearnerServiceClient::new(endpoint.connect().await.unwrap());
    service.register(registration(&run).to_wire()).await.unwrap();
    let request = wire::GetWeightsRequest { weights: Some(weights.to_wire()), repeats: false };
    let unread = service.get_weights(request).await.unwrap();
    (service, unread)
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn two_hundred_idle_and_vanishing_peers_use_little_memory_and_do_not_affect_the_run() {
    let runs = Runs::new();
    let (attacked, undisturbed) = (runs.folder("attacked"), runs.folder("undisturbed"));
    learner(&undisturbed, &SETTINGS).finish(&[]);
    let learner = learner(&attacked, &SETTINGS);
    let before = ProcessUsage::of(&learner);
    let mut first = Attacker::connect(&learner.url).await;
    let (run, weights) = (first.run.clone(), first.lease().await.weights);
    let peer = |_| tokio::spawn(peer(learner.url.clone(), run.clone(), weights));
    let peers = (0..PEERS).map(peer).collect::<Vec<_>>();
    let mut held = Vec::new();
    for each in peers {
        held.push(each.await.unwrap());
    }
    let during = ProcessUsage::of(&learner);
    assert!(during.descriptors <= before.descriptors + PEERS + 16, "{before:?}, {during:?}");
    assert!(
        during.resident_mib <= before.resident_mib + MOST_MIB_EACH * PEERS as u64,
        "{before:?}, {during:?}"
    );
    // Half of them disconnect, the others stay idle while a valid actor does the work.
    held.truncate(PEERS / 2);
    while ProcessUsage::of(&learner).descriptors > before.descriptors + PEERS / 2 + 16 {
        tokio::task::yield_now().await;
    }
    finished(learner).await;
    drop(held);
    assert_eq!(inspect(&attacked), inspect(&undisturbed));
}
