//! A client that sends invalid messages.

use proto::wire::learner_service_client::LearnerServiceClient;
use proto::{
    AgentChunk, Lease, LeaseAnswer, PushHeader, Registered, Registration, RunDescription,
    TrajectoryChunk, Work, wire,
};
use tonic::Status;
use tonic::transport::Channel;

/// A registered client with a separate connection, so that attacks do not affect each other.
pub(super) struct Attacker {
    pub(super) service: LearnerServiceClient<Channel>,
    pub(super) run: RunDescription,
    pub(super) own: Registered,
}

impl Attacker {
    pub(super) async fn connect(url: &str) -> Self {
        let mut service = LearnerServiceClient::connect(url.to_owned()).await.unwrap();
        let run = service.describe_run(wire::DescribeRunRequest {}).await.unwrap().into_inner();
        let run = RunDescription::from_wire(run.run).unwrap();
        let registered = service.register(registration(&run).to_wire()).await.unwrap();
        let own = Registered::from_wire(&registered.into_inner());
        Self { service, run, own }
    }

    pub(super) async fn asks_for_work(&mut self, wait_millis: u32) -> LeaseAnswer {
        let request = wire::LeaseSlotsRequest {
            actor_id: self.own.actor.0,
            incarnation: self.own.incarnation.0,
            wait_millis,
            log_steps_lost: 0,
        };
        let answer = self.service.lease_slots(request).await.unwrap().into_inner();
        LeaseAnswer::from_wire(answer, &self.run).unwrap()
    }

    pub(super) async fn lease(&mut self) -> Lease {
        match self.asks_for_work(20_000).await {
            LeaseAnswer::Lease(lease) => lease,
            other => panic!("expected a lease, got {other:?}"),
        }
    }

    pub(super) async fn push(&mut self, message: wire::PushTrajectoryRequest) -> Status {
        let stream = self.service.push_trajectory(tokio_stream::iter([message])).await;
        stream.unwrap().into_inner().message().await.unwrap_err()
    }
}

pub(super) fn registration(run: &RunDescription) -> Registration {
    Registration {
        client: "attacker".to_owned(),
        build: run.build.clone(),
        protocol_version: run.protocol_version,
        environment: run.environment.clone(),
        rollout_fingerprint: Some(run.rollout_fingerprint),
        process: None,
    }
}

/// A first chunk of the right shape with arbitrary values.
pub(super) fn arbitrary_chunk(run: &RunDescription) -> TrajectoryChunk {
    let rows = (run.chunk_steps * run.environments_per_slot) as usize;
    let stored = (run.chunk_steps / run.hidden_every * run.environments_per_slot) as usize;
    let agents = run.environment.agents.iter().zip(&run.hidden_sizes);
    let agents = agents.map(|(agent, hidden)| AgentChunk {
        observation: vec![0.1; rows * agent.observation.len()],
        action: vec![0.1; rows * agent.action.size],
        log_prob: vec![0.0; rows],
        hidden: vec![0.0; stored * *hidden as usize],
    });
    TrajectoryChunk {
        sequence: 0,
        first_step: 0,
        steps: run.chunk_steps,
        agents: agents.collect(),
        state: vec![0.1; rows * run.environment.state.len()],
        reward: vec![0.0; rows],
        terminated: vec![false; rows],
        truncated: vec![false; rows],
        finals: Vec::new(),
        end: None,
        reward_terms: Vec::new(),
    }
}

/// The message that an actor with this lease would send.
pub(super) fn message(
    lease: &Lease,
    chunk: &TrajectoryChunk,
    run: &RunDescription,
) -> wire::PushTrajectoryRequest {
    let Work::Rollout(work) = &lease.work else { panic!("expected a slot, got {lease:?}") };
    let (chunk, digest) = chunk.to_wire(run, &work.origin());
    let content = wire::push_trajectory_request::Content::Chunk(chunk);
    PushHeader::of(lease, digest).to_wire(content)
}
