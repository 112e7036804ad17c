//! The robot environments of a slot: one world each, stepped in order.

mod describe;
mod warnings;

use std::sync::Arc;

use proto::{EnvironmentSpec, EpisodePosition};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;

use crate::config::{ContactForces, ObservationConfig, TaskConfig};
use crate::environment_batch::{EnvironmentBatch, Outcome};
use crate::error::{ActionError, SimError, StateError};
use crate::observation::Observation;
use crate::robot::Robot;
use crate::scene::Pose;
use crate::state::{State, StateBounds};
use crate::task::{self, Motion, Rules, Transition};
use crate::world::World;
use describe::Driven;

/// The robot environments of a slot.
pub(crate) struct RobotEnvironments {
    rules: Rules,
    robot: Arc<Robot>,
    description: EnvironmentSpec,
    bounds: StateBounds,
    observation: Observation,
    /// Motor driven by each component of the joint action, `[A]`.
    motors: Vec<Driven>,
    /// Controls of the last step in the state of a start, in the order of the joint action; empty unless the reward reads
    /// them.
    first_controls: Vec<f32>,
    environments: Vec<Environment>,
    /// Controls in motor order, `[A]`.
    controls: Vec<f32>,
    /// The same controls in the order of the joint action, `[A]`; not clamped.
    asked: Vec<f32>,
    /// State after the current step, before it is validated; then the state before it.
    next: State,
}

struct Environment {
    world: World,
    /// Position in the episode, and the motion after the last valid step. The controls have the order of the joint action
    /// and are empty unless the reward reads them.
    now: State,
    /// Global state of `now`, `[S]`.
    seen: Vec<f32>,
}

/// Returns `config`, without contact forces if the task does not support them.
fn effective(config: &ObservationConfig, rules: &Rules) -> ObservationConfig {
    let contact_forces =
        if rules.feels_contacts() { config.contact_forces } else { ContactForces::Absent };
    ObservationConfig { contact_forces, ..config.clone() }
}

/// The rest pose without motion.
fn rest(robot: &Robot, bounds: &StateBounds, position: EpisodePosition) -> State {
    State {
        position,
        coordinates: robot.rest().to_vec(),
        velocities: vec![0.0; bounds.velocities],
        actions: vec![0.0; bounds.actions],
    }
}

impl RobotEnvironments {
    /// Returns `count` environments in the robot's rest pose, in episode 0.
    pub(crate) fn new(config: &TaskConfig, count: usize) -> Result<Self, SimError> {
        let task = task::find(config)?;
        if count == 0 {
            return Err(SimError::NoEnvironments);
        }
        let motors = task.robot.blueprint().motors.len();
        let view = effective(&config.observation, &task.rules);
        let mut bounds = task.robot.state_bounds(task.episode_steps);
        if task.rules.reads_last_action() {
            bounds.actions = motors;
        }
        let (description, observation) = describe::describe(&task, &view, &bounds);
        let driven = Driven::all(&task);
        let first = driven.iter().map(|driven| task.controls.first[driven.motor]);
        let first_controls = first.take(bounds.actions).collect();
        let robot = Arc::new(task.robot);
        let position = EpisodePosition { episode: 0, step: 0, limit: task.episode_steps };
        let rest = rest(&robot, &bounds, position);
        let fresh = |_| Environment {
            world: World::new(Arc::clone(&robot)),
            now: rest.clone(),
            seen: vec![0.0; description.state.len()],
        };
        let mut environments = Self {
            rules: task.rules,
            bounds,
            motors: driven,
            first_controls,
            environments: (0..count).map(fresh).collect(),
            controls: vec![0.0; motors],
            asked: vec![0.0; motors],
            next: rest.clone(),
            robot,
            description,
            observation,
        };
        (0..count).for_each(|index| environments.update_state(index));
        Ok(environments)
    }
}

impl EnvironmentBatch for RobotEnvironments {
    fn description(&self) -> &EnvironmentSpec {
        &self.description
    }

    fn count(&self) -> usize {
        self.environments.len()
    }

    fn control_ranges(&self, agent: usize) -> Vec<[f32; 2]> {
        let sizes = self.description.agents.iter().map(|agent| agent.action.size);
        let first: usize = sizes.take(agent).sum();
        let own = &self.motors[first..][..self.description.agents[agent].action.size];
        own.iter().map(|driven| driven.range).collect()
    }

    fn warnings(&self) -> Vec<String> {
        warnings::warnings(&self.robot, &self.rules)
    }

    fn state_bounds(&self) -> Option<&StateBounds> {
        Some(&self.bounds)
    }

    fn reset(
        &mut self,
        environment: usize,
        episode: u64,
        limit: u32,
        key: [u8; 32],
    ) -> Result<(), SimError> {
        let limit = limit.clamp(1, self.description.episode_steps);
        let position = EpisodePosition { episode, step: 0, limit };
        let mut state = rest(&self.robot, &self.bounds, position);
        state.actions.copy_from_slice(&self.first_controls);
        let mut rng = ChaCha8Rng::from_seed(key);
        self.rules.randomise(&mut rng, &mut state.coordinates, &mut state.velocities);
        let bytes = state.to_bytes(&self.bounds.kind);
        self.rebuild(environment, &bytes).expect("start states are within the bounds of a state");
        Ok(())
    }

    fn restore(&mut self, environment: usize, state: &[u8]) -> Result<(), SimError> {
        Ok(self.rebuild(environment, state)?)
    }

    fn encode(&self, environment: usize) -> Result<Vec<u8>, SimError> {
        Ok(self.environments[environment].now.to_bytes(&self.bounds.kind))
    }

    fn position(&self, environment: usize) -> EpisodePosition {
        self.environments[environment].now.position
    }

    fn step(&mut self, actions: &[f32], outcome: &mut [Outcome]) -> Result<(), SimError> {
        let size = self.motors.len();
        assert_eq!(outcome.len(), self.count(), "outcome [E]");
        self.check(actions)?;
        for (index, outcome) in outcome.iter_mut().enumerate() {
            *outcome = self.step_one(index, &actions[index * size..][..size]);
        }
        Ok(())
    }

    fn observation(&self, environment: usize, agent: usize, out: &mut [f32]) {
        assert_eq!(out.len(), self.description.agents[agent].observation.len(), "observation");
        self.observation.see(agent, &self.environments[environment].seen, out);
    }

    fn state(&self, environment: usize, out: &mut [f32]) {
        assert_eq!(out.len(), self.description.state.len(), "state");
        out.copy_from_slice(&self.environments[environment].seen);
    }

    fn pose(&self, environment: usize) -> Pose {
        let world = &self.environments[environment].world;
        Pose { links: world.link_poses(), joints: world.joint_poses() }
    }

    fn world(&self, environment: usize) -> Option<&World> {
        Some(&self.environments[environment].world)
    }
}

impl RobotEnvironments {
    fn check(&self, actions: &[f32]) -> Result<(), ActionError> {
        let (environments, size) = (self.count(), self.motors.len());
        if actions.len() != environments * size {
            return Err(ActionError::Length { got: actions.len(), environments, size });
        }
        let Some(at) = actions.iter().position(|number| !number.is_finite()) else {
            return Ok(());
        };
        let (environment, mut index, mut agent) = (at / size, at % size, 0);
        while index >= self.description.agents[agent].action.size {
            index -= self.description.agents[agent].action.size;
            agent += 1;
        }
        Err(ActionError::NotFinite { environment, agent, index, value: actions[at] })
    }

    /// Rebuilds a world from an encoded state. All resets and restores use this function.
    fn rebuild(&mut self, index: usize, bytes: &[u8]) -> Result<(), StateError> {
        let state = State::from_bytes(bytes, &self.bounds)?;
        let environment = &mut self.environments[index];
        environment.world.rebuild(&state.coordinates, &state.velocities);
        environment.now = state;
        self.update_state(index);
        Ok(())
    }

    fn step_one(&mut self, index: usize, action: &[f32]) -> Outcome {
        for ((driven, asked), &number) in self.motors.iter().zip(&mut self.asked).zip(action) {
            *asked = driven.scale.apply(number);
            self.controls[driven.motor] = *asked;
        }
        let environment = &mut self.environments[index];
        let position = &mut environment.now.position;
        position.step = position.step.saturating_add(1);
        self.next.position = *position;
        let whole = environment.world.step(&self.controls);
        environment.world.coordinates(&mut self.next.coordinates);
        environment.world.velocities(&mut self.next.velocities);
        let bounded = self.bounds.check_motion(&self.next.coordinates, &self.next.velocities);
        if !whole || bounded.is_err() {
            environment.world.rebuild(&environment.now.coordinates, &environment.now.velocities);
            return Outcome { truncated: true, fault: true, ..Outcome::default() };
        }
        let remembered = self.next.actions.len();
        self.next.actions.copy_from_slice(&self.asked[..remembered]);
        std::mem::swap(&mut environment.now, &mut self.next);
        self.update_state(index);
        self.outcome(index)
    }

    /// Computes the global state of `now`. Features of contact forces, the last ones, stay 0.
    fn update_state(&mut self, index: usize) {
        let mut seen = std::mem::take(&mut self.environments[index].seen);
        let now = &self.environments[index].now;
        self.rules.state(&self.motion(now), &mut seen);
        self.environments[index].seen = seen;
    }

    /// Result of a valid step. `now` is the motion after the step, `next` the motion before it.
    fn outcome(&self, index: usize) -> Outcome {
        let environment = &self.environments[index];
        let (before, after) = (self.motion(&self.next), self.motion(&environment.now));
        let (control, last_control) = (self.asked.as_slice(), self.next.actions.as_slice());
        let dt_secs = self.description.dt_secs as f32;
        let EpisodePosition { step, limit, .. } = environment.now.position;
        let terminated = self.rules.terminated(&after, &environment.seen);
        Outcome {
            reward: self.rules.reward(&Transition {
                before,
                after,
                control,
                last_control,
                dt_secs,
            }),
            terminated,
            truncated: !terminated && step >= limit,
            fault: false,
        }
    }

    fn motion<'a>(&'a self, state: &'a State) -> Motion<'a> {
        Motion {
            coordinates: &state.coordinates,
            reference: self.robot.reference(),
            velocities: &state.velocities,
        }
    }
}
