//! Reward, end and global state of an episode, as a task file defines them for its robot.

use proto::{FeatureRole, FeatureSpec};
use rapier3d::math::Vector;

use super::Motion;
use super::command::CommandRanges;
use super::definition::{
    Around, Audience, HealthyRow, TaskFile, TermName, TermRow, check_repeats, refused, within,
};
use super::disturbance::{DisturbanceRanges, DrawnEpisode};
use super::healthy::{Watched, checked_healthy};
use super::names::Names;
use super::relations::{RelationFeature, Relations};
use super::start::Start;
use super::terms::{Term, Transition, WeightedSum};
use crate::error::{SimError, short};
use crate::robot::{Orientation, Robot};
use crate::state::EpisodeDraws;
use crate::world::World;

/// Rules of an episode, with all names resolved to indices.
#[derive(Clone, Debug)]
pub(crate) struct Rules {
    pub(crate) start: Start,
    /// Control for an action of 0.
    pub(crate) around: Around,
    reward: WeightedSum,
    cost: WeightedSum,
    /// Names of the reward's terms: of the rewards, then of the costs, `[K]`.
    pub(crate) term_names: Vec<String>,
    healthy: Vec<(Watched, HealthyRow)>,
    /// Coordinates in the global state.
    shown: Vec<usize>,
    relations: Relations,
    /// Numbers of measured positions and velocities.
    measured: [usize; 2],
    largest_velocity: Option<f32>,
    /// First components of velocities of free joints that are expressed in the axes of their bodies, and the rotations.
    velocities_in_body: Vec<(usize, Orientation)>,
    /// Whether contact forces can be observed.
    pub(crate) contact_forces: bool,
    pub(crate) command: CommandRanges,
    pub(crate) disturbance: DisturbanceRanges,
    /// Who observes the disturbances.
    pub(crate) audience: Audience,
    /// Number of features that describe the disturbances.
    described: usize,
    /// What reads the root, since it names no body or coordinate.
    pub(crate) of_root: Vec<String>,
}

impl Rules {
    /// Resolves the rules of a task file for its robot.
    pub(super) fn new(file: &TaskFile, robot: &Robot) -> Result<Self, SimError> {
        let names = Names::coordinates(robot);
        let command = CommandRanges::new(&file.command, robot)?;
        let shown = shown(&file.state.hidden, names, robot)?;
        let relations = Relations::new(&file.state.bodies, robot)?;
        let measured = measured_features(&shown, &relations, robot);
        let disturbance = DisturbanceRanges::new(&file.disturbance, robot, &measured)?;
        let features: Vec<String> = measured.into_iter().map(|feature| feature.name).collect();
        let positions = features.iter().filter(|name| name.ends_with(".position")).count();
        let largest = file.state.largest_velocity;
        largest.map_or(Ok(()), |most| within("state.largest_velocity", most, 1e-3, 1e6))?;
        let healthy = file.healthy.iter();
        let healthy = healthy.map(|row| checked_healthy(row, robot, &features, largest));
        let rules = Self {
            start: Start::new(&file.start, names, robot)?,
            around: file.actions.around,
            reward: WeightedSum::new("reward", &file.reward, robot, &command)?,
            cost: WeightedSum::new("cost", &file.cost, robot, &command)?,
            term_names: term_names(file),
            healthy: healthy.collect::<Result<_, _>>()?,
            shown,
            relations,
            measured: [positions, features.len() - positions],
            largest_velocity: largest,
            velocities_in_body: file.state.velocities_in_body(&robot.layout.orientations)?,
            contact_forces: file.state.contact_forces,
            command,
            described: match file.state.disturbances {
                Audience::Nobody => 0,
                Audience::Critic | Audience::Agents => disturbance.features().len(),
            },
            disturbance,
            audience: file.state.disturbances,
            of_root: of_root(file),
        };
        if rules.audience != Audience::Nobody && rules.described == 0 {
            let why = "has no effect, because [disturbance] states nothing that can be observed";
            return Err(refused(format!("state.disturbances {why}; remove it")));
        }
        Ok(rules)
    }

    /// Coordinates `[nq]` and velocities `[nv]` of the start without noise.
    pub(crate) fn start_pose(&self, robot: &Robot) -> (Vec<f32>, Vec<f32>) {
        let mut coordinates = robot.rest().to_vec();
        let mut velocities = vec![0.0; robot.velocity_names().len()];
        self.start.apply(&mut coordinates, &mut velocities);
        (coordinates, velocities)
    }

    /// Reward of a step: the sum of the rewards minus the sum of the costs. Writes its terms, costs as negative rewards, `[K]`.
    pub(crate) fn reward(&self, step: &Transition<'_>, terms: &mut [f32]) -> f32 {
        let (rewards, costs) = terms.split_at_mut(self.reward.len());
        let reward = self.reward.value(step, rewards) - self.cost.value(step, costs);
        costs.iter_mut().for_each(|cost| *cost = 0.0 - *cost);
        reward
    }

    /// Whether the episode terminates for a reason other than its length: a number has left its healthy range. `state` is
    /// the global state.
    pub(crate) fn terminated(&self, after: &Motion<'_>, state: &[f32]) -> bool {
        !self.healthy.iter().all(|(watched, row)| row.holds(watched.value(after, state)))
    }

    /// The conditions that the start without noise does not meet, with its values.
    pub(crate) fn unhealthy_start(&self, robot: &Robot) -> Vec<String> {
        let (coordinates, velocities) = self.start_pose(robot);
        let (reference, velocities) = (robot.reference(), velocities.as_slice());
        let motion = Motion { coordinates: &coordinates, reference, velocities };
        let mut state = vec![0.0; self.measured.iter().sum()];
        self.measure(&motion, &mut state);
        let values =
            self.healthy.iter().map(|(watched, row)| (row, watched.value(&motion, &state)));
        let unmet = values.filter(|(row, value)| !row.holds(*value));
        unmet
            .map(|(row, value)| {
                format!("`healthy.{}` ({}, is {})", row.name(), row.bounds(), short(value))
            })
            .collect()
    }

    /// Whether episodes can have different returns.
    pub(crate) fn can_vary(&self) -> bool {
        let ends = !self.healthy.is_empty();
        let mut terms = self.reward.weighted().chain(self.cost.weighted());
        terms.any(|term| ends || !matches!(term, Term::Alive))
    }

    /// Whether the reward depends on the actions of the step before.
    pub(crate) fn reads_last_action(&self) -> bool {
        self.reward.reads_last_action() || self.cost.reads_last_action()
    }

    /// The x of the mass centre, m, if the reward depends on it, else 0.
    pub(crate) fn mass_centre(&self, world: &World) -> f32 {
        let is_read = self.reward.reads_mass_centre() || self.cost.reads_mass_centre();
        if is_read { world.centre_of_mass()[0] } else { 0.0 }
    }

    /// Whether an episode draws anything besides its start.
    pub(crate) fn has_draws(&self) -> bool {
        !self.command.is_empty() || self.disturbance.are_stated()
    }

    /// Draws the command and the disturbances of an episode.
    pub(crate) fn draw(&self, draws: &EpisodeDraws) -> DrawnEpisode {
        DrawnEpisode { command: self.command.draw(draws.key), ..self.disturbance.draw(draws) }
    }

    /// Measured features of the global state: positions, then velocities, `[M]`.
    pub(crate) fn measured_features(&self, robot: &Robot) -> Vec<FeatureSpec> {
        measured_features(&self.shown, &self.relations, robot)
    }

    /// Indices in the global state of the features that relate bodies, each with the tree whose agents observe it if
    /// observations are local, or none.
    pub(crate) fn related(&self, robot: &Robot) -> Vec<(usize, Option<usize>)> {
        let [positions, velocities] = self.relations.features();
        let moving = self.measured[0] + robot.velocity_names().len();
        let places = (self.shown.len()..).zip(positions).chain((moving..).zip(velocities));
        places.map(|(place, feature)| (place, feature.observer)).collect()
    }

    /// Features of the disturbances, the last ones of the global state; empty with `Audience::Nobody`.
    pub(crate) fn disturbance_features(&self) -> Vec<FeatureSpec> {
        let mut features = self.disturbance.features();
        features.truncate(self.described);
        features
    }

    /// Writes the global state: the measured features and the command to the start of `out`, the disturbances to its end.
    /// Features of contact forces, between them, stay as they are.
    pub(crate) fn state(&self, motion: &Motion<'_>, drawn: &DrawnEpisode, out: &mut [f32]) {
        let command = self.measured.iter().sum::<usize>();
        out[command..][..drawn.command.len()].copy_from_slice(&drawn.command);
        let disturbances = out.len() - self.described;
        self.disturbance.write(drawn, &mut out[disturbances..]);
        self.measure(motion, out);
    }

    /// Writes the measured features to the start of `out`.
    fn measure(&self, motion: &Motion<'_>, out: &mut [f32]) {
        let (positions, rest) = out.split_at_mut(self.measured[0]);
        for (to, &index) in positions.iter_mut().zip(&self.shown) {
            *to = motion.position(index);
        }
        let (joints, velocities) = (motion.velocities.len(), &mut rest[..self.measured[1]]);
        velocities[..joints].copy_from_slice(motion.velocities);
        let related = &mut positions[self.shown.len()..];
        self.relations.write(motion, related, &mut velocities[joints..]);
        for (first, orientation) in &self.velocities_in_body {
            let velocity = &mut velocities[*first..][..3];
            let rotation = orientation.rotation(motion.coordinates);
            velocity
                .copy_from_slice(&(rotation.inverse() * Vector::from_slice(velocity)).to_array());
        }
        if let Some(largest) = self.largest_velocity {
            velocities.iter_mut().for_each(|v| *v = v.clamp(-largest, largest));
        }
    }
}

/// Positions of joints and bodies, then velocities of joints and bodies.
fn measured_features(shown: &[usize], relations: &Relations, robot: &Robot) -> Vec<FeatureSpec> {
    let [positions, velocities] = relations.features();
    let joint = |name: &String, kind: &str| format!("{name}.{kind}");
    let shown = shown.iter().map(|&index| joint(&robot.coordinate_names()[index], "position"));
    let moving = robot.velocity_names().iter().map(|name| joint(name, "velocity"));
    let name = |feature: RelationFeature| feature.name;
    let names = shown
        .chain(positions.into_iter().map(name))
        .chain(moving)
        .chain(velocities.into_iter().map(name));
    names.map(|name| FeatureSpec { name, role: FeatureRole::Signal }).collect()
}

/// Names of the rewards, then of the costs. The second term of a kind is `KIND_2`.
pub(super) fn term_names(file: &TaskFile) -> Vec<String> {
    let rows: Vec<&TermRow> = file.reward.iter().chain(&file.cost).collect();
    let name = |(index, row): (usize, &&TermRow)| {
        let term = row.term;
        match rows[..index].iter().filter(|before| before.term == row.term).count() {
            0 => term.to_string(),
            before => format!("{term}_{}", before + 1),
        }
    };
    rows.iter().enumerate().map(name).collect()
}

/// What reads the root of the robot, since it names no body or coordinate.
fn of_root(file: &TaskFile) -> Vec<String> {
    let reads = |row: &&TermRow| match row.term {
        TermName::Upright => row.of.is_none(),
        TermName::VelocityTracking => row.of.is_none() && file.command.of.is_none(),
        TermName::ForwardSpeed => row.coordinate.is_none(),
        _ => false,
    };
    let of = |key: &'static str, rows: &[TermRow]| {
        let reading = rows.iter().filter(reads);
        reading.map(|row| format!("`{key}.{}`", row.term)).collect::<Vec<_>>()
    };
    let is_upright =
        |row: &&HealthyRow| row.feature.as_deref() == Some("upright") && row.of.is_none();
    let healthy = file.healthy.iter().filter(is_upright).map(|_| "`healthy.upright`".to_owned());
    [of("reward", &file.reward), of("cost", &file.cost), healthy.collect()].concat()
}

/// Indices of the coordinates that are not hidden.
fn shown(hidden: &[String], names: Names<'_>, robot: &Robot) -> Result<Vec<usize>, SimError> {
    check_repeats("state.hidden", hidden)?;
    let hidden = hidden.iter().map(|name| names.index("state.hidden", name));
    let hidden = hidden.collect::<Result<Vec<_>, _>>()?;
    Ok((0..robot.coordinate_names().len()).filter(|index| !hidden.contains(index)).collect())
}
