//! A toy environment for two agents, and its rollouts. Two points move on one line each; each agent pushes one of them
//! to its target.

use learner::lease::end_states::StateReader;
use policy::{
    ActorPolicy, Draw, PolicySnapshot, Purpose, RunSeed, Scratch, generator, standard_normal,
};
use proto::{
    ActionSpec, AgentChunk, AgentSpec, EnvironmentSpec, EnvironmentStart, EpisodePosition,
    EvaluationResult, EvaluationWork, FeatureRole, FeatureSpec, FinalStep, RolloutWork,
    RunDescription, SlotEnd, Start, TrajectoryChunk,
};

/// Steps until an episode is truncated.
const EPISODE_STEPS: u32 = 10;

/// Target positions of the points.
const TARGETS: [f32; 2] = [0.5, -0.5];

/// The environment's description.
pub(crate) fn environment() -> EnvironmentSpec {
    let feature = |name: &str, role| FeatureSpec { name: name.to_owned(), role };
    let agent = |index: usize| AgentSpec {
        name: format!("agent_{index}"),
        joints: vec![format!("push_{index}")],
        observation: vec![
            feature("x", FeatureRole::Signal),
            feature("y", FeatureRole::Signal),
            feature("self", FeatureRole::Identity),
        ],
        seen: vec![0, 1],
        near: vec![index],
        action: ActionSpec { size: 1, low: -1.0, high: 1.0, choices: None },
    };
    EnvironmentSpec {
        task: "toy/targets-2x1".to_owned(),
        agents: vec![agent(0), agent(1)],
        state: vec![feature("x", FeatureRole::Signal), feature("y", FeatureRole::Signal)],
        dt_secs: 0.1,
        episode_steps: EPISODE_STEPS,
        state_kind: "toy".to_owned(),
        state_version: 1,
        max_state_bytes: 64,
        feature_z: false,
    }
}

/// Decodes the environment's states.
pub(crate) fn states() -> StateReader {
    StateReader::new(|state| {
        if state.len() != 32 {
            return Err(format!("it has {} bytes; a state of the toy has 32", state.len()));
        }
        let World { episode, step, limit, .. } = World::decode(state);
        Ok(EpisodePosition { episode, step, limit })
    })
}

/// The state of one environment.
#[derive(Clone, Copy)]
struct World {
    points: [f32; 2],
    episode: u64,
    step: u32,
    limit: u32,
}

impl World {
    fn reset(seed: RunSeed, draw: Draw, episode: u64, limit: u32) -> Self {
        let mut rng = generator(seed, draw);
        let points = [0, 1].map(|_| 0.1 * standard_normal(&mut rng));
        Self { points, episode, step: 0, limit }
    }

    fn episode(seed: RunSeed, environment: u32, episode: u64, limit: u32) -> Self {
        let draw = Draw::of(Purpose::Reset).iteration(episode).environment(environment);
        Self::reset(seed, draw, episode, limit)
    }

    fn encode(&self) -> Vec<u8> {
        let points = self.points.iter().flat_map(|point| point.to_le_bytes());
        let counters = [self.episode, self.step.into(), self.limit.into()];
        points.chain(counters.iter().flat_map(|counter| counter.to_le_bytes())).collect()
    }

    fn decode(bytes: &[u8]) -> Self {
        let point = |i: usize| f32::from_le_bytes(bytes[4 * i..][..4].try_into().unwrap());
        let counter = |i: usize| u64::from_le_bytes(bytes[8 + 8 * i..][..8].try_into().unwrap());
        let (step, limit) = (counter(1) as u32, counter(2) as u32);
        Self { points: [point(0), point(1)], episode: counter(0), step, limit }
    }

    /// Steps the environment. Returns the reward and whether the episode ended.
    fn step(&mut self, actions: [f32; 2]) -> (f32, bool) {
        for (point, action) in self.points.iter_mut().zip(actions) {
            *point = 0.9 * *point + 0.1 * action.clamp(-1.0, 1.0);
        }
        self.step += 1;
        let miss = self
            .points
            .iter()
            .zip(TARGETS)
            .map(|(point, target)| (point - target) * (point - target));
        (-miss.sum::<f32>(), self.step >= self.limit)
    }

    fn observation(&self, agent: usize) -> Vec<f32> {
        vec![self.points[0], self.points[1], agent as f32]
    }
}

/// The rollout of a slot.
struct Slot<'a> {
    run: &'a RunDescription,
    policy: &'a PolicySnapshot,
    work: &'a RolloutWork,
    worlds: Vec<World>,
    /// Recurrent states `[E, H]` of each agent.
    hidden: Vec<Vec<f32>>,
}

/// Rolls out all chunks of a slot.
pub(crate) fn roll_out(
    run: &RunDescription,
    policy: &PolicySnapshot,
    work: &RolloutWork,
) -> Vec<TrajectoryChunk> {
    let seed = RunSeed(run.seed);
    let world = |start: &EnvironmentStart| match &start.start {
        Start::Fresh { episode, limit } => {
            World::episode(seed, start.environment, *episode, *limit)
        }
        Start::Continue { state, .. } => World::decode(state),
    };
    let hidden = |agent: usize| -> Vec<f32> {
        let size = policy.agents[agent].hidden_size();
        let row = |start: &EnvironmentStart| match &start.start {
            Start::Fresh { .. } => vec![0.0; size],
            Start::Continue { recurrent, .. } => recurrent[agent].clone(),
        };
        work.environments.iter().flat_map(row).collect()
    };
    let worlds = work.environments.iter().map(world).collect();
    let mut slot = Slot { run, policy, work, worlds, hidden: [0, 1].map(hidden).into() };
    (0..run.slot_steps / run.chunk_steps).map(|sequence| slot.chunk(sequence)).collect()
}

impl Slot<'_> {
    fn chunk(&mut self, sequence: u32) -> TrajectoryChunk {
        let first_step = sequence * self.run.chunk_steps;
        let (steps, agents) = (self.run.chunk_steps, vec![AgentChunk::default(); 2]);
        let mut chunk =
            TrajectoryChunk { sequence, first_step, steps, agents, ..TrajectoryChunk::default() };
        for step in first_step..first_step + self.run.chunk_steps {
            self.step(step, &mut chunk);
        }
        if first_step + self.run.chunk_steps == self.run.slot_steps {
            let environments = self.worlds.iter().map(World::encode).collect();
            chunk.end = Some(SlotEnd { environments, recurrent: self.hidden.clone() });
        }
        chunk
    }

    fn step(&mut self, step: u32, chunk: &mut TrajectoryChunk) {
        chunk.state.extend(self.worlds.iter().flat_map(|world| world.points));
        let actions = [0, 1].map(|agent| self.act(step, agent, &mut chunk.agents[agent]));
        let [first, second] = actions;
        for (environment, chosen) in first.into_iter().zip(second).enumerate() {
            let chosen = [chosen.0, chosen.1];
            let (reward, done) = self.worlds[environment].step(chosen);
            chunk.reward.push(reward);
            chunk.terminated.push(false);
            chunk.truncated.push(done);
            if done || step + 1 == self.run.slot_steps {
                chunk.finals.push(self.last(step, environment));
            }
            if done {
                self.restart(environment);
            }
        }
    }

    /// Computes one agent's actions in all environments.
    fn act(&mut self, step: u32, agent: usize, chunk: &mut AgentChunk) -> Vec<f32> {
        if step.is_multiple_of(self.run.hidden_every) {
            chunk.hidden.extend_from_slice(&self.hidden[agent]);
        }
        let policy = &self.policy.agents[agent];
        let rows = self.worlds.len();
        let observation: Vec<f32> =
            self.worlds.iter().flat_map(|world| world.observation(agent)).collect();
        let mut mean = vec![0.0; rows];
        policy.forward(
            rows,
            &observation,
            &mut self.hidden[agent],
            &mut mean,
            &mut Scratch::default(),
        );
        let mut actions = Vec::new();
        for (start, mean) in self.work.environments.iter().zip(&mean) {
            let (iteration, environment) = (self.work.iteration, start.environment);
            let draw = Draw::of_action(iteration, environment, step, agent as u32);
            let mut rng = generator(RunSeed(self.run.seed), draw);
            let mut action = [0.0];
            policy.draw(&[*mean], &mut rng, &mut action);
            chunk.log_prob.push(policy.log_prob(&[*mean], &action));
            actions.push(action[0]);
        }
        chunk.observation.extend_from_slice(&observation);
        chunk.action.extend_from_slice(&actions);
        actions
    }

    fn last(&self, step: u32, environment: usize) -> FinalStep {
        let world = &self.worlds[environment];
        FinalStep {
            step,
            environment: environment as u32,
            state: world.points.to_vec(),
            observation: [0, 1].map(|agent| world.observation(agent)).into(),
        }
    }

    fn restart(&mut self, environment: usize) {
        let global = self.work.environments[environment].environment;
        let episode = self.worlds[environment].episode + 1;
        self.worlds[environment] =
            World::episode(RunSeed(self.run.seed), global, episode, EPISODE_STEPS);
        for (hidden, policy) in self.hidden.iter_mut().zip(&self.policy.agents) {
            let size = policy.hidden_size();
            hidden[environment * size..][..size].fill(0.0);
        }
    }
}

/// Plays one evaluation episode with mean actions.
pub(crate) fn evaluate(
    run: &RunDescription,
    policy: &PolicySnapshot,
    work: &EvaluationWork,
) -> EvaluationResult {
    let draw =
        Draw::of(Purpose::EvaluationReset).iteration(work.iteration).environment(work.episode);
    let mut world = World::reset(RunSeed(run.seed), draw, 0, EPISODE_STEPS);
    let zeros = |agent: &ActorPolicy| vec![0.0; agent.hidden_size()];
    let mut hidden: Vec<Vec<f32>> = policy.agents.iter().map(zeros).collect();
    let mut extrinsic_return = 0.0;
    loop {
        let mut actions = [0.0; 2];
        for (agent, action) in actions.iter_mut().enumerate() {
            let mut mean = [0.0];
            let observation = world.observation(agent);
            let (policy, hidden) = (&policy.agents[agent], &mut hidden[agent]);
            policy.forward(1, &observation, hidden, &mut mean, &mut Scratch::default());
            *action = mean[0];
        }
        let (reward, done) = world.step(actions);
        extrinsic_return += f64::from(reward);
        if done {
            return EvaluationResult { episode: work.episode, extrinsic_return, steps: world.step };
        }
    }
}
