//! Schedules evaluations and stores the outstanding one in checkpoints. At most one evaluation is outstanding; its
//! result does not affect training.

use std::collections::BTreeMap;

use bytes::Bytes;
use policy::arrays::{Array, NamedArrays};

use crate::config::EvaluationConfig;
use crate::observe::metrics::{MeasuredReturn, Returns, returns};
use crate::store::checkpoint::{CheckpointError, fields};

const ITERATION: &str = "evaluation/iteration";
const POLICY: &str = "evaluation/policy";

/// The evaluations of a run.
#[derive(Debug)]
pub struct Evaluations {
    config: EvaluationConfig,
    steps_per_iteration: u64,
    last_iteration: u64,
    latest: Option<Evaluated>,
    /// The results that are in the metrics, in their order.
    measured: Vec<MeasuredReturn>,
    /// Replaces the schedule and the number of episodes.
    planned: Option<PlannedEvaluations>,
}

/// Number of episodes of each evaluation, by the iteration of the evaluated policies.
pub type PlannedEvaluations = BTreeMap<u64, u32>;

/// Policies whose evaluation has begun.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Evaluated {
    /// Finished iterations of these policies.
    pub iteration: u64,
    /// An encoded `policy::PolicySnapshot`.
    pub policy: Bytes,
}

impl Evaluations {
    /// The evaluations of a run of `last_iteration` iterations. `measured` are the results that are already in
    /// the metrics. There are exactly the `planned` ones, if any are planned.
    #[must_use]
    pub fn new(
        config: EvaluationConfig,
        steps_per_iteration: u64,
        last_iteration: u64,
        measured: Vec<MeasuredReturn>,
        planned: Option<PlannedEvaluations>,
    ) -> Self {
        Self { config, steps_per_iteration, last_iteration, latest: None, measured, planned }
    }

    /// Number of episodes of the evaluation of an iteration.
    #[must_use]
    pub fn episodes(&self, iteration: u64) -> u32 {
        let planned = self.planned.as_ref().and_then(|planned| planned.get(&iteration));
        planned.copied().unwrap_or(self.config.episodes)
    }

    /// Whether there are evaluations of the policies after `iteration` iterations at all.
    fn includes(&self, iteration: u64) -> bool {
        let usual = self.config.every_steps > 0;
        self.planned.as_ref().map_or(usual, |planned| planned.contains_key(&iteration))
    }

    /// Whether an evaluation of the policies after `iteration` iterations is due and has not begun.
    #[must_use]
    pub fn due(&self, iteration: u64) -> bool {
        let begun = self.latest.as_ref().is_some_and(|latest| latest.iteration == iteration);
        if !self.includes(iteration) || begun || self.is_measured(iteration) {
            return false;
        }
        if self.planned.is_some() {
            return true;
        }
        self.config.is_due(iteration, self.steps_per_iteration, self.last_iteration)
    }

    fn is_measured(&self, iteration: u64) -> bool {
        self.measured.iter().any(|measured| measured.iteration == iteration)
    }

    /// The results that can be compared with each other.
    pub(crate) fn returns(&self) -> Returns {
        returns(&self.measured)
    }

    /// The evaluation whose result is outstanding.
    #[must_use]
    pub fn outstanding(&self) -> Option<&Evaluated> {
        let pending = |latest: &&Evaluated| {
            self.includes(latest.iteration) && !self.is_measured(latest.iteration)
        };
        self.latest.as_ref().filter(pending)
    }

    /// Begins an evaluation.
    pub fn begin(&mut self, evaluated: Evaluated) {
        self.latest = Some(evaluated);
    }

    /// Ends the evaluation whose result is in the metrics.
    pub fn end(&mut self, measured: MeasuredReturn) {
        self.measured.push(measured);
    }

    /// The latest evaluation as arrays under `evaluation/`, finished or not. Whether it is finished depends on timing
    /// and is read from the metrics.
    #[must_use]
    pub fn arrays(&self) -> NamedArrays {
        let Some(latest) = &self.latest else { return NamedArrays::new() };
        let iteration = Array::I64 { shape: vec![1], data: vec![latest.iteration as i64] };
        let shape = vec![latest.policy.len()];
        let data = latest.policy.to_vec();
        [(ITERATION.to_owned(), iteration), (POLICY.to_owned(), Array::U8 { shape, data })].into()
    }

    /// Restores the state that [`Self::arrays`] returned.
    ///
    /// # Errors
    /// An array is missing or has the wrong type.
    pub fn restore(&mut self, arrays: &NamedArrays) -> Result<(), CheckpointError> {
        if !arrays.contains_key(ITERATION) {
            return Ok(());
        }
        let iteration = fields::one_count(arrays, ITERATION)?;
        let policy = Bytes::copy_from_slice(fields::bytes(arrays, POLICY)?);
        self.latest = Some(Evaluated { iteration, policy });
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn evaluations(every_steps: u64) -> Evaluations {
        let config = EvaluationConfig { every_steps, episodes: 2, sampled: false };
        Evaluations::new(config, 4000, 30, Vec::new(), None)
    }

    #[test]
    fn the_start_the_end_and_every_multiple_are_due_once() {
        let mut all = evaluations(50_000);
        let due: Vec<u64> = (0..=30).filter(|iteration| all.due(*iteration)).collect();
        // 13 x 4,000 = 52,000 is the first above 50,000; 25 x 4,000 = 100,000 is exactly a multiple.
        assert_eq!(due, [0, 13, 25, 30]);
        all.begin(Evaluated { iteration: 13, policy: Bytes::new() });
        assert!(!all.due(13));
        assert_eq!((0..=30).filter(|iteration| evaluations(0).due(*iteration)).count(), 0);
    }

    #[test]
    fn planned_evaluations_replace_the_schedule() {
        let plan = Some([(3, 5), (7, 2)].into());
        let mut planned = Evaluations { planned: plan, ..evaluations(0) };
        assert_eq!((0..=30).filter(|it| planned.due(*it)).collect::<Vec<_>>(), [3, 7]);
        assert_eq!((planned.episodes(3), planned.episodes(7)), (5, 2));
        planned.begin(Evaluated { iteration: 7, policy: Bytes::new() });
        assert!(planned.outstanding().is_some());
        planned.begin(Evaluated { iteration: 8, policy: Bytes::new() });
        assert!(planned.outstanding().is_none(), "a checkpoint's own one that is not planned");
    }
}
