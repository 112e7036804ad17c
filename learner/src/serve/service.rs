//! The gRPC service: it converts messages into calls of the exchange and refusals into statuses. Limits, keepalive and
//! deadlines are set here; the slot table decides which calls are allowed when.

use std::sync::Arc;
use std::time::Duration;

use proto::wire::control_service_server::{self, ControlServiceServer};
use proto::wire::learner_service_server::{self, LearnerService, LearnerServiceServer};
use proto::{
    ActorId, Heartbeat, Incarnation, LeaseId, MAX_DESCRIPTION_BYTES, MAX_LEASE_WAIT_MILLIS,
    MAX_MESSAGE_BYTES, MAX_UNACKNOWLEDGED, Reason, Refusal, Registration, ReturnedLease,
    WeightsName, wire,
};
use security::Role;
use tokio::sync::{Semaphore, mpsc};
use tokio_stream::wrappers::ReceiverStream;
use tonic::service::interceptor::InterceptedService;
use tonic::transport::Server;
use tonic::{Code, Request, Response, Status, Streaming};
use tonic_health::pb::health_server;
use tonic_reflection::server::Builder;

use crate::lease::exchange::{Caller, Exchange};
use crate::serve::listener::Listener;
use crate::serve::service::control::Control;
use crate::serve::service::ingest::Results;

mod bodies;
mod connections;
mod control;
mod deadline;
mod handshake;
mod ingest;
mod operator;
mod policies;
mod registry;
mod snapshots;
mod storage;

pub use operator::{Operator, WatchedLines};
pub use policies::{ServedPolicies, serve_policies};

/// Interval of keepalive pings on an idle connection.
const KEEPALIVE: Duration = Duration::from_secs(20);
/// A connection whose peer does not answer a ping for this long is closed, which frees its leases.
const KEEPALIVE_TIMEOUT: Duration = Duration::from_secs(10);
/// Most concurrent streams of one connection.
const MOST_STREAMS: u32 = 16;
/// Flow-control window of one connection, bytes.
const CONNECTION_WINDOW: u32 = 4 << 20;
/// Flow-control window of one stream, bytes. Result streams that wait to be checked leave room for other calls.
const STREAM_WINDOW: u32 = CONNECTION_WINDOW / (connections::MOST_PUSHES as u32 + 2);
/// Largest HTTP/2 frame, bytes. Most chunks fit into one, instead of many frames of the default 16 KiB.
const MOST_FRAME_BYTES: u32 = 256 << 10;
/// Most bytes of all headers of one request.
const MOST_HEADER_BYTES: u32 = 16 << 10;

/// Services of a learner besides health and reflection.
const LEARNER_SERVICES: [&str; 2] =
    [learner_service_server::SERVICE_NAME, control_service_server::SERVICE_NAME];
/// Reason why building reflection cannot fail.
const COMPILED: &str = "the descriptors were compiled with the program";

/// Serves `exchange` at `listener` until `shutdown` completes and the open calls have ended. At most `most_with_actors`
/// connections may have actors.
///
/// # Errors
/// The service failed.
pub async fn serve(
    exchange: Arc<Exchange>,
    listener: Listener,
    most_with_actors: usize,
    shutdown: impl Future<Output = ()>,
) -> Result<(), tonic::transport::Error> {
    let closed_on = Arc::clone(&exchange);
    let on_close = Arc::new(move |id| closed_on.disconnect(id));
    let incoming = connections::accept(listener, most_with_actors, on_close);
    let storage = exchange.storage();
    let environment_bytes = proto::wire_bytes(&exchange.run.environment.to_wire());
    let control = ControlServiceServer::new(Control { exchange: Arc::clone(&exchange) });
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let learner = Learner { exchange, checks: Arc::new(Semaphore::new(cores)) };
    let learner = LearnerServiceServer::new(learner)
        .max_decoding_message_size(MAX_MESSAGE_BYTES)
        .max_encoding_message_size(MAX_DESCRIPTION_BYTES);
    let (reporter, health) = tonic_health::server::health_reporter();
    reporter.set_serving::<LearnerServiceServer<Learner>>().await;
    tokio::spawn(storage::follow(storage, reporter));
    server()
        .layer(bodies::limits(environment_bytes))
        .add_service(InterceptedService::new(learner, connections::needs(Role::Actor)))
        .add_service(control)
        .add_service(health)
        .add_service(reflection(&LEARNER_SERVICES).build_v1().expect(COMPILED))
        .add_service(reflection(&LEARNER_SERVICES).build_v1alpha().expect(COMPILED))
        .serve_with_incoming_shutdown(incoming, shutdown)
        .await
}

/// A server with the limits common to all services.
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

/// Server reflection for `services`. Tools use either of its two versions, so both are served.
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
    /// Permits of concurrent checks of results, one for each core. More threads would only wait for cores, and each
    /// thread that has checked a result keeps freed memory.
    checks: Arc<Semaphore>,
}

impl Learner {
    /// Logs and counts a refusal and converts it to a status.
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
        let run = Some(self.exchange.run.to_wire());
        Ok(Response::new(wire::DescribeRunResponse { run }))
    }

    async fn register(
        &self,
        request: Request<wire::RegisterRequest>,
    ) -> Result<Response<wire::RegisterResponse>, Status> {
        let caller = connections::caller(&request, "register");
        let registered = Registration::from_wire(request.get_ref().clone())
            .and_then(|registration| self.exchange.register(caller.connection, &registration))
            .map_err(|refusal| self.counted(&caller, refusal))?;
        // Afterwards, so that a refused registration takes no place, and a connection that closed keeps no actor.
        if let Err(refusal) = connections::note_actor(&request) {
            self.exchange.disconnect(caller.connection);
            return Err(self.counted(&caller, refusal));
        }
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
        let timeout = Duration::from_millis(millis.into());
        let sender = caller.connection;
        let answer = self.exchange.lease(sender, actor, incarnation, timeout).await;
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
        let wire::GetWeightsRequest { weights, repeats } = request.into_inner();
        let found = WeightsName::from_wire(weights, "weights")
            .and_then(|name| self.exchange.weights(name))
            .map_err(|refusal| self.counted(&caller, refusal))?;
        let repeats = if repeats { found.repeats.clone() } else { Vec::new() };
        Ok(Response::new(snapshots::stream(found.name, found.bytes.clone(), repeats, caller)))
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
        // A full channel means that the actor does not receive its acknowledgements; then no further message is read.
        let (acks, stream) = mpsc::channel(MAX_UNACKNOWLEDGED);
        let pushes = connections::pushes(&request);
        let share = request.extensions().get().cloned();
        let messages = request.into_inner();
        let checks = Arc::clone(&self.checks);
        let results = Results { messages, pushes, share, checks };
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

    async fn return_lease(
        &self,
        request: Request<wire::ReturnLeaseRequest>,
    ) -> Result<Response<wire::ReturnLeaseResponse>, Status> {
        let caller = connections::caller(&request, "return_lease");
        ReturnedLease::from_wire(request.get_ref())
            .and_then(|returned| self.exchange.give_back(caller.connection, &returned))
            .map_err(|refusal| self.counted(&caller, refusal))?;
        Ok(Response::new(wire::ReturnLeaseResponse {}))
    }
}

/// The refusal for an unreadable message; `None` if the peer disconnected.
fn unreadable(status: &Status) -> Option<Refusal> {
    let reason = match status.code() {
        // tonic's status for a message over the limit.
        Code::OutOfRange | Code::ResourceExhausted => Reason::TooLarge,
        Code::Internal => Reason::Undecodable,
        _ => return None,
    };
    Some(Refusal::new(reason, "message", status.message()))
}

/// Logs and counts a refusal of a message for `lease` and converts it to a status.
fn refused(
    exchange: &Exchange,
    caller: &Caller,
    lease: Option<LeaseId>,
    refusal: Refusal,
) -> Status {
    exchange.refused(caller, lease, &refusal);
    refusal.into()
}
