//! `s2mia film`: an episode of a trained policy as a strip of pictures, with its speed and signs of simulator
//! artefacts.

mod times;

use std::path::Path;

use crate::cli::FilmArguments;
use crate::errors::Usage;
use crate::film::{self, Frame, PlayedEpisode};
use crate::process::output;
use crate::run::checkpointed::{self, Trained};

/// Writes the strip and prints the measures of the whole episode.
pub(super) fn run(arguments: &FilmArguments) -> anyhow::Result<()> {
    let trained = checkpointed::trained(&arguments.run)?;
    demand_simulator(&trained, &arguments.run)?;
    let path = arguments.out.clone().unwrap_or_else(|| arguments.run.join("film.png"));
    output::check_file("--out", &path)?;
    let episode = trained.episode(arguments.episode);
    let played = PlayedEpisode::play(&trained.config.task, &trained.policy, episode.key())?;
    let steps = times::steps(arguments, played.dt_secs, played.steps())?;
    let frames: Vec<Frame<'_>> = steps.iter().map(|&step| played.frame(step)).collect();
    let png = film::strip(&played.robot, &frames)?;
    output::file(&path, &png)?;
    output::line(format!("{episode}: {}", played.summary()));
    output::line(format!("{}: {}", path.display(), times_shown(&frames, arguments.every_secs)));
    Ok(())
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
