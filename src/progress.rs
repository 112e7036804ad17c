//! The progress that commands print: of a run, a bar on a terminal and plain lines elsewhere; of shorter work, such as
//! `s2mia eval`, a bar on stderr if that is a terminal. Stdout keeps the results of such commands alone.

use std::collections::VecDeque;
use std::fmt::Display;
use std::io::IsTerminal as _;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use learner::observe::event::{EvaluationReport, Event, IterationReport, Spread};

use crate::figures::chart;
use crate::process::output;

/// Time between two plain lines.
const LINE_PERIOD: Duration = Duration::from_secs(10);

/// Layout of a run's bar.
const BAR: &str = "{bar:40.cyan/black} {human_pos}/{human_len} steps ({percent} %)\n{wide_msg}";

/// A bar if stdout is a terminal, plain lines elsewhere.
pub(crate) enum Screen {
    /// The bar.
    Bar(ProgressBar),
    /// Time between two plain lines, and when the last one was due.
    Lines(Duration, Option<Instant>),
}

impl Screen {
    /// For `total` steps; `layout` is that of the bar.
    pub(crate) fn new(total: u64, layout: &str, line_period: Duration) -> Self {
        if !std::io::stdout().is_terminal() {
            return Self::Lines(line_period, None);
        }
        let bars = output::bars();
        bars.set_draw_target(ProgressDrawTarget::stdout());
        Self::Bar(bars.add(styled(ProgressBar::new(total), layout)))
    }

    /// Whether to show something at `now`: on a bar always, else when the next plain line is due.
    pub(crate) fn is_due(&mut self, now: Instant) -> bool {
        let Self::Lines(period, last) = self else { return true };
        let is_due = last.is_none_or(|last| now.duration_since(last) >= *period);
        if is_due {
            *last = Some(now);
        }
        is_due
    }

    /// Prints a line, above the bar.
    pub(crate) fn line(&self, text: &str) {
        match self {
            Self::Bar(bar) if !bar.is_finished() => bar.println(text),
            _ => output::line(text),
        }
    }

    fn clear(&self) {
        if let Self::Bar(bar) = self {
            bar.finish_and_clear();
        }
    }
}

impl Drop for Screen {
    fn drop(&mut self) {
        self.clear();
    }
}

/// Shows the events of one run.
pub(crate) struct Progress {
    recent: RecentIterations,
    screen: Screen,
}

impl Progress {
    /// For a run of `total` env steps.
    pub(crate) fn new(total: u64) -> Self {
        let screen = Screen::new(total, BAR, LINE_PERIOD);
        Self { recent: RecentIterations::new(total), screen }
    }

    /// Shows one event.
    pub(crate) fn observe(&mut self, event: &Event) {
        self.recent.observe(event, Instant::now());
        match event {
            Event::Iteration(_) => self.iteration(),
            Event::Collecting { env_steps, .. } => self.collecting(*env_steps),
            Event::Evaluation(report) => self.screen.line(&evaluated(report)),
            Event::Waiting { seconds, reason } => {
                let waited = chart::duration(*seconds);
                self.screen.line(&format!("waited {waited} so far: {reason}"));
            }
            Event::Stage(_) | Event::Checkpoint(_) | Event::CheckpointFailed { .. } => {}
        }
        if self.recent.is_complete() {
            self.screen.clear();
        }
    }

    fn iteration(&mut self) {
        let is_due = self.screen.is_due(Instant::now()) || self.recent.is_complete();
        match &self.screen {
            Screen::Bar(bar) => {
                bar.set_position(self.recent.env_steps());
                bar.set_message(self.recent.figures());
            }
            Screen::Lines(..) if is_due => output::line(self.recent.line()),
            Screen::Lines(..) => {}
        }
    }

    fn collecting(&self, env_steps: u64) {
        if let Screen::Bar(bar) = &self.screen {
            bar.set_position(env_steps);
        }
    }
}

/// Iterations over which speed and phase shares are averaged.
const WINDOW: usize = 20;

/// The last iterations of a run.
struct RecentIterations {
    total: u64,
    /// When the first message of the run arrived, and the environment steps before it.
    begun: Option<(Instant, u64)>,
    /// When each iteration ended, and its report.
    reports: VecDeque<(Instant, IterationReport)>,
}

impl RecentIterations {
    /// Before the first iteration of a run of `total` environment steps.
    fn new(total: u64) -> Self {
        Self { total, begun: None, reports: VecDeque::new() }
    }

    /// Environment steps of finished iterations.
    fn env_steps(&self) -> u64 {
        self.reports.back().map_or(0, |(_, report)| report.env_steps)
    }

    /// Whether the last iteration is done.
    fn is_complete(&self) -> bool {
        self.env_steps() >= self.total
    }

    /// Keeps an iteration, or the start of the run.
    fn observe(&mut self, event: &Event, now: Instant) {
        match event {
            Event::Iteration(report) => {
                self.reports.push_back((now, report.clone()));
                if self.reports.len() > WINDOW {
                    self.reports.pop_front();
                }
            }
            Event::Collecting { env_steps, .. } if self.reports.is_empty() => {
                self.begun.get_or_insert((now, *env_steps));
            }
            _ => {}
        }
    }

    /// Speed, return, time left and phase shares, for the line under the bar: at most 80 columns.
    fn figures(&self) -> String {
        let mut parts = Vec::new();
        if let Some(speed) = self.steps_per_sec() {
            parts.push(format!("{} steps/s", chart::thousands(speed as u64)));
        }
        parts.push(self.episode_return());
        parts.extend(self.secs_left().map(|secs| format!("{} left", chart::duration(secs))));
        parts.push(self.phases());
        parts.join("  ")
    }

    /// The same as one plain line.
    fn line(&self) -> String {
        let percent = 100.0 * self.env_steps() as f64 / self.total.max(1) as f64;
        let done = chart::thousands(self.env_steps());
        let total = chart::thousands(self.total);
        format!("{done}/{total} steps ({percent:.1} %)  {}", self.figures())
    }

    fn steps_per_sec(&self) -> Option<f64> {
        let mut ends = self.reports.iter().map(|(end, report)| (*end, report.env_steps));
        let last = ends.next_back()?;
        let begun = self.begun.filter(|_| self.reports.len() < WINDOW);
        let first = begun.or_else(|| ends.next())?;
        let secs = last.0.duration_since(first.0).as_secs_f64();
        (secs > 0.0).then(|| last.1.saturating_sub(first.1) as f64 / secs)
    }

    fn secs_left(&self) -> Option<f64> {
        let speed = self.steps_per_sec()?;
        let left = self.total.saturating_sub(self.env_steps());
        (left > 0 && speed > 0.0).then(|| left as f64 / speed)
    }

    fn phases(&self) -> String {
        let sum = |secs: fn(&IterationReport) -> f64| {
            self.reports.iter().map(|(_, report)| secs(report)).sum::<f64>()
        };
        let (rollout, update) = (sum(|it| it.rollout_secs), sum(|it| it.update_secs));
        let share = 100.0 * rollout / (rollout + update).max(f64::MIN_POSITIVE);
        format!("roll out {share:.0} % update {:.0} %", 100.0 - share)
    }

    fn episode_return(&self) -> String {
        let last = self.reports.back().and_then(|(_, report)| report.episode_return);
        last.map_or_else(|| "return -".to_owned(), |last| format!("return {last:.1}"))
    }
}

/// The line of an evaluation.
fn evaluated(report: &EvaluationReport) -> String {
    let Spread { mean, standard_deviation, minimum, maximum } = report.spread;
    format!(
        "evaluation at {} steps: return {mean:.1} ± {standard_deviation:.1} ({minimum:.1} to {maximum:.1}, {})",
        chart::thousands(report.env_steps),
        chart::count_of(report.episodes as u64, "episode")
    )
}

/// How far a command is that works through a known amount.
pub(crate) struct WorkProgress(ProgressBar);

impl WorkProgress {
    /// Before any work.
    pub(crate) fn new() -> Self {
        let style = "{bar:24.cyan/black} {percent} %, {eta} left: {wide_msg}";
        Self(output::bars().add(styled(ProgressBar::new(0), style)))
    }

    /// `done` of `total` is done; `place` states which part of the work, such as `episode 3/10`.
    pub(crate) fn reach(&self, done: u64, total: u64, place: impl FnOnce() -> String) {
        if !self.0.is_hidden() {
            self.0.set_length(total);
            self.0.set_position(done);
            self.0.set_message(place());
        }
    }

    /// Prints a result on stdout, above the bar.
    pub(crate) fn print(&self, text: impl Display) {
        output::bars().suspend(|| output::line(text));
    }
}

impl Drop for WorkProgress {
    fn drop(&mut self) {
        self.0.finish_and_clear();
    }
}

fn styled(bar: ProgressBar, template: &str) -> ProgressBar {
    let style = ProgressStyle::with_template(template).expect("templates are well formed");
    bar.with_style(style.progress_chars("━╸─"))
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    fn iteration(iteration: u64, episode_return: Option<f64>) -> Event {
        Event::Iteration(IterationReport {
            iteration,
            env_steps: iteration * 4000,
            iteration_secs: 4.0,
            rollout_secs: 1.0,
            update_secs: 3.0,
            density_secs: 0.5,
            episode_return,
            actors: 2,
            messages_refused: 0,
            leases_reissued: 0,
            metrics: Vec::new(),
        })
    }

    #[test]
    fn a_line_tells_steps_speed_phases_return_and_time_left() {
        let start = Instant::now();
        let mut recent = RecentIterations::new(40_000);
        for k in 1..=4 {
            let event = iteration(k, Some(k as f64));
            recent.observe(&event, start + Duration::from_secs(4 * k));
        }
        assert_eq!(
            recent.line(),
            "16,000/40,000 steps (40.0 %)  1,000 steps/s  return 4.0  24s left  \
             roll out 25 % update 75 %"
        );
    }

    #[test]
    fn before_any_episode_has_ended_there_is_no_return() {
        let mut recent = RecentIterations::new(40_000);
        recent.observe(&iteration(1, None), Instant::now());
        assert!(recent.line().contains("return -"), "{}", recent.line());
    }

    #[test]
    fn the_line_of_an_evaluation_has_its_spread() {
        let spread =
            Spread { mean: 812.44, standard_deviation: 33.1, minimum: 760.0, maximum: 866.0 };
        let report = EvaluationReport {
            iteration: 25,
            env_steps: 100_000,
            spread,
            episodes: 10,
            sampled: false,
            metrics: Vec::new(),
        };
        assert_eq!(
            evaluated(&report),
            "evaluation at 100,000 steps: return 812.4 ± 33.1 (760.0 to 866.0, 10 episodes)"
        );
    }
}
