//! Client of the learner: one connection and its deadlines.

use std::ops::Range;
use std::sync::Arc;
use std::time::Duration;

use policy::PolicySnapshot;
use proto::wire::get_weights_response::Part;
use proto::wire::learner_service_client::LearnerServiceClient;
use proto::{
    Authorization, Heartbeat, HeartbeatAnswer, LeaseAnswer, MAX_DESCRIPTION_BYTES,
    MAX_MESSAGE_BYTES, MAX_UNACKNOWLEDGED, Registered, Registration, ReturnedLease, RunDescription,
    WeightsName, wire,
};
use security::{ClientTls, Token};
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tonic::service::interceptor::InterceptedService;
use tonic::transport::{Certificate, Channel, ClientTlsConfig, Endpoint, Identity};
use tonic::{Code, Request, Status, Streaming};

use crate::config::{ActorConfig, Transport};
use crate::diagnosis;
use crate::error::{ActorError, EnvironmentError, causes};

mod environment;
mod weights;

pub(crate) use environment::{EnvironmentClient, Play};
pub(crate) use weights::WeightsCache;

/// Deadline of calls that the learner answers immediately.
const CALL_DEADLINE: Duration = Duration::from_secs(10);
/// Deadline of a second connection, which finds the reason why the first one failed.
const DIAGNOSIS_DEADLINE: Duration = Duration::from_secs(5);
/// Longest time for which the learner may hold a lease request.
const LEASE_WAIT_MILLIS: u32 = 10_000;
/// Largest HTTP/2 frame, bytes. Weights need fewer frames than with the default of 16 KiB.
const MOST_FRAME_BYTES: u32 = 256 << 10;
/// Largest size of a snapshot, bytes.
const MAX_WEIGHTS_BYTES: u64 = 1 << 30;

/// Stream of results and their acknowledgements.
pub(crate) struct PushStream {
    pub(crate) results: mpsc::Sender<wire::PushTrajectoryRequest>,
    pub(crate) acknowledgements: Streaming<wire::PushTrajectoryResponse>,
}

/// A connection to the learner.
#[derive(Clone)]
pub(crate) struct Client {
    service: LearnerServiceClient<InterceptedService<Channel, Authorization>>,
}

impl Client {
    /// Connects to the learner within the deadline.
    pub(crate) async fn connect(config: &ActorConfig) -> Result<Self, ActorError> {
        let channel = endpoint(config)?.connect().await.map_err(|error| {
            let mut status = Status::unavailable(causes(&error));
            status.set_source(Arc::new(error));
            ActorError::Refused(status)
        })?;
        let header = config.token.as_ref().map(Token::header);
        let authorization = Authorization::new(header.as_deref());
        let service = LearnerServiceClient::with_interceptor(channel, authorization)
            .max_decoding_message_size(MAX_MESSAGE_BYTES)
            .max_encoding_message_size(MAX_MESSAGE_BYTES);
        Ok(Self { service })
    }

    pub(crate) async fn describe_run(&mut self) -> Result<RunDescription, ActorError> {
        let request = within(CALL_DEADLINE, wire::DescribeRunRequest {});
        let mut service = self.service.clone().max_decoding_message_size(MAX_DESCRIPTION_BYTES);
        let answer = service.describe_run(request).await?.into_inner();
        Ok(RunDescription::from_wire(answer.run)?)
    }

    pub(crate) async fn register(&mut self, own: &Registration) -> Result<Registered, ActorError> {
        let request = within(CALL_DEADLINE, own.to_wire());
        Ok(Registered::from_wire(&self.service.register(request).await?.into_inner()))
    }

    /// Requests a lease and reports the number of steps that the log lost since the last answer.
    pub(crate) async fn lease(
        &mut self,
        own: &Registered,
        run: &RunDescription,
        log_steps_lost: u64,
    ) -> Result<LeaseAnswer, ActorError> {
        let message = wire::LeaseSlotsRequest {
            actor_id: own.actor.0,
            incarnation: own.incarnation.0,
            wait_millis: LEASE_WAIT_MILLIS,
            log_steps_lost,
        };
        let deadline = CALL_DEADLINE + Duration::from_millis(LEASE_WAIT_MILLIS.into());
        let response = self.service.lease_slots(within(deadline, message)).await?;
        Ok(LeaseAnswer::from_wire(response.into_inner(), run)?)
    }

    pub(crate) async fn heartbeat(
        &mut self,
        beat: &Heartbeat,
    ) -> Result<HeartbeatAnswer, ActorError> {
        let answer = self.service.heartbeat(within(CALL_DEADLINE, beat.to_wire())).await?;
        Ok(HeartbeatAnswer::from_wire(&answer.into_inner())?)
    }

    /// Returns a lease that cannot be processed.
    pub(crate) async fn return_lease(
        &mut self,
        returned: &ReturnedLease,
    ) -> Result<(), ActorError> {
        self.service.return_lease(within(CALL_DEADLINE, returned.to_wire())).await?;
        Ok(())
    }

    pub(crate) async fn open_push(&mut self) -> Result<PushStream, ActorError> {
        let (results, queue) = mpsc::channel(MAX_UNACKNOWLEDGED);
        let answer = self.service.push_trajectory(ReceiverStream::new(queue)).await?;
        Ok(PushStream { results, acknowledgements: answer.into_inner() })
    }

    /// Returns the snapshot with this name, from the cache or the learner.
    pub(crate) async fn weights(
        &mut self,
        cache: &WeightsCache,
        name: WeightsName,
    ) -> Result<Arc<PolicySnapshot>, ActorError> {
        let fetch = async {
            let bytes = self.fetch(name).await?;
            Ok(Arc::new(decoded(&bytes, name)?))
        };
        cache.get(name, fetch).await
    }

    async fn fetch(&mut self, name: WeightsName) -> Result<Vec<u8>, ActorError> {
        let request = wire::GetWeightsRequest { weights: Some(name.to_wire()), repeats: true };
        let mut parts = self.service.get_weights(request).await?.into_inner();
        let mut bytes = Vec::new();
        let mut total = None;
        while let Some(part) = next(&mut parts).await? {
            match (part.part, total) {
                (Some(Part::Header(header)), None) => total = Some(size(&header, name)?),
                (Some(Part::Data(data)), Some(total)) if bytes.len() + data.len() <= total => {
                    bytes.extend_from_slice(&data);
                }
                (Some(Part::Repeat(repeat)), Some(total)) => {
                    let range = earlier(&repeat, bytes.len(), total);
                    bytes.extend_from_within(range.ok_or_else(|| out_of_order(name))?);
                }
                _ => return Err(out_of_order(name)),
            }
        }
        if policy::digest(&bytes) != name.digest.0 {
            let length = bytes.len();
            return Err(wrong_weights(
                name,
                format!("the digest of {length} bytes does not match"),
            ));
        }
        Ok(bytes)
    }
}

fn endpoint(config: &ActorConfig) -> Result<Endpoint, ActorError> {
    let wrong = |error| ActorError::learner_url(&config.learner, &causes(&error));
    let endpoint = Endpoint::from_shared(config.learner.clone())
        .map_err(wrong)?
        .connect_timeout(CALL_DEADLINE)
        .http2_keep_alive_interval(Duration::from_secs(30))
        .keep_alive_timeout(Duration::from_secs(10))
        .keep_alive_while_idle(true)
        .tcp_nodelay(true)
        .max_frame_size(MOST_FRAME_BYTES);
    match &config.transport {
        Transport::PlainText | Transport::PlainTextOnLoopback => Ok(endpoint),
        Transport::Tls(tls) => endpoint.tls_config(client_tls(tls)).map_err(wrong),
    }
}

fn client_tls(tls: &ClientTls) -> ClientTlsConfig {
    let config = ClientTlsConfig::new()
        .ca_certificate(Certificate::from_pem(&tls.authority))
        .identity(Identity::from_pem(&tls.certificate, &tls.key));
    match &tls.server_name {
        Some(name) => config.domain_name(name),
        None => config,
    }
}

impl From<Status> for ActorError {
    fn from(status: Status) -> Self {
        Self::Refused(status)
    }
}

/// Replaces an error by its reason if the TLS settings of the two sides do not match.
pub(crate) async fn explained(error: ActorError, config: &ActorConfig) -> ActorError {
    let ActorError::Refused(status) = &error else { return error };
    let broken = matches!(status.code(), Code::Unavailable | Code::Unknown | Code::Cancelled)
        || status.message().starts_with("h2 protocol error");
    let why = match (&config.transport, security::explain(status)) {
        (_, Some(why)) => Some(why),
        (_, None) if !broken => None,
        (transport, None) => {
            let tls = match transport {
                Transport::Tls(tls) => Some(tls),
                Transport::PlainText | Transport::PlainTextOnLoopback => None,
            };
            diagnosis::reason(&config.learner, tls, DIAGNOSIS_DEADLINE).await
        }
    };
    match why {
        Some(why) => ActorError::Other(format!("no session with {}: {why}", config.learner)),
        None => error,
    }
}

/// Whether a retry with a new connection can succeed.
pub(crate) fn is_transient(error: &ActorError) -> bool {
    let status = match error {
        ActorError::Refused(status) => status,
        ActorError::Environment(EnvironmentError::Away { status, .. }) => status.as_ref(),
        ActorError::Weights { .. } => return true,
        _ => return false,
    };
    !matches!(
        status.code(),
        Code::InvalidArgument
            | Code::FailedPrecondition
            | Code::PermissionDenied
            | Code::Unauthenticated
            | Code::Unimplemented
            | Code::OutOfRange
    )
}

/// Receives the next message of a stream within the deadline.
async fn next<M>(stream: &mut Streaming<M>) -> Result<Option<M>, ActorError> {
    match tokio::time::timeout(CALL_DEADLINE, stream.message()).await {
        Ok(message) => Ok(message?),
        Err(_) => Err(Status::deadline_exceeded("the learner stopped sending weights").into()),
    }
}

fn size(header: &wire::WeightsHeader, name: WeightsName) -> Result<usize, ActorError> {
    let total = header.total_bytes;
    if total > MAX_WEIGHTS_BYTES {
        return Err(wrong_weights(
            name,
            format!("they have {total} bytes; the limit is {MAX_WEIGHTS_BYTES}"),
        ));
    }
    Ok(total as usize)
}

/// The received bytes that a part repeats; `None` if there are fewer, or if the snapshot would have more than `total`.
fn earlier(repeat: &wire::WeightsRepeat, received: usize, total: usize) -> Option<Range<usize>> {
    let offset = usize::try_from(repeat.offset).ok()?;
    let length = usize::try_from(repeat.length).ok().filter(|it| *it <= total - received)?;
    offset.checked_add(length).filter(|end| *end <= received).map(|end| offset..end)
}

fn out_of_order(name: WeightsName) -> ActorError {
    wrong_weights(name, "parts are out of order or too long".to_owned())
}

/// Decodes weights that match their name. A retry would receive the same bytes.
fn decoded(bytes: &[u8], name: WeightsName) -> Result<PolicySnapshot, ActorError> {
    PolicySnapshot::from_bytes(bytes).map_err(|error| {
        let version = name.version.0;
        ActorError::Other(format!(
            "this build cannot decode weights {version} ({error}); use the learner's build"
        ))
    })
}

fn wrong_weights(name: WeightsName, why: String) -> ActorError {
    ActorError::Weights { version: name.version.0, why }
}

fn within<M>(deadline: Duration, message: M) -> Request<M> {
    let mut request = Request::new(message);
    request.set_timeout(deadline);
    request
}

#[cfg(test)]
mod tests {
    use proto::{Digest, PolicyVersion};

    use super::*;

    #[test]
    fn weights_that_this_build_cannot_decode_end_the_actor_and_damaged_ones_are_requested_again() {
        let name = WeightsName { version: PolicyVersion(3), digest: Digest([7; 32]) };
        let error = decoded(b"weights of another build", name).unwrap_err();
        assert!(!is_transient(&error) && is_transient(&out_of_order(name)));
        let line = error.to_string();
        assert!(line.starts_with("this build cannot decode weights 3 ("), "{line}");
    }
}
