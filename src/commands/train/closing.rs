//! The last lines of `s2mia train`: results, checkpoint and possible next commands.

use std::path::Path;
use std::time::Duration;

use learner::Summary;
use recording::trajectory_log::{is_log_name, totals};

use crate::figures::chart;
use crate::process::shell;
use crate::run::run_path::{self, config_file};

/// Size of the curve in characters.
const WIDTH: usize = 60;
const ROWS: usize = 8;

/// Whether a run may be made longer afterwards.
#[derive(Clone, Copy, Debug)]
pub(super) enum Length {
    /// By a resume.
    MayRise,
    /// Every step depends on the length, so a longer run is a different run.
    Fixed,
}

/// A run of `s2mia train` that has ended.
pub(super) struct Closing<'a> {
    /// Run folder.
    pub(super) folder: &'a Path,
    /// How far the run is.
    pub(super) summary: &'a Summary,
    /// Whether it may be made longer.
    pub(super) length: Length,
    /// Duration of this session.
    pub(super) elapsed: Duration,
}

impl Closing<'_> {
    /// All lines; `evaluations` are pairs of environment steps and mean return.
    pub(super) fn text(&self, evaluations: &[(f64, f64)]) -> String {
        let mut parts = vec![self.reached()];
        parts.extend(improvement(evaluations));
        parts.push(format!("checkpoint: {}", self.summary.checkpoint.display()));
        parts.push(self.next());
        parts.join("\n")
    }

    fn reached(&self) -> String {
        let done = if self.summary.stopped_early { "stopped" } else { "finished" };
        format!(
            "\n{done}: {} env steps, {} iterations, {} in this session",
            chart::thousands(self.summary.env_steps),
            chart::thousands(self.summary.iteration),
            chart::duration(self.elapsed.as_secs_f64()),
        )
    }

    fn next(&self) -> String {
        let run = shell::path(self.folder);
        let twice = format!("run.iterations={}", self.summary.iteration * 2);
        let train = match (self.summary.stopped_early, self.length) {
            (true, _) => format!("--resume {run}"),
            (false, Length::MayRise) => format!("--resume {run} {twice}"),
            (false, Length::Fixed) => {
                let config = shell::path(&config_file(self.folder));
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
        format!(
            "next:\n  s2mia plot {run}\n  s2mia eval {run}\n  s2mia record {run}\n  s2mia train {train}"
        )
    }
}

/// Totals of all trajectory logs of the run.
pub(super) fn logged(logs: &Path) -> String {
    let logged = run_path::files(logs, is_log_name).unwrap_or_default();
    let finished: Vec<_> = logged.iter().filter_map(|path| totals(path).ok()).collect();
    let sum = |figure: &str| {
        let values = finished.iter().filter_map(|of| of.get(figure)?.parse::<u64>().ok());
        chart::thousands(values.sum())
    };
    format!(
        "logged {} steps in {} shares of episodes to {}; {} shares lost, {} files not finished",
        sum("steps"),
        sum("shares"),
        logs.display(),
        sum("lost_shares"),
        logged.len() - finished.len(),
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

    fn text(summary: &Summary, length: Length, evaluations: &[(f64, f64)]) -> String {
        let (folder, elapsed) = (Path::new("runs/a"), Duration::from_secs(723));
        Closing { folder, summary, length, elapsed }.text(evaluations)
    }

    #[test]
    fn a_finished_run_tells_return_checkpoint_and_next_commands() {
        let evaluations = [(0.0, -3.25), (1_000_000.0, 2345.62)];
        let text = text(&summary(), Length::MayRise, &evaluations);
        for part in [
            "finished: 1,000,000 env steps, 250 iterations, 12m03s",
            "evaluation return -3.2 -> 2345.6",
            "checkpoint: runs/a/checkpoints/iter_00000250",
            "s2mia plot runs/a",
            "s2mia eval runs/a",
            "s2mia record runs/a",
            "s2mia train --resume runs/a run.iterations=500",
        ] {
            assert!(text.contains(part), "{part} is not in:\n{text}");
        }
    }

    #[test]
    fn a_shell_reads_the_next_commands_as_they_are_meant() {
        let (folder, elapsed) = (Path::new("my runs/it's/"), Duration::ZERO);
        let summary = summary();
        let next = |length| Closing { folder, summary: &summary, length, elapsed }.text(&[]);
        let last = r"s2mia train --resume 'my runs/it'\''s/' run.iterations=500";
        assert!(next(Length::MayRise).ends_with(last), "{}", next(Length::MayRise));
        let last = r"'run.dir=my runs/it'\''s-longer' run.iterations=500";
        assert!(next(Length::Fixed).ends_with(last), "{}", next(Length::Fixed));
    }

    #[test]
    fn a_stopped_run_is_resumed_as_it_was() {
        let stopped = Summary { stopped_early: true, ..summary() };
        let text = text(&stopped, Length::MayRise, &[]);
        assert!(text.ends_with("s2mia train --resume runs/a"), "{text}");
        assert!(text.contains("stopped: "), "{text}");
    }

    #[test]
    fn a_run_whose_steps_depended_on_its_length_is_made_longer_as_a_new_one() {
        let text = text(&summary(), Length::Fixed, &[]);
        let last =
            "s2mia train --config runs/a/config.toml run.dir=runs/a-longer run.iterations=500";
        assert!(text.ends_with(last), "{text}");
    }
}
