//! Rollouts and training in a world with two agents. The policies' acting code makes batches; densities and updates run
//! in the learner's order. There is no learner process and no simulator.

use marl::{ActionKind, AgentBatch, AgentShape, Algorithm, Batch, Final, Problem, Surprise};
use policy::{ActorPolicy, Draw, PolicySnapshot, Purpose, RunSeed, Scratch, generator};
use rand::RngCore;

use crate::settings::Settings;

const SEED: RunSeed = RunSeed(1);
/// Number of parallel environments.
const ENVIRONMENTS: usize = 64;

/// One episode of a world with two agents. Each action is one number, and both agents observe the state.
pub(crate) trait TwoAgentGame {
    /// Steps of an episode, which ends by termination.
    const STEPS: usize;
    /// Size of the state.
    const STATE: usize;
    /// Kind of action. Continuous actions are in -1..1.
    const ACTION: ActionKind;

    /// An initial state.
    fn begin(rng: &mut impl RngCore) -> Self;

    /// The state, `[STATE]`.
    fn state(&self) -> Vec<f32>;

    /// The team's reward for a joint action.
    fn step(&mut self, actions: [f32; 2]) -> f32;
}

/// One agent's turn and its network's output.
pub(crate) struct Turn<'a> {
    pub(crate) agent: usize,
    environment: usize,
    step: usize,
    policy: &'a ActorPolicy,
    output: &'a [f32],
}

impl Turn<'_> {
    /// The mean or most likely action, as in evaluation.
    pub(crate) fn mode_action(&self) -> f32 {
        let mut action = [0.0];
        self.policy.mode(self.output, &mut action);
        action[0]
    }

    /// Probability of a choice.
    pub(crate) fn probability(&self, choice: f32) -> f32 {
        libm::expf(self.policy.log_prob(self.output, &[choice]))
    }

    /// A random action, as in training.
    pub(crate) fn sampled_action(&self, iteration: u64) -> f32 {
        let key = Draw::of(Purpose::Action).iteration(iteration).step(self.step as u32);
        let key = key.environment(self.environment as u32).agent(self.agent as u32);
        let mut action = [0.0];
        self.policy.draw(self.output, &mut generator(SEED, key), &mut action);
        action[0]
    }
}

/// Mean undiscounted return of the episodes.
pub(crate) fn mean_return(batch: &Batch) -> f32 {
    batch.reward.iter().sum::<f32>() / ENVIRONMENTS as f32
}

/// Sizes as a task declares them.
pub(crate) fn problem<W: TwoAgentGame>() -> Problem {
    let shape = AgentShape {
        observation: W::STATE + 2,
        action: 1,
        action_range: (-1.0, 1.0),
        kind: W::ACTION,
        surprise_features: (0..W::STATE).collect(),
    };
    Problem { agents: vec![shape.clone(), shape], state: W::STATE }
}

/// Initial states for one purpose.
fn begin<W: TwoAgentGame>(draw: Draw) -> Vec<W> {
    let environments = 0..ENVIRONMENTS as u32;
    environments.map(|e| W::begin(&mut generator(SEED, draw.environment(e)))).collect()
}

/// The state and the agent's index.
fn observe(world: &impl TwoAgentGame, agent: usize) -> Vec<f32> {
    let number = [0, 1].map(|index| if index == agent { 1.0 } else { 0.0 });
    [world.state(), number.to_vec()].concat()
}

/// Plays one episode in each of `worlds`, and returns their final states; `choose` chooses the actions.
fn play<W: TwoAgentGame>(
    snapshot: &PolicySnapshot,
    mut worlds: Vec<W>,
    mut choose: impl FnMut(Turn<'_>) -> f32,
) -> (Batch, Vec<W>) {
    let rows = W::STEPS * ENVIRONMENTS;
    let mut batch = Batch {
        steps: W::STEPS,
        environments: ENVIRONMENTS,
        agents: vec![AgentBatch::default(); 2],
        terminated: (0..rows).map(|row| row / ENVIRONMENTS + 1 == W::STEPS).collect(),
        truncated: vec![false; rows],
        ..Batch::default()
    };
    let initial_state = |policy: &ActorPolicy| vec![0.0; ENVIRONMENTS * policy.hidden_size()];
    let mut hidden: Vec<Vec<f32>> = snapshot.agents.iter().map(initial_state).collect();
    for step in 0..W::STEPS {
        batch.state.extend(worlds.iter().flat_map(TwoAgentGame::state));
        for (agent, policy) in snapshot.agents.iter().enumerate() {
            let data = &mut batch.agents[agent];
            if step.is_multiple_of(policy.chunk_steps()) {
                data.hidden.extend(&hidden[agent]);
            }
            let seen: Vec<f32> = worlds.iter().flat_map(|world| observe(world, agent)).collect();
            let mut outputs = vec![0.0; ENVIRONMENTS * policy.output_size()];
            let scratch = &mut Scratch::default();
            policy.forward(ENVIRONMENTS, &seen, &mut hidden[agent], &mut outputs, scratch);
            for (environment, output) in outputs.chunks_exact(policy.output_size()).enumerate() {
                let action = choose(Turn { agent, environment, step, policy, output });
                data.action.push(action);
                data.log_prob.push(policy.log_prob(output, &[action]));
            }
            data.observation.extend(seen);
        }
        for (environment, world) in worlds.iter_mut().enumerate() {
            let row = step * ENVIRONMENTS + environment;
            batch.reward.push(world.step([0, 1].map(|agent| batch.agents[agent].action[row])));
        }
    }
    batch.finals = worlds.iter().enumerate().map(last).collect();
    (batch, worlds)
}

fn last<W: TwoAgentGame>((environment, world): (usize, &W)) -> Final {
    let observation = [0, 1].map(|agent| observe(world, agent)).to_vec();
    Final { step: W::STEPS - 1, environment, state: world.state(), observation }
}

/// Plays evaluation episodes with the actions of `choose`.
pub(crate) fn evaluate<W: TwoAgentGame>(
    snapshot: &PolicySnapshot,
    choose: impl FnMut(Turn<'_>) -> f32,
) -> (Batch, Vec<W>) {
    play(snapshot, begin(Draw::of(Purpose::EvaluationReset)), choose)
}

/// The policies before the first iteration and after the last one.
pub(crate) fn train<W: TwoAgentGame>(settings: &Settings, iterations: u64) -> [PolicySnapshot; 2] {
    let Settings { config, policy, .. } = settings;
    config.validate().unwrap();
    let problem = problem::<W>();
    let mut surprise = Surprise::new(&config.surprise, &problem, SEED).unwrap();
    let mut algorithm = marl::build(config, policy, &problem, SEED).unwrap();
    let start = algorithm.snapshot().unwrap();
    for iteration in 0..iterations {
        learn::<W>(&mut surprise, algorithm.as_mut(), iteration);
    }
    [start, algorithm.snapshot().unwrap()]
}

/// One iteration in the learner's order.
fn learn<W: TwoAgentGame>(surprise: &mut Surprise, algorithm: &mut dyn Algorithm, iteration: u64) {
    let worlds = begin::<W>(Draw::of(Purpose::Reset).iteration(iteration));
    let draw = |turn: Turn<'_>| turn.sampled_action(iteration);
    let batch = play(&algorithm.snapshot().unwrap(), worlds, draw).0;
    surprise.refit(&batch, iteration).unwrap();
    algorithm.update(&batch, &surprise.relabel(&batch), iteration).unwrap();
}
