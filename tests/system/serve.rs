//! Served policies compute the same actions as the evaluator, bit for bit.

use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use std::time::Duration;

use policy::{Draw, DrawKey, PolicySnapshot, Purpose, RunSeed};
use proto::wire::policy_service_client::PolicyServiceClient;
use proto::{
    ActStep, Acted, ActionChoice, ActuatorSpec, AgentSpec, Reason, Refusal, WeightsName, wire,
};
use sim::{EnvironmentBatch, Outcome};
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tonic::transport::Channel;
use tonic::{Code, Request, Status, Streaming};

use crate::cue_service::{look, numbers};
use crate::peer::{start_request, step_request};
use crate::processes::Background;
use crate::runs::{Runs, command, inspect, refused, succeeded, text, train};

/// A finished run of two iterations, shared by all tests.
fn trained() -> &'static Path {
    static RUN: OnceLock<(Runs, PathBuf)> = OnceLock::new();
    let (_, folder) = RUN.get_or_init(|| {
        let runs = Runs::new();
        let folder = runs.folder("trained");
        train(&folder, &["run.iterations=2"]);
        (runs, folder)
    });
    folder
}

/// The environment of a run.
fn world(folder: &Path) -> Box<dyn EnvironmentBatch> {
    let settings = std::fs::read_to_string(folder.join("config.toml")).unwrap();
    let settings: toml::Table = settings.parse().unwrap();
    let task = sim::TaskConfig {
        task: settings["task"].as_str().unwrap().to_owned(),
        definition: None,
        weights: None,
        observation: settings["observation"].clone().try_into().unwrap(),
    };
    sim::environments(&task, 1).unwrap()
}

/// A server of policies.
struct Server {
    process: Background,
    url: String,
}

impl Server {
    fn start(folder: &Path, more: &[&str]) -> Self {
        let mut serve = command(&["serve", text(folder), "--listen=127.0.0.1:0"]);
        let mut process = Background::start(serve.args(more));
        let url = process.url();
        Self { process, url }
    }

    async fn client(&self) -> PolicyServiceClient<Channel> {
        PolicyServiceClient::connect(self.url.clone()).await.unwrap()
    }

    async fn describe(&self) -> wire::DescribePolicyResponse {
        let described = self.client().await.describe_policy(wire::DescribePolicyRequest {}).await;
        described.unwrap().into_inner()
    }

    /// The weights that a new stream would use.
    async fn weights(&self) -> WeightsName {
        WeightsName::from_wire(self.describe().await.weights, "weights").unwrap()
    }
}

/// Resets to the first state of the evaluator's episode with this index, after two iterations.
fn reset(world: &mut dyn EnvironmentBatch, episode: u32) {
    let key = DrawKey::of_evaluation(RunSeed(7), 2, episode);
    let steps = world.description().episode_steps;
    world.reset(0, 0, steps, key.0).unwrap();
}

/// The agents' observations.
fn observations(world: &dyn EnvironmentBatch) -> Vec<(usize, Vec<f32>)> {
    look(world).observations.into_iter().enumerate().collect()
}

/// An open stream of actions.
struct Acting {
    steps: mpsc::Sender<wire::ActRequest>,
    answers: Streaming<wire::ActResponse>,
}

impl Acting {
    async fn begin(server: &Server, choice: ActionChoice) -> Self {
        let (steps, queue) = mpsc::channel(4);
        steps.send(start_request(choice)).await.unwrap();
        let act = server.client().await.act(ReceiverStream::new(queue)).await;
        let answers = act.unwrap().into_inner();
        Self { steps, answers }
    }

    async fn send(&mut self, message: wire::ActRequest) -> Result<Acted, Status> {
        self.steps.send(message).await.unwrap();
        let answer = self.answers.message().await?.unwrap();
        let action =
            |row: &wire::AgentAction| (row.agent as usize, numbers(row.action.as_ref().unwrap()));
        let weights = WeightsName::from_wire(answer.weights, "weights").unwrap();
        Ok(Acted { weights, actions: answer.actions.iter().map(action).collect() })
    }

    async fn step(&mut self, step: ActStep) -> Acted {
        self.send(step_request(&step)).await.unwrap()
    }
}

/// A step with these observations.
type Step = fn(Vec<(usize, Vec<f32>)>) -> ActStep;

/// The first step of an episode.
fn first(observations: Vec<(usize, Vec<f32>)>) -> ActStep {
    ActStep { reset: true, observations }
}

/// A later step.
fn next(observations: Vec<(usize, Vec<f32>)>) -> ActStep {
    ActStep { reset: false, observations }
}

/// The actions of all agents, concatenated.
fn side_by_side(acted: &Acted) -> Vec<f32> {
    acted.actions.iter().flat_map(|(_, action)| action.clone()).collect()
}

/// Plays an episode with the actions of `acting`; returns the joint actions and the return.
async fn play(
    acting: &mut Acting,
    world: &mut dyn EnvironmentBatch,
    episode: u32,
) -> (Vec<Vec<f32>>, f64) {
    reset(world, episode);
    let (mut joint, mut total, mut outcomes) = (Vec::new(), 0.0, [Outcome::default()]);
    loop {
        let begins = if joint.is_empty() { first } else { next };
        let acted = acting.step(begins(observations(world))).await;
        joint.push(side_by_side(&acted));
        world.step(joint.last().unwrap(), &mut outcomes).unwrap();
        total += f64::from(outcomes[0].reward);
        if outcomes[0].terminated || outcomes[0].truncated {
            return (joint, total);
        }
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn episodes_with_the_service_equal_those_of_the_evaluator_bit_for_bit() {
    let folder = trained();
    let server = Server::start(folder, &[]);
    let loaded = learner::store::checkpoint::load_newest(folder).unwrap().checkpoint;
    let snapshot = PolicySnapshot::from_bytes(&loaded.policy).unwrap();
    let printed = succeeded(&["eval", text(folder), "--episodes=2", "--json"]);
    let returns = printed.split("\"return\":").skip(1).map(|rest| rest.split(',').next().unwrap());
    let returns: Vec<&str> = returns.collect();
    let mut acting = Acting::begin(&server, ActionChoice::Mean).await;
    let (mut here, mut there) = (world(folder), world(folder));
    for episode in 0..2 {
        let (joint, total) = play(&mut acting, &mut *here, episode).await;
        let draw = Draw::of(Purpose::EvaluationReset).iteration(2).environment(episode);
        let mut expected = Vec::new();
        let keep = |event: rollout::StepEvent<'_>| {
            if let rollout::StepEvent::After(step) = event {
                expected.push(step.actions.concat());
            }
        };
        rollout::play_episode(
            &mut *there,
            &snapshot,
            (DrawKey::of(RunSeed(7), draw), ActionChoice::Mean),
            keep,
        )
        .unwrap();
        assert_eq!(joint, expected);
        assert_eq!(returns[episode as usize], serde_json::json!(total).to_string());
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_service_describes_its_agents_and_weights() {
    let folder = trained();
    let server = Server::start(folder, &[]);
    let (described, weights) = (server.describe().await, server.weights().await);
    let bytes = learner::store::checkpoint::load_newest(folder).unwrap().checkpoint.policy;
    assert_eq!(weights.digest.0, policy::digest(&bytes));
    assert_eq!(weights.version.0, inspect(folder)["iteration"]);
    let world = world(folder);
    let environment = world.description().clone();
    let agent = |(index, agent): (usize, &AgentSpec)| wire::PolicyAgent {
        agent: Some(agent.to_wire()),
        hidden_size: 8,
        distribution: wire::ActionDistribution::Gaussian.into(),
        control_ranges: vec![wire::ControlRange { low: -1.0, high: 1.0 }; agent.joints.len()],
        actuators: world.actuators(index).iter().map(ActuatorSpec::to_wire).collect(),
    };
    let expected = wire::DescribePolicyResponse {
        run_id: "trained".to_owned(),
        agents: environment.agents.iter().enumerate().map(agent).collect(),
        task: environment.task,
        weights: Some(weights.to_wire()),
        dt_secs: environment.dt_secs,
        algorithm: "happo-s2mia".to_owned(),
        seed: 7,
    };
    assert_eq!(described, expected);
    let mut acting = Acting::begin(&server, ActionChoice::Mean).await;
    let seen = observations(&*world);
    assert_eq!(acting.step(next(seen)).await.weights, weights);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn drawn_actions_depend_on_the_seed_but_not_on_other_streams_or_the_grouping_of_agents() {
    let folder = trained();
    let server = Server::start(folder, &[]);
    let mut world = world(folder);
    reset(&mut *world, 0);
    let seen = observations(&*world);
    let mut by_seed = Vec::new();
    // The first step of a stream begins an episode, with or without `reset`.
    for (seed, begins) in [(1, first as Step), (1, next), (2, next)] {
        let mut acting = Acting::begin(&server, ActionChoice::Sampled { seed }).await;
        let mut actions = Vec::new();
        for step in [begins, next, first] {
            actions.push(side_by_side(&acting.step(step(seen.clone())).await));
        }
        by_seed.push(actions);
    }
    assert_eq!(by_seed[0], by_seed[1]);
    let distinct = |a: &Vec<f32>, b: &Vec<f32>| a.iter().zip(b).all(|(a, b)| a != b);
    assert!(distinct(&by_seed[0][0], &by_seed[2][0]), "another seed draws other noise");
    assert!(distinct(&by_seed[0][0], &by_seed[0][2]), "so does another episode");
    // One agent per message, in another order, next to another active stream.
    let mut other = Acting::begin(&server, ActionChoice::Mean).await;
    let mut acting = Acting::begin(&server, ActionChoice::Sampled { seed: 1 }).await;
    let mut alone = vec![Vec::new(); seen.len()];
    for (agent, observation) in seen.iter().rev() {
        let (one, everybody) = tokio::join!(
            acting.step(next(vec![(*agent, observation.clone())])),
            other.step(next(seen.clone()))
        );
        assert_eq!(everybody.actions.len(), seen.len());
        alone[*agent] = one.actions[0].1.clone();
    }
    assert_eq!(alone.concat(), by_seed[0][0]);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn invalid_steps_are_rejected_by_field_and_do_not_affect_other_streams() {
    let folder = trained();
    let server = Server::start(folder, &[]);
    let seen = observations(&*world(folder));
    let mut wild = seen.clone();
    wild[1].1[0] = f32::NAN;
    let mut honest = Acting::begin(&server, ActionChoice::Mean).await;
    honest.step(next(seen.clone())).await;
    for (message, reason, field) in [
        (step_request(&next(wild)), Reason::NotFinite, "step.observations[1].observation"),
        (start_request(ActionChoice::Mean), Reason::BadValue, "start"),
    ] {
        let mut acting = Acting::begin(&server, ActionChoice::Mean).await;
        let status = acting.send(message).await.unwrap_err();
        let refusal = Refusal::from_status(&status).unwrap();
        assert_eq!((refusal.reason, refusal.field.as_str()), (reason, field));
    }
    honest.step(next(seen)).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_stream_ends_at_its_deadline_and_when_the_server_stops() {
    let folder = trained();
    let mut server = Server::start(folder, &[]);
    let (sender, queue) = mpsc::channel(1);
    sender.send(start_request(ActionChoice::Mean)).await.unwrap();
    let mut request = Request::new(ReceiverStream::new(queue));
    // The header is set by hand, so that only the server enforces the deadline.
    request.metadata_mut().insert("grpc-timeout", "200m".parse().unwrap());
    let mut late = server.client().await.act(request).await.unwrap().into_inner();
    let ended = tokio::time::timeout(Duration::from_secs(20), late.message()).await;
    assert_eq!(ended.unwrap().unwrap_err().code(), Code::DeadlineExceeded);

    let mut acting = Acting::begin(&server, ActionChoice::Mean).await;
    acting.step(next(observations(&*world(folder)))).await;
    server.process.signal("-TERM");
    assert_eq!(acting.answers.message().await.unwrap_err().code(), Code::Unavailable);
    assert_eq!(server.process.rest(), ["stopping"]);
}

#[test]
fn health_is_served_and_remote_clients_require_an_option() {
    let folder = trained();
    let server = Server::start(folder, &[]);
    assert!(succeeded(&["health", "--learner", &server.url]).contains("serves"));
    let line = refused(&["serve", text(folder), "--listen=0.0.0.0:0"]);
    assert!(line.contains("--insecure-allow-remote"), "{line}");
}
