//! How far a run is, in words. Pure: time comes in from outside, text goes out.

use std::collections::VecDeque;
use std::time::Instant;

use learner::evaluation::Spread;
use learner::{Event, IterationReport};

use crate::figures::chart;

/// Iterations over which speed and phase shares are averaged.
const WINDOW: usize = 20;

/// Returns kept for the sparkline and the trend.
const HISTORY: usize = 40;

/// Characters of the sparkline.
const SPARKLINE: usize = 12;

/// What the last iterations were like.
pub(super) struct Standing {
    total: u64,
    env_steps: u64,
    /// Moment and env steps at the end of the last iterations.
    marks: VecDeque<(Instant, u64)>,
    rollout_secs: VecDeque<f64>,
    update_secs: VecDeque<f64>,
    returns: VecDeque<f64>,
}

impl Standing {
    /// Before the first iteration of a run of `total` env steps.
    pub(super) fn new(total: u64) -> Self {
        Self {
            total,
            env_steps: 0,
            marks: VecDeque::new(),
            rollout_secs: VecDeque::new(),
            update_secs: VecDeque::new(),
            returns: VecDeque::new(),
        }
    }

    /// Env steps of finished iterations.
    pub(super) fn env_steps(&self) -> u64 {
        self.env_steps
    }

    /// Whether the last iteration is done.
    pub(super) fn is_complete(&self) -> bool {
        self.env_steps >= self.total
    }

    /// Keeps what an event says.
    pub(super) fn take_in(&mut self, event: &Event, now: Instant) {
        match event {
            Event::Iteration(report) => self.iteration(report, now),
            // The first message of a run, before any iteration: speed counts from here.
            Event::Collecting { env_steps, .. } if self.marks.is_empty() => {
                self.marks.push_back((now, *env_steps));
            }
            _ => {}
        }
    }

    fn iteration(&mut self, report: &IterationReport, now: Instant) {
        self.env_steps = report.env_steps;
        keep(&mut self.marks, (now, report.env_steps), WINDOW);
        keep(&mut self.rollout_secs, report.rollout_secs, WINDOW);
        keep(&mut self.update_secs, report.update_secs, WINDOW);
        if let Some(episode_return) = report.episode_return {
            keep(&mut self.returns, episode_return, HISTORY);
        }
    }

    /// Speed, return, time left and phase shares, for the line under the bar: at most 80 columns.
    pub(super) fn figures(&self) -> String {
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
    pub(super) fn line(&self) -> String {
        let percent = 100.0 * self.env_steps as f64 / self.total.max(1) as f64;
        let (done, total) = (chart::thousands(self.env_steps), chart::thousands(self.total));
        format!("{done}/{total} steps ({percent:.1} %)  {}", self.figures())
    }

    fn steps_per_sec(&self) -> Option<f64> {
        let (first, last) = (self.marks.front()?, self.marks.back()?);
        let secs = last.0.duration_since(first.0).as_secs_f64();
        (secs > 0.0).then(|| last.1.saturating_sub(first.1) as f64 / secs)
    }

    fn secs_left(&self) -> Option<f64> {
        let speed = self.steps_per_sec()?;
        let left = self.total.saturating_sub(self.env_steps);
        (left > 0 && speed > 0.0).then(|| left as f64 / speed)
    }

    fn phases(&self) -> String {
        let (rollout, update) = (sum(&self.rollout_secs), sum(&self.update_secs));
        let share = 100.0 * rollout / (rollout + update).max(f64::MIN_POSITIVE);
        format!("roll out {share:.0} % update {:.0} %", 100.0 - share)
    }

    fn episode_return(&self) -> String {
        let returns: Vec<f64> = self.returns.iter().copied().collect();
        match returns.last() {
            None => "return -".to_owned(),
            Some(last) => {
                let spark = chart::sparkline(&returns, SPARKLINE);
                format!("return {last:.1} {} {spark}", chart::trend(&returns))
            }
        }
    }
}

/// The line of an event that is told at once.
pub(super) fn notice(event: &Event) -> Option<String> {
    match event {
        Event::Evaluation { env_steps, spread, episodes, .. } => {
            let Spread { mean, standard_deviation, minimum, maximum } = spread;
            Some(format!(
                "evaluation at {} steps: return {mean:.1} ± {standard_deviation:.1} \
                 ({minimum:.1} to {maximum:.1}, {episodes} episodes)",
                chart::thousands(*env_steps)
            ))
        }
        Event::Waiting { seconds, reason } => {
            Some(format!("waited {} so far: {reason}", chart::duration(*seconds)))
        }
        _ => None,
    }
}

fn keep<T>(values: &mut VecDeque<T>, value: T, limit: usize) {
    values.push_back(value);
    while values.len() > limit {
        values.pop_front();
    }
}

fn sum(values: &VecDeque<f64>) -> f64 {
    values.iter().sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

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
        let mut standing = Standing::new(40_000);
        for k in 1..=4 {
            let event = iteration(k, Some(k as f64));
            standing.take_in(&event, start + Duration::from_secs(4 * k));
        }
        assert_eq!(
            standing.line(),
            "16,000/40,000 steps (40.0 %)  1,000 steps/s  return 4.0 ↗ ▁▃▆█  24s left  \
             roll out 25 % update 75 %"
        );
    }

    #[test]
    fn before_any_episode_has_ended_there_is_no_return() {
        let mut standing = Standing::new(40_000);
        standing.take_in(&iteration(1, None), Instant::now());
        assert!(standing.line().contains("return -"), "{}", standing.line());
    }

    #[test]
    fn an_evaluation_is_told_with_its_spread() {
        let spread =
            Spread { mean: 812.44, standard_deviation: 33.1, minimum: 760.0, maximum: 866.0 };
        let event = Event::Evaluation { iteration: 25, env_steps: 100_000, spread, episodes: 10 };
        assert_eq!(
            notice(&event).as_deref(),
            Some("evaluation at 100,000 steps: return 812.4 ± 33.1 (760.0 to 866.0, 10 episodes)")
        );
    }
}
