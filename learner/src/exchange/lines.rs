//! The last lines of a run, for whoever watches it. A watcher that is slow or comes late misses the oldest; it holds
//! nobody up.

use std::collections::VecDeque;

use proto::{EvaluationSummary, RunEnd, RunLine};
use tokio::sync::watch;

use crate::event::{Event, IterationReport};
use crate::exchange::Exchange;

/// Lines that are kept; the oldest makes room.
const KEPT: usize = 256;

/// The last lines of a run.
#[derive(Debug, Default)]
pub struct Lines {
    run_id: String,
    kept: VecDeque<RunLine>,
    evaluation: Option<EvaluationSummary>,
}

impl Lines {
    /// Of a run of this name, none yet.
    #[must_use]
    pub fn new(run_id: String) -> Self {
        Self { run_id, ..Self::default() }
    }

    /// Keeps what an event says.
    fn take_in(&mut self, event: &Event) {
        match event {
            Event::Iteration(report) => self.push(self.of_iteration(report)),
            Event::Evaluation { iteration, spread, episodes, .. } => {
                self.evaluation = Some(EvaluationSummary {
                    iteration: *iteration,
                    mean: spread.mean,
                    standard_deviation: spread.standard_deviation,
                    episodes: *episodes as u32,
                });
            }
            _ => {}
        }
    }

    /// The last line: that of the newest iteration again, with the evaluation that came in since. Where there is none,
    /// `(iteration, env_steps)` is where the learner began.
    fn end(&mut self, end: RunEnd, begin: (u64, u64)) {
        let first = || RunLine::without_figures(self.run_id.clone(), begin.0, begin.1);
        let newest = self.kept.back().cloned().unwrap_or_else(first);
        self.push(RunLine { evaluation: self.evaluation, end: Some(end), ..newest });
    }

    /// Lines of later iterations than this, and the last one whatever its iteration.
    #[must_use]
    pub fn after(&self, iteration: u64) -> Vec<RunLine> {
        let news = |line: &&RunLine| line.iteration > iteration || line.end.is_some();
        self.kept.iter().filter(news).cloned().collect()
    }

    fn push(&mut self, line: RunLine) {
        self.kept.push_back(line);
        if self.kept.len() > KEPT {
            self.kept.pop_front();
        }
    }

    fn of_iteration(&self, report: &IterationReport) -> RunLine {
        RunLine {
            run_id: self.run_id.clone(),
            iteration: report.iteration,
            env_steps: report.env_steps,
            env_steps_per_sec: report.env_steps_per_sec(),
            episode_return: report.episode_return,
            evaluation: self.evaluation,
            end: None,
        }
    }
}

impl Exchange {
    /// Keeps what an event says for watchers.
    pub fn show(&self, event: &Event) {
        self.lines.send_modify(|lines| lines.take_in(event));
    }

    /// Tells watchers that no more lines come; `reached` are the run's iterations and their environment steps, where the
    /// trainer could still tell.
    pub fn show_end(&self, end: RunEnd, reached: Option<(u64, u64)>) {
        let status = self.status();
        let counted = (status.iteration, status.iteration * status.slots * self.slot_steps());
        self.lines.send_modify(|lines| lines.end(end, reached.unwrap_or(counted)));
    }

    /// The lines so far, and whenever they change.
    #[must_use]
    pub fn lines(&self) -> watch::Receiver<Lines> {
        self.lines.subscribe()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evaluation::Spread;

    fn iteration(iteration: u64) -> Event {
        Event::Iteration(IterationReport {
            iteration,
            env_steps: iteration * 4000,
            // An evaluation was waited for, too.
            iteration_secs: 2.0,
            rollout_secs: 1.0,
            update_secs: 0.5,
            density_secs: 0.1,
            episode_return: Some(iteration as f64),
            actors: 2,
            messages_refused: 0,
            leases_reissued: 0,
            metrics: Vec::new(),
        })
    }

    fn evaluation(iteration: u64) -> Event {
        let spread = Spread { mean: 10.0, standard_deviation: 1.0, minimum: 9.0, maximum: 11.0 };
        Event::Evaluation { iteration, env_steps: iteration * 4000, spread, episodes: 2 }
    }

    fn iterations(lines: &[RunLine]) -> Vec<u64> {
        lines.iter().map(|line| line.iteration).collect()
    }

    #[test]
    fn whoever_comes_back_gets_what_it_has_not_seen_and_the_end_in_any_case() {
        let mut lines = Lines::new("a run".to_owned());
        let events = [iteration(1), evaluation(1), iteration(2), iteration(3)];
        events.iter().for_each(|event| lines.take_in(event));
        assert_eq!(iterations(&lines.after(1)), [2, 3]);
        assert_eq!(lines.after(2)[0].env_steps_per_sec, 2000.0, "4,000 steps in two seconds");
        assert_eq!(
            lines.after(0).iter().map(|line| line.evaluation.is_some()).collect::<Vec<_>>(),
            [false, true, true]
        );
        lines.take_in(&evaluation(3));
        lines.end(RunEnd::Finished, (0, 0));
        let last = &lines.after(3)[0];
        assert_eq!((last.iteration, last.end), (3, Some(RunEnd::Finished)));
        assert_eq!(last.evaluation.map(|found| found.iteration), Some(3));
    }

    #[test]
    fn the_oldest_lines_make_room() {
        let mut lines = Lines::new("a run".to_owned());
        (1..=300).for_each(|k| lines.take_in(&iteration(k)));
        let kept = iterations(&lines.after(0));
        assert_eq!((kept.len(), kept[0], kept[255]), (KEPT, 45, 300));
    }

    #[test]
    fn a_learner_that_ends_before_its_first_iteration_has_a_last_line() {
        let mut lines = Lines::new("a run".to_owned());
        lines.end(RunEnd::Stopped, (5, 20_000));
        assert_eq!(iterations(&lines.after(7)), [5]);
    }
}
