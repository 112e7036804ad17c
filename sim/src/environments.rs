//! The robot environments of a slot: one world each, stepped in order.

mod describe;
mod sensors;
mod warnings;

use std::sync::Arc;

use proto::{ActuatorSpec, EnvironmentSpec, EpisodePosition};

use crate::config::{ContactForces, ObservationConfig, TaskConfig};
use crate::environment_batch::{Disturbances, EnvironmentBatch, Outcome, check_actions, in_range};
use crate::error::{SimError, StateError};
use crate::noise::{DrawPurpose, generator};
use crate::observation::Observation;
use crate::robot::Robot;
use crate::scene::Pose;
use crate::state::{EpisodeDraws, LARGEST_ACTION, State, StateBounds};
use crate::task::{self, DrawnEpisode, Motion, Rules, Task, Transition};
use crate::world::World;
use describe::Driven;
use sensors::Sensors;

/// The robot environments of a slot.
pub(crate) struct RobotEnvironments {
    rules: Rules,
    robot: Arc<Robot>,
    description: EnvironmentSpec,
    bounds: StateBounds,
    observation: Observation,
    /// Motor driven by each component of the joint action, `[A]`.
    motors: Vec<Driven>,
    environments: Vec<Environment>,
    /// Controls in motor order, `[A]`.
    controls: Vec<f32>,
    /// The same controls in the order of the joint action, `[A]`; not clamped to their ranges.
    asked: Vec<f32>,
    /// State after the current step, before it is validated; then the state before it.
    next: State,
    /// Which new episodes are disturbed.
    disturbances: Disturbances,
}

struct Environment {
    world: World,
    /// Position in the episode, and the motion after the last valid step. The controls have the order of the joint action
    /// and are empty unless the reward or a delay reads them.
    now: State,
    /// Global state of `now`, `[S]`.
    seen: Vec<f32>,
    /// What the episode has drawn besides its start.
    drawn: DrawnEpisode,
    /// Terms of the last step's reward, `[K]`.
    terms: Vec<f32>,
    /// What the agents observe instead of `seen`, if the task disturbs their sensors.
    sensors: Option<Sensors>,
}

/// Returns `config`, without contact forces if the task does not support them.
fn effective(config: &ObservationConfig, rules: &Rules) -> ObservationConfig {
    let contact_forces =
        if rules.contact_forces { config.contact_forces } else { ContactForces::Absent };
    ObservationConfig { contact_forces, ..config.clone() }
}

/// Bounds of the states of a task.
fn state_bounds(task: &Task) -> StateBounds {
    let rules = &task.rules;
    let [action_delay, observation_delay] = rules.disturbance.longest_delays();
    let remembered = action_delay.max(u32::from(rules.reads_last_action()));
    let measured = rules.measured_features(&task.robot).len();
    StateBounds {
        actions: remembered as usize * task.robot.blueprint.motors.len(),
        measurements: observation_delay as usize * measured,
        has_draws: rules.has_draws(),
        ..task.robot.state_bounds(task.episode_steps)
    }
}

/// The rest pose without motion; the actions before were 0. The episode has the key 0 and is not disturbed.
fn rest(
    robot: &Robot,
    bounds: &StateBounds,
    motors: &[Driven],
    position: EpisodePosition,
) -> State {
    let controls = motors.iter().map(|driven| in_range(driven.range, 0.0)).cycle();
    let draws = EpisodeDraws { key: [0; 32], is_disturbed: false };
    State {
        position,
        coordinates: robot.rest().to_vec(),
        velocities: vec![0.0; bounds.velocities],
        activations: vec![0.0; bounds.activations.len()],
        actions: controls.take(bounds.actions).collect(),
        measurements: vec![0.0; bounds.measurements],
        draws: bounds.has_draws.then_some(draws),
    }
}

/// Writes a history, the newest entry first: `newest`, then as much of the history `before` as fits.
fn remember(to: &mut [f32], newest: &[f32], before: &[f32]) {
    let (first, rest) = to.split_at_mut(newest.len().min(to.len()));
    first.copy_from_slice(&newest[..first.len()]);
    rest.copy_from_slice(&before[..rest.len()]);
}

impl RobotEnvironments {
    /// Returns `count` environments in the robot's rest pose, in episode 0.
    pub(crate) fn new(config: &TaskConfig, count: usize) -> Result<Self, SimError> {
        let task = task::find(config)?;
        let view = effective(&config.observation, &task.rules);
        let bounds = state_bounds(&task);
        let (description, observation) = describe::describe(&task, &view, &bounds);
        describe::check_sight(&description)?;
        let motors = Driven::all(&task);
        let robot = Arc::new(task.robot);
        let position = EpisodePosition { episode: 0, step: 0, limit: task.episode_steps };
        let rest = rest(&robot, &bounds, &motors, position);
        let fresh = |_| Environment {
            world: World::new(Arc::clone(&robot)),
            now: rest.clone(),
            seen: vec![0.0; description.state.len()],
            drawn: DrawnEpisode::default(),
            terms: vec![0.0; description.reward_terms.len()],
            sensors: Sensors::of(&task.rules, &robot),
        };
        let mut environments = Self {
            bounds,
            environments: (0..count).map(fresh).collect(),
            controls: vec![0.0; motors.len()],
            asked: vec![0.0; motors.len()],
            next: rest.clone(),
            rules: task.rules,
            motors,
            robot,
            description,
            observation,
            disturbances: Disturbances::AsInTraining,
        };
        (0..count).for_each(|index| environments.begin(index, rest.clone()));
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
        self.driven(agent).iter().map(|driven| driven.range).collect()
    }

    fn actuators(&self, agent: usize) -> Vec<ActuatorSpec> {
        let own = self.driven(agent).iter();
        own.map(|driven| self.robot.actuator_spec(driven.motor)).collect()
    }

    fn warnings(&self) -> Vec<String> {
        let motors = self.robot.blueprint.motors.iter();
        let mut controls: Vec<[f32; 2]> = motors.map(|motor| motor.range).collect();
        self.motors.iter().for_each(|driven| controls[driven.motor] = driven.range);
        warnings::warnings(&self.robot, &self.rules, &controls)
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
        let mut state = rest(&self.robot, &self.bounds, &self.motors, position);
        let mut rng = generator(key, DrawPurpose::Start, 0);
        self.rules.start.randomise(&mut rng, &mut state.coordinates, &mut state.velocities);
        self.rules.start.set_activations(&mut state.activations);
        let is_disturbed = self.starts_disturbed();
        state.draws = self.bounds.has_draws.then_some(EpisodeDraws { key, is_disturbed });
        let bytes = state.to_bytes(&self.bounds.kind);
        self.rebuild(environment, &bytes).expect("start states are within the bounds of a state");
        self.environments[environment].terms.fill(0.0);
        Ok(())
    }

    fn set_disturbances(&mut self, disturbances: Disturbances) {
        self.disturbances = disturbances;
    }

    fn can_be_disturbed(&self) -> bool {
        self.rules.disturbance.are_stated()
    }

    fn drawn(&self) -> Vec<String> {
        [self.rules.command.lines(), self.rules.disturbance.row.lines()].concat()
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
        check_actions(&self.description, self.count(), actions)?;
        for (index, outcome) in outcome.iter_mut().enumerate() {
            *outcome = self.step_one(index, &actions[index * size..][..size]);
        }
        Ok(())
    }

    fn observation(&self, environment: usize, agent: usize, out: &mut [f32]) {
        assert_eq!(out.len(), self.description.agents[agent].observation.len(), "observation");
        let Environment { seen, sensors, .. } = &self.environments[environment];
        let view = sensors.as_ref().map_or(seen, |sensors| &sensors.observed);
        self.observation.see(agent, view, out);
    }

    fn state(&self, environment: usize, out: &mut [f32]) {
        assert_eq!(out.len(), self.description.state.len(), "state");
        out.copy_from_slice(&self.environments[environment].seen);
    }

    fn reward_terms(&self, environment: usize) -> &[f32] {
        &self.environments[environment].terms
    }

    fn pose(&self, environment: usize) -> Pose {
        let world = &self.environments[environment].world;
        let root = self.robot.layout.root;
        Pose { links: world.link_poses(), root, joints: world.joint_poses() }
    }

    fn world(&self, environment: usize) -> Option<&World> {
        Some(&self.environments[environment].world)
    }
}

impl RobotEnvironments {
    /// The motors of an agent, in the order of its action.
    fn driven(&self, agent: usize) -> &[Driven] {
        let sizes = self.description.agents.iter().map(|agent| agent.action.size);
        let first: usize = sizes.take(agent).sum();
        &self.motors[first..][..self.description.agents[agent].action.size]
    }

    /// Rebuilds a world from an encoded state. All resets and restores use this function.
    fn rebuild(&mut self, index: usize, bytes: &[u8]) -> Result<(), StateError> {
        let state = State::from_bytes(bytes, &self.bounds)?;
        self.begin(index, state);
        Ok(())
    }

    /// Continues from a state within bounds.
    fn begin(&mut self, index: usize, state: State) {
        let environment = &mut self.environments[index];
        if let Some(draws) = &state.draws {
            environment.drawn = self.rules.draw(draws);
            environment.world.set_conditions(environment.drawn.conditions.clone());
        }
        environment.world.rebuild(&state.coordinates, &state.velocities);
        environment.world.set_activations(&state.activations);
        environment.now = state;
        self.update_state(index);
    }

    /// Whether episodes that start now are disturbed.
    fn starts_disturbed(&self) -> bool {
        match self.disturbances {
            Disturbances::AsInTraining => true,
            Disturbances::AsInEvaluations => self.rules.disturbance.row.in_evaluations,
            Disturbances::Off => false,
        }
    }

    fn step_one(&mut self, index: usize, action: &[f32]) -> Outcome {
        let environment = &mut self.environments[index];
        for ((driven, asked), &number) in self.motors.iter().zip(&mut self.asked).zip(action) {
            // Valid states hold no larger ones.
            *asked = in_range(driven.range, number).clamp(-LARGEST_ACTION, LARGEST_ACTION);
            self.controls[driven.motor] = driven.limited(*asked);
        }
        if let Some(back) = environment.drawn.action_delay.checked_sub(1) {
            let delayed = &environment.now.actions[back as usize * self.asked.len()..];
            for (driven, &asked) in self.motors.iter().zip(delayed) {
                self.controls[driven.motor] = driven.limited(asked);
            }
        }
        let position = &mut environment.now.position;
        position.step = position.step.saturating_add(1);
        self.next.position = *position;
        environment.world.push(&environment.drawn.forces);
        let mass_centre_before = self.rules.mass_centre(&environment.world);
        let whole = environment.world.step(&self.controls);
        environment.world.coordinates(&mut self.next.coordinates);
        environment.world.velocities(&mut self.next.velocities);
        environment.world.activations(&mut self.next.activations);
        let bounded = self.bounds.check_motion(&self.next.coordinates, &self.next.velocities);
        if !whole || bounded.is_err() {
            environment.world.rebuild(&environment.now.coordinates, &environment.now.velocities);
            environment.world.set_activations(&environment.now.activations);
            environment.terms.fill(0.0);
            self.update_state(index);
            return Outcome { truncated: true, fault: true, ..Outcome::default() };
        }
        if self.bounds.normalise_drifted(&mut self.next.coordinates) {
            environment.world.correct(&self.next.coordinates, &self.next.velocities);
            environment.world.set_activations(&self.next.activations);
        }
        remember(&mut self.next.actions, &self.asked, &environment.now.actions);
        if let Some(sensors) = &environment.sensors {
            remember(&mut self.next.measurements, &sensors.measured, &environment.now.measurements);
        }
        self.next.draws = environment.now.draws;
        std::mem::swap(&mut environment.now, &mut self.next);
        self.update_state(index);
        self.outcome(index, mass_centre_before)
    }

    /// Computes the global state of `now`, of which features of contact forces stay 0, and what the agents observe of it.
    fn update_state(&mut self, index: usize) {
        let Environment { now, seen, drawn, sensors, .. } = &mut self.environments[index];
        if let Some(draws) = &now.draws {
            self.rules.disturbance.draw_forces(draws, now.position.step, drawn);
        }
        self.rules.state(&motion(&self.robot, now), drawn, seen);
        if let Some(sensors) = sensors {
            sensors.measure(&self.rules, now, drawn, seen);
        }
    }

    /// Result of a valid step. `now` is the motion after the step, `next` the motion before it.
    fn outcome(&mut self, index: usize, mass_centre_before: f32) -> Outcome {
        let Environment { world, now, seen, drawn, terms, .. } = &mut self.environments[index];
        let [before, after] = [&self.next, &*now].map(|state| motion(&self.robot, state));
        let (control, last_control) = (self.asked.as_slice(), self.next.actions.as_slice());
        let dt_secs = self.description.dt_secs as f32;
        let EpisodePosition { step, limit, .. } = now.position;
        let terminated = self.rules.terminated(&after, seen);
        let mass_centre = [mass_centre_before, self.rules.mass_centre(world)];
        let command = &drawn.command;
        let transition =
            Transition { before, after, control, last_control, command, mass_centre, dt_secs };
        Outcome {
            reward: self.rules.reward(&transition, terms),
            terminated,
            truncated: !terminated && step >= limit,
            fault: false,
        }
    }
}

fn motion<'a>(robot: &'a Robot, state: &'a State) -> Motion<'a> {
    Motion {
        coordinates: &state.coordinates,
        reference: robot.reference(),
        velocities: &state.velocities,
    }
}
