//! The current figures of a run. The exchange publishes them; status, page, metrics and watchers read them.

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

use proto::{
    EvaluationResult, EvaluationSummary, Film, Incarnation, PolicyVersion, RunEnd, RunLine, Status,
};

use crate::observe::event::{Event, IterationReport, Stage, WrittenCheckpoint};

/// Lines kept for watchers that are slow or connect late; the oldest is dropped.
const KEPT_LINES: usize = 256;
/// Films kept for the page; a film has at most 0.62 MB.
const KEPT_FILMS: usize = 16;

/// Results of all audits so far, of slots and of episodes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct AuditCounts {
    /// Both results were equal.
    pub agreed: u64,
    /// The results differed; the run stops at the first.
    pub disagreed: u64,
    /// No other actor had time for it.
    pub skipped: u64,
}

/// The figures of a run. Counts start with the learner's process.
#[derive(Clone, Debug, Default)]
pub struct RunSnapshot {
    /// Figures that the control service reports, open leases included.
    pub status: Status,
    /// The trainer's current stage.
    pub stage: Stage,
    /// What is missing while no results arrive.
    pub waiting: Option<String>,
    /// Environment steps accepted in the open iteration, those of incomplete slots included.
    pub steps_collected: u64,
    /// Chunks accepted.
    pub chunks_accepted: u64,
    /// Size of all messages with results, bytes.
    pub bytes_received: u64,
    /// Steps that the actors' trajectory logs lost.
    pub log_steps_lost: u64,
    /// Size of the newest weights, bytes.
    pub weights_bytes: u64,
    /// Slots of the open iteration that are leased.
    pub held_slots: u64,
    /// Results of all audits.
    pub audits: AuditCounts,
    /// Median time from lease to result of the latest slots, for each environment of a slot, seconds.
    pub slot_secs: Option<f64>,
    /// Actors without a fingerprint whose results count: with any, the run is not exactly repeatable.
    pub foreign_actors: u64,
    /// Refused messages by reason.
    pub refusals: BTreeMap<String, u64>,
    /// The last finished iteration.
    pub report: Option<IterationReport>,
    /// The last finished evaluation.
    pub evaluation: Option<EvaluationSummary>,
    /// The last checkpoint.
    pub checkpoint: Option<WrittenCheckpoint>,
    /// Checkpoints that could not be written.
    pub checkpoint_failures: u64,
    /// Episodes truncated because of a fault of their environment.
    pub environment_faults: u64,
    /// Updates that were skipped because returns were not finite.
    pub updates_skipped: u64,
    /// Films of the newest evaluations, in the order of their policies.
    pub films: Vec<Arc<FilmedEpisode>>,
    lines: VecDeque<RunLine>,
}

/// A film of an evaluation episode.
#[derive(Clone, Debug, PartialEq)]
pub struct FilmedEpisode {
    /// The policies that acted.
    pub version: PolicyVersion,
    /// The episode's result.
    pub result: EvaluationResult,
    /// The episode's first frames.
    pub film: Film,
}

impl RunSnapshot {
    /// A run whose trainer has not started.
    #[must_use]
    pub fn new(run_id: String, incarnation: Incarnation) -> Self {
        let status = Status { run_id, incarnation, ..Status::default() };
        Self { status, ..Self::default() }
    }

    /// Lines of iterations after `iteration`, and the run's last line in any case.
    #[must_use]
    pub fn after(&self, iteration: u64) -> Vec<RunLine> {
        let new = |line: &&RunLine| line.iteration > iteration || line.end.is_some();
        self.lines.iter().filter(new).cloned().collect()
    }

    /// Duration of each part of the last iteration, seconds. A checkpoint belongs to the iteration that it saves.
    pub(crate) fn phase_secs(&self) -> Option<[(&'static str, f64); 4]> {
        let report = self.report.as_ref()?;
        let saved = self.checkpoint.filter(|written| written.iteration == report.iteration);
        Some([
            ("collect", report.rollout_secs),
            ("refit", report.density_secs),
            ("update", report.update_secs - report.density_secs),
            ("save", saved.map_or(0.0, |written| written.secs)),
        ])
    }

    /// Updates the figures that `event` reports.
    pub(crate) fn observe(&mut self, event: &Event) {
        match event {
            Event::Stage(stage) => self.stage = *stage,
            Event::Iteration(report) => self.iteration(report),
            Event::Collecting { .. } => self.waiting = None,
            Event::Waiting { reason, .. } => self.waiting = Some(reason.clone()),
            Event::Checkpoint(written) => self.checkpoint = Some(*written),
            Event::CheckpointFailed { .. } => self.checkpoint_failures += 1,
            Event::Evaluation(report) => {
                self.evaluation = Some(EvaluationSummary {
                    iteration: report.iteration,
                    mean: report.spread.mean,
                    standard_deviation: report.spread.standard_deviation,
                    episodes: report.episodes as u32,
                });
            }
        }
    }

    /// Whether the run has its last line.
    pub(crate) fn has_ended(&self) -> bool {
        self.lines.back().is_some_and(|line| line.end.is_some())
    }

    /// Adds the run's last line: the newest one, or `first` if there is none, with the last evaluation.
    pub(crate) fn end(&mut self, end: RunEnd, first: RunLine) {
        let newest = self.lines.back().cloned().unwrap_or(first);
        self.push(RunLine { evaluation: self.evaluation, end: Some(end), ..newest });
    }

    /// Keeps the film of an accepted episode, and of all films those of the newest policies.
    pub(crate) fn show_film(&mut self, filmed: FilmedEpisode) {
        self.films.retain(|shown| shown.version != filmed.version);
        let place = self.films.partition_point(|shown| shown.version < filmed.version);
        self.films.insert(place, Arc::new(filmed));
        if self.films.len() > KEPT_FILMS {
            self.films.remove(0);
        }
    }

    fn iteration(&mut self, report: &IterationReport) {
        self.waiting = None;
        self.environment_faults += count(report, "environment_faults");
        self.updates_skipped += count(report, "losses/update_skipped");
        self.push(RunLine {
            run_id: self.status.run_id.clone(),
            iteration: report.iteration,
            env_steps: report.env_steps,
            env_steps_per_sec: report.env_steps_per_sec(),
            episode_return: report.episode_return,
            evaluation: self.evaluation,
            end: None,
        });
        self.report = Some(report.clone());
    }

    fn push(&mut self, line: RunLine) {
        self.lines.push_back(line);
        if self.lines.len() > KEPT_LINES {
            self.lines.pop_front();
        }
    }
}

/// An integer figure of an iteration; 0 if it is missing.
fn count(report: &IterationReport, name: &str) -> u64 {
    let found = report.metrics.iter().find(|(figure, _)| figure == name);
    found.map_or(0, |(_, value)| *value as u64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::observe::event::{EvaluationReport, Spread};

    fn run() -> RunSnapshot {
        RunSnapshot::new("a run".to_owned(), Incarnation(1))
    }

    fn iteration(iteration: u64) -> Event {
        Event::Iteration(IterationReport {
            iteration,
            env_steps: iteration * 4000,
            // Longer than rollout and update: the iteration also waited for an evaluation.
            iteration_secs: 2.0,
            rollout_secs: 1.0,
            update_secs: 0.5,
            ..IterationReport::default()
        })
    }

    fn evaluation(iteration: u64) -> Event {
        let spread = Spread { mean: 10.0, standard_deviation: 1.0, minimum: 9.0, maximum: 11.0 };
        let env_steps = iteration * 4000;
        Event::Evaluation(EvaluationReport {
            iteration,
            env_steps,
            spread,
            episodes: 2,
            sampled: false,
            metrics: Vec::new(),
        })
    }

    fn iterations(lines: &[RunLine]) -> Vec<u64> {
        lines.iter().map(|line| line.iteration).collect()
    }

    #[test]
    fn a_watcher_that_returns_gets_each_new_line_and_the_last_line_in_any_case() {
        let mut run = run();
        let events = [iteration(1), evaluation(1), iteration(2), iteration(3)];
        events.iter().for_each(|event| run.observe(event));
        assert_eq!(iterations(&run.after(1)), [2, 3]);
        assert_eq!(run.after(2)[0].env_steps_per_sec, 2000.0, "4,000 steps in two seconds");
        assert_eq!(
            run.after(0).iter().map(|line| line.evaluation.is_some()).collect::<Vec<_>>(),
            [false, true, true]
        );
        run.observe(&evaluation(3));
        assert!(!run.has_ended());
        run.end(RunEnd::Finished, RunLine::default());
        assert!(run.has_ended());
        let last = &run.after(3)[0];
        assert_eq!((last.iteration, last.end), (3, Some(RunEnd::Finished)));
        assert_eq!(last.evaluation.map(|found| found.iteration), Some(3));
    }

    #[test]
    fn the_oldest_lines_are_dropped() {
        let mut run = run();
        (1..=300).for_each(|k| run.observe(&iteration(k)));
        let kept = iterations(&run.after(0));
        assert_eq!((kept.len(), kept[0], kept[255]), (KEPT_LINES, 45, 300));
    }

    #[test]
    fn a_learner_that_ends_before_its_first_iteration_has_a_last_line() {
        let mut run = run();
        run.end(RunEnd::Stopped, RunLine { iteration: 5, env_steps: 20_000, ..RunLine::default() });
        assert_eq!(iterations(&run.after(7)), [5]);
    }
}
