//! The progress that `s2mia train` and `s2mia learner` print: a bar on a terminal, plain lines elsewhere.
//! `progress/wording.rs` writes the text of both. `progress/work.rs` is the progress of shorter commands.

mod wording;
mod work;

use std::io::IsTerminal as _;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use learner::Event;

use crate::process::{logging, output};
use wording::RecentIterations;
pub(crate) use work::WorkProgress;

/// Time between two plain lines.
const LINE_PERIOD: Duration = Duration::from_secs(10);

/// Shows the events of one run.
pub(crate) struct Progress {
    recent: RecentIterations,
    screen: Screen,
}

enum Screen {
    Bar(ProgressBar),
    Lines { last: Option<Instant> },
}

impl Progress {
    /// For a run of `total` env steps; a bar if stdout is a terminal.
    pub(crate) fn new(total: u64) -> Self {
        let screen = match std::io::stdout().is_terminal() {
            true => Screen::Bar(bar(total)),
            false => Screen::Lines { last: None },
        };
        Self { recent: RecentIterations::new(total), screen }
    }

    /// Shows one event.
    pub(crate) fn observe(&mut self, event: &Event) {
        self.recent.observe(event, Instant::now());
        match event {
            Event::Iteration(_) => self.iteration(),
            Event::Collecting { env_steps, .. } => self.collecting(*env_steps),
            Event::Waiting { .. } | Event::Evaluation(_) => {
                self.line(&wording::notice(event).unwrap_or_default());
            }
            Event::Stage(_) | Event::Checkpoint(_) | Event::CheckpointFailed { .. } => {}
        }
        if self.recent.is_complete() {
            self.clear();
        }
    }

    fn iteration(&mut self) {
        let now = Instant::now();
        match &mut self.screen {
            Screen::Bar(bar) => {
                bar.set_position(self.recent.env_steps());
                bar.set_message(self.recent.figures());
            }
            Screen::Lines { last } => {
                let due = last.is_none_or(|last| now.duration_since(last) >= LINE_PERIOD);
                if due || self.recent.is_complete() {
                    *last = Some(now);
                    output::line(self.recent.line());
                }
            }
        }
    }

    fn collecting(&self, env_steps: u64) {
        if let Screen::Bar(bar) = &self.screen {
            bar.set_position(env_steps);
        }
    }

    fn line(&self, text: &str) {
        match &self.screen {
            Screen::Bar(bar) if !bar.is_finished() => bar.println(text),
            _ => output::line(text),
        }
    }

    fn clear(&self) {
        if let Screen::Bar(bar) = &self.screen {
            bar.finish_and_clear();
        }
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        self.clear();
    }
}

fn bar(total: u64) -> ProgressBar {
    let bars = logging::bars();
    bars.set_draw_target(ProgressDrawTarget::stdout());
    let style = ProgressStyle::with_template(
        "{bar:40.cyan/black} {human_pos}/{human_len} steps ({percent} %)\n{wide_msg}",
    );
    let style = style.expect("the template is well formed").progress_chars("━╸─");
    bars.add(ProgressBar::new(total).with_style(style))
}
