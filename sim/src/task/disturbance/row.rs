//! `[disturbance]` of a task file.

use rand::RngCore;
use serde::de::Error;
use serde::{Deserialize, Deserializer};

use super::super::definition::{refused, within};
use super::super::relations::WorldAxis;
use super::super::start::Noise;
use crate::arrays;
use crate::error::{SimError, short};

/// Largest delay, steps. A state has an action or a measurement for each.
pub(crate) const LONGEST_DELAY: u32 = 20;

/// `[disturbance]` of a task file. A range is `[low, high]`; equal ends state a constant.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct DisturbanceRow {
    /// Forces on links.
    pub(super) push: Vec<PushRow>,
    /// Masses on links, drawn per episode.
    pub(super) payload: Vec<PayloadRow>,
    /// Changes of the heights of fixed shapes, drawn per shape and episode.
    pub(super) terrain: Vec<TerrainRow>,
    /// Angle of the ground, rad, drawn per episode in a random direction.
    #[serde(deserialize_with = "arrays::given")]
    pub(super) slope: Option<[f32; 2]>,
    /// Factor of the friction of all contacts, drawn per episode.
    #[serde(deserialize_with = "arrays::given")]
    pub(super) friction: Option<[f32; 2]>,
    /// Factor of the torque of each motor, drawn per motor and episode.
    #[serde(deserialize_with = "arrays::given")]
    pub(super) motor_strength: Option<[f32; 2]>,
    /// Factor of the damping of each joint, drawn per joint and episode.
    #[serde(deserialize_with = "arrays::given")]
    pub(super) joint_damping: Option<[f32; 2]>,
    /// Steps between an action and its effect, drawn per episode.
    #[serde(deserialize_with = "arrays::given")]
    pub(super) action_delay: Option<[u32; 2]>,
    /// Steps between a measurement and its observation, drawn per episode.
    #[serde(deserialize_with = "arrays::given")]
    pub(super) observation_delay: Option<[u32; 2]>,
    /// Error of each measurement, drawn in every step.
    #[serde(deserialize_with = "stated")]
    pub(super) sensor_noise: SensorRow,
    /// Error of each measurement, drawn per episode.
    #[serde(deserialize_with = "stated")]
    pub(super) sensor_bias: SensorRow,
    /// Whether the evaluations of a training are disturbed, too.
    pub(crate) in_evaluations: bool,
}

/// A force on the mass centre of a link. Each window of `period_secs` has one push, at a time that is drawn uniformly.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct PushRow {
    pub(super) link: String,
    /// Range of its size, N.
    #[serde(deserialize_with = "arrays::exact")]
    pub(super) force: [f32; 2],
    pub(super) duration_secs: f32,
    /// Mean time between pushes, s.
    pub(super) period_secs: f32,
    /// World axes that span the directions, which are uniformly distributed. Default: x or y for a robot in the vertical
    /// plane of this axis, x and y for others.
    pub(super) axes: Option<Vec<WorldAxis>>,
}

/// A point mass at the mass centre of a link.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct PayloadRow {
    pub(super) link: String,
    /// kg.
    #[serde(deserialize_with = "arrays::exact")]
    pub(super) mass: [f32; 2],
}

/// The shapes of a body that is fixed to the world, other than planes.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct TerrainRow {
    pub(super) body: String,
    /// m, added to the height of each shape.
    #[serde(deserialize_with = "arrays::exact")]
    pub(super) height: [f32; 2],
}

/// Errors of the measured coordinates (m or rad) and velocities (m/s or rad/s).
#[derive(Clone, Copy, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(super) struct SensorRow {
    pub(super) positions: Option<Noise>,
    pub(super) velocities: Option<Noise>,
}

impl DisturbanceRow {
    /// Checks all ranges.
    pub(super) fn check(&self) -> Result<(), SimError> {
        let given = |key: &str, range: Option<[f32; 2]>, most| {
            range.map_or(Ok(()), |range| {
                ascending(&format!("disturbance.{key}"), range, [0.0, most])
            })
        };
        given("slope", self.slope, 1.5)?;
        given("friction", self.friction, 10.0)?;
        given("motor_strength", self.motor_strength, 10.0)?;
        given("joint_damping", self.joint_damping, 100.0)?;
        for push in &self.push {
            let place = format!("push ({})", push.link);
            given(&format!("{place}.force"), Some(push.force), 1e6)?;
            within(&format!("disturbance.{place}.duration_secs"), push.duration_secs, 1e-6, 1e4)?;
            within(&format!("disturbance.{place}.period_secs"), push.period_secs, 1e-6, 1e4)?;
        }
        for payload in &self.payload {
            given(&format!("payload ({}).mass", payload.link), Some(payload.mass), 1e4)?;
        }
        for terrain in &self.terrain {
            let key = format!("disturbance.terrain ({}).height", terrain.body);
            ascending(&key, terrain.height, [-100.0, 100.0])?;
        }
        for (key, range) in
            [("action_delay", self.action_delay), ("observation_delay", self.observation_delay)]
        {
            if let Some([low, high]) =
                range.filter(|[low, high]| low > high || *high > LONGEST_DELAY)
            {
                return Err(refused(format!(
                    "disturbance.{key} must be [low, high] in 0..={LONGEST_DELAY} steps, is [{low}, {high}]"
                )));
            }
        }
        for (key, sensors) in
            [("sensor_noise", self.sensor_noise), ("sensor_bias", self.sensor_bias)]
        {
            for (of, noise) in
                [("positions", sensors.positions), ("velocities", sensors.velocities)]
            {
                let size = noise.map_or(0.0, Noise::size);
                within(&format!("disturbance.{key}.{of}"), size, 0.0, 1e3)?;
            }
        }
        Ok(())
    }

    /// What the task states, one line each.
    pub(crate) fn lines(&self) -> Vec<String> {
        let factor = |name: &str, of: &str, range: Option<[f32; 2]>| {
            range.map(|[low, high]| format!("{name}: {low} to {high} times {of}, in each episode"))
        };
        let delay = |name: &str, range: Option<[u32; 2]>| {
            range.map(|[low, high]| format!("{name}: {low} to {high} steps, in each episode"))
        };
        let push =
            |PushRow { link, force: [low, high], duration_secs, period_secs, .. }: &PushRow| {
                format!(
                    "push of {link}: {low} to {high} N for {duration_secs} s, once in {period_secs} s"
                )
            };
        let payload = |PayloadRow { link, mass: [low, high] }: &PayloadRow| {
            format!("payload on {link}: {low} to {high} kg, in each episode")
        };
        let terrain = |TerrainRow { body, height: [low, high] }: &TerrainRow| {
            format!(
                "heights of {body}: changed by {low} to {high} m, for each shape, in each episode"
            )
        };
        let slope = |[low, high]: [f32; 2]| {
            format!("slope of the ground: {low} to {high} rad, in each episode")
        };
        let single = [
            self.slope.map(slope),
            factor("friction", "the model's", self.friction),
            factor("motor strength", "the model's, for each motor", self.motor_strength),
            factor("joint damping", "the model's, for each joint", self.joint_damping),
            delay("delay of actions", self.action_delay),
            delay("delay of observations", self.observation_delay),
        ];
        let mut lines: Vec<String> = self.push.iter().map(push).collect();
        lines.extend(self.payload.iter().map(payload));
        lines.extend(self.terrain.iter().map(terrain));
        lines.extend(single.into_iter().flatten());
        lines.extend(self.sensor_noise.lines("sensor noise", "in each step"));
        lines.extend(self.sensor_bias.lines("sensor bias", "in each episode"));
        lines
    }
}

impl SensorRow {
    pub(super) fn is_stated(&self) -> bool {
        self.positions.is_some() || self.velocities.is_some()
    }

    /// Indices of the measurements that it changes.
    pub(super) fn stated(&self, count: usize, coordinates: usize) -> impl Iterator<Item = usize> {
        let positions = self.positions.is_some();
        let velocities = self.velocities.is_some();
        (0..count).filter(move |index| if *index < coordinates { positions } else { velocities })
    }

    /// Adds a draw to each of the measurements, of which the first ones are `coordinates`.
    pub(super) fn add(&self, rng: &mut impl RngCore, out: &mut [f32], coordinates: usize) {
        let (positions, velocities) = out.split_at_mut(coordinates);
        for (distribution, numbers) in [(self.positions, positions), (self.velocities, velocities)]
        {
            if let Some(distribution) = distribution {
                numbers.iter_mut().for_each(|number| *number += distribution.draw(rng));
            }
        }
    }

    fn lines(&self, name: &str, when: &str) -> impl Iterator<Item = String> {
        let rows = [("coordinates", self.positions), ("velocities", self.velocities)];
        rows.map(|(of, noise)| noise.map(|noise| format!("{name} of {of}: {noise}, {when}")))
            .into_iter()
            .flatten()
    }
}

/// Reads a table that states an error.
fn stated<'de, D: Deserializer<'de>>(deserializer: D) -> Result<SensorRow, D::Error> {
    let row: SensorRow = arrays::table(deserializer)?;
    if row.is_stated() {
        Ok(row)
    } else {
        Err(D::Error::custom("it needs `positions` or `velocities`; add one, or remove the key"))
    }
}

/// Refuses a range that does not ascend or leaves `bounds`.
pub(in super::super) fn ascending(
    key: &str,
    range: [f32; 2],
    bounds: [f32; 2],
) -> Result<(), SimError> {
    let ([low, high], [least, most]) = (range, bounds);
    if low <= high && least <= low && high <= most {
        return Ok(());
    }
    let [low, high, least, most] = [low, high, least, most].map(short);
    Err(refused(format!("{key} must be [low, high] in {least}..={most}, is [{low}, {high}]")))
}
