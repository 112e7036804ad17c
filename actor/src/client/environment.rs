//! Client of a program that provides environments: one call for the specification, then a stream of requests and
//! answers.

use std::ops::Range;
use std::time::Duration;

use proto::wire::environment_service_client::EnvironmentServiceClient;
use proto::{EnvironmentSpec, MAX_MESSAGE_BYTES, PlayRequest, Refusal, Steps, View, wire};
use tokio::runtime::Handle;
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tonic::transport::{Channel, Endpoint};
use tonic::{Status, Streaming};

use super::{CALL_DEADLINE, within};
use crate::error::{ActorError, EnvironmentError, causes};

/// Deadline of an answer on the stream, for each request.
const ANSWER_DEADLINE: Duration = Duration::from_secs(60);

/// A connection to a program that provides an environment.
#[derive(Clone, Debug)]
pub(crate) struct EnvironmentClient {
    url: String,
    service: EnvironmentServiceClient<Channel>,
}

/// A stream of requests, used on a thread that may block. It is opened with the first request, because some servers
/// send nothing before it.
#[derive(Debug)]
pub(crate) struct Play {
    client: EnvironmentClient,
    spec: EnvironmentSpec,
    runtime: Handle,
    open: Option<Open>,
}

#[derive(Debug)]
struct Open {
    /// Capacity 1: further requests wait until the connection accepts them.
    requests: mpsc::Sender<wire::PlayRequest>,
    answers: Streaming<wire::PlayResponse>,
}

impl EnvironmentClient {
    /// Connects, without keep-alive pings: some servers treat frequent pings as an attack.
    pub(crate) async fn connect(url: &str) -> Result<Self, ActorError> {
        let endpoint = Endpoint::from_shared(url.to_owned())
            .map_err(|error| ActorError::environment_url(url, &causes(&error)))?;
        let endpoint = endpoint.connect_timeout(CALL_DEADLINE).tcp_nodelay(true);
        let channel = endpoint
            .connect()
            .await
            .map_err(|error| away(url, Status::unavailable(causes(&error))))?;
        let service = EnvironmentServiceClient::new(channel)
            .max_decoding_message_size(MAX_MESSAGE_BYTES)
            .max_encoding_message_size(MAX_MESSAGE_BYTES);
        Ok(Self { url: url.to_owned(), service })
    }

    /// Requests the environment's specification.
    pub(crate) async fn describe(&mut self) -> Result<EnvironmentSpec, ActorError> {
        let request = within(CALL_DEADLINE, wire::DescribeEnvironmentRequest {});
        let answer = self.service.describe_environment(request).await;
        let answer = answer.map_err(|status| away(&self.url, status))?.into_inner();
        Ok(EnvironmentSpec::from_service(answer).map_err(|refusal| wrong(&self.url, refusal))?)
    }

    /// Creates a stream for environments with the specification `spec`. Call it inside the tokio runtime.
    pub(crate) fn play(&self, spec: &EnvironmentSpec) -> Play {
        let (client, spec) = (self.clone(), spec.clone());
        Play { client, spec, runtime: Handle::current(), open: None }
    }
}

impl Play {
    pub(crate) fn reset(&mut self, environment: u32, seed: [u8; 32]) -> Answer<View> {
        let answer = self.ask(PlayRequest::Reset { environment, seed })?;
        self.read(View::from_wire(&answer, &self.spec))
    }

    /// Restores states of several environments.
    pub(crate) fn restore(&mut self, states: &[(u32, &[u8])]) -> Answer<Vec<View>> {
        let restore = |(environment, state): &(u32, &[u8])| PlayRequest::Restore {
            environment: *environment,
            state: state.to_vec(),
        };
        let answers = self.ask_all(states.iter().map(restore).collect())?;
        let views = answers.iter().map(|answer| View::from_wire(answer, &self.spec));
        self.read(views.collect())
    }

    /// Saves the states of several environments.
    pub(crate) fn save(&mut self, environments: Range<u32>) -> Answer<Vec<Vec<u8>>> {
        let save = |environment| PlayRequest::Save { environment };
        let answers = self.ask_all(environments.map(save).collect())?;
        let states = answers.iter().map(|answer| proto::saved_state(answer, &self.spec));
        self.read(states.collect())
    }

    /// Steps environments; `actions` is `[n, act]` for each agent.
    pub(crate) fn step(&mut self, environments: Vec<u32>, actions: Vec<Vec<f32>>) -> Answer<Steps> {
        let count = environments.len();
        let answer = self.ask(PlayRequest::Step { environments, actions })?;
        self.read(Steps::from_wire(&answer, &self.spec, count))
    }

    fn read<T>(&self, answer: Result<T, Refusal>) -> Answer<T> {
        answer.map_err(|refusal| wrong(&self.client.url, refusal))
    }

    /// Sends a request and blocks until the answer arrives. A failure closes the stream.
    fn ask(&mut self, request: PlayRequest) -> Answer<wire::PlayResponse> {
        let mut answers = self.ask_all(vec![request])?;
        Ok(answers.pop().expect("each request has an answer"))
    }

    /// Sends requests without waiting for the answers in between. Blocks until all answers have arrived. A failure
    /// closes the stream.
    fn ask_all(&mut self, requests: Vec<PlayRequest>) -> Answer<Vec<wire::PlayResponse>> {
        let runtime = self.runtime.clone();
        let answered = runtime.block_on(async {
            let deadline = ANSWER_DEADLINE.saturating_mul(requests.len() as u32);
            let answered = tokio::time::timeout(deadline, self.exchange_all(requests)).await;
            answered.unwrap_or_else(|_| {
                let secs = deadline.as_secs();
                Err(Status::deadline_exceeded(format!("no answer within {secs} s")))
            })
        });
        answered.map_err(|status| {
            self.open = None;
            away(&self.client.url, status)
        })
    }

    async fn exchange(&mut self, request: wire::PlayRequest) -> Result<wire::PlayResponse, Status> {
        match &mut self.open {
            Some(open) => {
                open.send(request).await;
                open.receive().await
            }
            none => none.insert(begin(&mut self.client.service, request).await?).receive().await,
        }
    }

    async fn exchange_all(
        &mut self,
        requests: Vec<PlayRequest>,
    ) -> Result<Vec<wire::PlayResponse>, Status> {
        let mut answers = Vec::with_capacity(requests.len());
        let mut requests = requests.iter().map(PlayRequest::to_wire);
        let (Some(first), count) = (requests.next(), requests.len()) else { return Ok(answers) };
        answers.push(self.exchange(first).await?);
        let Some(Open { requests: queue, answers: stream }) = &mut self.open else {
            return Err(closed());
        };
        let send = async {
            for request in requests {
                // If the stream is closed, its status has the reason.
                let _ = queue.send(request).await;
            }
            Ok::<_, Status>(())
        };
        let receive = async {
            for _ in 0..count {
                answers.push(stream.message().await?.ok_or_else(closed)?);
            }
            Ok::<_, Status>(())
        };
        tokio::try_join!(send, receive)?;
        Ok(answers)
    }
}

impl Open {
    async fn send(&self, request: wire::PlayRequest) {
        // If the stream is closed, its status has the reason.
        let _ = self.requests.send(request).await;
    }

    async fn receive(&mut self) -> Result<wire::PlayResponse, Status> {
        self.answers.message().await?.ok_or_else(closed)
    }
}

fn closed() -> Status {
    Status::unavailable("the stream was closed")
}

type Answer<T> = Result<T, EnvironmentError>;

async fn begin(
    service: &mut EnvironmentServiceClient<Channel>,
    first: wire::PlayRequest,
) -> Result<Open, Status> {
    let (requests, queue) = mpsc::channel(1);
    requests.send(first).await.map_err(|_| Status::internal("the queue is closed"))?;
    let answers = service.play(ReceiverStream::new(queue)).await?.into_inner();
    Ok(Open { requests, answers })
}

fn away(url: &str, status: Status) -> EnvironmentError {
    EnvironmentError::Away { url: url.to_owned(), status: Box::new(status) }
}

fn wrong(url: &str, refusal: Refusal) -> EnvironmentError {
    EnvironmentError::Wrong { url: url.to_owned(), refusal: Box::new(refusal) }
}
