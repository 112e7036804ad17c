//! What an evaluated episode looks like, as capsules in the world, for whoever watches the run.

use proto::{Film, MAX_FRAMES};
use sim::{Environments, LinkShape, SimError};

/// Episode of each evaluation that is filmed.
pub(crate) const FILMED: u32 = 0;

/// Films the beginning of an episode, a frame at each step.
pub(crate) struct Camera {
    /// Each with the index of its link in a pose.
    shapes: Vec<(usize, LinkShape)>,
    film: Film,
    frames: usize,
}

impl Camera {
    /// In front of `world`, whose task is `task`; none where there is no robot to be seen.
    pub(crate) fn before(world: &Environments, task: &str) -> Result<Option<Self>, SimError> {
        let pose = world.pose(0);
        let link = |shape: &LinkShape| pose.links.iter().position(|link| link.name == shape.link);
        let shapes = sim::shapes(task)?.into_iter();
        let shapes: Vec<_> = shapes.filter_map(|shape| Some((link(&shape)?, shape))).collect();
        if shapes.is_empty() {
            return Ok(None);
        }
        let drivers = sim::drivers(world.description(), &pose);
        let film = Film {
            frame_secs: world.description().dt_secs,
            radii: shapes.iter().map(|(_, shape)| shape.shape.radius()).collect(),
            drivers: shapes.iter().map(|(link, _)| drivers[*link]).collect(),
            ends: Vec::new(),
        };
        let mut camera = Self { shapes, film, frames: 0 };
        camera.see(world);
        Ok(Some(camera))
    }

    /// Takes one more frame, if the film is long enough for it.
    pub(crate) fn see(&mut self, world: &Environments) {
        if self.frames == MAX_FRAMES {
            return;
        }
        self.frames += 1;
        let pose = world.pose(0);
        let ends = self.shapes.iter().map(|(link, shape)| shape.ends(&pose.links[*link]));
        self.film.ends.extend(ends.flatten().flatten());
    }

    /// What it took.
    pub(crate) fn film(self) -> Film {
        self.film
    }
}
