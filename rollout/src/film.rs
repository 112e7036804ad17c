//! Film of an evaluated episode, as capsules in the world, for viewers of the run.

use proto::{Film, MAX_CAPSULES, MAX_FRAMES};
use sim::{Capsule, EnvironmentBatch, LinkShape, Robot, World};

use crate::step_event::StepEvent;

/// Index of the filmed episode of each evaluation.
pub const FILMED: u32 = 0;

/// Captures the start of an episode, one frame per step.
pub struct FilmRecorder {
    /// Capsules in the frames of their links, and the indices of these in a pose; then fixed ones, in the world.
    capsules: Vec<(Option<usize>, Capsule)>,
    /// Height of the floor in the episode, metres.
    floor: f32,
    film: Film,
    frames: usize,
}

impl FilmRecorder {
    /// Creates a recorder for `world` and captures the first frame; `None` without a simulated robot, or if the robot has
    /// too many capsules for a film. Of what is fixed around it, as much is captured as fits.
    #[must_use]
    pub fn before(world: &dyn EnvironmentBatch) -> Option<Self> {
        let task = world.description();
        let pose = world.pose(0);
        if pose.links.is_empty() {
            return None;
        }
        let link = |shape: &LinkShape| pose.links.iter().position(|link| link.name == shape.link);
        let shapes = world.robot().map(Robot::shapes).unwrap_or_default().into_iter();
        let fixed = world.world(0).map(World::fixed_capsules).unwrap_or_default().into_iter();
        let shapes = shapes.filter_map(|shape| Some((link(&shape)?, shape.capsules())));
        let mut capsules: Vec<(Option<usize>, Capsule)> = shapes
            .flat_map(|(link, all)| all.into_iter().map(move |one| (Some(link), one)))
            .collect();
        if !(1..=MAX_CAPSULES).contains(&capsules.len()) {
            return None;
        }
        capsules.extend(fixed.map(|one| (None, one)).take(MAX_CAPSULES - capsules.len()));
        let drivers = sim::drivers(world);
        let film = Film {
            frame_secs: task.dt_secs,
            radii: capsules.iter().map(|(_, capsule)| capsule.radius).collect(),
            drivers: capsules.iter().map(|(link, _)| link.and_then(|link| drivers[link])).collect(),
            ends: Vec::new(),
        };
        let floor = world.world(0).and_then(World::floor_height).unwrap_or(0.0);
        let mut recorder = Self { capsules, floor, film, frames: 0 };
        recorder.capture(world);
        Some(recorder)
    }

    /// Captures what an episode shows at `event`; `recorder` is `None` before the episode.
    pub fn follow(recorder: &mut Option<Self>, event: &StepEvent<'_>) {
        match event {
            StepEvent::Before(0, world) => *recorder = Self::before(*world),
            StepEvent::Before(..) => {}
            StepEvent::After(played) => {
                if let Some(recorder) = recorder {
                    recorder.capture(played.world);
                }
            }
        }
    }

    /// Captures a frame, unless the film is full.
    pub fn capture(&mut self, world: &dyn EnvironmentBatch) {
        if self.frames == MAX_FRAMES {
            return;
        }
        self.frames += 1;
        let pose = world.pose(0);
        let ends = self.capsules.iter().map(|(link, capsule)| {
            let link = link.map(|link| &pose.links[link]);
            capsule.ends.map(|end| {
                let [x, y, z] = link.map_or(end, |link| link.in_world(end));
                [x, y, z - self.floor]
            })
        });
        self.film.ends.extend(ends.flatten().flatten());
    }

    /// The frames captured so far.
    #[must_use]
    pub fn film(self) -> Film {
        self.film
    }
}
