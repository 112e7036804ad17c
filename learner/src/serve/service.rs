//! The gRPC service: it turns messages into calls of the exchange, and refusals into statuses. Limits,
//! keepalive and deadlines stand here; what is allowed when is decided in the slot table.

use std::sync::Arc;
use std::time::Duration;

use proto::wire::control_service_server::{self, ControlServiceServer};
use proto::wire::learner_service_server::{self, LearnerService, LearnerServiceServer};
use proto::{
    ActorId, Heartbeat, Incarnation, LeaseId, MAX_LEASE_WAIT_MILLIS, MAX_MESSAGE_BYTES,
    MAX_UNACKNOWLEDGED, Reason, Refusal, Registration, WeightsName, wire,
};
use security::Role;
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tonic::service::interceptor::InterceptedService;
use tonic::transport::Server;
use tonic::{Request, Response, Status, Streaming};
use tonic_health::pb::health_server;
use tonic_reflection::server::Builder;

use crate::door::Door;
use crate::exchange::{Caller, Exchange};
use crate::service::control::Control;
use crate::service::ingest::Results;

mod bodies;
mod connections;
mod control;
mod crowd;
mod deadline;
mod greeting;
mod ingest;
mod opened;
mod operator;
mod policies;
mod registry;
mod snapshots;
mod storage;

pub use operator::{DistantCheckpoint, Operator, WatchedLines};
pub use policies::{ServedPolicies, serve_policies};
pub use storage::STORAGE;

/// A connection on which nothing came is asked for a sign of life after this long...
const KEEPALIVE: Duration = Duration::from_secs(20);
/// ... and closed when none comes for this long: its leases are free again.
const KEEPALIVE_TIMEOUT: Duration = Duration::from_secs(10);
/// Streams of one connection.
const MOST_STREAMS: u32 = 16;
/// What one stream may have in flight, bytes.
const STREAM_WINDOW: u32 = 1 << 20;
/// What one connection may have in flight, bytes.
const CONNECTION_WINDOW: u32 = 4 << 20;
/// Largest HTTP/2 frame, bytes: most chunks arrive in one instead of in pieces of 16 KiB.
const MOST_FRAME_BYTES: u32 = 256 << 10;
/// Size of all headers of one request, bytes.
const MOST_HEADER_BYTES: u32 = 16 << 10;

/// What a learner serves besides health and reflection.
const OF_LEARNERS: [&str; 2] =
    [learner_service_server::SERVICE_NAME, control_service_server::SERVICE_NAME];
/// Why reflection can always be built.
const COMPILED: &str = "the descriptors were compiled with the program";

/// Serves `exchange` at `door` until `shutdown` completes and the open calls have ended. At most `most_with_actors`
/// connections may have actors.
///
/// # Errors
/// Says why the service broke down.
pub async fn serve(
    exchange: Arc<Exchange>,
    door: Door,
    most_with_actors: usize,
    shutdown: impl Future<Output = ()>,
) -> Result<(), tonic::transport::Error> {
    let held = Arc::clone(&exchange);
    let farewell = Arc::new(move |id| held.disconnect(id));
    let incoming = connections::accept(door, most_with_actors, farewell);
    let storage = exchange.storage();
    let control = ControlServiceServer::new(Control { exchange: Arc::clone(&exchange) });
    let learner = LearnerServiceServer::new(Learner { exchange })
        .max_decoding_message_size(MAX_MESSAGE_BYTES)
        .max_encoding_message_size(MAX_MESSAGE_BYTES);
    let (reporter, health) = tonic_health::server::health_reporter();
    reporter.set_serving::<LearnerServiceServer<Learner>>().await;
    tokio::spawn(storage::follow(storage, reporter));
    server()
        .layer(bodies::limits())
        .add_service(InterceptedService::new(learner, connections::needs(Role::Actor)))
        .add_service(control)
        .add_service(health)
        .add_service(reflection(&OF_LEARNERS).build_v1().expect(COMPILED))
        .add_service(reflection(&OF_LEARNERS).build_v1alpha().expect(COMPILED))
        .serve_with_incoming_shutdown(incoming, shutdown)
        .await
}

/// A server with the limits that hold for all of ours.
fn server() -> Server {
    Server::builder()
        .http2_keepalive_interval(Some(KEEPALIVE))
        .http2_keepalive_timeout(Some(KEEPALIVE_TIMEOUT))
        .max_concurrent_streams(MOST_STREAMS)
        .initial_stream_window_size(STREAM_WINDOW)
        .initial_connection_window_size(CONNECTION_WINDOW)
        .max_frame_size(MOST_FRAME_BYTES)
        .http2_max_header_list_size(MOST_HEADER_BYTES)
}

/// Tells which of our services there are. Tools in use ask in either of two versions, so both are served.
fn reflection(services: &[&str]) -> Builder<'static> {
    let configured = Builder::configure()
        .register_encoded_file_descriptor_set(wire::DESCRIPTORS)
        .register_encoded_file_descriptor_set(tonic_health::pb::FILE_DESCRIPTOR_SET)
        .with_service_name(health_server::SERVICE_NAME);
    services.iter().fold(configured, |configured, name| configured.with_service_name(*name))
}

/// The calls of `LearnerService`.
#[derive(Debug)]
struct Learner {
    exchange: Arc<Exchange>,
}

impl Learner {
    /// Tells and counts a refusal and makes it a status.
    fn counted(&self, caller: &Caller, refusal: Refusal) -> Status {
        refused(&self.exchange, caller, None, refusal)
    }
}

#[tonic::async_trait]
impl LearnerService for Learner {
    async fn describe_run(
        &self,
        _request: Request<wire::DescribeRunRequest>,
    ) -> Result<Response<wire::DescribeRunResponse>, Status> {
        let run = Some(self.exchange.run().to_wire());
        Ok(Response::new(wire::DescribeRunResponse { run }))
    }

    async fn register(
        &self,
        request: Request<wire::RegisterRequest>,
    ) -> Result<Response<wire::RegisterResponse>, Status> {
        let caller = connections::caller(&request, "register");
        let room = connections::note_actor(&request);
        let registered = room
            .and_then(|()| Registration::from_wire(request.into_inner()))
            .and_then(|registration| self.exchange.register(caller.connection, &registration))
            .map_err(|refusal| self.counted(&caller, refusal))?;
        Ok(Response::new(registered.to_wire()))
    }

    async fn lease_slots(
        &self,
        request: Request<wire::LeaseSlotsRequest>,
    ) -> Result<Response<wire::LeaseSlotsResponse>, Status> {
        let caller = connections::caller(&request, "lease_slots");
        let request = request.into_inner();
        let millis = request.wait_millis.min(MAX_LEASE_WAIT_MILLIS);
        let (actor, incarnation) = (ActorId(request.actor_id), Incarnation(request.incarnation));
        let patience = Duration::from_millis(millis.into());
        let sender = caller.connection;
        let answer = self.exchange.lease(sender, actor, incarnation, patience).await;
        let answer = answer.map_err(|refusal| self.counted(&caller, refusal))?;
        self.exchange.count_lost_log_steps(request.log_steps_lost);
        Ok(Response::new(answer.to_wire()))
    }

    type GetWeightsStream = ReceiverStream<Result<wire::GetWeightsResponse, Status>>;

    async fn get_weights(
        &self,
        request: Request<wire::GetWeightsRequest>,
    ) -> Result<Response<Self::GetWeightsStream>, Status> {
        let caller = connections::caller(&request, "get_weights");
        let found = WeightsName::from_wire(request.into_inner().weights, "weights")
            .and_then(|name| self.exchange.snapshot(name).map(|bytes| (name, bytes)));
        let (name, bytes) = found.map_err(|refusal| self.counted(&caller, refusal))?;
        Ok(Response::new(snapshots::stream(name, bytes, caller)))
    }

    type PushTrajectoryStream = ReceiverStream<Result<wire::PushTrajectoryResponse, Status>>;

    async fn push_trajectory(
        &self,
        request: Request<Streaming<wire::PushTrajectoryRequest>>,
    ) -> Result<Response<Self::PushTrajectoryStream>, Status> {
        let caller = connections::caller(&request, "push_trajectory");
        if !self.exchange.is_registered(caller.connection) {
            let detail = "no actor is registered on this connection";
            let refusal = Refusal::new(Reason::UnknownActor, "connection", detail);
            return Err(self.counted(&caller, refusal));
        }
        // Full when the actor does not take its acknowledgements away; then nothing more is read.
        let (acks, stream) = mpsc::channel(MAX_UNACKNOWLEDGED);
        let (pushes, share) = (connections::pushes(&request), request.extensions().get().cloned());
        let results = Results { messages: request.into_inner(), pushes, share };
        tokio::spawn(ingest::pump(Arc::clone(&self.exchange), caller, results, acks));
        Ok(Response::new(ReceiverStream::new(stream)))
    }

    async fn heartbeat(
        &self,
        request: Request<wire::HeartbeatRequest>,
    ) -> Result<Response<wire::HeartbeatResponse>, Status> {
        let caller = connections::caller(&request, "heartbeat");
        let beat = Heartbeat::from_wire(&request.into_inner());
        let answer = self.exchange.heartbeat(caller.connection, &beat);
        let answer = answer.map_err(|refusal| self.counted(&caller, refusal))?;
        Ok(Response::new(answer.to_wire()))
    }
}

/// A refusal of something that belongs to `lease`, told, counted and made a status.
fn refused(
    exchange: &Exchange,
    caller: &Caller,
    lease: Option<LeaseId>,
    refusal: Refusal,
) -> Status {
    exchange.refused(caller, lease, &refusal);
    refusal.into()
}
