//! `s2mia film`: an episode of a trained policy as a strip of pictures, with its speed and signs of simulator
//! artefacts.

mod times;

use std::path::Path;

use crate::cli::FilmArguments;
use crate::errors::Usage;
use crate::film::{self, Frame, PlayedEpisode};
use crate::process::output;
use crate::process::target::Target;
use crate::run::checkpointed::{self, Trained};
use crate::run::run_path;

/// Writes the strip and prints the measures of the whole episode.
pub(super) fn run(arguments: &FilmArguments) -> anyhow::Result<()> {
    let trained = checkpointed::trained(&arguments.run)?;
    demand_simulator(&trained, &arguments.run)?;
    let target = target(arguments)?;
    let episode = trained.episode(arguments.episode);
    let played = PlayedEpisode::play(&trained.config.task, &trained.policy, episode.key())?;
    let steps = times::steps(arguments, played.dt_secs, played.steps())?;
    let frames: Vec<Frame<'_>> = steps.iter().map(|&step| played.frame(step)).collect();
    let png = film::strip(&played.robot, &frames)?;
    target.write(&png)?;
    output::line(format!("{episode}: {}", played.summary()));
    let shown = target.path().display();
    output::line(format!("{shown}: {}", times_shown(&frames, arguments.every_secs)));
    Ok(())
}

/// The file to write: the named one, or that of the run folder.
fn target(arguments: &FilmArguments) -> anyhow::Result<Target> {
    match &arguments.out {
        Some(path) => Ok(Target::named("--out", path, "png", arguments.force.existing())?),
        None => Target::fixed(&run_path::folder_of(&arguments.run, "--out")?.join("film.png")),
    }
}

/// The times that the strip shows.
fn times_shown(frames: &[Frame<'_>], every_secs: f64) -> String {
    let (first, last) = (frames[0].time_secs, frames[frames.len() - 1].time_secs);
    match frames.len() {
        1 => format!("one frame, at {first:.2} s"),
        count => {
            format!("{count} frames from {first:.2} s to {last:.2} s, one every {every_secs} s")
        }
    }
}

/// Only the simulator's robots have links that can be drawn.
fn demand_simulator(trained: &Trained, run: &Path) -> Result<(), Usage> {
    match trained.config.environment.url.as_str() {
        "" => Ok(()),
        url => Err(Usage::new(format!(
            "the environment of {} is at {url}; its description has no shapes, so only the simulator's \
             robots can be drawn; `s2mia record` writes its observations and states",
            run.display()
        ))),
    }
}
