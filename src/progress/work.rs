//! Progress of a command that works through a known amount, such as `s2mia eval`, on stderr: on a terminal one line that
//! is rewritten, elsewhere a line every ten seconds. Stdout keeps the command's results alone.

use std::fmt::Display;
use std::io::IsTerminal as _;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};

use super::LINE_PERIOD;
use crate::figures::chart;
use crate::process::output;

/// Time between two updates of the line on a terminal.
const DRAW_PERIOD: Duration = Duration::from_millis(100);

/// Shortest time from which the time left is estimated.
const SHORTEST_MEASURED: Duration = Duration::from_secs(1);

/// Shows how far a command is. Commands that end within a period print nothing.
pub(crate) struct WorkProgress {
    pace: Pace,
    /// On a terminal.
    bar: Option<ProgressBar>,
}

impl WorkProgress {
    /// Before any work; a bar if stderr is a terminal.
    pub(crate) fn new() -> Self {
        let bar = std::io::stderr().is_terminal().then(bar);
        let period = if bar.is_some() { DRAW_PERIOD } else { LINE_PERIOD };
        Self { pace: Pace::new(Instant::now(), period), bar }
    }

    /// `done` of `total` is done; `place` states which part of the work, such as `episode 3/10`.
    pub(crate) fn reach(&mut self, done: u64, total: u64, place: impl FnOnce() -> String) {
        let Some(text) = self.pace.due(Instant::now(), (done, total), place) else { return };
        match &self.bar {
            None => output::error(text),
            Some(bar) => {
                bar.set_length(total);
                bar.set_position(done);
                bar.set_message(text);
            }
        }
    }

    /// Prints a result on stdout, above the bar.
    pub(crate) fn print(&self, text: impl Display) {
        match &self.bar {
            None => output::line(text),
            Some(_) => output::bars().suspend(|| output::line(text)),
        }
    }
}

impl Drop for WorkProgress {
    fn drop(&mut self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }
}

/// When the next line is due, and its text. Pure: the caller passes the time.
struct Pace {
    period: Duration,
    began: Instant,
    /// When the last line was shown, or when the work began.
    shown: Instant,
}

impl Pace {
    fn new(now: Instant, period: Duration) -> Self {
        Self { period, began: now, shown: now }
    }

    /// The next line, if the last one is old enough.
    fn due(
        &mut self,
        now: Instant,
        (done, total): (u64, u64),
        place: impl FnOnce() -> String,
    ) -> Option<String> {
        if now.duration_since(self.shown) < self.period {
            return None;
        }
        self.shown = now;
        let share = done as f64 / total.max(1) as f64;
        let (percent, place) = (100.0 * share, place());
        let elapsed = now.duration_since(self.began);
        let known = share > 0.0 && share < 1.0 && elapsed >= SHORTEST_MEASURED;
        let left = elapsed.as_secs_f64() * (1.0 - share) / share;
        // The place comes last, because a narrow terminal cuts the line off.
        Some(if known {
            format!("{percent:.1} %, {} left: {place}", chart::duration(left))
        } else {
            format!("{percent:.1} %: {place}")
        })
    }
}

fn bar() -> ProgressBar {
    let style = ProgressStyle::with_template("{bar:24.cyan/black} {wide_msg}");
    let style = style.expect("the template is well formed").progress_chars("━╸─");
    output::bars().add(ProgressBar::new(0).with_style(style))
}

#[cfg(test)]
mod tests {
    use super::*;

    const PLACE: fn() -> String = || "episode 3/10, step 500".to_owned();

    #[test]
    fn without_a_terminal_a_line_is_due_every_ten_seconds_and_none_in_a_shorter_command() {
        let begin = Instant::now();
        let mut pace = Pace::new(begin, LINE_PERIOD);
        let found = (0..=25).filter(|secs| {
            let now = begin + Duration::from_secs(*secs);
            pace.due(now, (*secs, 100), PLACE).is_some()
        });
        assert_eq!(found.collect::<Vec<_>>(), [10, 20]);
    }

    #[test]
    fn a_line_states_the_place_the_share_and_the_time_left() {
        let begin = Instant::now();
        let mut pace = Pace::new(begin, LINE_PERIOD);
        let text = pace.due(begin + Duration::from_secs(10), (2500, 10_000), PLACE);
        assert_eq!(text.as_deref(), Some("25.0 %, 30s left: episode 3/10, step 500"));
        let text = pace.due(begin + Duration::from_secs(20), (0, 10_000), PLACE);
        assert_eq!(text.as_deref(), Some("0.0 %: episode 3/10, step 500"));
        pace.began = begin + Duration::from_secs(25);
        let text = pace.due(begin + Duration::from_secs(30), (5000, 10_000), PLACE);
        assert_eq!(text.as_deref(), Some("50.0 %, 5s left: episode 3/10, step 500"));
    }
}
