//! Disturbances of an episode: the ranges that `[disturbance]` of a task file states, and their draws.
//!
//! Every draw is a function of the episode's key, the purpose of the draw and, for noise and pushes, the step
//! ([`crate::noise::generator`]). A state therefore contains the key instead of what was drawn, and an episode that is
//! restored in the middle continues with the same draws in any process. What is not stated is not drawn, and the start
//! state of an episode is the same with and without disturbances.

mod push;
mod row;

use proto::{FeatureRole, FeatureSpec};
use rand::RngCore;
use rapier3d::math::Vector;

use super::definition::{check_repeats, refused};
use super::names::Names;
use super::relations::WorldAxis;
use crate::error::SimError;
use crate::noise::{self, DrawPurpose, generator};
use crate::robot::{GroundForm, GroundPlan, JointPlan, LinkPlan, Robot, ShapePlan};
use crate::state::EpisodeDraws;
use crate::world::EpisodeConditions;
use push::Push;
pub(super) use row::ascending;
pub(crate) use row::{DisturbanceRow, LONGEST_DELAY};
use row::{PayloadRow, SensorRow};

/// Largest number of pushes, of payloads, and of rows of the terrain.
const MOST_ROWS: usize = 100;

/// The disturbances of a task, with names resolved to indices.
#[derive(Clone, Debug)]
pub(crate) struct DisturbanceRanges {
    pub(crate) row: DisturbanceRow,
    pushes: Vec<Push>,
    /// Links of the payloads.
    loaded: Vec<usize>,
    /// Fixed shapes of the terrain, each with its row.
    raised: Vec<(usize, usize)>,
    /// Gravity of the model, m/s^2, and the axes in which the ground can slope.
    gravity: (Vector, Vec<WorldAxis>),
    motors: Vec<String>,
    hinges: Vec<String>,
    /// Names of the measured positions, then of the velocities; the second number is that of the positions.
    measured: (Vec<String>, usize),
}

/// What an episode has drawn.
#[derive(Clone, Debug, Default)]
pub(crate) struct DrawnEpisode {
    pub(crate) conditions: EpisodeConditions,
    /// Target velocity, `[C]`.
    pub(crate) command: Vec<f32>,
    /// Steps.
    pub(crate) action_delay: u32,
    /// Steps.
    pub(crate) observation_delay: u32,
    /// Bias of each measurement, `[M]`.
    pub(crate) bias: Vec<f32>,
    /// Link and force (N) of each push in the step that starts now.
    pub(crate) forces: Vec<(usize, Vector)>,
}

impl DisturbanceRanges {
    /// Resolves a row. `features` are the measured ones: positions, then velocities.
    pub(super) fn new(
        row: &DisturbanceRow,
        robot: &Robot,
        features: &[FeatureSpec],
    ) -> Result<Self, SimError> {
        row.check()?;
        check_effects(row, robot)?;
        let loaded = links("payload", row.payload.iter().map(|payload| &payload.link), robot)?;
        let pushed = links("push", row.push.iter().map(|push| &push.link), robot)?;
        let pushes = row.push.iter().zip(pushed);
        let names: Vec<String> = features.iter().map(|feature| feature.name.clone()).collect();
        let coordinates = names.iter().filter(|name| name.ends_with(".position")).count();
        Ok(Self {
            row: row.clone(),
            pushes: pushes
                .map(|(row, link)| Push::new(row, link, robot))
                .collect::<Result<_, _>>()?,
            loaded,
            raised: raised(row, robot)?,
            gravity: (robot.blueprint.gravity, push::horizontal_of_all(robot)),
            motors: robot.actuators().map(|motor| motor.name.to_owned()).collect(),
            hinges: robot.hinges().map(|(name, _)| name.to_owned()).collect(),
            measured: (names, coordinates),
        })
    }

    /// Whether the task states a disturbance.
    pub(crate) fn are_stated(&self) -> bool {
        !self.row.lines().is_empty()
    }

    /// Longest delays of actions and observations, steps.
    pub(crate) fn longest_delays(&self) -> [u32; 2] {
        [self.row.action_delay, self.row.observation_delay]
            .map(|range| range.map_or(0, |[_, high]| high))
    }

    /// Whether what agents observe can differ from the state.
    pub(crate) fn change_sensors(&self) -> bool {
        let errors = [self.row.sensor_noise, self.row.sensor_bias];
        errors.iter().any(SensorRow::is_stated) || self.longest_delays()[1] > 0
    }

    /// Draws an episode; without disturbances, the values that change nothing.
    pub(super) fn draw(&self, draws: &EpisodeDraws) -> DrawnEpisode {
        let nothing = DisturbanceRow::default();
        let row = if draws.is_disturbed { &self.row } else { &nothing };
        let rng = |purpose| generator(draws.key, purpose, 0);
        let factors = |range: Option<[f32; 2]>, purpose, count| {
            let (range, mut rng) = (range.unwrap_or([1.0; 2]), rng(purpose));
            (0..count).map(|_| noise::within(&mut rng, range)).collect::<Vec<_>>()
        };
        let delay = |range: Option<[u32; 2]>, purpose| {
            noise::whole(&mut rng(purpose), range.unwrap_or([0; 2]))
        };
        let mut payloads = rng(DrawPurpose::Payload);
        let mut mass = |row: &PayloadRow| noise::within(&mut payloads, row.mass);
        let (names, coordinates) = &self.measured;
        let mut bias = vec![0.0; names.len()];
        row.sensor_bias.add(&mut rng(DrawPurpose::SensorBias), &mut bias, *coordinates);
        DrawnEpisode {
            conditions: EpisodeConditions {
                friction: factors(row.friction, DrawPurpose::Friction, 1)[0],
                gravity: row.slope.map(|range| self.tilted(range, &mut rng(DrawPurpose::Slope))),
                rises: if draws.is_disturbed { self.rises(draws.key) } else { Vec::new() },
                payloads: self
                    .loaded
                    .iter()
                    .copied()
                    .zip(row.payload.iter().map(&mut mass))
                    .collect(),
                motor_strengths: factors(
                    row.motor_strength,
                    DrawPurpose::MotorStrength,
                    self.motors.len(),
                ),
                joint_dampings: factors(
                    row.joint_damping,
                    DrawPurpose::JointDamping,
                    self.hinges.len(),
                ),
            },
            command: Vec::new(),
            action_delay: delay(row.action_delay, DrawPurpose::ActionDelay),
            observation_delay: delay(row.observation_delay, DrawPurpose::ObservationDelay),
            bias,
            forces: self.pushes.iter().map(|push| (push.link, Vector::ZERO)).collect(),
        }
    }

    /// Gravity on ground with a drawn slope, in the axes of the ground, m/s^2.
    fn tilted(&self, slope: [f32; 2], rng: &mut impl RngCore) -> Vector {
        let (gravity, axes) = &self.gravity;
        let angle = noise::within(rng, slope);
        let along = push::direction(rng, axes) * gravity.length();
        *gravity * libm::cosf(angle) + along * libm::sinf(angle)
    }

    /// Draws the heights of the terrain.
    fn rises(&self, key: [u8; 32]) -> Vec<(usize, f32)> {
        let mut rng = generator(key, DrawPurpose::Terrain, 0);
        let mut rise = |height: [f32; 2]| noise::within(&mut rng, height);
        let raised = self.raised.iter();
        raised.map(|(ground, row)| (*ground, rise(self.row.terrain[*row].height))).collect()
    }

    /// Conditions of an undisturbed episode with the terrain at its largest heights; `None` without terrain.
    pub(crate) fn highest_terrain(&self) -> Option<EpisodeConditions> {
        let highest = |(ground, row): &(usize, usize)| (*ground, self.row.terrain[*row].height[1]);
        let rises: Vec<(usize, f32)> = self.raised.iter().map(highest).collect();
        let undisturbed = EpisodeDraws { key: [0; 32], is_disturbed: false };
        let is_raised = !rises.is_empty();
        is_raised.then(|| EpisodeConditions { rises, ..self.draw(&undisturbed).conditions })
    }

    /// Sets the forces of the step that starts now, the step `step` of the episode.
    pub(crate) fn draw_forces(&self, draws: &EpisodeDraws, step: u32, drawn: &mut DrawnEpisode) {
        if !draws.is_disturbed {
            return;
        }
        for ((number, push), (_, force)) in (0..).zip(&self.pushes).zip(&mut drawn.forces) {
            *force = push.force(draws.key, number, step);
        }
    }

    /// Adds bias and noise of the step `step` to the measurements `[M]`.
    pub(crate) fn measure(&self, draws: &EpisodeDraws, step: u32, bias: &[f32], out: &mut [f32]) {
        if !draws.is_disturbed {
            return;
        }
        out.iter_mut().zip(bias).for_each(|(number, bias)| *number += bias);
        let mut rng = generator(draws.key, DrawPurpose::SensorNoise, step);
        self.row.sensor_noise.add(&mut rng, out, self.measured.1);
    }

    /// Features that describe what was drawn.
    pub(super) fn features(&self) -> Vec<FeatureSpec> {
        let mut names = Vec::new();
        self.describe(&DrawnEpisode::default(), |name, _| names.push(name()));
        let signal =
            |name| FeatureSpec { name: format!("disturbance.{name}"), role: FeatureRole::Signal };
        names.into_iter().map(signal).collect()
    }

    /// Writes the values of [`Self::features`], unless `out` is empty.
    pub(super) fn write(&self, drawn: &DrawnEpisode, out: &mut [f32]) {
        if out.is_empty() {
            return;
        }
        let mut places = out.iter_mut();
        self.describe(drawn, |_, value| {
            if let Some(place) = places.next() {
                *place = value;
            }
        });
    }

    /// Calls `each` with name and value of everything that the task states; values that are not drawn yet are 0.
    fn describe(&self, drawn: &DrawnEpisode, mut each: impl FnMut(&dyn Fn() -> String, f32)) {
        let (row, conditions) = (&self.row, &drawn.conditions);
        let at = |values: &[f32], index: usize| values.get(index).copied().unwrap_or(0.0);
        if row.friction.is_some() {
            each(&|| "friction".to_owned(), conditions.friction);
        }
        for (axis, name) in ["x", "y"].iter().enumerate().filter(|_| row.slope.is_some()) {
            let gravity = conditions.gravity.map_or(0.0, |gravity| gravity[axis]);
            each(&|| format!("gravity.{name}"), gravity);
        }
        for (index, (_, terrain)) in self.raised.iter().enumerate() {
            let rise = conditions.rises.get(index).map_or(0.0, |(_, rise)| *rise);
            each(&|| format!("terrain.{}.{index}", row.terrain[*terrain].body), rise);
        }
        for (index, payload) in row.payload.iter().enumerate() {
            let mass = conditions.payloads.get(index).map_or(0.0, |(_, mass)| *mass);
            each(&|| format!("payload.{}", payload.link), mass);
        }
        for (index, motor) in
            self.motors.iter().enumerate().filter(|_| row.motor_strength.is_some())
        {
            each(&|| format!("motor_strength.{motor}"), at(&conditions.motor_strengths, index));
        }
        for (index, hinge) in self.hinges.iter().enumerate().filter(|_| row.joint_damping.is_some())
        {
            each(&|| format!("joint_damping.{hinge}"), at(&conditions.joint_dampings, index));
        }
        if row.action_delay.is_some() {
            each(&|| "action_delay".to_owned(), drawn.action_delay as f32);
        }
        if row.observation_delay.is_some() {
            each(&|| "observation_delay".to_owned(), drawn.observation_delay as f32);
        }
        for index in row.sensor_bias.stated(self.measured.0.len(), self.measured.1) {
            each(&|| format!("sensor_bias.{}", self.measured.0[index]), at(&drawn.bias, index));
        }
        for (index, push) in row.push.iter().enumerate() {
            let force = drawn.forces.get(index).map_or([0.0; 3], |(_, force)| force.to_array());
            for (axis, force) in ["x", "y", "z"].iter().zip(force) {
                each(&|| format!("push.{}.{axis}", push.link), force);
            }
        }
    }
}

/// Refuses what cannot disturb this robot.
fn check_effects(row: &DisturbanceRow, robot: &Robot) -> Result<(), SimError> {
    let mut hinges = robot.layout.hinges.iter().map(|hinge| &hinge.plan);
    let damped = hinges.any(|hinge| hinge.damping != 0.0 && !hinge.turns_ball());
    let gravity = robot.blueprint.gravity;
    let falls = gravity.z < 0.0 && gravity.x == 0.0 && gravity.y == 0.0;
    for (refuses, why) in [
        (
            row.joint_damping.is_some() && !damped,
            "joint_damping is a factor of damping, and no hinge or slide of the model has any",
        ),
        (
            row.friction.is_some() && !robot.blueprint.has_contacts(),
            "friction is a factor of the friction of contacts, and nothing in the model can touch",
        ),
        (
            row.slope.is_some() && !falls,
            "slope tilts the ground under gravity along -z, which the model has not",
        ),
        (
            row.in_evaluations && row.lines().is_empty(),
            "in_evaluations has no effect without a disturbance",
        ),
    ] {
        if refuses {
            return Err(refused(format!("disturbance.{why}; remove it")));
        }
    }
    Ok(())
}

/// Fixed shapes of the bodies that the terrain names, each with its row.
fn raised(row: &DisturbanceRow, robot: &Robot) -> Result<Vec<(usize, usize)>, SimError> {
    let blueprint = &robot.blueprint;
    let solid = |ground: &&GroundPlan| !matches!(ground.form, GroundForm::Plane);
    let grounds = || blueprint.grounds.iter().enumerate();
    let bodies =
        blueprint.grounds.iter().filter(solid).map(|ground| &blueprint.bodies[ground.body]);
    let known: Vec<String> = bodies.cloned().collect();
    let names = Names::new("fixed body with a shape that is no plane", &known);
    let mut found = Vec::new();
    let raised: Vec<&String> = row.terrain.iter().map(|terrain| &terrain.body).collect();
    check_rows("disturbance.terrain", raised.len())?;
    check_repeats("disturbance.terrain.body", &raised)?;
    let bases = blueprint.links.iter().filter(|link| link.is_base());
    let shapes = bases.flat_map(|link| &link.shapes);
    let in_base: Vec<&ShapePlan> = shapes.filter(|shape| shape.surface.is_some()).collect();
    for (index, terrain) in row.terrain.iter().enumerate() {
        if in_base.iter().any(|shape| blueprint.bodies[shape.body] == terrain.body) {
            return Err(refused(format!(
                "disturbance.terrain.body: the shapes of `{}` are a robot's base, since the model has no free joint; move \
                 them to the `worldbody`, and name \"world\"",
                terrain.body
            )));
        }
        names.index("disturbance.terrain.body", &terrain.body)?;
        let own = grounds().filter(|(_, ground)| blueprint.bodies[ground.body] == terrain.body);
        found.extend(own.filter(|(_, ground)| solid(ground)).map(|(ground, _)| (ground, index)));
    }
    Ok(found)
}

fn check_rows(place: &str, count: usize) -> Result<(), SimError> {
    if count > MOST_ROWS {
        Err(refused(format!("{place} has {count} rows; at most {MOST_ROWS} are allowed")))
    } else {
        Ok(())
    }
}

/// Indices of the links that the rows of `disturbance.KEY` name.
fn links<'a>(
    key: &str,
    names: impl ExactSizeIterator<Item = &'a String>,
    robot: &Robot,
) -> Result<Vec<usize>, SimError> {
    let place = format!("disturbance.{key}");
    check_rows(&place, names.len())?;
    let plans = &robot.blueprint.links;
    let can_move =
        |link: &&LinkPlan| link.mass.mass() > 0.0 && !matches!(link.joint, JointPlan::Fixed);
    let known: Vec<String> = plans.iter().filter(can_move).map(|link| link.name.clone()).collect();
    let mut found = Vec::new();
    for name in names {
        Names::new("link with a mass that can move", &known)
            .index(&format!("{place}.link"), name)?;
        let link = plans.iter().position(|link| link.name == *name);
        let link = link.expect("the link is one of the known ones");
        if found.contains(&link) {
            return Err(refused(format!("{place}: the link `{name}` is named twice; remove one")));
        }
        found.push(link);
    }
    Ok(found)
}
