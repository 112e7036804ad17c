//! Film of an evaluated episode, as capsules in the world, for viewers of the run.

use proto::{Film, MAX_CAPSULES, MAX_FRAMES};
use sim::{Capsule, EnvironmentBatch, LinkShape, Robot, SimError};

/// Index of the filmed episode of each evaluation.
pub(crate) const FILMED: u32 = 0;

/// Captures the start of an episode, one frame per step.
pub(crate) struct Camera {
    /// Capsules in the frames of their links, and the indices of these in a pose.
    capsules: Vec<(usize, Capsule)>,
    film: Film,
    frames: usize,
}

impl Camera {
    /// Creates a camera for `world` and captures the first frame; `None` without a simulated robot, or if the robot has
    /// too many capsules for a film.
    pub(crate) fn before(world: &dyn EnvironmentBatch) -> Result<Option<Self>, SimError> {
        let (task, pose) = (world.description(), world.pose(0));
        if pose.links.is_empty() {
            return Ok(None);
        }
        let link = |shape: &LinkShape| pose.links.iter().position(|link| link.name == shape.link);
        let shapes = world.robot().map(Robot::shapes).unwrap_or_default().into_iter();
        let shapes = shapes.filter_map(|shape| Some((link(&shape)?, shape.capsules())));
        let capsules: Vec<(usize, Capsule)> =
            shapes.flat_map(|(link, all)| all.into_iter().map(move |one| (link, one))).collect();
        if !(1..=MAX_CAPSULES).contains(&capsules.len()) {
            return Ok(None);
        }
        let drivers = sim::drivers(task, &pose);
        let film = Film {
            frame_secs: task.dt_secs,
            radii: capsules.iter().map(|(_, capsule)| capsule.radius).collect(),
            drivers: capsules.iter().map(|(link, _)| drivers[*link]).collect(),
            ends: Vec::new(),
        };
        let mut camera = Self { capsules, film, frames: 0 };
        camera.capture(world);
        Ok(Some(camera))
    }

    /// Captures a frame, unless the film is full.
    pub(crate) fn capture(&mut self, world: &dyn EnvironmentBatch) {
        if self.frames == MAX_FRAMES {
            return;
        }
        self.frames += 1;
        let pose = world.pose(0);
        let ends = self.capsules.iter().map(|(link, capsule)| {
            let link = &pose.links[*link];
            capsule.ends.map(|end| link.in_world(end))
        });
        self.film.ends.extend(ends.flatten().flatten());
    }

    /// Returns the film.
    pub(crate) fn film(self) -> Film {
        self.film
    }
}

#[cfg(test)]
mod tests {
    use sim::{ObservationConfig, ObservationNorm, TaskConfig};

    use super::*;
    use crate::trajectory_log::tests::fixture;

    #[test]
    fn a_film_has_every_capsule_at_its_link_and_is_limited_in_length() {
        let world = fixture::world();
        let mut camera = Camera::before(&*world).unwrap().unwrap();
        (0..MAX_FRAMES).for_each(|_| camera.capture(&*world));
        let film = camera.film();
        // The torso, its head, and two legs of three links.
        assert_eq!((film.radii.len(), film.ends.len()), (8, MAX_FRAMES * 8 * 6));
        let of = |agent| film.drivers.iter().filter(|driver| **driver == agent).count();
        assert_eq!((of(None), of(Some(0)), of(Some(1))), (2, 3, 3));
        let torso = &world.pose(0).links[0];
        let middle = [0, 1, 2].map(|i| (film.ends[i] + film.ends[i + 3]) / 2.0);
        let off = middle.iter().zip(torso.position).map(|(a, b)| (a - b).abs()).sum::<f32>();
        assert!(off < 1e-5, "{middle:?} and {torso:?}");
    }

    #[test]
    fn a_game_has_no_film() {
        let observation =
            ObservationConfig { norm: ObservationNorm::None, ..fixture::task().observation };
        let task = TaskConfig { task: "cue-2x1".to_owned(), observation, ..fixture::task() };
        let world = sim::environments(&task, 1).unwrap();
        assert!(Camera::before(&*world).unwrap().is_none());
    }
}
