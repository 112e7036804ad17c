//! Waits for rollouts and evaluation results, and reports progress meanwhile.

use std::time::{Duration, Instant};

use proto::WeightsName;

use crate::error::LearnerError;
use crate::lease::exchange::Wake;
use crate::lease::slots::{EvaluationOutcome, SlotRollout};
use crate::observe::event::{EvaluationReport, Event, Spread, Stage};
use crate::observe::metrics::MeasuredReturn;
use crate::observe::snapshot::RunSnapshot;
use crate::train::reward_terms;
use crate::train::trainer::RunningTrainer;

/// Interval at which the trainer checks whether to stop.
const POLL_INTERVAL: Duration = Duration::from_millis(100);

/// Interval of reports while no results arrive.
const REPORT_INTERVAL: Duration = Duration::from_secs(10);

/// The rollouts of an iteration.
pub(super) struct Collected {
    /// Complete rollouts, ordered by slot.
    pub(super) rollouts: Vec<SlotRollout>,
    /// Seconds from the opening of the slots to the last chunk.
    pub(super) secs: f64,
    /// The weights used for the rollouts.
    pub(super) behaviour: WeightsName,
}

impl RunningTrainer {
    /// Waits for the rollouts of the open iteration; `None` if the run must stop.
    pub(super) fn collect(&mut self) -> Result<Option<Collected>, LearnerError> {
        self.emit(&Event::Stage(Stage::Collect));
        self.progress.begin(Instant::now());
        while !(self.outside.stop)() {
            if let Some(collected) = self.arrived.take() {
                return Ok(Some(collected));
            }
            self.wait()?;
        }
        Ok(None)
    }

    /// Waits for the outstanding evaluation, if any; false if the run must stop first.
    pub(super) fn settle_evaluation(&mut self) -> Result<bool, LearnerError> {
        self.progress.begin(Instant::now());
        while self.trainer.evaluations.outstanding().is_some() {
            if (self.outside.stop)() {
                return Ok(false);
            }
            self.wait()?;
        }
        Ok(true)
    }

    fn wait(&mut self) -> Result<(), LearnerError> {
        self.trainer.folder.demand_in_place()?;
        match self.outside.exchange.wait(POLL_INTERVAL) {
            Wake::Iteration { rollouts, secs } => {
                let behaviour =
                    self.behaviour.expect("an iteration is opened before it is complete");
                self.arrived = Some(Collected { rollouts, secs, behaviour });
            }
            Wake::Evaluation(outcome) => self.take_evaluation(&outcome)?,
            Wake::BeginAgain(slot) => self.begin_again(&slot),
            Wake::Failed(error) => return Err(error.into()),
            Wake::Timeout => self.report_progress(),
        }
        Ok(())
    }

    fn take_evaluation(&mut self, outcome: &EvaluationOutcome) -> Result<(), LearnerError> {
        let iteration = outcome.iteration;
        let names = &self.outside.exchange.run.environment.reward_terms;
        let terms: Vec<&[f64]> =
            outcome.episodes.iter().map(|episode| episode.reward_terms.as_slice()).collect();
        let returns = outcome.episodes.iter().map(|episode| episode.extrinsic_return);
        let report = EvaluationReport {
            iteration,
            env_steps: self.trainer.steps_after(iteration),
            spread: Spread::of(returns),
            episodes: outcome.episodes.len(),
            sampled: self.trainer.launch.config.evaluation.sampled,
            metrics: reward_terms::means_per_episode(names, &terms),
        };
        self.trainer.metrics.evaluation(&report)?;
        self.trainer.evaluations.end(MeasuredReturn::of(&report));
        self.emit(&Event::Evaluation(report));
        Ok(())
    }

    fn report_progress(&mut self) {
        let now = self.outside.exchange.run_snapshot();
        let progress = self.progress.update(Instant::now(), &now);
        if progress.new_steps && self.arrived.is_none() {
            let iteration = self.trainer.iteration;
            let env_steps = self.trainer.env_steps() + now.steps_collected;
            self.emit(&Event::Collecting { iteration, env_steps });
        }
        if let Some(waiting) = progress.waiting {
            self.emit(&waiting);
        }
    }
}

/// Detects that no results arrive.
pub(super) struct ProgressMonitor {
    steps: u64,
    last_steps: Instant,
    last_report: Instant,
}

/// Progress since the previous update.
pub(super) struct CollectionProgress {
    /// Whether steps have arrived.
    pub(super) new_steps: bool,
    /// [`Event::Waiting`] if no results have arrived for long.
    pub(super) waiting: Option<Event>,
}

impl ProgressMonitor {
    /// A monitor that starts at `now`.
    pub(super) fn new(now: Instant) -> Self {
        Self { steps: 0, last_steps: now, last_report: now }
    }

    /// Restarts the monitor when the trainer begins to wait, so that an update does not count as waiting.
    fn begin(&mut self, now: Instant) {
        (self.last_steps, self.last_report) = (now, now);
    }

    /// Compares the run's figures with those of the previous update.
    pub(super) fn update(&mut self, now: Instant, run: &RunSnapshot) -> CollectionProgress {
        let new_steps = run.steps_collected != self.steps;
        self.steps = run.steps_collected;
        if new_steps {
            self.begin(now);
        }
        let due = now.duration_since(self.last_report) >= REPORT_INTERVAL;
        let waiting = due.then(|| self.report(now, run.status.actors));
        CollectionProgress { new_steps, waiting }
    }

    /// The reason why no results arrive.
    fn report(&mut self, now: Instant, actors: u64) -> Event {
        self.last_report = now;
        let seconds = now.duration_since(self.last_steps).as_secs_f64();
        let reason = match actors {
            0 => "no actor is connected; the logs of the actors may have the reason".to_owned(),
            1 => "the one actor has sent nothing".to_owned(),
            actors => format!("none of {actors} actors has sent anything"),
        };
        Event::Waiting { seconds, reason }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proto::Incarnation;

    fn run(steps_collected: u64, actors: u64) -> RunSnapshot {
        let mut run = RunSnapshot::new("a run".to_owned(), Incarnation(1));
        (run.steps_collected, run.status.actors) = (steps_collected, actors);
        run
    }

    #[test]
    fn a_lack_of_results_is_reported_every_ten_seconds_with_its_reason() {
        let start = Instant::now();
        let mut monitor = ProgressMonitor::new(start);
        let mut update = |secs, run| monitor.update(start + Duration::from_secs(secs), &run);
        assert!(update(1, run(40, 2)).new_steps);
        assert_eq!(update(9, run(40, 2)).waiting, None);
        let reason = "none of 2 actors has sent anything".to_owned();
        assert_eq!(update(11, run(40, 2)).waiting, Some(Event::Waiting { seconds: 10.0, reason }));
        assert_eq!(update(20, run(40, 2)).waiting, None);
        let reason = "no actor is connected; the logs of the actors may have the reason".to_owned();
        assert_eq!(update(21, run(40, 0)).waiting, Some(Event::Waiting { seconds: 20.0, reason }));
        assert!(update(22, run(80, 1)).new_steps);
    }

    #[test]
    fn the_time_before_the_trainer_waits_does_not_count() {
        let start = Instant::now();
        let at = |secs| start + Duration::from_secs(secs);
        let mut monitor = ProgressMonitor::new(start);
        assert!(monitor.update(at(1), &run(40, 1)).new_steps);
        monitor.begin(at(100));
        assert_eq!(monitor.update(at(101), &run(40, 1)).waiting, None);
        assert!(monitor.update(at(110), &run(40, 1)).waiting.is_some());
    }
}
