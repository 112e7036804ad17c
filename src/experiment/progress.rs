//! What an experiment shows while it runs: a bar on a terminal, plain lines elsewhere, and a line for each run
//! that ends.

use std::io::IsTerminal as _;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use super::plan::PlannedRun;
use super::run_state::{Ending, RunFolderState, run_state};
use crate::figures::chart;
use crate::process::output;

/// Time between two plain lines.
const LINE_PERIOD: Duration = Duration::from_secs(30);

/// Shows how far an experiment is.
pub(crate) struct ExperimentProgress {
    begin: Instant,
    /// How far each run was when last looked at; a finished one needs no other look.
    known: Vec<RunFolderState>,
    /// Environment steps that were done before.
    steps_before: u64,
    screen: Screen,
}

enum Screen {
    Bar(ProgressBar),
    Lines { last: Instant },
}

/// How far an experiment is.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Figures {
    finished: usize,
    runs: usize,
    going: usize,
    env_steps: u64,
    total: u64,
    /// Environment steps done since this process began, and how long that took.
    done: u64,
    secs: f64,
}

impl ExperimentProgress {
    /// Before the first run starts; a bar if stdout is a terminal.
    pub(crate) fn new(runs: &[PlannedRun]) -> Self {
        let begin = Instant::now();
        let known: Vec<RunFolderState> = runs.iter().map(run_state).collect();
        let (done, total) = steps(runs, &known);
        let screen = if std::io::stdout().is_terminal() {
            Screen::Bar(bar(total))
        } else {
            Screen::Lines { last: begin }
        };
        Self { begin, known, steps_before: done, screen }
    }

    /// Shows how far `runs` are, of which `going` are at work.
    pub(crate) fn show(&mut self, runs: &[PlannedRun], going: usize) {
        let now = Instant::now();
        match &mut self.screen {
            Screen::Lines { last } if now.duration_since(*last) < LINE_PERIOD => return,
            Screen::Lines { last } => *last = now,
            Screen::Bar(_) => {}
        }
        for (known, run) in self.known.iter_mut().zip(runs) {
            if *known != RunFolderState::Finished {
                *known = run_state(run);
            }
        }
        let (env_steps, total) = steps(runs, &self.known);
        let figures = Figures {
            finished: self.known.iter().filter(|known| **known == RunFolderState::Finished).count(),
            runs: runs.len(),
            going,
            env_steps,
            total,
            done: env_steps.saturating_sub(self.steps_before),
            secs: now.duration_since(self.begin).as_secs_f64(),
        };
        match &self.screen {
            Screen::Bar(bar) => {
                bar.set_position(env_steps);
                bar.set_message(figures.words());
            }
            Screen::Lines { .. } => output::line(figures.words()),
        }
    }

    /// Tells how a run ended.
    pub(crate) fn ended(&self, run: &PlannedRun, ending: &Ending) {
        let line = match ending {
            Ending::Finished => format!("{} is finished", run.name()),
            Ending::Stopped => format!("{} stopped; it can be resumed", run.name()),
            Ending::Failed(why) => format!("{} failed: {why}", run.name()),
            Ending::Misplaced(why) => format!("{} cannot begin: {why}", run.name()),
        };
        match &self.screen {
            Screen::Bar(bar) => bar.println(line),
            Screen::Lines { .. } => output::line(line),
        }
    }
}

impl Drop for ExperimentProgress {
    fn drop(&mut self) {
        if let Screen::Bar(bar) = &self.screen {
            bar.finish_and_clear();
        }
    }
}

impl Figures {
    fn words(&self) -> String {
        let speed = self.done as f64 / self.secs.max(f64::MIN_POSITIVE);
        let (env_steps, total) = (chart::thousands(self.env_steps), chart::thousands(self.total));
        let left = match self.done {
            0 => String::new(),
            _ => {
                let left = (self.total - self.env_steps) as f64 / speed;
                format!(
                    "  {} steps/s  {} left",
                    chart::thousands(speed as u64),
                    chart::duration(left)
                )
            }
        };
        let Self { finished, runs, going, .. } = self;
        format!("{finished}/{runs} runs finished, {going} at work  {env_steps}/{total} steps{left}")
    }
}

/// Environment steps that are done, and all of them.
fn steps(runs: &[PlannedRun], known: &[RunFolderState]) -> (u64, u64) {
    let total = |run: &PlannedRun| run.config.env_steps();
    let done = runs.iter().zip(known).map(|(run, known)| known.env_steps(total(run))).sum();
    (done, runs.iter().map(total).sum())
}

fn bar(total: u64) -> ProgressBar {
    let bars = output::bars();
    bars.set_draw_target(ProgressDrawTarget::stdout());
    let style = ProgressStyle::with_template("{bar:40.cyan/black} {percent} %\n{wide_msg}");
    let style = style.expect("the template is well formed").progress_chars("━╸─");
    bars.add(ProgressBar::new(total).with_style(style))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_time_left_counts_only_what_was_done_since_the_start() {
        let figures = Figures {
            finished: 1,
            runs: 4,
            going: 2,
            env_steps: 6_000,
            total: 16_000,
            done: 2_000,
            secs: 20.0,
        };
        // 10,000 steps are left, 100 a second.
        let expected = "1/4 runs finished, 2 at work  6,000/16,000 steps  100 steps/s  1m40s left";
        assert_eq!(figures.words(), expected);
        let words = Figures { done: 0, ..figures }.words();
        assert_eq!(words, "1/4 runs finished, 2 at work  6,000/16,000 steps");
    }
}
