//! Poses of a robot in an evaluation episode, for display only. Only size and format are validated.

use crate::read::{bad_value, from_1_to, length};
use crate::tensor::{floats, read_floats};
use crate::{Refusal, RunDescription, wire};

/// Maximum number of frames.
pub const MAX_FRAMES: usize = 400;
/// Maximum number of capsules in a frame.
pub const MAX_CAPSULES: usize = 64;
/// Maximum distance of a capsule from the world's origin along each axis, metres.
const MAX_DISTANCE: f32 = 1e5;
/// Coordinates of one capsule in one frame: two ends in the world.
const COORDINATES: usize = 6;

/// Motion of a robot, as capsules in the world.
#[derive(Clone, Debug, PartialEq)]
pub struct Film {
    /// Time between frames, seconds; greater than 0.
    pub frame_secs: f64,
    /// Radius of each capsule, metres.
    pub radii: Vec<f32>,
    /// For each capsule the agent that controls its joint, if any.
    pub drivers: Vec<Option<usize>>,
    /// `[frames, capsules, 6]`: x, y, z of one end, then of the other, metres.
    pub ends: Vec<f32>,
}

impl Film {
    /// Converts to the message.
    #[must_use]
    pub fn to_wire(&self) -> wire::Film {
        let capsules = self.radii.len();
        let frames = self.ends.len() / (COORDINATES * capsules).max(1);
        let driver = |agent: &Option<usize>| agent.map_or(0, |agent| agent as u32 + 1);
        wire::Film {
            frame_secs: self.frame_secs,
            radii: self.radii.clone(),
            drivers: self.drivers.iter().map(driver).collect(),
            ends: Some(floats(&[frames, capsules, COORDINATES], &self.ends)),
        }
    }

    /// Reads a film of an episode of `run`.
    ///
    /// # Errors
    /// If a size exceeds its limit, an agent is unknown, or a value is out of range.
    pub fn from_wire(wire: &wire::Film, run: &RunDescription) -> Result<Self, Refusal> {
        let shape = wire.ends.as_ref().map_or(&[][..], |ends| &ends.shape);
        let frames = shape.first().map_or(0, |frames| *frames as usize);
        let capsules = wire.radii.len();
        from_1_to(MAX_FRAMES, frames, "frames", "film.ends.shape")?;
        from_1_to(MAX_CAPSULES, capsules, "capsules", "film.radii")?;
        length(wire.drivers.len(), capsules, "film.drivers")?;
        let shape = [frames, capsules, COORDINATES];
        let ends = read_floats(wire.ends.as_ref(), &shape, "film.ends")?;
        if !ends.iter().all(|metres| metres.abs() <= MAX_DISTANCE) {
            return Err(bad_value("film.ends", format!("expected at most {MAX_DISTANCE} m")));
        }
        let agents = run.environment.agents.len() as u32;
        if wire.drivers.iter().any(|driver| *driver > agents) {
            return Err(bad_value("film.drivers", format!("expected 0 to {agents}")));
        }
        if !wire.radii.iter().all(|radius| (0.0..=1e3).contains(radius)) {
            return Err(bad_value("film.radii", "expected 0 to 1000 m"));
        }
        if !(1e-6..=1e3).contains(&wire.frame_secs) {
            return Err(bad_value("film.frame_secs", "expected 1e-6 to 1000 s"));
        }
        Ok(Self {
            frame_secs: wire.frame_secs,
            radii: wire.radii.clone(),
            drivers: wire
                .drivers
                .iter()
                .map(|driver| driver.checked_sub(1).map(|i| i as usize))
                .collect(),
            ends,
        })
    }
}
