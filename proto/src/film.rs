//! What an evaluated episode looked like: for people alone, so it is checked for its size and form and for nothing else.

use crate::read::{hold, length};
use crate::tensor::{Floats, floats};
use crate::{Refusal, RunDescription, wire};

/// Most frames of a film.
pub const MAX_FRAMES: usize = 400;
/// Most capsules in one frame.
pub const MAX_CAPSULES: usize = 64;
/// Farthest from the world's origin that a capsule may be, metres.
const FARTHEST: f32 = 1e5;
/// Numbers of one capsule in one frame: two ends in the world.
const NUMBERS: usize = 6;

/// A robot in motion, as capsules in the world.
#[derive(Clone, Debug, PartialEq)]
pub struct Film {
    /// Time from one frame to the next, seconds; more than 0.
    pub frame_secs: f64,
    /// For each capsule, metres.
    pub radii: Vec<f32>,
    /// For each capsule the agent that drives its joint, if any does.
    pub drivers: Vec<Option<usize>>,
    /// `[frames, capsules, 6]`: x, y, z of one end, then of the other, metres.
    pub ends: Vec<f32>,
}

impl Film {
    /// The message for it.
    #[must_use]
    pub fn to_wire(&self) -> wire::Film {
        let capsules = self.radii.len();
        let frames = self.ends.len() / (NUMBERS * capsules).max(1);
        let driver = |agent: &Option<usize>| agent.map_or(0, |agent| agent as u32 + 1);
        wire::Film {
            frame_secs: self.frame_secs,
            radii: self.radii.clone(),
            drivers: self.drivers.iter().map(driver).collect(),
            ends: Some(floats(&[frames, capsules, NUMBERS], &self.ends)),
        }
    }

    /// Reads a film of an episode of `run`.
    ///
    /// # Errors
    /// Refuses sizes over the limits, agents that the run has not, and what is no finite number.
    pub fn from_wire(wire: &wire::Film, run: &RunDescription) -> Result<Self, Refusal> {
        let shape = wire.ends.as_ref().map_or(&[][..], |ends| &ends.shape);
        let frames = shape.first().map_or(0, |frames| *frames as usize);
        let capsules = wire.radii.len();
        between(frames, MAX_FRAMES, "film.ends.shape")?;
        between(capsules, MAX_CAPSULES, "film.radii")?;
        length(wire.drivers.len(), capsules, "film.drivers")?;
        let shape = [frames, capsules, NUMBERS];
        let ends = Floats::check(wire.ends.as_ref(), &shape, "film.ends".to_owned())?;
        let agents = run.environment.agents.len() as u32;
        let known = wire.drivers.iter().all(|driver| *driver <= agents);
        hold(known.then_some(()).ok_or_else(|| format!("of {agents} agents")), "film.drivers")?;
        let sane = |radius: &f32| (0.0..=1e3).contains(radius);
        let (radii, secs) = (wire.radii.iter().all(sane), (1e-6..=1e3).contains(&wire.frame_secs));
        hold(
            radii.then_some(()).ok_or_else(|| "a radius in 0 to 1000 m".to_owned()),
            "film.radii",
        )?;
        hold(secs.then_some(()).ok_or_else(|| "1e-6 to 1000 s".to_owned()), "film.frame_secs")?;
        Ok(Self {
            frame_secs: wire.frame_secs,
            radii: wire.radii.clone(),
            drivers: wire
                .drivers
                .iter()
                .map(|driver| driver.checked_sub(1).map(|i| i as usize))
                .collect(),
            ends: within_sight(ends.decode()?)?,
        })
    }
}

/// Refuses capsules that no picture could show.
fn within_sight(ends: Vec<f32>) -> Result<Vec<f32>, Refusal> {
    let near = ends.iter().all(|metres| metres.abs() <= FARTHEST);
    hold(near.then_some(()).ok_or_else(|| format!("within {FARTHEST} m")), "film.ends")?;
    Ok(ends)
}

fn between(found: usize, most: usize, field: &str) -> Result<(), Refusal> {
    let fits = (1..=most).contains(&found).then_some(());
    hold(fits.ok_or_else(|| format!("{found} of them, allowed are 1 to {most}")), field)
}
