//! Tests of an actor with several leases: it requests the next before the last steps of one, steps it while the last messages of
//! one are unacknowledged, and drops one whose stream is refused.
#![expect(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

#[path = "../../rollout/tests/rollout/fixture.rs"]
mod fixture;
#[path = "../../rollout/tests/rollout/work.rs"]
mod work;

use std::pin::Pin;
use std::time::Duration;

use actor::{ActorConfig, Transport};
use proto::wire::get_weights_response::Part;
use proto::wire::learner_service_server::{LearnerService, LearnerServiceServer};
use proto::wire::push_trajectory_request::Content;
use proto::{
    Ack, AckState, ActorId, Digest, HeartbeatAnswer, Incarnation, Lease, LeaseAnswer, LeaseId,
    PolicyVersion, PushHeader, Registered, RunDescription, WeightsName, Work, wire,
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

/// A learner that delays acknowledgements. The test keeps a clone of it, which shares its state.
#[derive(Clone)]
struct Withholding {
    acknowledges: Acknowledges,
    /// Steps of a chunk.
    chunk: u32,
    /// The number of the first streams that it refuses.
    refused: u64,
    /// Streams that were opened.
    opened: watch::Sender<u64>,
    /// Requests for a lease.
    requested: watch::Sender<u64>,
    /// The highest lease of which a chunk has arrived.
    begun: watch::Sender<u64>,
    /// Leases, in the order of their last acknowledgements.
    finished: watch::Sender<Vec<u64>>,
}

impl Withholding {
    fn new(acknowledges: Acknowledges, chunk: u32, refused: u64) -> Self {
        let (opened, requested, begun, finished) = Default::default();
        Self { acknowledges, chunk, refused, opened, requested, begun, finished }
    }

    async fn acknowledge(
        self,
        message: Result<wire::PushTrajectoryRequest, Status>,
    ) -> Result<wire::PushTrajectoryResponse, Status> {
        let (header, content) = PushHeader::from_wire(message?)?;
        let Content::Chunk(chunk) = content else { panic!("no evaluation was leased") };
        let lease = header.lease;
        self.begun.send_modify(|begun| *begun = lease.0.max(*begun));
        let lease_finished = (chunk.sequence + 1) * self.chunk == STEPS;
        if self.acknowledges == Acknowledges::AfterNextRequest {
            let _ = self.requested.subscribe().wait_for(|&requested| requested > lease.0).await;
        }
        if lease_finished {
            if self.acknowledges == Acknowledges::AfterNextSlot {
                let next = (lease.0 + 1).min(LEASES);
                let _ = self.begun.subscribe().wait_for(|&begun| begun >= next).await;
            }
            self.finished.send_modify(|finished| finished.push(lease.0));
        }
        let (sequence, state) = (chunk.sequence, AckState::Accepted);
        Ok(Ack { lease, sequence, state, lease_finished }.to_wire())
    }
}

fn weights() -> (WeightsName, Vec<u8>) {
    let bytes = policy().to_bytes().unwrap();
    (WeightsName { version: PolicyVersion(1), digest: Digest(policy::digest(&bytes)) }, bytes)
}

type Answers<M> = Pin<Box<dyn Stream<Item = Result<M, Status>> + Send>>;

#[tonic::async_trait]
impl LearnerService for Withholding {
    async fn describe_run(
        &self,
        _: Request<wire::DescribeRunRequest>,
    ) -> Result<Response<wire::DescribeRunResponse>, Status> {
        let run = RunDescription { chunk_steps: self.chunk, hidden_every: self.chunk, ..run() };
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
        self.requested.send_modify(|requested| *requested += 1);
        let id = LeaseId(*self.requested.borrow());
        if id.0 > LEASES {
            // The run is over once every slot is acknowledged.
            let all = (LEASES - self.refused) as usize;
            let _ = self.finished.subscribe().wait_for(|finished| finished.len() == all).await;
            return Ok(Response::new(LeaseAnswer::Done.to_wire()));
        }
        let (work, (weights, _)) = (Work::Rollout(fresh_work()), weights());
        let lease = Lease { id, incarnation: Incarnation(1), weights, attempt: 0, work };
        Ok(Response::new(LeaseAnswer::Lease(lease).to_wire()))
    }

    type GetWeightsStream = Answers<wire::GetWeightsResponse>;

    async fn get_weights(
        &self,
        _: Request<wire::GetWeightsRequest>,
    ) -> Result<Response<Self::GetWeightsStream>, Status> {
        let (name, bytes) = weights();
        let (weights, total_bytes) = (Some(name.to_wire()), bytes.len() as u64);
        let header = wire::WeightsHeader { weights, total_bytes };
        let parts = [Part::Header(header), Part::Data(bytes.into())];
        let answers = parts.map(|part| Ok(wire::GetWeightsResponse { part: Some(part) }));
        Ok(Response::new(Box::pin(tokio_stream::iter(answers))))
    }

    type PushTrajectoryStream = Answers<wire::PushTrajectoryResponse>;

    async fn push_trajectory(
        &self,
        request: Request<Streaming<wire::PushTrajectoryRequest>>,
    ) -> Result<Response<Self::PushTrajectoryStream>, Status> {
        self.opened.send_modify(|opened| *opened += 1);
        if *self.opened.borrow() <= self.refused {
            return Err(Status::aborted("the lease was revoked"));
        }
        let learner = self.clone();
        let acknowledge = move |message| learner.clone().acknowledge(message);
        Ok(Response::new(Box::pin(request.into_inner().then(acknowledge))))
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
        let answer = HeartbeatAnswer { lease_valid: true, is_over: false };
        Ok(Response::new(answer.to_wire()))
    }
}

/// The leases that an actor with this learner finishes, ascending: two that end at the same time may be acknowledged in any order.
async fn finished_leases(learner: Withholding) -> Vec<u64> {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let url = format!("http://{}", listener.local_addr().unwrap());
    let service = LearnerServiceServer::new(learner.clone());
    let server = tonic::transport::Server::builder().add_service(service);
    tokio::spawn(server.serve_with_incoming(TcpListenerStream::new(listener)));
    let config = ActorConfig {
        learner: url,
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
    let mut finished = learner.finished.borrow().clone();
    finished.sort_unstable();
    finished
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
