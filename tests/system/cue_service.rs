//! The game `cue-2x1` as an environment service in this process.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};

use proto::wire::environment_service_server::{EnvironmentService, EnvironmentServiceServer};
use proto::wire::play_request::Request as Asked;
use proto::wire::{PlayResponse, play_response};
use proto::{EnvironmentSpec, Steps, View, wire};
use sim::{EnvironmentBatch, Outcome, TaskConfig};
use tokio::net::TcpListener;
use tokio::runtime::Runtime;
use tokio::sync::mpsc;
use tokio_stream::StreamExt as _;
use tokio_stream::wrappers::{ReceiverStream, TcpListenerStream};
use tonic::transport::Server;
use tonic::{Request, Response, Status, Streaming};

use crate::peer::{steps_answer, view_answer};

/// Faults of the environment service.
#[derive(Clone)]
pub(crate) struct Faults {
    /// Changes the description.
    pub(crate) description: fn(&mut wire::EnvironmentSpec),
    /// Changes a response.
    pub(crate) answer: fn(&mut play_response::Answer),
    /// Whether it rejects a saved state.
    pub(crate) rejects: fn(&[u8]) -> bool,
    /// Aborts the stream at every response with a multiple of this number, over all streams; 0 for never.
    pub(crate) abort_every: u32,
}

impl Faults {
    pub(crate) const NONE: Self =
        Self { description: |_| {}, answer: |_| {}, rejects: |_| false, abort_every: 0 };
    /// No faults, but the service cannot save states.
    pub(crate) const STATELESS: Self =
        Self { description: |spec| spec.max_state_bytes = 0, ..Self::NONE };
}

/// The running service; dropping it stops the service.
pub(crate) struct CueService {
    pub(crate) url: String,
    _runtime: Runtime,
}

impl CueService {
    pub(crate) fn start(faults: Faults) -> Self {
        Self::start_at("127.0.0.1:0", faults)
    }

    pub(crate) fn start_at(address: &str, faults: Faults) -> Self {
        let runtime =
            tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build();
        let runtime = runtime.unwrap();
        let listener = runtime.block_on(TcpListener::bind(address)).unwrap();
        let url = format!("http://{}", listener.local_addr().unwrap());
        let game = Game { faults, answers: Arc::default() };
        let server = Server::builder().add_service(EnvironmentServiceServer::new(game));
        runtime.spawn(server.serve_with_incoming(TcpListenerStream::new(listener)));
        Self { url, _runtime: runtime }
    }
}

#[derive(Clone)]
struct Game {
    faults: Faults,
    answers: Arc<AtomicU32>,
}

fn environment() -> Box<dyn EnvironmentBatch> {
    let task = serde_json::json!({
        "task": "cue-2x1",
        "observation": {
            "mode": "full_id", "norm": "none", "nearest": 1, "globals": "shown", "contact_forces": "absent",
        },
    });
    let task: TaskConfig = serde_json::from_value(task).unwrap();
    sim::environments(&task, 1).unwrap()
}

fn spec() -> EnvironmentSpec {
    environment().description().clone()
}

#[tonic::async_trait]
impl EnvironmentService for Game {
    async fn describe_environment(
        &self,
        _: Request<wire::DescribeEnvironmentRequest>,
    ) -> Result<Response<wire::DescribeEnvironmentResponse>, Status> {
        let mut environment = spec().to_wire();
        (self.faults.description)(&mut environment);
        let environment = Some(environment);
        Ok(Response::new(wire::DescribeEnvironmentResponse { environment }))
    }

    type PlayStream = ReceiverStream<Result<PlayResponse, Status>>;

    async fn play(
        &self,
        request: Request<Streaming<wire::PlayRequest>>,
    ) -> Result<Response<Self::PlayStream>, Status> {
        let (answers, queue) = mpsc::channel(1);
        tokio::spawn(self.clone().answer_all(request.into_inner(), answers));
        Ok(Response::new(ReceiverStream::new(queue)))
    }
}

impl Game {
    async fn answer_all(
        self,
        mut requests: Streaming<wire::PlayRequest>,
        answers: mpsc::Sender<Result<PlayResponse, Status>>,
    ) {
        let mut games = BTreeMap::new();
        while let Some(Ok(request)) = requests.next().await {
            let answer = self.answer(&mut games, request.request.unwrap());
            if answers.send(answer).await.is_err() {
                return;
            }
        }
    }

    fn answer(
        &self,
        games: &mut BTreeMap<u32, Box<dyn EnvironmentBatch>>,
        request: Asked,
    ) -> Result<PlayResponse, Status> {
        let count = self.answers.fetch_add(1, Ordering::Relaxed) + 1;
        if self.faults.abort_every > 0 && count.is_multiple_of(self.faults.abort_every) {
            return Err(Status::unavailable("temporarily unavailable"));
        }
        if let Asked::Restore(restored) = &request
            && (self.faults.rejects)(&restored.state)
        {
            return Err(Status::invalid_argument("ValueError: no state of this game"));
        }
        let mut answer = play(games, request);
        if let Some(answer) = &mut answer.answer {
            (self.faults.answer)(answer);
        }
        Ok(answer)
    }
}

fn play(games: &mut BTreeMap<u32, Box<dyn EnvironmentBatch>>, request: Asked) -> PlayResponse {
    match request {
        Asked::Reset(reset) => {
            let game = games.entry(reset.environment).or_insert_with(environment);
            // The client truncates episodes, never later than the game's own limit.
            game.reset(0, 0, u32::MAX, reset.seed[..].try_into().unwrap()).unwrap();
            view_answer(&look(&**game))
        }
        Asked::Restore(restored) => {
            let game = games.entry(restored.environment).or_insert_with(environment);
            game.restore(0, &restored.state).unwrap();
            view_answer(&look(&**game))
        }
        Asked::Save(saved) => {
            let state = games[&saved.environment].encode(0).unwrap().into();
            let answer = play_response::Answer::Saved(wire::EnvironmentState { state });
            PlayResponse { answer: Some(answer) }
        }
        Asked::Step(asked) => {
            let actions = asked.actions.iter().map(numbers).collect::<Vec<_>>();
            step(games, &asked.environments, &actions)
        }
    }
}

/// The floats of a tensor.
pub(crate) fn numbers(tensor: &wire::Tensor) -> Vec<f32> {
    tensor.data.as_chunks::<4>().0.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect()
}

fn step(
    games: &mut BTreeMap<u32, Box<dyn EnvironmentBatch>>,
    environments: &[u32],
    actions: &[Vec<f32>],
) -> PlayResponse {
    let nothing = View { observations: vec![Vec::new(); actions.len()], state: Vec::new() };
    let (reward, terminated, truncated) = Default::default();
    let mut steps = Steps { view: nothing, reward, terminated, truncated };
    for (row, number) in environments.iter().enumerate() {
        let game = games.get_mut(number).unwrap();
        let joint = actions.iter().map(|rows| rows[row]).collect::<Vec<_>>();
        let mut outcome = [Outcome::default()];
        game.step(&joint, &mut outcome).unwrap();
        let seen = look(&**game);
        for (all, own) in steps.view.observations.iter_mut().zip(seen.observations) {
            all.extend(own);
        }
        steps.view.state.extend(seen.state);
        steps.reward.push(outcome[0].reward);
        steps.terminated.push(outcome[0].terminated);
        steps.truncated.push(outcome[0].truncated);
    }
    steps_answer(&steps)
}

/// What the agents of the first environment observe, and its state.
pub(crate) fn look(game: &dyn EnvironmentBatch) -> View {
    let description = game.description();
    let agents = description.agents.iter().enumerate().map(|(agent, of)| {
        let mut row = vec![0.0; of.observation.len()];
        game.observation(0, agent, &mut row);
        row
    });
    let mut state = vec![0.0; description.state.len()];
    game.state(0, &mut state);
    View { observations: agents.collect(), state }
}
