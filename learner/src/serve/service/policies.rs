//! `PolicyService`: computes actions of trained policies for clients. Steps of different streams are computed
//! concurrently, those of one stream in order. Policies compute row by row, so batching streams would not be faster.

use std::sync::Arc;
use std::time::Duration;

use policy::{ActorPolicy, Head, RunSeed, Team};
use proto::wire::policy_service_server::{self, PolicyService, PolicyServiceServer};
use proto::{
    ActStep, Acted, ActionChoice, ActuatorSpec, EnvironmentSpec, MAX_MESSAGE_BYTES, Refusal, wire,
};
use security::Role;
use tokio::sync::{mpsc, watch};
use tokio::time::Instant;
use tokio_stream::wrappers::ReceiverStream;
use tonic::service::interceptor::InterceptedService;
use tonic::{Request, Response, Status, Streaming};

use super::{COMPILED, bodies, connections, deadline, reflection, server};
use crate::lease::exchange::Caller;
use crate::lease::published::Published;
use crate::serve::listener::Listener;

/// Actors register with learners only.
const NO_ACTORS: usize = 0;
/// Responses buffered per stream; while the buffer is full, no further step is read.
const ANSWERS_AHEAD: usize = 1;
/// Time limit for open streams to end when the server stops.
const CLOSING: Duration = Duration::from_secs(1);
/// Longer than any stream, and within the range of tokio's clock.
const NO_DEADLINE: Duration = Duration::from_secs(86_400 * 365);
/// Services besides health and reflection.
const SERVICES: [&str; 1] = [policy_service_server::SERVICE_NAME];

/// The served policies and their environment.
#[derive(Clone, Debug)]
pub struct ServedPolicies {
    /// Id of the run.
    pub run_id: String,
    /// Name of the run's algorithm.
    pub algorithm: String,
    /// Seed of the run.
    pub seed: RunSeed,
    /// The environment in which the policies were trained.
    pub environment: EnvironmentSpec,
    /// For each agent, the controls for the actions -1 and 1 of each number of its action; empty without a simulated robot.
    pub control_ranges: Vec<Vec<[f32; 2]>>,
    /// For each agent, the actuators that these numbers control.
    pub actuators: Vec<Vec<ActuatorSpec>>,
    /// The policies.
    pub published: Arc<Published>,
}

/// Serves policies at `listener` until `stop` is true; open streams then end with `UNAVAILABLE`.
///
/// # Errors
/// The service failed.
pub async fn serve_policies(
    served: ServedPolicies,
    listener: Listener,
    stop: watch::Receiver<bool>,
) -> Result<(), tonic::transport::Error> {
    let incoming = connections::accept(listener, NO_ACTORS, Arc::new(drop));
    let policies = Policies { served, stop: stop.clone() };
    let policies = PolicyServiceServer::new(policies).max_decoding_message_size(MAX_MESSAGE_BYTES);
    let (reporter, health) = tonic_health::server::health_reporter();
    reporter.set_serving::<PolicyServiceServer<Policies>>().await;
    let serving = server()
        .layer(bodies::limits(0))
        .add_service(InterceptedService::new(policies, connections::needs(Role::Operator)))
        .add_service(health)
        .add_service(reflection(&SERVICES).build_v1().expect(COMPILED))
        .add_service(reflection(&SERVICES).build_v1alpha().expect(COMPILED))
        .serve_with_incoming_shutdown(incoming, stopped(stop.clone()));
    tokio::select! {
        ended = serving => ended,
        // A client that does not read its responses must not delay the end.
        () = async { stopped(stop).await; tokio::time::sleep(CLOSING).await } => Ok(()),
    }
}

/// Completes when `stop` is true or its sender has been dropped.
async fn stopped(mut stop: watch::Receiver<bool>) {
    let _result = stop.wait_for(|stop| *stop).await;
}

/// The calls of `PolicyService`.
#[derive(Debug)]
struct Policies {
    served: ServedPolicies,
    stop: watch::Receiver<bool>,
}

#[tonic::async_trait]
impl PolicyService for Policies {
    async fn describe_policy(
        &self,
        _request: Request<wire::DescribePolicyRequest>,
    ) -> Result<Response<wire::DescribePolicyResponse>, Status> {
        Ok(Response::new(self.served.description()))
    }

    type ActStream = ReceiverStream<Result<wire::ActResponse, Status>>;

    async fn act(
        &self,
        request: Request<Streaming<wire::ActRequest>>,
    ) -> Result<Response<Self::ActStream>, Status> {
        let (answers, stream) = mpsc::channel(ANSWERS_AHEAD);
        let caller = connections::caller(&request, "act");
        let timeout = deadline::of(request.metadata()).unwrap_or(NO_DEADLINE);
        let end = Instant::now() + timeout.min(NO_DEADLINE);
        let published = Arc::clone(&self.served.published);
        let stop = self.stop.clone();
        let steps = request.into_inner();
        tokio::spawn(async move {
            let status = tokio::select! {
                () = answers.closed() => return,
                ended = answer_steps(steps, published, &answers, caller) => ended.err(),
                () = tokio::time::sleep_until(end) => Some(Status::deadline_exceeded("the stream's deadline has passed")),
                () = stopped(stop) => Some(Status::unavailable("the server is stopping")),
            };
            if let Some(status) = status {
                // Sending fails if the client has disconnected.
                let _sent = answers.send(Err(status)).await;
            }
        });
        Ok(Response::new(ReceiverStream::new(stream)))
    }
}

/// Answers the steps of a stream in order.
async fn answer_steps(
    mut steps: Streaming<wire::ActRequest>,
    published: Arc<Published>,
    answers: &mpsc::Sender<Result<wire::ActResponse, Status>>,
    caller: Caller,
) -> Result<(), Status> {
    let refused = |refusal: Refusal| {
        tracing::warn!(
            reason = refusal.reason.name(),
            field = refusal.field,
            "{caller}: request rejected: {}",
            refusal.detail
        );
        Status::from(refusal)
    };
    let unreadable = |status: Status| super::unreadable(&status).map_or(status, refused);
    let Some(start) = steps.message().await.map_err(unreadable)? else { return Ok(()) };
    let choice = ActionChoice::from_wire(start).map_err(refused)?;
    let agents = published.policy.agents.iter();
    let sizes = agents.map(ActorPolicy::observation_size).collect::<Vec<_>>();
    let mut agents = ServedAgents::new(published, choice);
    while let Some(step) = steps.message().await.map_err(unreadable)? {
        let step = ActStep::from_wire(&step, &sizes).map_err(refused)?;
        if step.reset {
            agents.team.reset(0);
        }
        let computed = tokio::task::spawn_blocking(move || {
            let acted = agents.act(&step);
            (agents, acted.to_wire())
        });
        let (kept, answer) = computed.await.map_err(|panic| Status::internal(panic.to_string()))?;
        agents = kept;
        if answers.send(Ok(answer)).await.is_err() {
            return Ok(());
        }
    }
    Ok(())
}

/// All agents of the environment that a client steps.
#[derive(Debug)]
struct ServedAgents {
    weights: Arc<Published>,
    team: Team,
}

impl ServedAgents {
    /// Agents at the start of their first episode.
    fn new(weights: Arc<Published>, choice: ActionChoice) -> Self {
        let seed = match choice {
            ActionChoice::Mean => None,
            ActionChoice::Sampled { seed } => Some(RunSeed(seed)),
        };
        let team = Team::new(&weights.policy, 1, seed);
        Self { weights, team }
    }

    /// Computes actions for the observations of a validated step.
    fn act(&mut self, step: &ActStep) -> Acted {
        let Self { weights, team } = self;
        let rows = step.observations.iter();
        let actions = rows.map(|(agent, row)| (*agent, team.act(&weights.policy, *agent, row)));
        Acted { actions: actions.collect(), weights: weights.name }
    }
}

impl ServedPolicies {
    fn description(&self) -> wire::DescribePolicyResponse {
        let range = |[low, high]: &[f32; 2]| wire::ControlRange { low: *low, high: *high };
        let agents = self.environment.agents.iter().zip(&self.published.policy.agents);
        let agents = agents.zip(self.control_ranges.iter().zip(&self.actuators));
        let agents = agents.map(|((agent, policy), (ranges, actuators))| wire::PolicyAgent {
            agent: Some(agent.to_wire()),
            hidden_size: policy.hidden_size() as u32,
            distribution: distribution(policy.head()).into(),
            control_ranges: ranges.iter().map(range).collect(),
            actuators: actuators.iter().map(ActuatorSpec::to_wire).collect(),
        });
        wire::DescribePolicyResponse {
            run_id: self.run_id.clone(),
            task: self.environment.task.clone(),
            weights: Some(self.published.name.to_wire()),
            agents: agents.collect(),
            dt_secs: self.environment.dt_secs,
            algorithm: self.algorithm.clone(),
            seed: self.seed.0,
        }
    }
}

fn distribution(head: Head) -> wire::ActionDistribution {
    match head {
        Head::Gaussian | Head::SharedGaussian(_) => wire::ActionDistribution::Gaussian,
        Head::Categorical { .. } => wire::ActionDistribution::Categorical,
        Head::Deterministic { .. } => wire::ActionDistribution::ClampedGaussian,
        Head::Uniform { .. } => wire::ActionDistribution::Uniform,
        Head::TanhGaussian { .. } => wire::ActionDistribution::TanhGaussian,
    }
}
