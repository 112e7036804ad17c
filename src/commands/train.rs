//! `s2mia train`: a learner in this process and actors in their own, on this machine.

use std::path::Path;
use std::time::{Duration, Instant};

use actor::Transport;
use clap::Args;
use learner::observe::event::Summary;
use learner::store::run_folder::{CONFIG, LOGS, METRICS};
use proto::Episodes;
use recording::trajectory_log::{is_log_name, totals};
use tokio::sync::watch;

use crate::config::keys::START;
use crate::config::run_config::RunConfig;
use crate::endpoints::PageArguments;
use crate::figures::{LEARNING_CURVE, chart, learning_curve};
use crate::process::{self, output, runtime, shell};
use crate::progress::Progress;
use crate::run::{
    self, PreparedRun, ResumeArguments, SettingsArguments, run_path, session, warm_up,
};

/// `s2mia train`
#[derive(Args, Debug)]
pub(crate) struct TrainArguments {
    /// Settings.
    #[command(flatten)]
    pub(crate) settings: SettingsArguments,
    /// Resume.
    #[command(flatten)]
    pub(crate) resume: ResumeArguments,
    /// Write a checkpoint and stop when standard input closes, so that the run does not outlive its parent process.
    #[arg(long)]
    pub(crate) stop_with_stdin: bool,
    /// Web page.
    #[command(flatten)]
    pub(crate) page: PageArguments,
}

/// Trains to the end of the run or until a stop signal; both leave a checkpoint and end with status 0.
pub(super) fn run(arguments: &TrainArguments) -> anyhow::Result<()> {
    arguments.page.check(None)?;
    let prepared =
        run::prepare(&arguments.settings, &arguments.resume, &Transport::PlainTextOnLoopback)?;
    let PreparedRun { config, folder, launch, .. } = &prepared;
    output::line(opening(config, &launch.environment.task, folder));
    warm_up::remark(config).iter().for_each(output::line);
    let (stop_sender, stop) = watch::channel(false);
    if arguments.stop_with_stdin {
        process::stop_with_stdin(stop_sender.clone())?;
    }
    runtime()?.block_on(train(prepared, &arguments.page, stop_sender, stop))
}

async fn train(
    prepared: PreparedRun,
    page: &PageArguments,
    stop_sender: watch::Sender<bool>,
    stop: watch::Receiver<bool>,
) -> anyhow::Result<()> {
    let PreparedRun { config, folder, launch, new: _new } = prepared;
    let page = page.open(None).await?;
    let begin = Instant::now();
    process::stop_on_signal(stop_sender.clone(), || {
        output::line("stopping after a checkpoint; Ctrl-C again ends at once without one");
    })?;
    let mut progress = Progress::new(config.env_steps());
    let observer = Box::new(move |event: &learner::observe::event::Event| progress.observe(event));
    let summary = session::train(&config, launch, page, observer, (stop_sender, stop)).await;
    if config.log.episodes != Episodes::None {
        output::line(logged(&folder.join(LOGS)));
    }
    let summary = summary?;
    let length = if config.resolved.depends_on_length() { Length::Fixed } else { Length::MayRise };
    // A damaged metrics file does not make the run a failure.
    let points = learning_curve::evaluations(&folder.join(METRICS)).unwrap_or_else(|error| {
        tracing::warn!("{error:#}; the learning curve is not shown");
        Vec::new()
    });
    let twice = twice(&config, &summary);
    let elapsed = begin.elapsed();
    let closing = Closing { folder: &folder, summary: &summary, length, twice, elapsed };
    output::line(closing.text(&points));
    Ok(())
}

/// The first line: the folder and the settings of the run.
fn opening(config: &RunConfig, task: &str, folder: &Path) -> String {
    let start = match config.resolved.text(START) {
        "" => String::new(),
        start => format!(", from the policies of {start}"),
    };
    format!(
        "{}: task {task}, algorithm {}, seed {}, {}, {} env steps{start}",
        folder.display(),
        config.resolved.text("algorithm"),
        config.run.seed,
        chart::count_of(config.actors() as u64, "actor"),
        chart::thousands(config.env_steps()),
    )
}

/// The setting that makes the run twice as long, by the key that decided its length.
fn twice(config: &RunConfig, summary: &Summary) -> String {
    match config.run.iterations {
        0 => format!("run.env_steps={}", summary.env_steps * 2),
        _ => format!("run.iterations={}", summary.iteration * 2),
    }
}

/// Size of the curve in characters.
const WIDTH: usize = 60;
const ROWS: usize = 8;

/// Whether a run may be made longer afterwards.
#[derive(Clone, Copy, Debug)]
enum Length {
    /// By a resume.
    MayRise,
    /// Every step depends on the length, so a longer run is a different run.
    Fixed,
}

/// A run of `s2mia train` that has ended.
struct Closing<'a> {
    /// Run folder.
    folder: &'a Path,
    /// How far the run is.
    summary: &'a Summary,
    /// Whether it may be made longer.
    length: Length,
    /// The setting that makes it twice as long.
    twice: String,
    /// Duration of this session.
    elapsed: Duration,
}

impl Closing<'_> {
    /// All lines; `evaluations` are pairs of environment steps and mean return.
    fn text(&self, evaluations: &[(f64, f64)]) -> String {
        let mut parts = vec![self.reached()];
        parts.extend(improvement(evaluations));
        parts.push(format!("checkpoint: {}", self.summary.checkpoint.display()));
        parts.push(self.next());
        parts.join("\n")
    }

    fn reached(&self) -> String {
        let done = if self.summary.stopped_early { "stopped" } else { "finished" };
        format!(
            "\n{done}: {} env steps, {}, {} in this session",
            chart::thousands(self.summary.env_steps),
            chart::count_of(self.summary.iteration, "iteration"),
            chart::duration(self.elapsed.as_secs_f64()),
        )
    }

    fn next(&self) -> String {
        let run = shell::path(self.folder);
        let twice = &self.twice;
        let train = match (self.summary.stopped_early, self.length) {
            (true, _) => format!("--resume {run}"),
            (false, Length::MayRise) => format!("--resume {run} {twice}"),
            (false, Length::Fixed) => {
                let config = shell::path(&self.folder.join(CONFIG));
                // Of `a/` and `.` the folder beside it, not one in it.
                let run = match self.folder.file_name() {
                    Some(_) => self.folder.to_path_buf(),
                    None => self.folder.canonicalize().unwrap_or_else(|_| self.folder.into()),
                };
                let name = format!("{}-longer", run_path::name(&run));
                let dir = format!("run.dir={}", run.with_file_name(name).display());
                let dir = shell::word(&dir);
                format!("--config {config} {dir} {twice}")
            }
        };
        let drawn = self.folder.join(format!("{LEARNING_CURVE}.svg")).exists();
        let force = if drawn { " --force" } else { "" };
        format!(
            "next:\n  s2mia page {run}\n  s2mia plot {run}{force}\n  s2mia eval {run}\n  s2mia record {run}\n  s2mia train {train}"
        )
    }
}

/// Totals of all trajectory logs of the run.
fn logged(logs: &Path) -> String {
    let logged = run_path::files(logs, is_log_name).unwrap_or_default();
    let finished: Vec<_> = logged.iter().filter_map(|path| totals(path).ok()).collect();
    let sum = |figure: &str| -> u64 {
        let values = finished.iter().filter_map(|of| of.get(figure)?.parse::<u64>().ok());
        values.sum()
    };
    format!(
        "logged {} in {} of episodes to {}; {} lost, {} not finished and not counted",
        chart::count_of(sum("steps"), "step"),
        chart::count_of(sum("shares"), "share"),
        logs.display(),
        chart::count_of(sum("lost_shares"), "share"),
        chart::count_of((logged.len() - finished.len()) as u64, "file"),
    )
}

/// First and last evaluation, and the curve between them.
fn improvement(evaluations: &[(f64, f64)]) -> Option<String> {
    let (first, last) = (evaluations.first()?, evaluations.last()?);
    if evaluations.len() == 1 {
        let steps = chart::thousands(last.0 as u64);
        return Some(format!("evaluation return {:.1} at {steps} env steps", last.1));
    }
    let change = format!("evaluation return {:.1} -> {:.1}", first.1, last.1);
    Some(format!("{change}\n\n{}\n", chart::area(evaluations, WIDTH, ROWS, "env steps")))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn summary() -> Summary {
        Summary {
            iteration: 250,
            env_steps: 1_000_000,
            checkpoint: "runs/a/checkpoints/iter_00000250".into(),
            stopped_early: false,
            weights_sha256: String::new(),
            state_sha256: String::new(),
        }
    }

    fn text(summary: &Summary, length: Length) -> String {
        let (folder, elapsed) = (Path::new("runs/a"), Duration::from_secs(723));
        let twice = "run.iterations=500".to_owned();
        let closing = Closing { folder, summary, length, twice, elapsed };
        closing.text(&[(0.0, -3.25), (1_000_000.0, 2345.62)])
    }

    #[test]
    fn a_finished_run_tells_return_checkpoint_and_next_commands() {
        let text = text(&summary(), Length::MayRise);
        for part in [
            "finished: 1,000,000 env steps, 250 iterations, 12m03s",
            "evaluation return -3.2 -> 2345.6",
            "checkpoint: runs/a/checkpoints/iter_00000250",
            "s2mia page runs/a",
            "s2mia plot runs/a",
            "s2mia eval runs/a",
            "s2mia record runs/a",
            "s2mia train --resume runs/a run.iterations=500",
        ] {
            assert!(text.contains(part), "{part} is not in:\n{text}");
        }
    }

    #[test]
    fn a_run_is_made_longer_by_the_setting_of_its_length() {
        let next = |settings: &[&str]| twice(&RunConfig::with(settings).unwrap(), &summary());
        assert_eq!(next(&["run.iterations=250"]), "run.iterations=500");
        assert_eq!(next(&["run.env_steps=999_900"]), "run.env_steps=2000000");
    }

    #[test]
    fn a_shell_reads_the_next_commands_as_they_are_meant() {
        let (folder, elapsed) = (Path::new("my runs/it's/"), Duration::ZERO);
        let summary = summary();
        let next = |length| {
            let twice = "run.iterations=500".to_owned();
            Closing { folder, summary: &summary, length, twice, elapsed }.text(&[])
        };
        let last = r"s2mia train --resume 'my runs/it'\''s/' run.iterations=500";
        assert!(next(Length::MayRise).ends_with(last), "{}", next(Length::MayRise));
        let last = r"'run.dir=my runs/it'\''s-longer' run.iterations=500";
        assert!(next(Length::Fixed).ends_with(last), "{}", next(Length::Fixed));
    }

    #[test]
    fn a_stopped_run_is_resumed_as_it_was_and_one_of_a_fixed_length_made_longer_as_a_new_one() {
        let stopped = text(&Summary { stopped_early: true, ..summary() }, Length::MayRise);
        assert!(stopped.ends_with("s2mia train --resume runs/a"), "{stopped}");
        assert!(stopped.contains("stopped: "), "{stopped}");
        let fixed = text(&summary(), Length::Fixed);
        let last =
            "s2mia train --config runs/a/config.toml run.dir=runs/a-longer run.iterations=500";
        assert!(fixed.ends_with(last), "{fixed}");
    }
}
