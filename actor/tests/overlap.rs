//! Tests of an actor with several leases: it requests the next before the last steps of one, steps it while the last messages of
//! one are unacknowledged, and drops one whose stream is refused.
#![expect(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

#[path = "../../rollout/tests/rollout/fixture.rs"]
mod fixture;
#[path = "../../rollout/tests/rollout/work.rs"]
mod work;

use std::pin::Pin;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use actor::{ActorConfig, Transport};
use proto::wire::get_weights_response::Part;
use proto::wire::learner_service_server::{LearnerService, LearnerServiceServer};
use proto::wire::push_trajectory_request::Content;
use proto::{
    Ack, AckState, ActorId, Digest, HeartbeatAnswer, Incarnation, Lease, LeaseAnswer, LeaseId,
    PolicyVersion, PushHeader, Registered, RunDescription, RunState, WeightsName, Work, wire,
};
use tokio::net::TcpListener;
use tokio::sync::watch;
use tokio_stream::wrappers::TcpListenerStream;
use tokio_stream::{Stream, StreamExt as _};
use tonic::{Request, Response, Status, Streaming};

use fixture::policy;
use work::{CHUNK, STEPS, fresh_work, run};

const LEASES: u64 = 3;

/// When the fake learner acknowledges.
#[derive(Clone, Copy, PartialEq)]
enum Acknowledges {
    /// The last chunk of a slot when the first chunk of the next slot arrives, all others at once.
    AfterNextSlot,
    /// Every chunk when the next lease is requested.
    AfterNextRequest,
}

/// A learner that delays acknowledgements.
struct Withholding {
    weights: Vec<u8>,
    acknowledges: Acknowledges,
    /// Steps of a chunk.
    chunk: u32,
    /// The number of the first streams that it refuses.
    refused: u64,
    opened: AtomicU64,
    /// Requests for a lease.
    requested: watch::Sender<u64>,
    /// The highest lease of which a chunk has arrived.
    begun: watch::Sender<u64>,
    /// Leases, in the order of their last acknowledgements.
    finished: Mutex<Vec<u64>>,
    over: watch::Sender<bool>,
}

impl Withholding {
    fn new(acknowledges: Acknowledges, chunk: u32, refused: u64) -> Self {
        Self {
            weights: policy().to_bytes().unwrap(),
            acknowledges,
            chunk,
            refused,
            opened: AtomicU64::new(0),
            requested: watch::Sender::new(0),
            begun: watch::Sender::new(0),
            finished: Mutex::default(),
            over: watch::Sender::new(false),
        }
    }

    fn name(&self) -> WeightsName {
        WeightsName { version: PolicyVersion(1), digest: Digest(policy::digest(&self.weights)) }
    }
}

type Answers<M> = Pin<Box<dyn Stream<Item = Result<M, Status>> + Send>>;

/// The service, shared with the test, which reads the order of leases.
struct Shared(std::sync::Arc<Withholding>);

#[tonic::async_trait]
impl LearnerService for Shared {
    async fn describe_run(
        &self,
        _: Request<wire::DescribeRunRequest>,
    ) -> Result<Response<wire::DescribeRunResponse>, Status> {
        let chunk = self.0.chunk;
        let run = RunDescription { chunk_steps: chunk, hidden_every: chunk, ..run() };
        Ok(Response::new(wire::DescribeRunResponse { run: Some(run.to_wire()) }))
    }

    async fn register(
        &self,
        _: Request<wire::RegisterRequest>,
    ) -> Result<Response<wire::RegisterResponse>, Status> {
        let registered = Registered { actor: ActorId(1), incarnation: Incarnation(1) };
        Ok(Response::new(registered.to_wire()))
    }

    async fn lease_slots(
        &self,
        _: Request<wire::LeaseSlotsRequest>,
    ) -> Result<Response<wire::LeaseSlotsResponse>, Status> {
        self.0.requested.send_modify(|requested| *requested += 1);
        let id = LeaseId(*self.0.requested.borrow());
        if id.0 > LEASES {
            // The run is over once every slot is acknowledged.
            let _ = self.0.over.subscribe().wait_for(|&over| over).await;
            return Ok(Response::new(LeaseAnswer::Done.to_wire()));
        }
        let work = Work::Rollout(fresh_work());
        let weights = self.0.name();
        let lease = Lease { id, incarnation: Incarnation(1), weights, attempt: 0, work };
        Ok(Response::new(LeaseAnswer::Lease(lease).to_wire()))
    }

    type GetWeightsStream = Answers<wire::GetWeightsResponse>;

    async fn get_weights(
        &self,
        _: Request<wire::GetWeightsRequest>,
    ) -> Result<Response<Self::GetWeightsStream>, Status> {
        let total_bytes = self.0.weights.len() as u64;
        let header = wire::WeightsHeader { weights: Some(self.0.name().to_wire()), total_bytes };
        let parts = [Part::Header(header), Part::Data(self.0.weights.clone().into())];
        let answers = parts.map(|part| Ok(wire::GetWeightsResponse { part: Some(part) }));
        Ok(Response::new(Box::pin(tokio_stream::iter(answers))))
    }

    type PushTrajectoryStream = Answers<wire::PushTrajectoryResponse>;

    async fn push_trajectory(
        &self,
        request: Request<Streaming<wire::PushTrajectoryRequest>>,
    ) -> Result<Response<Self::PushTrajectoryStream>, Status> {
        if self.0.opened.fetch_add(1, Ordering::Relaxed) < self.0.refused {
            return Err(Status::aborted("the lease was revoked"));
        }
        let learner = std::sync::Arc::clone(&self.0);
        let acknowledged = request.into_inner().then(move |message| {
            let learner = std::sync::Arc::clone(&learner);
            async move { acknowledge(&learner, message?).await }
        });
        Ok(Response::new(Box::pin(acknowledged)))
    }

    async fn return_lease(
        &self,
        _: Request<wire::ReturnLeaseRequest>,
    ) -> Result<Response<wire::ReturnLeaseResponse>, Status> {
        Err(Status::unimplemented("no lease of this test fails"))
    }

    async fn heartbeat(
        &self,
        _: Request<wire::HeartbeatRequest>,
    ) -> Result<Response<wire::HeartbeatResponse>, Status> {
        let answer = HeartbeatAnswer { run_state: RunState::Running, lease_valid: true };
        Ok(Response::new(answer.to_wire()))
    }
}

async fn acknowledge(
    learner: &Withholding,
    message: wire::PushTrajectoryRequest,
) -> Result<wire::PushTrajectoryResponse, Status> {
    let (header, content) = PushHeader::from_wire(message)?;
    let Content::Chunk(chunk) = content else { panic!("no evaluation was leased") };
    let lease = header.lease;
    learner.begun.send_modify(|begun| *begun = lease.0.max(*begun));
    let lease_finished = (chunk.sequence + 1) * learner.chunk == STEPS;
    if learner.acknowledges == Acknowledges::AfterNextRequest {
        let _ = learner.requested.subscribe().wait_for(|&requested| requested > lease.0).await;
    }
    if lease_finished {
        if learner.acknowledges == Acknowledges::AfterNextSlot {
            let next = (lease.0 + 1).min(LEASES);
            let _ = learner.begun.subscribe().wait_for(|&begun| begun >= next).await;
        }
        let finished = &mut learner.finished.lock().unwrap();
        finished.push(lease.0);
        learner.over.send_replace(finished.len() as u64 == LEASES - learner.refused);
    }
    let (sequence, state) = (chunk.sequence, AckState::Accepted);
    Ok(Ack { lease, sequence, state, lease_finished }.to_wire())
}

/// The leases that an actor with this learner finishes, in order.
async fn finished_leases(learner: Withholding) -> Vec<u64> {
    let withholding = std::sync::Arc::new(learner);
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let learner = format!("http://{}", listener.local_addr().unwrap());
    let service = LearnerServiceServer::new(Shared(std::sync::Arc::clone(&withholding)));
    let server = tonic::transport::Server::builder().add_service(service);
    tokio::spawn(server.serve_with_incoming(TcpListenerStream::new(listener)));
    let config = ActorConfig {
        learner,
        transport: Transport::PlainTextOnLoopback,
        token: None,
        environment: None,
        max_outage_secs: 1.0,
        build: "test".to_owned(),
        name: "actor".to_owned(),
        threads: 1,
        log: None,
    };
    let (_stop, never) = watch::channel(false);
    let run = tokio::time::timeout(Duration::from_secs(60), actor::run(config, never));
    run.await.expect("the actor waits for an acknowledgement that the learner withholds").unwrap();
    let finished = withholding.finished.lock().unwrap();
    finished.clone()
}

#[tokio::test]
async fn an_actor_steps_the_next_slot_before_the_last_one_is_acknowledged() {
    let learner = Withholding::new(Acknowledges::AfterNextSlot, CHUNK, 0);
    assert_eq!(finished_leases(learner).await, [1, 2, 3]);
}

#[tokio::test]
async fn an_actor_requests_the_next_lease_before_the_last_steps_of_a_slot() {
    // Eight chunks fill the stream and the queue before it, so the actor cannot learn that the slot ended.
    let learner = Withholding::new(Acknowledges::AfterNextRequest, STEPS / 8, 0);
    assert_eq!(finished_leases(learner).await, [1, 2, 3]);
}

#[tokio::test]
async fn results_of_a_lease_whose_stream_is_refused_do_not_reach_the_next_lease() {
    let learner = Withholding::new(Acknowledges::AfterNextSlot, CHUNK, 1);
    assert_eq!(finished_leases(learner).await, [2, 3]);
}
