//! Waiting for actors: rollouts, evaluation results, and what is told while nothing comes.

use std::time::{Duration, Instant};

use proto::WeightsName;

use crate::error::LearnerError;
use crate::evaluation::Spread;
use crate::event::{Event, Stage};
use crate::exchange::{EvaluationOutcome, SlotRollout, Wake};
use crate::snapshot::RunSnapshot;
use crate::trainer::Work;

/// How long the trainer waits before it looks whether it should stop.
const GLANCE: Duration = Duration::from_millis(100);

/// Stillness after which it is told what is missing, and told again.
const STILL: Duration = Duration::from_secs(10);

/// An iteration's rollouts and how long they took.
pub(super) struct Collected {
    /// Ordered by slot, all complete.
    pub(super) rollouts: Vec<SlotRollout>,
    /// From the opening of the slots to the last chunk.
    pub(super) secs: f64,
    /// The weights with which they were rolled out.
    pub(super) behaviour: WeightsName,
}

impl Work {
    /// The rollouts of the open iteration; `None` if the run is to stop instead.
    pub(super) fn collect(&mut self) -> Result<Option<Collected>, LearnerError> {
        self.enter(Stage::Collect);
        self.patience.begin(Instant::now());
        while !(self.outside.stop)() {
            if let Some(collected) = self.arrived.take() {
                return Ok(Some(collected));
            }
            self.wait()?;
        }
        Ok(None)
    }

    /// Waits for the evaluation that is still out, if there is one; false if the run is to stop first.
    pub(super) fn settle_evaluation(&mut self) -> Result<bool, LearnerError> {
        self.patience.begin(Instant::now());
        while self.trainer.evaluations.outstanding().is_some() {
            if (self.outside.stop)() {
                return Ok(false);
            }
            self.wait()?;
        }
        Ok(true)
    }

    fn wait(&mut self) -> Result<(), LearnerError> {
        if self.save_if_asked() {
            self.enter(Stage::Collect);
        }
        match self.outside.exchange.wait(GLANCE) {
            Wake::Iteration { rollouts, secs } => {
                let behaviour =
                    self.behaviour.expect("an iteration is opened before it is complete");
                self.arrived = Some(Collected { rollouts, secs, behaviour });
            }
            Wake::Evaluation(outcome) => self.take_evaluation(&outcome)?,
            Wake::Failed(error) => return Err(error.into()),
            Wake::Patience => self.report_progress(),
        }
        Ok(())
    }

    fn take_evaluation(&mut self, outcome: &EvaluationOutcome) -> Result<(), LearnerError> {
        let (iteration, episodes) = (outcome.iteration, outcome.episodes.len());
        let env_steps = self.trainer.steps_after(iteration);
        let returns = outcome.episodes.iter().map(|episode| episode.extrinsic_return);
        let spread = Spread::of(returns);
        self.trainer.metrics.evaluation(iteration, env_steps, &spread, episodes)?;
        self.trainer.evaluations.end(iteration);
        self.tell(&Event::Evaluation { iteration, env_steps, spread, episodes });
        Ok(())
    }

    fn report_progress(&mut self) {
        let now = self.outside.exchange.run_snapshot();
        let told = self.patience.look(Instant::now(), &now);
        if let Some(change) = told.change {
            self.tell(&change);
        }
        if told.moved && self.arrived.is_none() {
            let iteration = self.trainer.iteration;
            let env_steps = self.trainer.env_steps() + now.steps_collected;
            self.tell(&Event::Collecting { iteration, env_steps });
        }
        if let Some(waiting) = told.waiting {
            self.tell(&waiting);
        }
    }
}

/// Notices when nothing comes in.
pub(super) struct Patience {
    steps: u64,
    moved: Instant,
    told: Instant,
    paused: bool,
}

/// What a look at the progress showed.
pub(super) struct Look {
    /// Steps have come in since the last look.
    pub(super) moved: bool,
    /// What is missing, if nothing has come for long.
    pub(super) waiting: Option<Event>,
    /// That the run was paused or resumed, if it was.
    pub(super) change: Option<Event>,
}

impl Patience {
    /// From now on.
    pub(super) fn new(now: Instant) -> Self {
        Self { steps: 0, moved: now, told: now, paused: false }
    }

    /// The trainer waits from now on: what it did before, such as an update, is no stillness.
    fn begin(&mut self, now: Instant) {
        (self.moved, self.told) = (now, now);
    }

    /// Compares the run's figures with those of the last look.
    pub(super) fn look(&mut self, now: Instant, run: &RunSnapshot) -> Look {
        let (steps, paused) = (run.steps_collected, run.status.paused);
        let moved = steps != self.steps;
        let event = if paused { Event::Paused } else { Event::Resumed };
        let change = (paused != self.paused).then_some(event);
        (self.steps, self.paused) = (steps, paused);
        if moved || paused {
            // A pause is no stillness.
            self.begin(now);
        }
        let waiting =
            (now.duration_since(self.told) >= STILL).then(|| self.missing(now, run.status.actors));
        Look { moved, waiting, change }
    }

    /// What is missing; it is told again after as long a time.
    fn missing(&mut self, now: Instant, actors: u64) -> Event {
        self.told = now;
        let seconds = now.duration_since(self.moved).as_secs_f64();
        let reason = match actors {
            0 => "no actor is connected".to_owned(),
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

    fn progress(steps_collected: u64, actors: u64) -> RunSnapshot {
        let mut run = RunSnapshot::new("a run".to_owned(), Incarnation(1));
        (run.steps_collected, run.status.actors) = (steps_collected, actors);
        run
    }

    #[test]
    fn stillness_is_told_every_ten_seconds_with_what_is_missing() {
        let start = Instant::now();
        let mut patience = Patience::new(start);
        let mut look = |secs, progress| patience.look(start + Duration::from_secs(secs), &progress);
        assert!(look(1, progress(40, 2)).moved);
        assert_eq!(look(9, progress(40, 2)).waiting, None);
        let reason = "none of 2 actors has sent anything".to_owned();
        assert_eq!(
            look(11, progress(40, 2)).waiting,
            Some(Event::Waiting { seconds: 10.0, reason })
        );
        assert_eq!(look(20, progress(40, 2)).waiting, None);
        let reason = "no actor is connected".to_owned();
        assert_eq!(
            look(21, progress(40, 0)).waiting,
            Some(Event::Waiting { seconds: 20.0, reason })
        );
        assert!(look(22, progress(80, 1)).moved);
    }

    #[test]
    fn a_pause_is_told_when_it_begins_and_ends_and_is_no_stillness() {
        let start = Instant::now();
        let mut patience = Patience::new(start);
        let mut look = |secs, paused| {
            let mut run = progress(0, 2);
            run.status.paused = paused;
            let told = patience.look(start + Duration::from_secs(secs), &run);
            (told.change, told.waiting.is_some())
        };
        assert_eq!(look(1, true), (Some(Event::Paused), false));
        assert_eq!(look(100, true), (None, false));
        assert_eq!(look(101, false), (Some(Event::Resumed), false));
        assert_eq!(look(109, false), (None, false));
        assert_eq!(look(110, false), (None, true));
    }

    #[test]
    fn the_time_before_the_trainer_waits_is_no_stillness() {
        let start = Instant::now();
        let at = |secs| start + Duration::from_secs(secs);
        let mut patience = Patience::new(start);
        assert!(patience.look(at(1), &progress(40, 1)).moved);
        patience.begin(at(100));
        assert_eq!(patience.look(at(101), &progress(40, 1)).waiting, None);
        assert!(patience.look(at(110), &progress(40, 1)).waiting.is_some());
    }
}
