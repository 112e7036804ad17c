//! `s2mia film`: a trained policy's episode as a strip of pictures, and what tells running from cheating.

mod measures;
mod times;

use std::path::Path;

use anyhow::Context as _;
use proto::ActionChoice;
use sim::Outcome;

use crate::cli::FilmArguments;
use crate::commands::Usage;
use crate::commands::checkpointed::{self, Trained};
use crate::commands::film::measures::{Measures, Moment};
use crate::film::{self, Cast, Frame};
use crate::output;

/// Writes the strip and says what the whole episode came to.
pub(super) fn run(arguments: &FilmArguments) -> anyhow::Result<()> {
    let trained = checkpointed::trained(&arguments.run)?;
    demand_simulator(&trained, &arguments.run)?;
    let played = play(&trained, arguments.episode)?;
    let steps = times::steps(arguments, played.dt_secs, played.moments.len() - 1)?;
    let frames: Vec<Frame<'_>> = steps.iter().map(|&step| played.frame(step)).collect();
    let png = film::strip(&played.cast, &frames)?;
    let path = arguments.out.clone().unwrap_or_else(|| arguments.run.join("film.png"));
    output::file(&path, &png)?;
    let (iteration, episode) = (trained.iteration, arguments.episode);
    output::line(format!("iteration {iteration}, episode {episode}: {}", played.told()));
    output::line(format!("{}: {}", path.display(), told(&frames, arguments.every_secs)));
    Ok(())
}

/// Which moments the strip shows.
fn told(frames: &[Frame<'_>], every_secs: f64) -> String {
    let (first, last) = (frames[0].time_secs, frames[frames.len() - 1].time_secs);
    match frames.len() {
        1 => format!("one frame, at {first:.2} s"),
        count => {
            format!("{count} frames from {first:.2} s to {last:.2} s, one every {every_secs} s")
        }
    }
}

/// A whole episode.
struct Played {
    cast: Cast,
    dt_secs: f64,
    /// The start, then after every step.
    moments: Vec<Moment>,
    end: Outcome,
}

impl Played {
    fn frame(&self, step: usize) -> Frame<'_> {
        Frame { time_secs: step as f64 * self.dt_secs, pose: &self.moments[step].pose }
    }

    fn told(&self) -> String {
        let end = match self.end {
            Outcome { fault: true, .. } => "; the physics broke down and ended it early",
            Outcome { terminated: true, .. } => "; the task's rules ended it early",
            _ => "",
        };
        format!("{}{end}", Measures::of(&self.moments, self.dt_secs))
    }
}

/// Only the simulator's robots have links that can be drawn.
fn demand_simulator(trained: &Trained, run: &Path) -> Result<(), Usage> {
    match trained.config.environment.url.as_str() {
        "" => Ok(()),
        url => Err(Usage::new(format!(
            "the environment of {} is at {url}, and only the simulator's robots can be drawn; \
             `s2mia record` shows its state",
            run.display()
        ))),
    }
}

/// The episode that `s2mia eval` plays under this number.
fn play(trained: &Trained, episode: u32) -> anyhow::Result<Played> {
    let task = &trained.config.task;
    let mut world = sim::environments(task, 1).context("cannot build the task")?;
    let shapes = sim::shapes(&task.task).context("cannot build the robot")?;
    if shapes.is_empty() {
        let why = format!("{} is a game: there is nothing to draw", task.task);
        return Err(Usage::new(why).into());
    }
    let cast = Cast::new(world.description(), shapes, &world.pose(0));
    let dt_secs = world.description().dt_secs;
    let key = trained.start(episode);
    // The same draw as the episode's own, to see where it starts.
    world.reset(0, 0, world.description().episode_steps, key.0)?;
    let mut moments = vec![Moment::of(&*world)];
    let mut end = Outcome::default();
    actor::play_episode(&mut *world, &trained.policy, (key, ActionChoice::Mean), |step| {
        let before = moments.last().expect("the start is there");
        let now = Moment::after(step, before);
        moments.push(now);
        end = step.outcome;
    })
    .context("the episode broke off")?;
    Ok(Played { cast, dt_secs, moments, end })
}
