//! `s2mia film`: an episode of a trained policy as an animation or as a strip of pictures, with its speed and signs of
//! simulator artefacts.

use std::path::{Path, PathBuf};

use clap::Args;

use crate::errors::Usage;
use crate::film::{self, Animation, FFMPEG, PlayedEpisode, TimedPose, ViewDirection};
use crate::process::output;
use crate::process::target::ForceArguments;
use crate::run::chosen::ChosenArguments;
use crate::run::stored::Trained;
use crate::run::{run_path, stored};

/// `s2mia film`
#[derive(Args, Debug)]
pub(crate) struct FilmArguments {
    /// Policies.
    #[command(flatten)]
    pub(crate) of: ChosenArguments,
    /// Index of the episode, counted as in `s2mia eval`.
    #[arg(long, value_name = "INDEX", default_value_t = 0)]
    pub(crate) episode: u32,
    /// Draw the pictures side by side in one PNG instead of an animation.
    #[arg(long)]
    pub(crate) still: bool,
    /// Direction of view [default: three-quarter, or side with --still].
    #[arg(long, value_enum)]
    pub(crate) view: Option<ViewDirection>,
    /// Number of pictures [default: 60, or 8 with --still, or those of a shorter episode].
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=1200))]
    pub(crate) frames: Option<u32>,
    /// Time of the first picture [default: 5, or the middle of a shorter episode].
    #[arg(long, value_name = "SECONDS")]
    pub(crate) from_secs: Option<f64>,
    /// Time between two pictures.
    #[arg(long, value_name = "SECONDS", default_value_t = 0.05)]
    pub(crate) every_secs: f64,
    /// File to write: .gif, with ffmpeg on the path also .mp4 or .webm, with --still .png [default: RUN/film.gif or
    /// RUN/film.png; TASK.gif or TASK.png].
    #[arg(long, value_name = "FILE")]
    pub(crate) out: Option<PathBuf>,
    /// Force.
    #[command(flatten)]
    pub(crate) force: ForceArguments,
}

/// Writes the film and prints the measures of the whole episode.
pub(super) fn run(arguments: &FilmArguments) -> anyhow::Result<()> {
    let format = Format::of(arguments)?;
    let run = arguments.of.path()?;
    let trained = stored::trained(&run)?;
    demand_simulator(&trained, &run)?;
    let out = ("--out", arguments.out.as_deref());
    let own = PathBuf::from("film").with_extension(format.extension());
    let target = run_path::target(&run, out, &own, arguments.force.existing())?;
    let episode = trained.episode(arguments.episode);
    let mut hosted = trained.environment()?;
    let world = hosted.environment.as_mut();
    let played = PlayedEpisode::play(world, &trained.policy, episode.key())?;
    let steps = steps(arguments, played.dt_secs, played.steps())?;
    let frames: Vec<TimedPose<'_>> = steps.iter().map(|&step| played.frame(step)).collect();
    let animation = |view: Option<ViewDirection>| {
        let view = view.unwrap_or(ViewDirection::ThreeQuarter);
        Animation::of(&played.robot, &frames, view, arguments.every_secs)
    };
    match format {
        Format::Still => {
            let view = arguments.view.unwrap_or(ViewDirection::Side);
            target.write(&film::strip(&played.robot, &frames, view)?)?;
        }
        Format::Gif => target.write(&animation(arguments.view)?.gif()?)?,
        Format::Video(_) => target.fill(|draft| animation(arguments.view)?.video(draft))?,
    }
    output::line(format!("{episode}: {}", played.summary()));
    let shown = target.path().display();
    output::line(format!(
        "{shown}: {}",
        times_shown(&frames, arguments.every_secs, played.dt_secs)
    ));
    Ok(())
}

/// Format of a film.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Format {
    /// A strip of pictures as PNG.
    Still,
    /// An animated GIF.
    Gif,
    /// A video with this extension.
    Video(&'static str),
}

/// Extensions of the videos that ffmpeg writes.
const VIDEOS: [&str; 2] = ["mp4", "webm"];
/// Shortest time between two pictures of a GIF that viewers respect, seconds.
const SHORTEST_IN_GIF: f64 = 0.02;
/// Most pictures in a strip.
const MOST_IN_STRIP: u32 = 64;

impl Format {
    /// The format that the arguments ask for.
    fn of(arguments: &FilmArguments) -> Result<Self, Usage> {
        if arguments.still {
            return match arguments.frames {
                Some(frames) if frames > MOST_IN_STRIP => Err(Usage::new(format!(
                    "--frames {frames}: a strip has at most {MOST_IN_STRIP} pictures; leave out --still for an animation"
                ))),
                _ => Ok(Self::Still),
            };
        }
        let extension = arguments.out.as_deref().and_then(Path::extension);
        let is = |one: &str| extension.is_none_or(|found| found.eq_ignore_ascii_case(one));
        if is("gif") && arguments.every_secs < SHORTEST_IN_GIF {
            let every = arguments.every_secs;
            return Err(Usage::new(format!(
                "--every-secs {every}: viewers show a GIF's pictures for at least {SHORTEST_IN_GIF} s"
            )));
        }
        if is("gif") {
            return Ok(Self::Gif);
        }
        let shown = arguments.out.as_deref().unwrap_or(Path::new("")).display();
        match VIDEOS.into_iter().find(|video| is(video)) {
            Some(video) if is_on_path(FFMPEG) => Ok(Self::Video(video)),
            Some(_) => Err(Usage::new(format!(
                "--out {shown}: only {FFMPEG} writes this format, and it is not on the path; install it, or name a .gif"
            ))),
            None => Err(Usage::new(format!(
                "--out {shown}: no film has this format; name a .gif, .mp4 or .webm, or with --still a .png"
            ))),
        }
    }

    fn extension(self) -> &'static str {
        match self {
            Self::Still => "png",
            Self::Gif => "gif",
            Self::Video(extension) => extension,
        }
    }
}

/// Whether a folder of the variable `PATH` has a file of this name.
fn is_on_path(program: &str) -> bool {
    let folders = std::env::var_os("PATH").unwrap_or_default();
    std::env::split_paths(&folders).any(|folder| folder.join(program).is_file())
}

/// The times that the film shows, of a robot with steps of `dt_secs`.
fn times_shown(frames: &[TimedPose<'_>], every_secs: f64, dt_secs: f64) -> String {
    let steps = every_secs / dt_secs;
    let nearest = if (steps - steps.round()).abs() > 1e-6 {
        format!(", each of the nearest step of {dt_secs} s")
    } else {
        String::new()
    };
    let first = frames[0].time_secs;
    let last = frames[frames.len() - 1].time_secs;
    match frames.len() {
        1 => format!("one frame, at {first:.2} s"),
        count => {
            format!(
                "{count} frames from {first:.2} s to {last:.2} s, one every {every_secs} s{nearest}"
            )
        }
    }
}

/// Only the simulator's robots have links that can be drawn.
pub(super) fn demand_simulator(trained: &Trained, run: &Path) -> Result<(), Usage> {
    match trained.config.environment.url.as_str() {
        "" => Ok(()),
        url => Err(Usage::new(format!(
            "the environment of {} is at {url}; its description has no shapes, so only the simulator's \
             robots can be drawn; `s2mia record` writes its observations and states",
            run.display()
        ))),
    }
}

/// Default time of the first frame, seconds; the start of the episode is over by then.
const UNDER_WAY: f64 = 5.0;
/// Tolerance of the conversion from seconds to steps, in steps.
const ROUNDING: f64 = 1e-6;

/// The steps nearest to the frames' times, in rising order, in an episode of `length` steps of `dt_secs` seconds.
fn steps(arguments: &FilmArguments, dt_secs: f64, length: usize) -> Result<Vec<usize>, Usage> {
    let every = arguments.every_secs / dt_secs;
    if !every.is_finite() || every < 1.0 - ROUNDING {
        let asked = arguments.every_secs;
        return Err(Usage::new(format!(
            "--every-secs {asked} does not fit: the shortest interval is one step, {dt_secs} s"
        )));
    }
    let asked = arguments.from_secs.map(|from| from / dt_secs);
    let frames = frames(arguments, (length as f64 - asked.unwrap_or(0.0)).max(0.0) / every);
    let span = f64::from(frames - 1) * every;
    let from = asked.unwrap_or_else(|| usual_start(dt_secs, length, span));
    let last = from + span;
    if !(from >= 0.0 && last.round() <= length as f64) {
        let end = length as f64 * dt_secs;
        let first = from * dt_secs;
        let last = last * dt_secs;
        return Err(Usage::new(format!(
            "the frames reach from {first:.2} s to {last:.2} s, the episode from 0 s to {end:.2} s; \
             change --from-secs, --every-secs or --frames"
        )));
    }
    Ok((0..frames).map(|frame| (from + f64::from(frame) * every).round() as usize).collect())
}

/// The number of frames in an episode of `intervals` intervals between two frames.
fn frames(arguments: &FilmArguments, intervals: f64) -> u32 {
    let usual = if arguments.still { 8 } else { 60 };
    arguments.frames.unwrap_or_else(|| usual.min((intervals + ROUNDING) as u32 + 1))
}

/// Default first frame, in steps. A short episode is shown from its middle, or earlier if the frames then fit.
fn usual_start(dt_secs: f64, length: usize, span: f64) -> f64 {
    let usual = UNDER_WAY / dt_secs;
    let length = length as f64;
    if usual + span <= length { usual } else { (length / 2.0).min(length - span).max(0.0) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn arguments(frames: u32, from_secs: Option<f64>, every_secs: f64) -> FilmArguments {
        FilmArguments {
            of: ChosenArguments::default(),
            episode: 0,
            still: true,
            view: None,
            frames: Some(frames),
            from_secs,
            every_secs,
            out: None,
            force: ForceArguments::default(),
        }
    }

    fn refusal(arguments: &FilmArguments, length: usize) -> String {
        steps(arguments, 0.05, length).unwrap_err().to_string()
    }

    #[test]
    fn frames_are_evenly_spaced_from_five_seconds_on_or_from_where_they_fit() {
        for (frames, from_secs, every_secs, length, expected) in [
            (3, None, 0.05, 1000, &[100, 101, 102][..]),
            (3, None, 0.5, 1000, &[100, 110, 120]),
            // A short episode is shown from its middle.
            (3, None, 0.05, 40, &[20, 21, 22]),
            (4, None, 0.05, 4, &[1, 2, 3, 4]),
        ] {
            let arguments = arguments(frames, from_secs, every_secs);
            let found = steps(&arguments, 0.05, length).unwrap();
            assert_eq!(found, expected, "{frames} frames, every {every_secs} s, of {length}");
        }
        // By default as many as fit after the first one.
        let late = FilmArguments { frames: None, ..arguments(0, Some(49.9), 0.05) };
        assert_eq!(steps(&late, 0.05, 1000).unwrap(), [998, 999, 1000]);
        // 0.05 s is 6.25 steps of 8 ms.
        assert_eq!(steps(&arguments(3, Some(0.0), 0.05), 0.008, 1000).unwrap(), [0, 6, 13]);
    }

    #[test]
    fn times_beyond_the_episode_are_refused_with_both_ranges() {
        let line = refusal(&arguments(8, Some(49.9), 0.05), 1000);
        assert!(line.contains("49.90 s to 50.25 s") && line.contains("50.00 s"), "{line}");
        refusal(&arguments(8, None, 0.05), 3);
        // Without --frames a short episode has fewer.
        let all = FilmArguments { frames: None, ..arguments(1, None, 0.05) };
        assert_eq!(steps(&all, 0.05, 3).unwrap(), [0, 1, 2, 3]);
        refusal(&arguments(1, Some(f64::NAN), 0.05), 1000);
        refusal(&arguments(1, Some(-1.0), 0.05), 1000);
    }

    #[test]
    fn an_interval_shorter_than_a_step_is_refused() {
        for every_secs in [0.0, 0.04, -1.0, f64::INFINITY, f64::NAN] {
            let line = refusal(&arguments(2, None, every_secs), 1000);
            assert!(line.contains("one step, 0.05 s"), "{line}");
        }
    }
}
